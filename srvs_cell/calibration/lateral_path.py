"""The lateral path: the straight sideways move of the camera between the left and the right image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.geometry import Transform, pose_difference

if TYPE_CHECKING:
    from srvs_cell.calibration.calibration import Calibration

MIN_BASELINE_MM = 2.0
"""Below this, a repeatability of 0.03 mm is already 1.5 % of depth."""
MIN_PLANNED_MM = 3.0
"""Above the least baseline by more than a robot misses its target."""
MAX_ROTATION_DEG = 5.0
"""Rectification takes up small rotations; beyond this the images lose common field."""
MAX_DIRECTION_ERROR_DEG = 15.0
"""Between the motion and the camera's +x axis; at 90 degrees it would be an axial or a vertical camera model."""


@dataclass(frozen=True)
class BaselineReport:
    """What two poses make of a stereo pair.

    Attributes:
        baseline_mm: distance between the camera centres.
        rotation_deg: angle between the two orientations.
        along_x_mm, along_y_mm, along_z_mm: the motion in the left camera's axes.
    """

    baseline_mm: float
    rotation_deg: float
    along_x_mm: float
    along_y_mm: float
    along_z_mm: float


def plan_right_pose(calibration: Calibration, base_T_tcp_left: Transform, baseline_mm: float) -> Transform:
    """Return the right TCP pose: the camera moves along its own +x axis by ``baseline_mm``, without rotation.

    Args:
        calibration: for the hand-eye transform.
        base_T_tcp_left: Transform("base", "tcp") at the left end of the path.
        baseline_mm: length of the path; the paper's is 30 mm.

    Raises:
        AlarmError: BASELINE_INVALID where the baseline is shorter than `MIN_PLANNED_MM`.
    """
    if not baseline_mm >= MIN_PLANNED_MM:
        raise AlarmError(Alarm.BASELINE_INVALID, f"baseline_mm = {baseline_mm:g}: must be at least {MIN_PLANNED_MM:g}.")
    return moved_aside(calibration, base_T_tcp_left, baseline_mm, 0.0)


def moved_aside(calibration: Calibration, base_T_tcp: Transform, along_mm: float, across_mm: float) -> Transform:
    """Return the TCP pose from which the camera has moved along its own x and y axes, without rotation.

    Args:
        calibration: for the hand-eye transform.
        base_T_tcp: Transform("base", "tcp") before.
        along_mm: along the camera's x axis.
        across_mm: along its y axis.
    """
    camera_axes = (base_T_tcp @ calibration.tcp_T_camera).rotation
    shift_mm = camera_axes @ np.array([along_mm, across_mm, 0.0])
    return Transform.from_parts(
        base_T_tcp.target, base_T_tcp.source, base_T_tcp.rotation, base_T_tcp.translation_mm + shift_mm
    )


def measure_baseline(
    calibration: Calibration, base_T_tcp_left: Transform, base_T_tcp_right: Transform
) -> BaselineReport:
    """Return what the two poses make of a stereo pair, without judging it."""
    left = base_T_tcp_left @ calibration.tcp_T_camera
    right = base_T_tcp_right @ calibration.tcp_T_camera
    distance_mm, angle_deg = pose_difference(left, right)
    x_mm, y_mm, z_mm = (float(value) for value in left.inverse().apply(right.translation_mm))
    return BaselineReport(distance_mm, angle_deg, x_mm, y_mm, z_mm)


def check_baseline(calibration: Calibration, base_T_tcp_left: Transform, base_T_tcp_right: Transform) -> BaselineReport:
    """Refuse two poses that make no usable stereo pair.

    Args:
        calibration: for the hand-eye transform.
        base_T_tcp_left: Transform("base", "tcp") at the left end, as reported.
        base_T_tcp_right: the same at the right end.

    Returns:
        The measured baseline.

    Raises:
        AlarmError: BASELINE_INVALID: too short, turned too far, to the wrong side, or along the optical or the vertical
            axis of the image.
    """
    report = measure_baseline(calibration, base_T_tcp_left, base_T_tcp_right)
    if report.baseline_mm < MIN_BASELINE_MM:
        raise AlarmError(
            Alarm.BASELINE_INVALID,
            f"The camera moved {report.baseline_mm:.3f} mm; at least {MIN_BASELINE_MM:g} mm are needed.",
        )
    if report.rotation_deg > MAX_ROTATION_DEG:
        raise AlarmError(
            Alarm.BASELINE_INVALID,
            f"The camera turned by {report.rotation_deg:.3f} deg between the images; at most {MAX_ROTATION_DEG:g} deg.",
        )
    motion = f"x {report.along_x_mm:.3f}, y {report.along_y_mm:.3f}, z {report.along_z_mm:.3f} mm in the left camera"
    if report.along_x_mm < 0.0 and abs(report.along_x_mm) >= np.hypot(report.along_y_mm, report.along_z_mm):
        raise AlarmError(
            Alarm.BASELINE_INVALID, f"The camera moved to its left ({motion}): left and right are exchanged."
        )
    aside_mm = float(np.hypot(report.along_y_mm, report.along_z_mm))
    direction_deg = float(np.rad2deg(np.arctan2(aside_mm, report.along_x_mm)))
    if direction_deg > MAX_DIRECTION_ERROR_DEG:
        axis = "optical axis" if abs(report.along_z_mm) > abs(report.along_y_mm) else "image's vertical axis"
        raise AlarmError(
            Alarm.BASELINE_INVALID,
            f"The motion ({motion}) is {direction_deg:.1f} deg off the camera's x axis, towards the {axis}; "
            f"at most {MAX_DIRECTION_ERROR_DEG:g} deg.",
        )
    return report
