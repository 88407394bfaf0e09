"""The journal keeps what it was told, across processes, and says what was left unfinished."""

from __future__ import annotations

import sqlite3
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import pytest

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell.journal import GripperKnowledge, Journal

if TYPE_CHECKING:
    from pathlib import Path

NOON = datetime(2026, 1, 2, 12, tzinfo=UTC)


def journal(tmp_path: Path) -> Journal:
    return Journal(tmp_path / "deep" / "journal.sqlite", now=lambda: NOON)


async def test_entries_are_read_back_newest_first(tmp_path: Path) -> None:
    book = journal(tmp_path)
    left = await book.open()
    assert (left.motions, left.knowledge, left.unresolved) == ((), None, "")
    run = await book.begin_run("Production", "runs/{run:06d}")
    await book.event("command", "start", run=run, source="op", detail={"accepted": True})
    await book.event("step", "plan", run=None, source="job", detail={})
    await book.raise_alarm(Alarm.GRIP_EMPTY, "{not json}", run=run)
    await book.end_run(run, "finished")
    assert [event["name"] for event in await book.history(10)] == ["plan", "start"]
    assert (await book.history(10, run))[0]["detail"] == {"accepted": True}
    assert len(await book.history(1)) == 1
    (alarm,) = await book.alarms()
    assert (alarm["code"], alarm["detail"], alarm["cleared_at"]) == (2101, "{not json}", None)
    await book.clear_alarms([2101, 2102])
    assert (await book.alarms())[0]["cleared_at"] == "2026-01-02T12:00:00.000+00:00"
    (entry,) = await book.runs()
    assert (entry["outcome"], entry["directory"]) == ("finished", "runs/000001")
    await book.close()


async def test_entries_that_are_not_awaited_keep_their_order(tmp_path: Path) -> None:
    book = journal(tmp_path)
    await book.open()
    waiting = [book.event("transition", str(i), run=None, source="cell", detail={}) for i in range(50)]
    motion = await book.intend("move_linear", {}, run=None)
    assert [int(event["name"]) for event in await book.history(100)] == list(range(49, -1, -1))
    assert all(entry.done() for entry in waiting)
    await book.outcome(motion, "done", {})
    await book.close()


async def test_an_intent_without_outcome_is_found_by_the_next_process(tmp_path: Path) -> None:
    book = journal(tmp_path)
    await book.open()
    done = await book.intend("move_linear", {"target": [1, 2]}, run=None)
    await book.outcome(done, "done", {})
    await book.intend("close", {"held": {"workpiece": 2}}, run=None)
    await book.close()
    left = await (again := journal(tmp_path)).open()
    assert [motion["kind"] for motion in left.motions] == ["close"]
    assert left.motions[0]["detail"] == {"held": {"workpiece": 2}}
    assert left.unresolved.startswith("close was begun at 2026-01-02")
    await again.resolve(GripperKnowledge.EMPTY, None, "op")
    await again.close()
    left = await (third := journal(tmp_path)).open()
    assert (left.unresolved, left.knowledge) == ("", GripperKnowledge.EMPTY)
    await third.close()


async def test_a_held_part_is_found_by_the_next_process(tmp_path: Path) -> None:
    book = journal(tmp_path)
    await book.open()
    motion = await book.intend("close", {}, run=None)
    await book.outcome(motion, "holding", {}, (GripperKnowledge.HOLDING, {"workpiece": 1}))
    await book.close()
    left = await (again := journal(tmp_path)).open()
    assert left.held == {"workpiece": 1}
    assert left.unresolved == "a part was in the gripper."
    await again.close()


async def test_a_journal_of_another_version_is_not_touched(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA user_version = 7")
    connection.close()
    book = Journal(path)
    with pytest.raises(AlarmError, match="schema version 7") as caught:
        await book.open()
    assert caught.value.alarm is Alarm.JOURNAL_FAILED
    assert not book.is_open
    await book.close()


async def test_a_folder_that_cannot_be_made_is_a_named_alarm(tmp_path: Path) -> None:
    (tmp_path / "deep").write_text("a file where a folder should be")
    book = journal(tmp_path)
    with pytest.raises(AlarmError, match="deep") as caught:
        await book.open()
    assert caught.value.alarm is Alarm.JOURNAL_FAILED
    with pytest.raises(AlarmError, match="not open"):
        await book.intend("move_linear", {}, run=None)
    await book.close()


async def test_the_file_survives_a_power_loss_in_mid_write(tmp_path: Path) -> None:
    book = journal(tmp_path)
    await book.open()
    await book.event("command", "start", run=None, source="op", detail={})
    with sqlite3.connect(book.path) as reader:
        assert reader.execute("PRAGMA journal_mode").fetchone() == ("wal",)
        assert reader.execute("PRAGMA user_version").fetchone() == (1,)
        assert reader.execute("SELECT name FROM events").fetchall() == [("start",)]
    reader.close()
    await book.close()
