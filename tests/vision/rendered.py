"""Stereo pairs of chosen parts, from the simulator's own renderer: lens, shading, shadows and grain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drivers.sim.gripper_geometry import CameraMount, GripperGeometry
from drivers.sim.lens import Lens
from drivers.sim.parts import CUBOID, Part
from drivers.sim.renderer import Renderer
from drivers.sim.sensor import Sensor
from drivers.sim.simulation import BASELINE_MM, OBSERVE_POSE, TABLE_CENTRE_MM
from drivers.sim.world import Snapshot, World
from srvs_cell.calibration import Calibration, CameraIntrinsics, HandEye, plan_right_pose
from srvs_cell.geometry import Transform
from srvs_cell.vision import StereoView

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array

SENSOR = Sensor(blur_px=0.7, full_well_e=8000.0, read_noise=1.2)
TABLE_Z_MM = TABLE_CENTRE_MM[2]
_TABLE_ALBEDO = 0.42


@dataclass(frozen=True, kw_only=True)
class Hull(Part):
    """A part of any convex shape."""

    corners_mm: tuple[tuple[float, float, float], ...]

    def vertices_mm(self) -> Array:
        return np.array(self.corners_mm)


def part(
    kind: str = CUBOID,
    size_mm: tuple[float, float] = (60.0, 40.0),
    height_mm: float = 40.0,
    at_mm: tuple[float, float] = (750.0, 0.0),
    yaw_deg: float = 20.0,
    albedo: float = 0.75,
    low_height_mm: float | None = None,
) -> Part:
    low_mm = height_mm if low_height_mm is None else low_height_mm
    length_mm, width_mm = size_mm
    return Part(
        kind=kind,
        length_mm=length_mm,
        width_mm=width_mm,
        height_mm=height_mm,
        low_height_mm=low_mm,
        x_mm=at_mm[0],
        y_mm=at_mm[1],
        yaw_deg=yaw_deg,
        albedo=albedo,
        label=False,
    )


def stereo_pair(
    parts: Sequence[Part], *, sensor: Sensor = SENSOR, lens: Lens | None = None, seed: int = 0
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], StereoView]:
    """Render the parts from both ends of the lateral path; returns the images and where they were taken."""
    lens = lens or Lens()
    mount = CameraMount().tcp_T_camera
    calibration = Calibration(
        camera=CameraIntrinsics(
            width=lens.width,
            height=lens.height,
            fx=lens.fx,
            fy=lens.fy,
            cx=lens.cx,
            cy=lens.cy,
            distortion=lens.distortion,
        ),
        hand_eye=HandEye(xyz_mm=(mount.x_mm, mount.y_mm, mount.z_mm), wpr_deg=(mount.w_deg, mount.p_deg, mount.r_deg)),
    )
    left = Transform.from_xyzwpr("base", "tcp", OBSERVE_POSE)
    right = plan_right_pose(calibration, left, BASELINE_MM)
    world = World(tuple(parts), GripperGeometry(), TABLE_CENTRE_MM, left.matrix)
    renderer = Renderer(world, lens, CameraMount().transform().matrix, _TABLE_ALBEDO, seed)
    random = np.random.default_rng(seed)
    still = world.snapshot()
    images = [sensor.expose(renderer.render(Snapshot(0.0, still.qpos, pose.matrix)), random) for pose in (left, right)]
    return images[0], images[1], StereoView(calibration, left, right, TABLE_Z_MM)
