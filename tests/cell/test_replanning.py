"""After each move the scene is really looked at: a hand in the cell leads to a new plan, never to a blind move."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from drivers.sim.doubles import Block
from srvs_cell.cell import Unit
from srvs_cell.config import RetryParameters
from srvs_cell.planning import PlanningParameters
from tests.cell.support import ENDS, PARAMETERS, Cell, build, connected, in_step, job, running, see, three_blocks

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from srvs_cell.cell import StereoLook
    from srvs_cell.ports import GripState
    from srvs_cell.scene import Perception

PLACES = {(300.0, 120.0), (300.0, 0.0), (300.0, -120.0)}


def disturbed(cell: Cell, hands: dict[int, Callable[[], None]]) -> list[int]:
    """Let a person do something before looks of these numbers (from 0); return a list that counts the looks."""
    plain = cell.unit.equipment.perceive
    looks: list[int] = []

    def perceive(look: StereoLook) -> Perception:
        if len(looks) in hands:
            hands[len(looks)]()
        perception = plain(look)
        looks.append(len(perception.workpieces))
        return perception

    cell.unit = Unit(replace(cell.unit.equipment, perceive=perceive), simulation=True)
    return looks


def block(cell: Cell, name: str) -> Block:
    return next(block for block in cell.world.blocks if block.name == name)


def push(cell: Cell, name: str, dx_mm: float, dy_mm: float) -> None:
    block(cell, name).x_mm += dx_mm
    block(cell, name).y_mm += dy_mm


def places(cell: Cell) -> dict[str, tuple[float, float]]:
    return {block.name: (round(block.x_mm, 1), round(block.y_mm, 1)) for block in cell.world.blocks}


def warning(cell: Cell) -> str:
    (alarm,) = cell.unit.snapshot()["alarms"]
    assert alarm["name"] == "SCENE_CHANGED"
    return str(alarm["detail"])


EACH_PLAN = replace(PARAMETERS, look=replace(PARAMETERS.look, verify="each_plan"))


async def test_every_move_is_followed_by_a_look(tmp_path: Path) -> None:
    cell = build(tmp_path)
    looks = disturbed(cell, {})
    async with running(cell):
        assert await job(cell) == "Complete"
        assert looks == [3] * 4
        assert cell.alarms == []


async def test_where_the_config_says_so_only_the_whole_plan_is_followed_by_one(tmp_path: Path) -> None:
    cell = build(tmp_path, parameters=EACH_PLAN)
    looks = disturbed(cell, {})
    async with running(cell):
        assert await job(cell) == "Complete"
        assert looks == [3] * 2


@pytest.mark.parametrize("name", ["low", "middle", "tall"])
@pytest.mark.parametrize("after", [1, 2, 3])
async def test_a_part_that_was_pushed_by_hand_is_planned_for_anew_and_the_places_are_kept(
    tmp_path: Path, name: str, after: int
) -> None:
    cell = build(tmp_path)
    disturbed(cell, {after: lambda: push(cell, name, 60.0, 15.0)})
    async with running(cell):
        assert await job(cell) == "Complete"
        assert places(cell) == {"tall": (300.0, 120.0), "middle": (300.0, 0.0), "low": (300.0, -120.0)}
        assert "61.8 mm from" in warning(cell)
        assert f"After move {after}:" in warning(cell)
        assert cell.world.dropped == []
        assert len([n for n in cell.unit.snapshot()["artefacts"] if n.startswith("plan_")]) == 2


async def test_a_part_that_was_taken_away_is_not_looked_for_again(tmp_path: Path) -> None:
    cell = build(tmp_path)
    looks = disturbed(cell, {1: lambda: cell.world.blocks.remove(block(cell, "middle"))})
    async with running(cell):
        assert await job(cell) == "Complete"
        assert looks[:3] == [3, 2, 2]
        standing = places(cell)
        assert set(standing.values()) <= PLACES
        assert standing["tall"][1] > standing["low"][1]
        assert "workpiece 1 (cuboid) is not seen at (300.0, 0.0)" in warning(cell)


async def test_a_part_that_was_added_is_planned_for(tmp_path: Path) -> None:
    cell = build(tmp_path)
    disturbed(cell, {1: lambda: cell.world.blocks.append(Block("new", 450.0, 60.0, 75.0))})
    async with running(cell):
        assert await job(cell) == "Complete"
        standing = places(cell)
        assert set(standing.values()) == PLACES | {(450.0, 60.0)}
        assert sorted(standing, key=lambda name: -standing[name][1]) == ["new", "tall", "middle", "low"]
        assert "a cuboid part stands at (450.0, 60.0) that was not there" in warning(cell)


async def test_a_part_that_the_gripper_has_dropped_is_looked_for(tmp_path: Path) -> None:
    cell = build(tmp_path)
    disturbed(cell, {})
    async with running(cell):
        await connected(cell)
        await cell.start()
        await in_step(cell, "place")
        cell.world.lose()
        assert await cell.reaches(*ENDS) == "Complete"
        assert set(places(cell).values()) == PLACES
        assert cell.unit.snapshot()["moves_done"] >= 3


async def test_a_gripper_that_goes_on_dropping_parts_holds_the_cell(tmp_path: Path) -> None:
    cell = build(tmp_path)
    close = cell.gripper.close

    async def slippery() -> GripState:
        felt = await close()
        cell.world.lose()
        return felt

    cell.gripper.close = slippery  # type: ignore[method-assign]
    async with running(cell):
        assert await job(cell) == "Held"
        assert "GRIP_LOST" in cell.alarms
        assert cell.unit.snapshot()["moves_done"] == 0
        assert [motion["kind"] for motion in await cell.journal.motions(500)].count("close") == 3


def misjudged(cell: Cell, numbers: Sequence[int]) -> None:
    """Let looks of these numbers take the first part for 15 mm higher than it is."""

    def as_seen(number: int, _: StereoLook, perception: Perception) -> Perception:
        if number not in numbers:
            return perception
        first, *others = perception.workpieces
        x_mm, y_mm, z_mm = first.position_mm
        higher = replace(first, position_mm=(x_mm, y_mm, z_mm + 15.0), height_mm=first.height_mm + 15.0)
        return replace(perception, workpieces=(higher, *others))

    see(cell, as_seen)


async def test_one_look_is_not_believed_against_the_plan(tmp_path: Path) -> None:
    cell = build(tmp_path)
    misjudged(cell, [1])
    async with running(cell):
        assert await job(cell) == "Complete"
        assert cell.alarms == []
        assert cell.unit.snapshot()["moves_done"] == 3


async def test_a_part_that_is_judged_anew_makes_no_second_place(tmp_path: Path) -> None:
    cell = build(tmp_path)
    misjudged(cell, [1, 2])
    async with running(cell):
        assert await job(cell) == "Complete"
        assert set(places(cell).values()) == PLACES


async def test_a_part_that_never_stays_holds_the_cell_with_its_name(tmp_path: Path) -> None:
    cell = build(tmp_path, parameters=replace(PARAMETERS, retries=RetryParameters(verify=2)))
    # Every third look is the first one after a move; one to be sure and one to plan by follow.
    disturbed(cell, {look: lambda: push(cell, "middle", 40.0, 0.0) for look in (1, 4, 7)})
    async with running(cell):
        assert await job(cell) == "Held"
        failed = next(alarm for alarm in cell.unit.snapshot()["alarms"] if alarm["name"] == "VERIFY_FAILED")
        assert "40.0 mm from" in failed["detail"]


async def test_a_grip_on_nothing_makes_no_place_of_a_buffer_place(tmp_path: Path) -> None:
    cell = build(tmp_path, parameters=EACH_PLAN)
    async with running(cell):
        await connected(cell)
        await cell.start()
        await in_step(cell, "pick", moves_done=1)
        cell.gripper.misses = 1
        assert await cell.reaches(*ENDS) == "Complete"
        assert set(places(cell).values()) == PLACES


async def test_a_place_that_was_to_be_filled_is_still_to_be_filled_when_the_rejected_part_has_gone(
    tmp_path: Path,
) -> None:
    blocks = [Block("good", 300.0, -120.0, 40.0), Block("low", 300.0, 0.0, 20.0), Block("spare", 500.0, 200.0, 40.0)]
    settings: dict[str, Any] = {
        "height_mm": [30.0, 100.0],
        "bin_mm": [100.0, 0.0],
        "stock_mm": [[500.0, 200.0]],
        "substitute_kind": "cuboid",
    }
    cell = build(tmp_path, blocks, planning=PlanningParameters(rule="element_change", rule_settings=settings))

    def into_the_bin_and_a_push() -> None:
        cell.world.blocks.remove(block(cell, "low"))
        push(cell, "good", 30.0, 0.0)

    disturbed(cell, {1: into_the_bin_and_a_push})
    async with running(cell):
        assert await job(cell) == "Complete"
        assert set(places(cell).values()) == {(300.0, -120.0), (300.0, 0.0)}


async def test_with_every_part_gone_in_mid_job_the_cell_waits_for_parts(tmp_path: Path) -> None:
    cell = build(tmp_path)
    disturbed(cell, {1: cell.world.blocks.clear})
    async with running(cell):
        assert await job(cell) == "Suspended"
        assert cell.alarms == ["SCENE_CHANGED", "NOTHING_SEEN"]
        cell.world.blocks += three_blocks()
        assert await cell.reaches("Complete", "Held", "Aborted") == "Complete"


async def test_a_part_that_the_look_from_aside_does_not_show_is_not_forgotten(tmp_path: Path) -> None:
    """It stands where only the pictures from the observe pose show it, on the way of the others."""
    cell = build(tmp_path, [*three_blocks(), Block("edge", 420.0, 250.0, 70.0)])
    observe = cell.unit.equipment.parameters.look.observe_pose.pose()
    plain = cell.unit.equipment.perceive
    parts: list[int] = []

    def perceive(look: StereoLook) -> Perception:
        if len(parts) == 2:
            push(cell, "low", 30.0, 0.0)
        perception = plain(look)
        left = look.base_T_tcp_left.translation_mm
        if float(np.hypot(left[0] - observe.x_mm, left[1] - observe.y_mm)) > 1.0:
            shown = tuple(part for part in perception.workpieces if part.position_mm[1] < 200.0)
            perception = replace(perception, workpieces=shown)
        parts.append(len(perception.workpieces))
        return perception

    equipment = replace(cell.unit.equipment, perceive=perceive, in_every_look=lambda part: part.position_mm[1] < 200.0)
    cell.unit = Unit(equipment, simulation=True)
    async with running(cell):
        assert await job(cell) == "Complete"
        assert 3 in parts
        said = "; ".join(alarm["detail"] for alarm in cell.unit.snapshot()["alarms"])
        assert "30.0 mm from" in said
        assert "not seen" not in said
        assert len(cell.unit.snapshot()["workpieces"]) == 4
        assert (block(cell, "edge").x_mm, block(cell, "edge").y_mm) == (420.0, 250.0)
