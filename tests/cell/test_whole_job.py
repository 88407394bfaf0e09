"""The paper's job on object-level doubles."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.cell import Command, Unit
from tests.cell.support import build, connected, running

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from srvs_cell.cell import StereoLook
    from srvs_cell.geometry import Transform, Xyzwpr
    from srvs_cell.scene import Perception


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


async def test_the_left_image_is_worked_on_while_the_arm_travels(tmp_path: Path) -> None:
    cell = build(tmp_path)
    equipment, looks = cell.unit.equipment, []

    def analyse(image: NDArray[np.uint8], base_T_tcp_left: Transform, base_T_tcp_right: Transform) -> str:
        moved_mm = np.linalg.norm(base_T_tcp_right.translation_mm - base_T_tcp_left.translation_mm)
        return f"frame {image[0, 0]}, {moved_mm:.1f} mm"

    def perceive(look: StereoLook) -> Perception:
        looks.append((look.early, int(look.left[0, 0]), int(look.right[0, 0])))
        return equipment.perceive(look)

    cell.unit = Unit(replace(equipment, analyse_left=analyse, perceive=perceive), simulation=True)
    async with running(cell):
        await connected(cell)
        await cell.start()
        assert await cell.reaches("Complete", "Held", "Aborted", "Stopped") == "Complete"
        assert looks == [(f"frame {left}, 30.0 mm", left, left + 1) for left in (2, 4, 6, 8)]


async def test_images_perception_plan_and_verification_are_kept(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await cell.reaches("Complete")
        folder = tmp_path / "runs" / "000001"
        assert cell.unit.snapshot()["run_directory"] == str(folder)
        looks = [f"{name}_{look}" for look in range(4) for name in ("left", "perception", "right")]
        kept = [*looks, "plan_0", "verify_1", "verify_2", "verify_3"]
        assert sorted(path.stem for path in folder.iterdir()) == sorted(kept)
        plan = json.loads((folder / "plan_0.json").read_text())
        assert [goal["point_mm"] for goal in plan["goals"]] == [[300.0, -120.0], [300.0, 0.0], [300.0, 120.0]]
        assert cell.unit.snapshot()["job_time_s"] > 10.0


async def test_every_motion_was_intended_before_it_was_commanded(tmp_path: Path) -> None:
    cell = build(tmp_path)
    order: list[str] = []
    move = cell.arm.move_linear

    async def commanded(target: Xyzwpr, speed_mm_s: float) -> Xyzwpr:
        (last,) = await cell.journal.motions(1)
        assert (last["outcome"], last["detail"]["target"]) == (None, list(target.as_tuple()))
        order.append("command")
        return await move(target, speed_mm_s)

    cell.arm.move_linear = commanded  # type: ignore[method-assign]
    async with running(cell):
        await connected(cell)
        await cell.start()
        assert await cell.reaches("Complete", "Held", "Aborted", "Stopped") == "Complete"
        assert len(order) > 20
        assert all(motion["outcome"] for motion in await cell.journal.motions(500))
