"""Run folders: the oldest go when there are too many, never one that somebody still needs."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from srvs_cell.cell import Command, Journal, RunRecorder, Unit
from tests.cell.support import build, connected, running

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path


def recorded(state_dir: Path, runs: Collection[int], keep_runs: int | None) -> RunRecorder:
    recorder = RunRecorder(state_dir, keep_runs)
    for run in runs:
        (recorder.begin(run) / "left_0.png").write_bytes(b"picture")
    return recorder


def there(state_dir: Path) -> list[int]:
    return sorted(int(folder.name) for folder in (state_dir / "runs").iterdir())


@pytest.mark.parametrize(
    ("keep_runs", "unresolved", "removed"),
    [
        (None, (), []),
        (5, (), []),
        (3, (), [1, 2]),
        (3, (1,), [2]),
        (1, (2, 3), [1, 4]),
    ],
)
def test_the_oldest_beyond_the_limit_go(
    tmp_path: Path, keep_runs: int | None, unresolved: tuple[int, ...], removed: list[int]
) -> None:
    recorder = recorded(tmp_path, range(1, 6), keep_runs)
    assert recorder.prune(5, unresolved) == removed
    assert there(tmp_path) == [run for run in range(1, 6) if run not in removed]


def test_the_current_run_stays_even_if_others_have_greater_numbers(tmp_path: Path) -> None:
    recorder = recorded(tmp_path, [1, 2, 900, 901, 902], 2)
    assert recorder.prune(2, ()) == [1]
    assert 2 in there(tmp_path)


def test_what_is_no_run_folder_is_not_touched(tmp_path: Path) -> None:
    recorder = recorded(tmp_path, range(1, 4), 1)
    (tmp_path / "runs" / "notes").mkdir()
    assert recorder.prune(3, ()) == [1, 2]
    assert (tmp_path / "runs" / "notes").exists()


def test_a_job_does_not_wait_until_a_year_of_runs_has_gone(tmp_path: Path) -> None:
    recorder = recorded(tmp_path, range(1, 101), 10)
    assert recorder.prune(100, ()) == list(range(1, 21))
    assert recorder.prune(100, ()) == list(range(21, 41))


def test_what_cannot_be_removed_is_told_and_does_not_stop_the_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = recorded(tmp_path, range(1, 4), 1)

    def refuse(path: Path) -> None:
        raise PermissionError(f"not yours: {path}")

    monkeypatch.setattr("shutil.rmtree", refuse)
    assert recorder.prune(3, ()) == []
    assert there(tmp_path) == [1, 2, 3]


async def test_an_open_intent_refers_to_its_run(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal.sqlite")
    await journal.open()
    for run in (3, 3, 7):
        await journal.intend("move_linear", {}, run=run)
    await journal.intend("open", {}, run=None)
    await journal.outcome(await journal.intend("move_joint", {}, run=8), "done", {})
    assert await journal.unresolved_runs() == {3, 7}
    await journal.close()


async def test_a_job_removes_old_folders_and_journals_which(tmp_path: Path) -> None:
    cell = build(tmp_path)
    recorder = RunRecorder(tmp_path, 1)
    cell.unit = Unit(replace(cell.unit.equipment, recorder=recorder), simulation=True)
    async with running(cell):
        await connected(cell)
        await cell.start()
        await cell.reaches("Complete")
        await cell.give(Command.RESET)
        await cell.reaches("Idle")
        await cell.give(Command.START)
        assert await cell.reaches("Complete", "Held") == "Complete"
        assert there(tmp_path) == [2]
        pruned = [row for row in await cell.journal.history(10_000) if row["kind"] == "prune"]
        assert [row["detail"] for row in pruned] == [{"runs": [1]}]
