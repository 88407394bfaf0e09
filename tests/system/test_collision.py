"""A gripper that comes down on a part nobody expected there: the operator brings the cell back without a restart."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from srvs_cell.cli.simulated_cell import SimulatedCell, SimulationOptions, simulated_cell
from tests.system.test_failures import bring_up, codes, follow

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
FINGER_MM = 47.0
"""From the middle of the open gripper to the middle of a finger."""
LOW_MM = 40.0
ENDS = {"Held", "Aborted", "Complete", "Stopped"}


@pytest.fixture
def hasty_cell(tmp_path: Path) -> Iterator[SimulatedCell]:
    """A cell that comes down so fast that the arm stops only when it is millimetres deep in what it hits."""
    hasty = {"cell": {"motion": {"approach_mm": 15.0, "travel_speed_mm_s": 450.0}}}
    with simulated_cell(SimulationOptions(objects=3, seed=1, imperfections="none"), tmp_path, hasty) as running:
        yield running


def step_until(cell: SimulatedCell, reached: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Do the job in single steps until a condition holds between two of them."""
    assert cell.client.command("command/start")["accepted"]
    while True:
        status = follow(cell, lambda status: status["state"] in ENDS)
        assert status["state"] == "Held", status["alarms"]
        if reached(status):
            return status
        assert cell.client.command("command/unhold")["accepted"]


def low_part_to_pick(status: dict[str, Any]) -> dict[str, Any] | None:
    """Return the workpiece that is picked next, where it is one that the open fingers go far down for."""
    if status["next_step"] != "pick":
        return None
    identifier = status["plan_detail"]["moves"][status["moves_done"]]["workpiece"]
    workpiece: dict[str, Any] = next(part for part in status["workpieces"] if part["id"] == identifier)
    return workpiece if workpiece["height_mm"] < LOW_MM else None


def move_tall_part(cell: SimulatedCell, x_mm: float, y_mm: float) -> tuple[float, float]:
    """Put the tallest part somewhere else, as a person would; return where it stood."""
    tall = max(cell.control.ask("truth")["parts"], key=lambda part: float(part["height_mm"]))
    former_x_mm, former_y_mm, _ = tall["base_mm"]
    dx_mm, dy_mm = x_mm - former_x_mm, y_mm - former_y_mm
    assert cell.control.ask("inject", fault="move_part", part=tall["id"], dx_mm=dx_mm, dy_mm=dy_mm)["ok"]
    return former_x_mm, former_y_mm


def test_after_a_collision_the_operator_brings_the_cell_back_without_a_restart(hasty_cell: SimulatedCell) -> None:
    cell = hasty_cell
    bring_up(cell)
    assert cell.client.command("mode", {"mode": "Manual"})["accepted"]
    workpiece = low_part_to_pick(step_until(cell, lambda status: low_part_to_pick(status) is not None))
    assert workpiece is not None
    grasp, yaw = workpiece["grasp"]["position_mm"], math.radians(workpiece["grasp"]["yaw_deg"])
    under_finger = grasp[0] + FINGER_MM * math.cos(yaw), grasp[1] + FINGER_MM * math.sin(yaw)
    former_place = move_tall_part(cell, *under_finger)
    assert cell.client.command("command/unhold")["accepted"]
    status = follow(cell, lambda status: status["state"] in ENDS - {"Held"})
    assert status["state"] == "Aborted"
    assert 2012 in codes(status), "the collision has a name"
    collided = cell.control.ask("truth")
    assert collided["arm"]["force_n"] > 100.0, "the arm has come to a stand clear of the part: this is no test of it"

    assert cell.client.command("resolve", {"gripper": "empty"})["accepted"]
    bring_up(cell)
    assert cell.control.ask("truth")["motions_started"] == collided["motions_started"], "moved without a start"
    step_until(cell, lambda status: status["next_step"] == "observe_left")
    freed = cell.control.ask("truth")["arm"]
    assert freed["fault"] is None
    assert freed["true_pose"][2] > collided["arm"]["true_pose"][2] + 100.0, "the first step takes the arm straight up"

    move_tall_part(cell, *former_place)
    assert cell.client.command("command/stop")["accepted"]
    follow(cell, lambda status: status["state"] == "Stopped")
    assert cell.client.command("mode", {"mode": "Production"})["accepted"]
    assert cell.client.command("command/reset")["accepted"]
    follow(cell, lambda status: status["state"] == "Idle")
    assert cell.client.command("command/start")["accepted"]
    status = follow(cell, lambda status: status["state"] in ENDS)
    assert status["state"] == "Complete", status["alarms"]
