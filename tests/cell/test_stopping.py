"""Stop, hold, abort and friends in the middle of the work: the arm stands, nothing moves by itself, and it is known."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from srvs_cell.cell import Command
from tests.cell.support import Cell, build, connected, in_step, running, standing, three_blocks

if TYPE_CHECKING:
    from pathlib import Path

HALTS = [(Command.HOLD, "Held"), (Command.STOP, "Stopped"), (Command.ABORT, "Aborted")]


async def outcomes(cell: Cell) -> list[str]:
    return [motion["outcome"] for motion in await cell.journal.motions()]


@pytest.mark.parametrize("step", ["move_laterally", "pick", "place"])
@pytest.mark.parametrize(("command", "state"), HALTS)
async def test_a_move_is_stopped_and_nothing_follows(tmp_path: Path, step: str, command: Command, state: str) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await in_step(cell, step)
        commanded = len(cell.arm.targets)
        await cell.give(command)
        await cell.reaches(state)
        pose, target = cell.arm.pose, cell.arm.targets[-1]
        assert cell.arm.stop_requests >= 1
        assert pose != target
        await cell.clock.sleep(15.0)
        assert cell.arm.pose == pose
        assert len(cell.arm.targets) == commanded
        assert (await outcomes(cell))[0] == "stopped"
        assert cell.alarms == []
        assert cell.unit.snapshot()["step"] is None


async def test_a_held_cell_looks_again_and_finishes(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await in_step(cell, "pick", moves_done=1)
        await cell.give(Command.HOLD)
        await cell.reaches("Held")
        places = {(block.x_mm, block.y_mm) for block in three_blocks()}
        assert cell.world.held is None
        assert standing(cell) != places, "a part waits in the buffer place"
        await cell.give(Command.UNHOLD)
        await cell.reaches("Complete", "Held", "Stopped", "Aborted")
        assert (cell.state, cell.alarms) == ("Complete", [])
        assert standing(cell) == places
        heights = [block.height_mm for block in sorted(cell.world.blocks, key=lambda block: -block.y_mm)]
        assert heights == sorted(heights, reverse=True)
        later = [event["name"] for event in await cell.journal.history(500) if event["kind"] == "step"]
        assert later.count("observe_left") >= 3 * 2


async def hold_with_a_part(cell: Cell) -> str:
    """Hold while a part is carried; return its name."""
    await in_step(cell, "place")
    await cell.give(Command.HOLD)
    await cell.reaches("Held")
    assert cell.world.held is not None
    assert cell.unit.snapshot()["gripper"]["knowledge"] == "holding"
    return cell.world.held[0].name


async def test_a_part_held_through_a_hold_is_put_where_it_belongs_first(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        name = await hold_with_a_part(cell)
        await cell.give(Command.UNHOLD)
        await cell.reaches("Complete", "Held", "Stopped", "Aborted")
        assert (cell.state, cell.alarms, cell.world.dropped) == ("Complete", [], [])
        steps = [event["name"] for event in await cell.journal.history(500) if event["kind"] == "step"]
        assert "deliver" in steps
        assert name in {block.name for block in cell.world.blocks}


async def test_a_part_held_through_stop_reset_and_start_is_put_where_it_belongs(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await hold_with_a_part(cell)
        await cell.give(Command.STOP)
        await cell.reaches("Stopped")
        assert cell.world.held is not None
        await cell.give(Command.RESET)
        await cell.reaches("Idle")
        await cell.give(Command.START)
        await cell.reaches("Complete", "Held", "Stopped", "Aborted")
        assert (cell.state, cell.alarms, cell.world.dropped) == ("Complete", [], [])


async def test_a_held_part_that_somebody_took_out_is_noticed(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await hold_with_a_part(cell)
        cell.world.lose()
        await cell.give(Command.UNHOLD)
        await cell.reaches("Held")
        assert cell.alarms == ["GRIP_LOST"]
        assert cell.unit.snapshot()["gripper"]["knowledge"] == "empty"


async def test_complete_finishes_the_part_in_hand_and_retreats(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await in_step(cell, "pick")
        await cell.give(Command.COMPLETE)
        await cell.reaches("Complete", "Stopped", "Aborted")
        assert cell.state == "Complete"
        assert cell.unit.snapshot()["moves_done"] == 1
        assert cell.world.held is None
        assert cell.arm.pose.z_mm == 400.0


async def test_complete_with_a_held_part_stops_and_says_why(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await hold_with_a_part(cell)
        commanded = len(cell.arm.targets)
        await cell.give(Command.COMPLETE)
        await cell.reaches("Stopped")
        assert cell.alarms == ["GRIPPER_OCCUPIED"]
        assert len(cell.arm.targets) == commanded


async def test_a_stop_overtakes_a_graceful_suspend(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await in_step(cell, "place")
        await cell.give(Command.SUSPEND)
        assert cell.state == "Suspending"
        await cell.give(Command.STOP)
        await cell.reaches("Stopped")
        assert cell.world.held is not None
        assert (await outcomes(cell))[0] in {"stopped", "not_begun"}


async def test_an_operators_suspend_waits_for_the_operator(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await in_step(cell, "place")
        await cell.give(Command.SUSPEND)
        await cell.reaches("Suspended")
        assert cell.world.held is None
        await cell.clock.sleep(20.0)
        assert cell.state == "Suspended"
        await cell.give(Command.UNSUSPEND)
        await cell.reaches("Complete")


async def test_an_empty_table_suspends_and_the_cell_looks_again_by_itself(tmp_path: Path) -> None:
    cell = build(tmp_path, [])
    async with running(cell):
        await connected(cell)
        await cell.start()
        await cell.reaches("Suspended")
        assert cell.alarms == ["NOTHING_SEEN"]
        looks = cell.camera.frames
        await cell.clock.sleep(20.0)
        assert cell.camera.frames > looks
        cell.world.blocks.extend(build(tmp_path).world.blocks)
        await cell.reaches("Complete")
        assert cell.alarms == []


async def test_the_daemons_end_stops_the_move(tmp_path: Path) -> None:
    cell = build(tmp_path)
    async with running(cell):
        await connected(cell)
        await cell.start()
        await in_step(cell, "pick")
    assert cell.arm.stop_requests >= 1
    assert cell.arm.lifecycle == "disconnected"
    commanded = len(cell.arm.targets)
    again = build(tmp_path)
    async with running(again):
        await connected(again)
        assert again.alarms == []
        assert again.unit.snapshot()["gripper"]["knowledge"] == "empty"
    assert len(cell.arm.targets) == commanded
