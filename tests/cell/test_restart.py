"""A process that dies in mid-motion: the next one knows, asks, and sends no move again."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest

from srvs_cell.cell import Command
from tests.cell.support import Cell, build, connected, running

if TYPE_CHECKING:
    from pathlib import Path


async def die_in(cell: Cell, step: str, kind: str) -> None:
    """Let the process vanish while a motion of a kind is under way: nothing is tidied up, nothing is written."""
    life = asyncio.create_task(cell.unit.run())
    await connected(cell)
    await cell.start()
    await cell.until("step", step)
    dying = False
    while not dying:
        with cell.clock.working():  # the motion must not end while the journal is read and closed
            (last,) = await cell.journal.motions(1)
            dying = last["kind"] == kind and last["outcome"] is None
            if dying:
                await cell.journal.close()
        await asyncio.sleep(0)
    for task in asyncio.all_tasks() - {asyncio.current_task()}:
        task.cancel()
    await asyncio.gather(life, return_exceptions=True)


async def restarted(former: Cell, tmp_path: Path) -> Cell:
    """Return a new process over the same world and journal."""
    cell = build(tmp_path)
    cell.world.blocks, cell.world.held = former.world.blocks, former.world.held
    cell.arm.pose = former.arm.pose
    cell.gripper._closed = former.gripper._closed
    return cell


@pytest.mark.parametrize(("step", "kind"), [("pick", "move_linear"), ("place", "move_linear"), ("pick", "close")])
async def test_an_unfinished_motion_is_resolved_by_a_person_and_never_sent_again(
    tmp_path: Path, step: str, kind: str
) -> None:
    former = build(tmp_path)
    await die_in(former, step, kind)
    cell = await restarted(former, tmp_path)
    async with running(cell):
        await connected(cell)
        assert (cell.state, cell.alarms) == ("Aborted", ["RESTART_UNRESOLVED"])
        assert cell.unit.snapshot()["gripper"]["knowledge"] == "unknown"
        refused = await cell.unit.command(Command.CLEAR, "test")
        assert "resolve gripper" in refused.reason
        await cell.clock.sleep(20.0)
        assert cell.arm.targets == []
        held = cell.world.held is not None
        assert (await cell.unit.resolve_gripper("holding" if held else "empty", "test")).accepted
        assert cell.alarms == []
        await cell.to_idle()
        assert cell.arm.targets == []
        await cell.give(Command.START)
        assert await cell.reaches("Complete", "Held", "Stopped", "Aborted") == "Complete"
        heights = [block.height_mm for block in sorted(cell.world.blocks, key=lambda block: -block.y_mm)]
        assert heights == sorted(heights, reverse=True)
        assert cell.world.dropped == []


async def test_an_answer_stays_given_over_another_restart(tmp_path: Path) -> None:
    former = build(tmp_path)
    await die_in(former, "pick", "move_linear")
    second = await restarted(former, tmp_path)
    async with running(second):
        await connected(second)
        await second.unit.resolve_gripper("empty", "test")
    third = await restarted(second, tmp_path)
    async with running(third):
        await connected(third)
        assert third.alarms == []


async def test_a_journal_that_is_reached_late_still_asks(tmp_path: Path) -> None:
    former = build(tmp_path)
    await die_in(former, "pick", "move_linear")
    path = former.journal.path
    path.rename(tmp_path / "aside")
    path.mkdir()
    cell = await restarted(former, tmp_path)
    async with running(cell):
        await connected(cell)
        assert cell.alarms == ["JOURNAL_FAILED"]
        path.rmdir()
        (tmp_path / "aside").rename(path)
        assert not (await cell.unit.command(Command.CLEAR, "test")).accepted
        assert (cell.state, cell.alarms) == ("Aborted", ["RESTART_UNRESOLVED"])
        assert cell.arm.targets == []


async def test_what_was_journalled_is_not_lost(tmp_path: Path) -> None:
    former = build(tmp_path)
    await die_in(former, "place", "move_linear")
    cell = await restarted(former, tmp_path)
    async with running(cell):
        await connected(cell)
        events = await cell.journal.history(1000)
        assert [event["name"] for event in events if event["kind"] == "command"] == ["start", "reset", "clear"]
        assert {"pick", "plan", "perceive"} <= {event["name"] for event in events if event["kind"] == "step"}
        artefacts = [event["detail"]["path"] for event in events if event["kind"] == "artefact"]
        assert all((tmp_path / path).exists() for path in artefacts)
        assert len(artefacts) == 4


@pytest.mark.parametrize("holds", ["full", "", "EMPTY"])
async def test_an_answer_that_is_none_is_refused(tmp_path: Path, holds: str) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        answer = await cell.unit.resolve_gripper(holds, "test")
        assert not answer.accepted
        assert "neither" in answer.reason
