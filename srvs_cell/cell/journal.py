"""What the cell did, on disk before it does it: SQLite in WAL mode, one writer thread.

Every command, transition, step, artefact, plan, alarm and motion is an entry. A motion is recorded twice: its intent
before the arm or the gripper is asked, its outcome afterwards. What a crash or a power loss leaves behind is therefore
known at the next start: an intent without outcome, or a part in the gripper, means that a person has to look.
"""

from __future__ import annotations

import asyncio
import json
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from typing import TYPE_CHECKING, Any, TypeVar

from srvs_cell.alarms import Alarm, AlarmError

if TYPE_CHECKING:
    from asyncio import Future
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

T = TypeVar("T")
Json = dict[str, Any]

SCHEMA_VERSION = 1
JOB_PLACES = "job_places"
"""Kind of the events that say on which places an unfinished job stands; the newest counts, without detail: on none."""
_JSON_COLUMNS = ("detail", "result")
_SCHEMA = """
CREATE TABLE runs (
    id INTEGER PRIMARY KEY, started_at TEXT NOT NULL, ended_at TEXT, mode TEXT NOT NULL, outcome TEXT, directory TEXT
);
CREATE TABLE events (
    id INTEGER PRIMARY KEY, at TEXT NOT NULL, run INTEGER, kind TEXT NOT NULL, name TEXT NOT NULL,
    source TEXT NOT NULL, detail TEXT NOT NULL
);
CREATE TABLE motions (
    id INTEGER PRIMARY KEY, at TEXT NOT NULL, run INTEGER, kind TEXT NOT NULL, detail TEXT NOT NULL,
    ended_at TEXT, outcome TEXT, result TEXT
);
CREATE TABLE alarms (
    id INTEGER PRIMARY KEY, at TEXT NOT NULL, run INTEGER, code INTEGER NOT NULL, name TEXT NOT NULL,
    detail TEXT NOT NULL, cleared_at TEXT
);
CREATE TABLE gripper (id INTEGER PRIMARY KEY CHECK (id = 1), at TEXT NOT NULL, knowledge TEXT NOT NULL, held TEXT);
CREATE INDEX open_motions ON motions (id) WHERE outcome IS NULL;
"""


class GripperKnowledge(StrEnum):
    """What is known to be in the gripper."""

    EMPTY = "empty"
    HOLDING = "holding"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class LeftOver:
    """What the last process left behind.

    Attributes:
        motions: intents without outcome, oldest first.
        knowledge: what was known of the gripper; None in a new journal.
        held: what it held, where it held something.
        job_places: of a job that was not finished; None where there is none.
    """

    motions: tuple[Json, ...]
    knowledge: GripperKnowledge | None
    held: Json | None
    job_places: Json | None = None

    @property
    def unresolved(self) -> str:
        """Why a person has to look before anything moves, or an empty string."""
        if self.motions:
            last = self.motions[-1]
            return f"{last['kind']} was begun at {last['at']} and its outcome was never recorded."
        if self.knowledge is GripperKnowledge.HOLDING:
            return "a part was in the gripper."
        if self.knowledge is GripperKnowledge.UNKNOWN:
            return "it was not known what the gripper held."
        return ""


def utc_now() -> datetime:
    """Return the time of day."""
    return datetime.now(UTC)


class Journal:
    """The journal file. One thread does the work, in the order of the calls.

    Methods hand their work to the thread before they return: whoever need not wait still has a place in the order.
    What they return is awaited for the result; it raises `AlarmError` JOURNAL_FAILED where the file cannot be written
    or read.
    """

    def __init__(self, path: Path, now: Callable[[], datetime] = utc_now) -> None:
        self.path = path
        self._now = now
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="journal")
        self._connection: sqlite3.Connection | None = None
        self._closed = False

    @property
    def is_open(self) -> bool:
        """Whether the file could be opened."""
        return self._connection is not None

    def open(self) -> Future[LeftOver]:
        """Open or make the file and return what the last process left behind."""
        return self._do(self._open)

    async def close(self) -> None:
        """Close the file; the journal cannot be used afterwards. A second time changes nothing."""
        if self._closed:
            return
        try:
            await self._do(self._close)
        finally:
            self._closed = True
            self._thread.shutdown(wait=False)

    def begin_run(self, mode: str, directory: str) -> Future[int]:
        """Record that a job begins and return its number. ``directory`` may hold ``{run}``."""

        def write(connection: sqlite3.Connection) -> int:
            cursor = connection.execute("INSERT INTO runs (started_at, mode) VALUES (?, ?)", (self._time(), mode))
            run = int(cursor.lastrowid or 0)
            connection.execute("UPDATE runs SET directory = ? WHERE id = ?", (directory.format(run=run), run))
            return run

        return self._write(write)

    def end_run(self, run: int, outcome: str) -> Future[None]:
        """Record how a job ended."""

        def write(connection: sqlite3.Connection) -> None:
            connection.execute("UPDATE runs SET ended_at = ?, outcome = ? WHERE id = ?", (self._time(), outcome, run))

        return self._write(write)

    def event(self, kind: str, name: str, *, run: int | None, source: str, detail: Mapping[str, Any]) -> Future[None]:
        """Record a command, transition, mode, step, artefact, plan, resolution or device event."""
        text = json.dumps(detail)

        def write(connection: sqlite3.Connection) -> None:
            connection.execute(
                "INSERT INTO events (at, run, kind, name, source, detail) VALUES (?, ?, ?, ?, ?, ?)",
                (self._time(), run, kind, name, source, text),
            )

        return self._write(write)

    def intend(self, kind: str, detail: Mapping[str, Any], *, run: int | None) -> Future[int]:
        """Record that a motion is about to be commanded, and return its number. It is on disk when this returns."""
        text = json.dumps(detail)

        def write(connection: sqlite3.Connection) -> int:
            cursor = connection.execute(
                "INSERT INTO motions (at, run, kind, detail) VALUES (?, ?, ?, ?)", (self._time(), run, kind, text)
            )
            return int(cursor.lastrowid or 0)

        return self._write(write)

    def outcome(
        self,
        motion: int,
        outcome: str,
        result: Mapping[str, Any],
        gripper: tuple[GripperKnowledge, Json | None] | None = None,
    ) -> Future[None]:
        """Record what became of a motion and, in the same transaction, what the gripper holds since."""
        text = json.dumps(result)

        def write(connection: sqlite3.Connection) -> None:
            connection.execute(
                "UPDATE motions SET ended_at = ?, outcome = ?, result = ? WHERE id = ?",
                (self._time(), outcome, text, motion),
            )
            if gripper is not None:
                self._write_gripper(connection, *gripper)

        return self._write(write)

    def resolve(self, knowledge: GripperKnowledge, held: Json | None, source: str) -> Future[None]:
        """Record what a person says of the gripper; closes every open intent."""

        def write(connection: sqlite3.Connection) -> None:
            connection.execute(
                "UPDATE motions SET ended_at = ?, outcome = 'resolved', result = ? WHERE outcome IS NULL",
                (self._time(), json.dumps({"source": source})),
            )
            self._write_gripper(connection, knowledge, held)

        return self._write(write)

    def raise_alarm(self, alarm: Alarm, detail: str, *, run: int | None) -> Future[int]:
        """Record an alarm and return its number."""

        def write(connection: sqlite3.Connection) -> int:
            cursor = connection.execute(
                "INSERT INTO alarms (at, run, code, name, detail) VALUES (?, ?, ?, ?, ?)",
                (self._time(), run, alarm.code, alarm.name, detail),
            )
            return int(cursor.lastrowid or 0)

        return self._write(write)

    def clear_alarms(self, codes: Sequence[int]) -> Future[None]:
        """Record that the alarms of these codes are not active any more."""

        def write(connection: sqlite3.Connection) -> None:
            connection.executemany(
                "UPDATE alarms SET cleared_at = ? WHERE code = ? AND cleared_at IS NULL",
                [(self._time(), code) for code in codes],
            )

        return self._write(write)

    def history(self, limit: int = 100, run: int | None = None) -> Future[list[Json]]:
        """Return the newest events, newest first, of one run or of all."""
        query = "SELECT * FROM events WHERE ?1 IS NULL OR run = ?1 ORDER BY id DESC LIMIT ?2"
        return self._read(query, (run, limit))

    def motions(self, limit: int = 100, run: int | None = None) -> Future[list[Json]]:
        """Return the newest motions, newest first, of one run or of all."""
        query = "SELECT * FROM motions WHERE ?1 IS NULL OR run = ?1 ORDER BY id DESC LIMIT ?2"
        return self._read(query, (run, limit))

    def alarms(self, limit: int = 100) -> Future[list[Json]]:
        """Return the newest alarms, newest first."""
        return self._read("SELECT * FROM alarms ORDER BY id DESC LIMIT ?", (limit,), ())

    async def unresolved_runs(self) -> frozenset[int]:
        """Return the runs whose motions have an intent without outcome."""
        rows = await self._read("SELECT DISTINCT run FROM motions WHERE outcome IS NULL AND run IS NOT NULL", (), ())
        return frozenset(int(row["run"]) for row in rows)

    def runs(self, limit: int = 100) -> Future[list[Json]]:
        """Return the newest runs, newest first."""
        return self._read("SELECT * FROM runs ORDER BY id DESC LIMIT ?", (limit,), ())

    def _time(self) -> str:
        return self._now().isoformat(timespec="milliseconds")

    def _open(self) -> LeftOver:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        connection = sqlite3.connect(self.path, isolation_level=None)
        connection.row_factory = sqlite3.Row
        connection.execute("PRAGMA journal_mode = WAL")
        # FULL: an intent that is "on disk" must survive a power loss, not only a crash of this process.
        connection.execute("PRAGMA synchronous = FULL")
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        if version == 0:
            connection.executescript(f"BEGIN; {_SCHEMA} PRAGMA user_version = {SCHEMA_VERSION}; COMMIT;")
        elif version != SCHEMA_VERSION:
            connection.close()
            raise AlarmError(
                Alarm.JOURNAL_FAILED,
                f"{self.path} has schema version {version}, this software writes {SCHEMA_VERSION}; move it away.",
            )
        self._connection = connection
        open_motions = _rows(connection.execute("SELECT * FROM motions WHERE outcome IS NULL ORDER BY id"))
        row = connection.execute("SELECT knowledge, held FROM gripper").fetchone()
        knowledge, held = (None, None) if row is None else (GripperKnowledge(row["knowledge"]), row["held"])
        newest = "SELECT detail FROM events WHERE kind = ? ORDER BY id DESC LIMIT 1"
        places = connection.execute(newest, (JOB_PLACES,)).fetchone()
        return LeftOver(
            tuple(open_motions),
            knowledge,
            None if held is None else json.loads(held),
            None if places is None else json.loads(places["detail"]) or None,
        )

    def _close(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _write_gripper(self, connection: sqlite3.Connection, knowledge: GripperKnowledge, held: Json | None) -> None:
        connection.execute(
            "INSERT INTO gripper (id, at, knowledge, held) VALUES (1, ?, ?, ?) "
            "ON CONFLICT (id) DO UPDATE SET at = excluded.at, knowledge = excluded.knowledge, held = excluded.held",
            (self._time(), knowledge.value, None if held is None else json.dumps(held)),
        )

    def _write(self, write: Callable[[sqlite3.Connection], T]) -> Future[T]:
        def transaction() -> T:
            connection = self._opened()
            with connection:
                connection.execute("BEGIN IMMEDIATE")
                return write(connection)

        return self._do(transaction)

    def _read(
        self, query: str, arguments: tuple[Any, ...], json_columns: tuple[str, ...] = _JSON_COLUMNS
    ) -> Future[list[Json]]:
        return self._do(lambda: _rows(self._opened().execute(query, arguments), json_columns))

    def _opened(self) -> sqlite3.Connection:
        if self._connection is None:
            raise sqlite3.ProgrammingError("the journal is not open")
        return self._connection

    def _do(self, work: Callable[[], T]) -> Future[T]:
        def guarded() -> T:
            try:
                return work()
            except (sqlite3.Error, OSError) as error:
                raise AlarmError(Alarm.JOURNAL_FAILED, f"{self.path}: {error}.") from error

        loop = asyncio.get_running_loop()
        if self._closed:
            refused: Future[T] = loop.create_future()
            refused.set_exception(AlarmError(Alarm.JOURNAL_FAILED, f"{self.path} is closed."))
            return refused
        return loop.run_in_executor(self._thread, guarded)


def _rows(cursor: sqlite3.Cursor, json_columns: tuple[str, ...] = _JSON_COLUMNS) -> list[Json]:
    rows = [dict(row) for row in cursor.fetchall()]
    for row in rows:
        row.update({column: json.loads(row[column]) for column in json_columns if row.get(column) is not None})
    return rows
