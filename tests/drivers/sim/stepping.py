"""A simulated cell that is stepped by hand: no threads, no wires."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from drivers.sim.clock_page import ClockPage
from drivers.sim.simulation import Simulation, SimulationParameters
from drivers.sim.world_model import TIMESTEP_S
from srvs_cell.geometry import Xyzwpr

if TYPE_CHECKING:
    from pathlib import Path

CLOSE, OPEN = 1, 2
TRAVEL_Z_MM = 130.0


def make_simulation(folder: Path, objects: int = 3, seed: int = 0, level: str = "none") -> Simulation:
    page = ClockPage.create(folder / "clock")
    return Simulation(SimulationParameters(objects=objects, seed=seed, level=level), page)


def pass_time(simulation: Simulation, seconds: float) -> None:
    for _ in range(round(seconds / TIMESTEP_S)):
        simulation.step()


def finish_motion(simulation: Simulation) -> float:
    """Step until the arm stands; return the seconds that it took."""
    start_s = simulation.world.time_s
    while simulation.arm.moving:
        simulation.step()
    return simulation.world.time_s - start_s


def go(simulation: Simulation, target: Xyzwpr, speed_mm_s: float = 400.0) -> float:
    simulation.arm.start_linear(target, speed_mm_s)
    return finish_motion(simulation)


def grip(simulation: Simulation, *, close: bool) -> None:
    simulation.arm.set_output(OPEN if close else CLOSE, False)
    simulation.arm.set_output(CLOSE if close else OPEN, True)
    pass_time(simulation, 0.6)


def grasp_pose(simulation: Simulation, part: int, along_mm: float = 0.0) -> Xyzwpr:
    """TCP pose that grips a part at its middle, or ``along_mm`` from it along the pads."""
    thing = simulation.world.parts[part]
    top = (thing.height_mm + thing.low_height_mm) / 2.0
    z_mm = simulation.world.table_z_mm + max(3.0, top - 12.0)
    r_deg = thing.yaw_deg - 180.0  # the jaws close along the TCP's y axis: yaw R - 90
    pose = Xyzwpr(thing.x_mm, thing.y_mm, z_mm, 180.0, 0.0, r_deg)
    return offset(pose, along_mm, 0.0)


def offset(pose: Xyzwpr, tcp_x_mm: float, base_z_mm: float) -> Xyzwpr:
    """Shift a pose along the TCP's x axis and upwards."""
    angle = np.deg2rad(pose.r_deg)
    return Xyzwpr(
        pose.x_mm + tcp_x_mm * float(np.cos(angle)),
        pose.y_mm + tcp_x_mm * float(np.sin(angle)),
        pose.z_mm + base_z_mm,
        pose.w_deg,
        pose.p_deg,
        pose.r_deg,
    )


def above(pose: Xyzwpr) -> Xyzwpr:
    return Xyzwpr(pose.x_mm, pose.y_mm, TRAVEL_Z_MM, pose.w_deg, pose.p_deg, pose.r_deg)
