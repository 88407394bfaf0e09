"""What is not perfect about the simulated cell, and the calibration file that does not know it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import yaml

from drivers.sim.arm import Repeatability
from drivers.sim.lens import Lens
from drivers.sim.sensor import Sensor
from srvs_cell.geometry import Transform, axis_rotation

if TYPE_CHECKING:
    from pathlib import Path

    from srvs_cell.geometry import Array

_CUT_SIGMAS: Final = 2.5
_DECIMALS: Final = 6


@dataclass(frozen=True, kw_only=True)
class Imperfections:
    """A level of imperfection. Errors are normal, cut at 2.5 sigma; each field is one standard deviation.

    Attributes:
        sensor: blur, vignetting and noise of the pictures.
        distorted: whether the lens distorts; a real one always does, and the calibration knows it.
        focal_relative: error of the calibrated focal length, as a share.
        principal_point_px: of the principal point, per axis.
        hand_eye_mm, hand_eye_deg: of the calibrated mount of the camera, per axis.
        repeatability: of the arm's true pose against the reported one.
        frame_lag_s: from exposure to the moment at which a frame can be had.
        queue_depth: frames that wait for their reader; while it is full new ones are dropped, as V4L2 does.
    """

    sensor: Sensor = field(default_factory=Sensor)
    distorted: bool = True
    focal_relative: float = 0.0
    principal_point_px: float = 0.0
    hand_eye_mm: float = 0.0
    hand_eye_deg: float = 0.0
    repeatability: Repeatability = field(default_factory=Repeatability)
    frame_lag_s: float = 0.0
    queue_depth: int = 4


LEVELS: Final = {
    "none": Imperfections(),
    "real": Imperfections(
        sensor=Sensor(blur_px=0.7, vignette=0.12, full_well_e=8000.0, read_noise=1.2),
        focal_relative=0.001,
        principal_point_px=0.5,
        hand_eye_mm=0.3,
        hand_eye_deg=0.05,
        repeatability=Repeatability(position_mm=0.03, angle_deg=0.005),
        frame_lag_s=0.05,
    ),
}


@dataclass(frozen=True, eq=False)
class CameraTruth:
    """The camera as it really is, and as the calibration says.

    Attributes:
        lens, mount: true lens and tcp_T_camera.
        calibrated_lens, calibrated_mount: what the file says.
    """

    lens: Lens
    mount: Transform
    calibrated_lens: Lens
    calibrated_mount: Transform


def make_camera(imperfections: Imperfections, nominal_mount: Transform, random: np.random.Generator) -> CameraTruth:
    """Draw a camera: no two are alike, and none is quite what its calibration says."""
    lens = Lens(
        fx=820.0 + float(random.uniform(-8.0, 8.0)),
        fy=820.0 + float(random.uniform(-8.0, 8.0)),
        cx=319.5 + float(random.uniform(-6.0, 6.0)),
        cy=239.5 + float(random.uniform(-6.0, 6.0)),
    )
    if not imperfections.distorted:
        lens = replace(lens, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))
    scale = 1.0 + imperfections.focal_relative * _normal(random, 1)[0]
    shift = imperfections.principal_point_px * _normal(random, 2)
    calibrated_lens = replace(
        lens, fx=lens.fx * scale, fy=lens.fy * scale, cx=lens.cx + float(shift[0]), cy=lens.cy + float(shift[1])
    )
    true_mount = nominal_mount @ _small(random, 0.5, 0.3)
    calibrated = true_mount @ _small(random, imperfections.hand_eye_mm, imperfections.hand_eye_deg)
    return CameraTruth(lens, true_mount, calibrated_lens, calibrated)


def write_calibration(camera: CameraTruth, path: Path) -> None:
    """Write the calibration file of the cell (schema version 1)."""
    lens, mount = camera.calibrated_lens, camera.calibrated_mount.to_xyzwpr()
    content: dict[str, Any] = {
        "schema_version": 1,
        "camera": {
            "width": lens.width,
            "height": lens.height,
            "fx": _rounded(lens.fx),
            "fy": _rounded(lens.fy),
            "cx": _rounded(lens.cx),
            "cy": _rounded(lens.cy),
            "distortion": [float(value) for value in lens.distortion],
        },
        "tcp_T_camera": {
            "xyz_mm": [_rounded(value) for value in mount.as_tuple()[:3]],
            "wpr_deg": [_rounded(value) for value in mount.as_tuple()[3:]],
        },
        "robot": {"user_frame": 1, "user_tool": 1},
    }
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def _normal(random: np.random.Generator, count: int) -> Array:
    return np.asarray(np.clip(random.standard_normal(count), -_CUT_SIGMAS, _CUT_SIGMAS))


def _small(random: np.random.Generator, millimetres: float, degrees: float) -> Transform:
    """Draw a small camera_T_camera: a shift and a turn about each axis."""
    shift, turn = millimetres * _normal(random, 3), degrees * _normal(random, 3)
    rotation = axis_rotation("x", turn[0]) @ axis_rotation("y", turn[1]) @ axis_rotation("z", turn[2])
    return Transform.from_parts("camera", "camera", rotation, shift)


def _rounded(value: float) -> float:
    return round(float(value), _DECIMALS)
