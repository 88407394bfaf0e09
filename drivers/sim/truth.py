"""What is true in the simulated cell, as plain data for demos and tests. Nothing that controls the cell may see it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.sim.parts import CUBOID, PRISM, WEDGE
from srvs_cell.geometry import Transform

if TYPE_CHECKING:
    from drivers.sim.parts import Part
    from drivers.sim.simulation import Simulation
    from drivers.sim.world import PartPose

_PRISM_SYMMETRY_DEG = 60.0


def truth(simulation: Simulation) -> dict[str, Any]:
    """Return parts (start and present), arm, gripper and time. Millimetres and degrees, base frame."""
    with simulation.time.lock:
        world, arm = simulation.world, simulation.arm
        parts = [
            _part(index, part, start, now)
            for index, (part, start, now) in enumerate(
                zip(world.parts, world.start_poses, world.part_poses(), strict=True)
            )
        ]
        true_pose = Transform("base", "tcp", world.base_T_tcp).to_xyzwpr()
        return {
            "time_s": world.time_s,
            "table_z_mm": world.table_z_mm,
            "parts": parts,
            "gripper": {"opening_mm": world.opening_mm, "held_part": world.held_part()},
            "arm": {
                "reported_pose": list(arm.pose.as_tuple()),
                "true_pose": list(true_pose.as_tuple()),
                "joints_deg": list(arm.joints_deg),
                "moving": arm.moving,
                "fault": arm.fault,
                "force_n": world.force_on_hand_n(),
            },
        }


def _part(index: int, part: Part, start: PartPose, now: PartPose) -> dict[str, Any]:
    return {
        "id": index,
        "kind": part.kind,
        "height_mm": part.height_mm,
        "low_height_mm": part.low_height_mm,
        "size_mm": [part.length_mm, part.width_mm],
        "albedo": part.albedo,
        **_pose(part, now),
        "start": _pose(part, start),
    }


def _pose(part: Part, pose: PartPose) -> dict[str, Any]:
    """Return place and direction; yaw of the long side modulo 180, of a prism's corner modulo 60, none of a cylinder.

    ``position_mm`` is the true centre of the top (wedge: inclined) face, wherever the part lies; ``rise_deg`` the
    direction in which that of a wedge rises, modulo 360.
    """
    matrix = pose.base_T_part
    top = matrix[:3, :3] @ part.top_centre_mm + matrix[:3, 3]
    yaw_deg: float | None = None
    if part.kind in {CUBOID, WEDGE}:
        yaw_deg = pose.yaw_deg
    elif part.kind == PRISM:
        yaw_deg = pose.yaw_deg % _PRISM_SYMMETRY_DEG
    # a wedge's low side is at its own +x
    rise_deg = float(np.rad2deg(np.arctan2(-matrix[1, 0], -matrix[0, 0])) % 360.0) if part.kind == WEDGE else None
    return {
        "position_mm": [float(value) for value in top],
        "base_mm": [float(value) for value in np.asarray(matrix[:3, 3])],
        "yaw_deg": yaw_deg,
        "rise_deg": rise_deg,
        "tilt_deg": pose.tilt_deg,
    }
