"""The paper's job on object-level doubles."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from srvs_cell.cell import Command
from tests.cell.support import build, connected, running

if TYPE_CHECKING:
    from pathlib import Path


async def test_a_whole_job_puts_the_tallest_at_the_largest_y(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await cell.reaches("Complete", "Held", "Aborted", "Stopped")
        assert (cell.state, cell.alarms) == ("Complete", [])
        places = {block.name: (round(block.x_mm, 1), round(block.y_mm, 1)) for block in cell.world.blocks}
        assert places == {"tall": (300.0, 120.0), "middle": (300.0, 0.0), "low": (300.0, -120.0)}
        assert cell.world.dropped == []
        snapshot = cell.unit.snapshot()
        assert json.loads(json.dumps(snapshot)) == snapshot
        assert snapshot["moves_done"] == snapshot["moves_total"] == len(snapshot["plan"]) == 3
        assert snapshot["runs_done"] == 1


async def test_a_second_job_has_nothing_to_move(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await cell.reaches("Complete")
        await cell.give(Command.RESET)
        await cell.reaches("Idle")
        targets = len(cell.arm.targets)
        await cell.give(Command.START)
        await cell.reaches("Complete")
        assert cell.unit.snapshot()["plan"] == []
        assert len(cell.arm.targets) == targets + 2
