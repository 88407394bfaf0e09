"""A part that cannot be taken: nobody is left to find out by counting."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from srvs_cell.scene import UNKNOWN_KIND
from tests.cell.support import PARAMETERS, Cell, build, job, running, see

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Any

    from srvs_cell.cell import StereoLook
    from srvs_cell.config import CellParameters
    from srvs_cell.scene import Perception

LEAVE = replace(PARAMETERS, unmovable_parts="leave")
UNKNOWN: dict[str, Any] = {"kind": UNKNOWN_KIND}
TOO_WIDE: dict[str, Any] = {"grasp": None, "grasp_refusal": "91.0 mm wide, the gripper opens to 80.0 mm"}


def with_a_part(tmp_path: Path, what: dict[str, Any], parameters: CellParameters, looks: int = 100) -> Cell:
    """Return a cell that in its first looks sees the middle part as something that cannot be taken."""
    cell = build(tmp_path, parameters=parameters)

    def as_seen(number: int, _: StereoLook, perception: Perception) -> Perception:
        if number >= looks:
            return perception
        low, middle, tall = perception.workpieces
        return replace(perception, workpieces=(low, replace(middle, **what), tall))

    see(cell, as_seen)
    return cell


def told(cell: Cell) -> str:
    return next(str(alarm["detail"]) for alarm in cell.unit.snapshot()["alarms"] if alarm["name"] == "PART_LEFT")


@pytest.mark.parametrize(
    ("what", "why"), [(UNKNOWN, "(unknown) at (300, 0): its shape is in no library"), (TOO_WIDE, "91.0 mm wide")]
)
async def test_it_holds_the_cell_before_anything_is_moved(tmp_path: Path, what: dict[str, Any], why: str) -> None:
    async with running(with_a_part(tmp_path, what, PARAMETERS)) as cell:
        assert await job(cell) == "Held"
        assert why in told(cell)
        assert cell.unit.snapshot()["moves_done"] == 0
        assert not any(motion["kind"] == "close" for motion in await cell.journal.motions(500))


async def test_a_part_that_was_seen_badly_once_is_looked_at_again(tmp_path: Path) -> None:
    async with running(with_a_part(tmp_path, UNKNOWN, PARAMETERS, looks=1)) as cell:
        assert await job(cell) == "Complete"
        assert cell.unit.snapshot()["moves_done"] == 3


async def test_the_warning_says_where_it_stands_and_why_it_is_unknown(tmp_path: Path) -> None:
    cut_off = {**UNKNOWN, "grasp": None, "grasp_refusal": "the picture's border cuts it off"}
    async with running(with_a_part(tmp_path, cut_off, LEAVE)) as cell:
        assert await job(cell) == "Complete"
        details = [alarm["detail"] for alarm in cell.unit.snapshot()["alarms"] if alarm["name"] == "UNKNOWN_OBJECT"]
        assert details[0] == "At x = 300 mm, y = 0 mm (the picture's border cuts it off)."
        assert "(unknown) at (300, 0): the picture's border cuts it off" in told(cell)


async def test_where_the_config_allows_it_the_others_are_moved_round_it_and_the_end_says_so(tmp_path: Path) -> None:
    async with running(with_a_part(tmp_path, UNKNOWN, LEAVE)) as cell:
        assert await job(cell) == "Complete"
        assert "workpiece 1 (unknown) at (300, 0): its shape is in no library" in told(cell)
        (alarm,) = [alarm for alarm in cell.unit.snapshot()["alarms"] if alarm["name"] == "PART_LEFT"]
        assert alarm["severity"] == "warning"
        assert "object library" in alarm["remedy"]
        assert {block.name: block.y_mm for block in cell.world.blocks} == pytest.approx(
            {"low": -120.0, "middle": 0.0, "tall": 120.0}
        )
