"""Looks must agree before anything is moved: an unseen part is one that the arm may hit."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from srvs_cell.cell import Unit
from tests.cell.support import Cell, build, connected, running

if TYPE_CHECKING:
    from collections.abc import Sequence
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
