"""Calibration: the calibration file and its check, lateral path, error budget."""

from srvs_cell.calibration.calibration import Calibration, CameraIntrinsics, HandEye, RobotFrames, Uncertainty
from srvs_cell.calibration.check import CalibrationVerdict, Finding, Level, check_calibration, verdict
from srvs_cell.calibration.error_budget import ErrorBudget
from srvs_cell.calibration.lateral_path import (
    BaselineReport,
    check_baseline,
    measure_baseline,
    moved_aside,
    plan_right_pose,
)
from srvs_cell.calibration.table_reference import BASIS, TableReference

__all__ = [
    "BASIS",
    "BaselineReport",
    "Calibration",
    "CalibrationVerdict",
    "CameraIntrinsics",
    "ErrorBudget",
    "Finding",
    "HandEye",
    "Level",
    "RobotFrames",
    "TableReference",
    "Uncertainty",
    "check_baseline",
    "check_calibration",
    "measure_baseline",
    "moved_aside",
    "plan_right_pose",
    "verdict",
]
