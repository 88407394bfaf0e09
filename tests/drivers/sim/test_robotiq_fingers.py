"""The Robotiq double's fingers as jaws of the simulated world, and the link to its serial port."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from drivers.sim.robotiq_fingers import ENDS, FASTEST, Contact, WorldFingers
from tests.drivers.sim.stepping import above, go, grasp_pose, make_simulation, pass_time

if TYPE_CHECKING:
    from pathlib import Path


def test_they_feel_what_stands_between_them_and_nothing_where_nothing_stands(tmp_path: Path) -> None:
    simulation = make_simulation(tmp_path, objects=2)
    world = simulation.world
    fingers = WorldFingers(world, simulation.time.lock, world.gripper.max_opening_mm)
    assert fingers.position == pytest.approx(ENDS[0], abs=1)
    assert fingers.contact() is Contact.ARRIVED
    fingers.go(255, FASTEST)
    assert fingers.contact() is Contact.MOVING
    pass_time(simulation, 0.6)
    assert fingers.contact() is Contact.ARRIVED
    assert fingers.position == pytest.approx(ENDS[1], abs=2)
    fingers.go(0, FASTEST)
    pass_time(simulation, 0.6)
    assert fingers.contact() is Contact.ARRIVED
    go(simulation, above(grasp_pose(simulation, 0)))
    go(simulation, grasp_pose(simulation, 0), 80.0)
    fingers.go(255, FASTEST)
    pass_time(simulation, 0.6)
    assert fingers.contact() is Contact.WHILE_CLOSING
    width_mm = world.gripper.max_opening_mm * (ENDS[1] - fingers.position) / (ENDS[1] - ENDS[0])
    assert width_mm == pytest.approx(world.opening_mm, abs=0.1)
    fingers.stand()
    go(simulation, above(grasp_pose(simulation, 0)), 200.0)
    assert world.held_part() == 0
