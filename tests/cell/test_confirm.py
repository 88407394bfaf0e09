"""Looks must agree before anything is moved: an unseen part is one that the arm may hit."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from srvs_cell.scene import UNKNOWN_KIND
from tests.cell.support import PARAMETERS, Cell, build, connected, job, running, see

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from srvs_cell.cell import StereoLook
    from srvs_cell.scene import Perception


def confirming(tmp_path: Path, agreeing_looks: int = 2) -> Cell:
    """Return a cell in which so many looks must agree."""
    return build(tmp_path, parameters=replace(PARAMETERS, look=replace(PARAMETERS.look, agreeing_looks=agreeing_looks)))


def blink(tmp_path: Path, missed: Sequence[int], agreeing_looks: int = 2) -> tuple[Cell, list[int]]:
    """Return a cell that does not see the first part in the looks of these numbers, and how many each look saw."""
    cell = confirming(tmp_path, agreeing_looks)
    seen: list[int] = []

    def as_seen(number: int, _: StereoLook, perception: Perception) -> Perception:
        workpieces = perception.workpieces[1:] if number in missed else perception.workpieces
        seen.append(len(workpieces))
        return replace(perception, workpieces=workpieces)

    see(cell, as_seen)
    return cell, seen


@pytest.mark.parametrize(("missed", "looks"), [((), [3, 3]), ((0,), [2, 3, 3]), ((1,), [3, 2, 3, 3])])
async def test_a_part_that_is_missed_once_is_relocated_all_the_same(
    tmp_path: Path, missed: tuple[int, ...], looks: list[int]
) -> None:
    cell, seen = blink(tmp_path, missed)
    async with running(cell):
        assert await job(cell) == "Complete"
        assert seen == [*looks, 3, 3, 3]  # and a look after each of the moves
        assert cell.unit.snapshot()["moves_done"] == 3


async def test_looks_that_never_agree_hold_the_cell_before_any_move(tmp_path: Path) -> None:
    cell, seen = blink(tmp_path, missed=(1, 3))
    async with running(cell):
        await connected(cell)
        before = [(block.x_mm, block.y_mm) for block in cell.world.blocks]
        await cell.start()
        assert await cell.reaches("Complete", "Held", "Aborted", "Stopped") == "Held"
        assert seen == [3, 2, 3, 2, 3]
        assert [alarm["name"] for alarm in cell.unit.snapshot()["alarms"]] == ["LOOKS_DISAGREE"]
        assert [(block.x_mm, block.y_mm) for block in cell.world.blocks] == before


async def test_one_look_is_enough_where_the_config_says_so(tmp_path: Path) -> None:
    cell, seen = blink(tmp_path, missed=(), agreeing_looks=1)
    async with running(cell):
        assert await job(cell) == "Complete"
        assert seen == [3, 3, 3, 3]


async def test_a_look_that_leaves_a_part_uncertain_is_repeated_from_aside(tmp_path: Path) -> None:
    places: list[tuple[float, float]] = []

    def doubt_from_the_observe_pose(_: int, look: StereoLook, perception: Perception) -> Perception:
        x_mm, y_mm, _z_mm = look.base_T_tcp_left.translation_mm
        places.append((float(x_mm), float(y_mm)))
        if math.dist(places[0], places[-1]) > 1.0:
            return perception
        first, *others = perception.workpieces
        return replace(perception, workpieces=(replace(first, covariance_mm2=100.0 * np.eye(3)), *others))

    cell = confirming(tmp_path)
    see(cell, doubt_from_the_observe_pose)
    look = cell.unit.equipment.parameters.look
    async with running(cell):
        assert await job(cell) == "Complete"
    observe = look.observe_pose.pose()
    assert places[:2] == [pytest.approx((observe.x_mm, observe.y_mm))] * 2
    assert all(math.dist(places[0], place) == pytest.approx(math.hypot(*look.aside_mm)) for place in places[2:])


@pytest.mark.parametrize("worse", [0, 1])
@pytest.mark.parametrize(
    "known_worse",
    [{"covariance_mm2": 100.0 * np.eye(3)}, {"kind": UNKNOWN_KIND, "grasp": None, "grasp_refusal": "unknown"}],
    ids=["uncertain", "unknown"],
)
async def test_of_each_part_the_look_counts_that_knows_it_best(
    tmp_path: Path, worse: int, known_worse: dict[str, Any]
) -> None:
    looks: list[int] = []

    def as_seen(number: int, _: StereoLook, perception: Perception) -> Perception:
        looks.append(number)
        if number != worse:
            return perception
        first, *others = perception.workpieces
        return replace(perception, workpieces=(replace(first, **known_worse), *others))

    cell = confirming(tmp_path)
    see(cell, as_seen)
    async with running(cell):
        assert await job(cell) == "Complete"
        assert cell.unit.snapshot()["moves_done"] == 3
    assert len(looks) == 2 + 3  # none had to be repeated: two before the plan, one after each move
