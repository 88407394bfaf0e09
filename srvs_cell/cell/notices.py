"""What has changed: who waits for it, which alarms are active, and what the journal is told of both."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, TypeVar

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell.alarm_list import AlarmList

if TYPE_CHECKING:
    from asyncio import Future
    from collections.abc import Callable, Mapping
    from datetime import datetime

    from srvs_cell.cell.journal import Journal
    from srvs_cell.ports import Clock

T = TypeVar("T")

CELL = "cell"
"""The source of what the cell does by itself, in the journal."""

_COMMUNICATION = frozenset(
    {
        Alarm.CONNECTION_REFUSED,
        Alarm.CONNECTION_TIMEOUT,
        Alarm.CONNECTION_LOST,
        Alarm.HEARTBEAT_LOST,
        Alarm.PROTOCOL_ERROR,
        Alarm.PROTOCOL_VERSION,
        Alarm.DEVICE_UNAVAILABLE,
        Alarm.CAMERA_UNAVAILABLE,
        Alarm.MOTION_OUTCOME_UNKNOWN,
    }
)


class Notices:
    """The unit's version, alarms and journal entries.

    Attributes:
        journal: for entries that belong to no present run.
        alarms: those that are active.
        run: number of the present job, or None before the first one.
        contact_lost: whether an alarm has said that a device does not answer; reset by whoever has reached them all.
        version: counts changes.
    """

    def __init__(
        self, journal: Journal, clock: Clock, now: Callable[[], datetime], on_failure: Callable[[AlarmError], None]
    ) -> None:
        self.journal = journal
        self.alarms = AlarmList(now)
        self.run: int | None = None
        self.contact_lost = False
        self.version = 0
        self._clock = clock
        self._on_failure = on_failure
        self._changed = asyncio.Event()
        self._pending: set[Future[Any]] = set()

    def changed(self) -> None:
        """Wake up whoever waits for a change."""
        self.version += 1
        self._changed.set()
        self._changed = asyncio.Event()

    async def wait_change(self, version: int) -> int:
        """Return the version as soon as it is greater than ``version``."""
        while self.version <= version:
            await self._changed.wait()
        return self.version

    def raise_alarm(self, error: AlarmError) -> None:
        """Show an alarm and journal it, once for as long as it is active."""
        self.contact_lost = self.contact_lost or error.alarm in _COMMUNICATION
        if self.alarms.add(error.alarm, error.detail) and error.alarm is not Alarm.JOURNAL_FAILED:
            self.note(self.journal.raise_alarm(error.alarm, error.detail, run=self.run))
        self.changed()

    def clear_alarms(self, *only: Alarm) -> None:
        """Take back these alarms, or all."""
        codes = [code for alarm in only for code in self.alarms.remove(alarm)] if only else self.alarms.clear()
        if codes:
            self.note(self.journal.clear_alarms(codes))

    def event(self, kind: str, name: str, source: str, detail: Mapping[str, Any]) -> Future[None]:
        """Journal an event of the present run."""
        return self.journal.event(kind, name, run=self.run, source=source, detail=detail)

    def note(self, entry: Future[Any]) -> None:
        """Keep a journal entry that need not be waited for; its failure is told to ``on_failure``."""
        self._pending.add(entry)
        entry.add_done_callback(self._noted_later)

    async def noted(self, entry: Future[Any]) -> None:
        """Wait for a journal entry; its failure is told to ``on_failure``."""
        try:
            await self.written(entry)
        except AlarmError as error:
            self._on_failure(error)

    async def written(self, entry: Future[T]) -> T:
        """Wait for a journal entry while a simulated clock stands still; raises JOURNAL_FAILED."""
        with self._clock.working():
            return await entry

    async def close(self) -> None:
        """Wait for the last entries and close the journal."""
        await asyncio.gather(*self._pending, return_exceptions=True)
        await self.journal.close()

    def _noted_later(self, entry: Future[Any]) -> None:
        self._pending.discard(entry)
        error = None if entry.cancelled() else entry.exception()
        if isinstance(error, AlarmError):
            self._on_failure(error)
