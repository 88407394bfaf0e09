"""Looks must agree before anything is moved: an unseen part is one that the arm may hit."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import count
from typing import TYPE_CHECKING

import numpy as np
import pytest

from srvs_cell.cell import Unit
from srvs_cell.scene import UNKNOWN_KIND
from tests.cell.support import Cell, build, connected, running

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from srvs_cell.cell import StereoLook
    from srvs_cell.scene import Perception


def blink(tmp_path: Path, missed: Sequence[int], agreeing_looks: int = 2) -> tuple[Cell, list[int]]:
    """Return a cell that does not see the first part in the looks of these numbers, and how many each look saw."""
    cell = build(tmp_path)
    equipment = cell.unit.equipment
    seen: list[int] = []

    def perceive(look: StereoLook) -> Perception:
        perception = equipment.perceive(look)
        workpieces = perception.workpieces[1:] if len(seen) in missed else perception.workpieces
        seen.append(len(workpieces))
        return replace(perception, workpieces=workpieces)

    look = replace(equipment.parameters.look, agreeing_looks=agreeing_looks)
    parameters = replace(equipment.parameters, look=look)
    cell.unit = Unit(replace(equipment, perceive=perceive, parameters=parameters), simulation=True)
    return cell, seen


def with_looks(tmp_path: Path, see: Callable[[int, StereoLook, Perception], Perception]) -> Cell:
    """Return a cell whose looks, counted from 0, see what a function makes of what is there; two must agree."""
    cell = build(tmp_path)
    equipment = cell.unit.equipment
    number = count()
    parameters = replace(equipment.parameters, look=replace(equipment.parameters.look, agreeing_looks=2))
    cell.unit = Unit(
        replace(
            equipment,
            perceive=lambda look: see(next(number), look, equipment.perceive(look)),
            parameters=parameters,
        ),
        simulation=True,
    )
    return cell


@pytest.mark.parametrize(("missed", "looks"), [((), [3, 3]), ((0,), [2, 3, 3]), ((1,), [3, 2, 3, 3])])
async def test_a_part_that_is_missed_once_is_relocated_all_the_same(
    tmp_path: Path, missed: tuple[int, ...], looks: list[int]
) -> None:
    cell, seen = blink(tmp_path, missed)
    async with running(cell):
        await connected(cell)
        await cell.start()
        assert await cell.reaches("Complete", "Held", "Aborted", "Stopped") == "Complete"
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
        await connected(cell)
        await cell.start()
        assert await cell.reaches("Complete", "Held", "Aborted", "Stopped") == "Complete"
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

    cell = with_looks(tmp_path, doubt_from_the_observe_pose)
    look = cell.unit.equipment.parameters.look
    async with running(cell):
        await connected(cell)
        await cell.start()
        assert await cell.reaches("Complete", "Held", "Aborted", "Stopped") == "Complete"
    observe = look.observe_pose.pose()
    assert places[:2] == [pytest.approx((observe.x_mm, observe.y_mm))] * 2
    assert all(math.dist(places[0], place) == pytest.approx(math.hypot(*look.aside_mm)) for place in places[2:])


@pytest.mark.parametrize("worse", [0, 1])
async def test_of_each_part_the_look_counts_that_knows_it_best(tmp_path: Path, worse: int) -> None:
    def doubt(number: int, _: StereoLook, perception: Perception) -> Perception:
        if number != worse:
            return perception
        first, *others = perception.workpieces
        return replace(perception, workpieces=(replace(first, covariance_mm2=100.0 * np.eye(3)), *others))

    cell = with_looks(tmp_path, doubt)
    async with running(cell):
        await connected(cell)
        await cell.start()
        assert await cell.reaches("Complete", "Held", "Aborted", "Stopped") == "Complete"
        assert cell.unit.snapshot()["moves_done"] == 3
        assert "UNCERTAIN_POSITION" not in {alarm["name"] for alarm in cell.unit.snapshot()["alarms"]}


@pytest.mark.parametrize("worse", [0, 1])
async def test_a_part_that_one_look_recognises_is_known(tmp_path: Path, worse: int) -> None:
    def forget(number: int, _: StereoLook, perception: Perception) -> Perception:
        if number != worse:
            return perception
        first, *others = perception.workpieces
        return replace(
            perception, workpieces=(replace(first, kind=UNKNOWN_KIND, grasp=None, grasp_refusal="unknown"), *others)
        )

    cell = with_looks(tmp_path, forget)
    async with running(cell):
        await connected(cell)
        await cell.start()
        assert await cell.reaches("Complete", "Held", "Aborted", "Stopped") == "Complete"
        assert cell.unit.snapshot()["moves_done"] == 3
