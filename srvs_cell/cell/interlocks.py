"""Process checks before every motion. They stand beside the robot's own safety functions, never instead of them.

Pure: a status, a target and the limits in; nothing out, or an `AlarmError` with the values and the bound.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.ports import RobotMode

if TYPE_CHECKING:
    from srvs_cell.calibration import CameraIntrinsics, RobotFrames
    from srvs_cell.config import MotionParameters, ToleranceParameters, WorkspaceBox
    from srvs_cell.geometry import Xyzwpr
    from srvs_cell.ports import Frame, RobotStatus
    from srvs_cell.scene import Workpiece

_SIGMAS = 2.0


def check_robot_ready(status: RobotStatus, frames: RobotFrames) -> None:
    """Raise where the robot may not be moved by this PC.

    Raises:
        AlarmError: ROBOT_FAULT, MODE_NOT_AUTO (mode switch or pendant), ROBOT_NOT_READY (servo off or E-stop),
            FRAME_CHANGED (user frame or tool number is not the calibration's).
    """
    if status.fault is not None:
        raise AlarmError(Alarm.ROBOT_FAULT, f"The controller reports: {status.fault}.")
    if status.mode is not RobotMode.AUTO:
        raise AlarmError(Alarm.MODE_NOT_AUTO, f"The mode switch is at {status.mode.value}.")
    if status.pendant_enabled:
        raise AlarmError(Alarm.MODE_NOT_AUTO, "The teach pendant is enabled.")
    if not status.servo_on:
        raise AlarmError(Alarm.ROBOT_NOT_READY, "The drives are off or an emergency stop is pressed.")
    for name, calibrated, present in (
        ("user frame", frames.user_frame, status.user_frame),
        ("tool frame", frames.user_tool, status.user_tool),
    ):
        if calibrated is not None and present is not None and calibrated != present:
            raise AlarmError(
                Alarm.FRAME_CHANGED, f"The active {name} is {present}, the calibration was made with {calibrated}."
            )


def check_target(target: Xyzwpr, workspace: WorkspaceBox) -> None:
    """Raise `AlarmError` WORKSPACE_LIMIT where a TCP target lies outside the box."""
    if violation := workspace.violation(target):
        raise AlarmError(Alarm.WORKSPACE_LIMIT, f"Target {target}: {violation}.")


def check_speed(speed_mm_s: float, motion: MotionParameters) -> None:
    """Raise `AlarmError` SPEED_LIMIT where a straight move is faster than the cell's limit."""
    if not 0.0 < speed_mm_s <= motion.speed_limit_mm_s:
        raise AlarmError(
            Alarm.SPEED_LIMIT, f"{speed_mm_s} mm/s was asked for, the limit is {motion.speed_limit_mm_s} mm/s."
        )


def check_certainty(workpiece: Workpiece, tolerance: ToleranceParameters) -> None:
    """Raise `AlarmError` UNCERTAIN_POSITION where two sigma of a position exceed what a grasp survives."""
    covariance = np.asarray(workpiece.covariance_mm2, dtype=np.float64)
    if not np.isfinite(covariance).all():
        raise AlarmError(Alarm.UNCERTAIN_POSITION, f"Workpiece {workpiece.id}: its covariance is not finite.")
    horizontal_mm = _SIGMAS * float(np.sqrt(max(0.0, np.linalg.eigvalsh(covariance[:2, :2])[-1])))
    vertical_mm = _SIGMAS * float(np.sqrt(max(0.0, covariance[2, 2])))
    for name, value_mm, bound_mm in (
        ("horizontally", horizontal_mm, tolerance.grasp_mm),
        ("vertically", vertical_mm, tolerance.grasp_height_mm),
    ):
        if value_mm > bound_mm:
            raise AlarmError(
                Alarm.UNCERTAIN_POSITION,
                f"Workpiece {workpiece.id} ({workpiece.kind}) is known to {value_mm:.1f} mm {name} (two sigma), "
                f"a grasp allows {bound_mm:.1f} mm.",
            )


def check_frame(frame: Frame, not_before_s: float, camera: CameraIntrinsics) -> None:
    """Raise where a frame is older than asked for or not of the calibrated size.

    Raises:
        AlarmError: CAMERA_STALE, IMAGE_INVALID.
    """
    if frame.exposed_at_s < not_before_s:
        age_ms = (not_before_s - frame.exposed_at_s) * 1000.0
        raise AlarmError(Alarm.CAMERA_STALE, f"The frame was exposed {age_ms:.0f} ms before it was asked for.")
    height, width = frame.image.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise AlarmError(
            Alarm.IMAGE_INVALID,
            f"The camera delivers {width} x {height} px, the calibration is for {camera.width} x {camera.height} px.",
        )
