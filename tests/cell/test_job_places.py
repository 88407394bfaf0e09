"""A job that was not finished is gone on with on its places: a buffer place in use is none of the next job's."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from drivers.sim.doubles import Block
from srvs_cell.cell import Command, Mode
from srvs_cell.cell.job_places import JobPlaces
from srvs_cell.planning import PlanningParameters
from tests.cell.support import ENDS, PARAMETERS, Cell, build, connected, in_step, running, standing, three_blocks
from tests.cell.test_restart import die_in, restarted

if TYPE_CHECKING:
    from pathlib import Path

PLACES = {(block.x_mm, block.y_mm) for block in three_blocks()}


async def stopped_after_a_move(cell: Cell) -> None:
    """Stop when a part waits in the buffer place and before another one is gripped."""
    await connected(cell)
    await cell.start()
    await in_step(cell, "pick", moves_done=1)
    await cell.give(Command.STOP)
    await cell.reaches("Stopped")
    assert cell.world.held is None
    assert standing(cell) != PLACES


async def again(cell: Cell) -> str:
    await cell.give(Command.RESET)
    await cell.reaches("Idle")
    await cell.give(Command.START)
    return await cell.reaches(*ENDS)


async def became_of_it(cell: Cell) -> list[tuple[str, dict[str, Any]]]:
    events = await cell.journal.history(1000)
    return [(event["name"], event["detail"]) for event in events if event["kind"] == "unfinished_job"]


async def test_after_a_stop_the_next_job_goes_on_on_the_places(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await stopped_after_a_move(cell)
        assert cell.unit.snapshot()["unfinished_job"] == 1
        assert (await again(cell), cell.alarms) == ("Complete", [])
        assert standing(cell) == PLACES
        assert cell.unit.snapshot()["unfinished_job"] is None
        assert await became_of_it(cell) == [("continued", {"begun_by": 1, "reason": ""})]


async def test_stopped_again_and_again_it_is_still_the_same_job(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await stopped_after_a_move(cell)
        await cell.give(Command.RESET)
        await cell.reaches("Idle")
        await cell.give(Command.START)
        await in_step(cell, "pick")
        await cell.give(Command.ABORT)
        await cell.reaches("Aborted")
        assert cell.unit.snapshot()["unfinished_job"] == 1
        await cell.start()
        assert await cell.reaches(*ENDS) == "Complete"
        assert standing(cell) == PLACES


async def test_a_job_that_an_operator_completes_early_is_not_finished(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await in_step(cell, "pick")
        await cell.give(Command.COMPLETE)
        await cell.reaches("Complete")
        assert cell.unit.snapshot()["unfinished_job"] == 1
        assert await again(cell) == "Complete"
        assert standing(cell) == PLACES


@pytest.mark.parametrize("kind", ["open", "move_linear"])
async def test_after_a_crash_with_a_part_on_its_way_to_the_buffer_place(tmp_path: Path, kind: str) -> None:
    former = build(tmp_path)
    await die_in(former, "place", kind)
    cell = await restarted(former, tmp_path)
    async with running(cell):
        await connected(cell)
        assert cell.unit.snapshot()["unfinished_job"] == 1
        holds = "empty" if cell.world.held is None else "holding"
        assert (await cell.unit.resolve_gripper(holds, "test")).accepted
        await cell.start()
        assert await cell.reaches(*ENDS) == "Complete"
        assert standing(cell) == PLACES


async def test_a_part_that_a_person_took_out_of_the_gripper_may_stand_anywhere(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await in_step(cell, "place")
        await cell.give(Command.STOP)
        await cell.reaches("Stopped")
        assert cell.world.held is not None
        block = cell.world.held[0]
        cell.world.release()
        block.x_mm, block.y_mm = 480.0, 40.0
        assert await again(cell) == "Complete"
        assert standing(cell) == PLACES


async def test_an_operator_may_forget_the_job(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await stopped_after_a_move(cell)
        taken = standing(cell)
        assert (await cell.unit.forget_job("test")).accepted
        assert cell.unit.snapshot()["unfinished_job"] is None
        refused = await cell.unit.forget_job("test")
        assert (refused.accepted, refused.reason) == (False, "There is no unfinished job.")
        assert await again(cell) == "Complete"
        assert standing(cell) == taken


async def test_a_running_job_is_not_forgotten(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await in_step(cell, "pick", moves_done=1)
        refused = await cell.unit.forget_job("test")
        assert not refused.accepted
        assert "hold, stop or abort" in refused.reason
        assert await cell.reaches(*ENDS) == "Complete"
        assert standing(cell) == PLACES


async def test_what_was_forgotten_or_finished_stays_so_over_a_restart(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as first:
        await stopped_after_a_move(first)
    second = await restarted(first, tmp_path)
    async with running(second):
        await connected(second)
        assert second.unit.snapshot()["unfinished_job"] == 1
        await second.unit.forget_job("test")
    third = await restarted(second, tmp_path)
    async with running(third):
        await connected(third)
        assert third.unit.snapshot()["unfinished_job"] is None
        await third.start()
        assert await third.reaches(*ENDS) == "Complete"
    fourth = await restarted(third, tmp_path)
    async with running(fourth):
        await connected(fourth)
        assert fourth.unit.snapshot()["unfinished_job"] is None


async def test_a_part_more_makes_it_another_job(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await stopped_after_a_move(cell)
        cell.world.blocks.append(Block("new", 450.0, 60.0, 20.0))
        taken = standing(cell)
        assert await again(cell) == "Complete"
        assert standing(cell) == taken
        ((said, detail),) = await became_of_it(cell)
        assert (said, detail["reason"]) == ("given up", "4 parts are seen, the job was about 3")


async def test_other_parts_elsewhere_make_it_another_job(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await stopped_after_a_move(cell)
        for block, x_mm in zip(cell.world.blocks, (420.0, 480.0, 540.0), strict=True):
            block.x_mm, block.y_mm = x_mm, block.height_mm
        taken = standing(cell)
        assert await again(cell) == "Complete"
        assert standing(cell) == taken
        ((said, detail),) = await became_of_it(cell)
        assert (said, detail["reason"]) == ("given up", "3 of 3 parts stand where the job has left none")


async def test_a_dry_run_leaves_no_job_behind(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.to_idle()
        assert (await cell.unit.set_mode(Mode.DRY_RUN, "test")).accepted
        await cell.give(Command.START)
        assert await cell.reaches(*ENDS) == "Complete"
        assert cell.unit.snapshot()["unfinished_job"] is None


async def test_a_place_that_a_stop_has_left_empty_is_still_filled_from_the_stock(tmp_path: Path) -> None:
    blocks = [Block("low", 300.0, 0.0, 20.0), Block("good", 300.0, 150.0, 40.0), Block("spare", 500.0, 200.0, 40.0)]
    settings = {
        "height_mm": [30.0, 100.0],
        "bin_mm": [100.0, 0.0],
        "stock_mm": [[500.0, 200.0]],
        "substitute_kind": "cuboid",
    }
    planning = PlanningParameters(rule="element_change", rule_settings=settings)
    look = replace(PARAMETERS.look, verify="each_plan")
    cell = build(tmp_path, blocks, replace(PARAMETERS, look=look), planning)
    async with running(cell):
        await connected(cell)
        await cell.start()
        await in_step(cell, "pick", moves_done=1)
        await cell.give(Command.STOP)
        await cell.reaches("Stopped")
        # What fell into the bin is seen no more.
        cell.world.blocks = [block for block in cell.world.blocks if block.name != "low"]
        assert await again(cell) == "Complete"
        assert standing(cell) == {(300.0, 0.0), (300.0, 150.0)}


def test_what_the_journal_holds_is_what_was_kept() -> None:
    places = JobPlaces(3, 5, ((1.0, 2.0), (3.0, 4.5)), ((7.0, 8.0),), 1)
    assert JobPlaces.from_json(places.as_json()) == places


@pytest.mark.parametrize(
    ("standing_mm", "goes_on"),
    [
        ([(0.0, 0.0), (100.0, 0.0), (200.0, 0.0)], True),
        ([(0.0, 0.0), (100.0, 0.0), (50.0, 90.0)], True),
        ([(0.0, 0.0), (500.0, 0.0), (51.0, 92.0)], True),
        ([(0.0, 0.0), (500.0, 0.0), (510.0, 90.0)], False),
        ([(0.0, 0.0), (100.0, 0.0)], True),
        ([(0.0, 0.0)], False),
        ([], False),
        ([(0.0, 0.0), (100.0, 0.0), (200.0, 0.0), (300.0, 0.0)], False),
    ],
)
def test_parts_where_the_job_can_have_left_them(standing_mm: list[tuple[float, float]], goes_on: bool) -> None:
    places = JobPlaces(1, 1, ((0.0, 0.0), (100.0, 0.0), (200.0, 0.0)), ((50.0, 90.0),), fewer=1)
    assert (places.why_given_up(standing_mm, 5.0) == "") is goes_on
