"""A verdict on a calibration: is it possible, and is it plausible for a camera on a robot's tool?"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from srvs_cell.calibration.calibration import Calibration

_RATIO_WARNING, _RATIO_ERROR = 0.02, 0.2
_CENTRE_WARNING, _CENTRE_ERROR = 0.1, 0.5
_FIELD_MIN_DEG, _FIELD_MAX_DEG = 5.0, 150.0
_FIELD_SAMPLES = 64
_TANGENTIAL_WARNING = 0.01
_HAND_EYE_WARNING_MM, _HAND_EYE_ERROR_MM = 500.0, 3000.0
_HAND_EYE_UNIT_MM = 1.0
_TILT_WARNING_DEG, _TILT_ERROR_DEG = 30.0, 90.0
_FOCAL_SIGMA_WARNING = 0.005
_HAND_EYE_SIGMA_WARNING_MM = 2.0


class Level(StrEnum):
    """How a finding counts."""

    OK = "ok"
    WARNING = "warning"
    ERROR = "error"


class CalibrationVerdict(StrEnum):
    """What the findings come to."""

    USABLE = "usable"
    DOUBTFUL = "doubtful"
    UNUSABLE = "unusable"


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        check: what was looked at.
        level: whether it is all right.
        value: what was found, with its unit.
        bound: what is expected.
        advice: what to do when it is not all right; empty otherwise.
    """

    check: str
    level: Level
    value: str
    bound: str
    advice: str = ""


def check_calibration(calibration: Calibration) -> list[Finding]:
    """Look at all that can be judged from the numbers alone; none of it replaces a touch test with a pointed tool."""
    return [
        _focal_ratio(calibration),
        _field_of_view(calibration),
        _principal_point(calibration),
        _distortion_monotone(calibration),
        _tangential(calibration),
        _hand_eye_distance(calibration),
        _hand_eye_tilt(calibration),
        _stated_uncertainty(calibration),
    ]


def verdict(findings: list[Finding]) -> CalibrationVerdict:
    """Return unusable if one finding is an error, doubtful if one is a warning, else usable."""
    levels = {finding.level for finding in findings}
    if Level.ERROR in levels:
        return CalibrationVerdict.UNUSABLE
    return CalibrationVerdict.DOUBTFUL if Level.WARNING in levels else CalibrationVerdict.USABLE


def _graded(value: float, warning: float, error: float) -> Level:
    if value > error:
        return Level.ERROR
    return Level.WARNING if value > warning else Level.OK


def _finding(check: str, level: Level, value: str, bound: str, advice: str) -> Finding:
    return Finding(check, level, value, bound, "" if level is Level.OK else advice)


def _focal_ratio(calibration: Calibration) -> Finding:
    ratio = calibration.camera.fx / calibration.camera.fy
    return _finding(
        "ratio fx/fy",
        _graded(abs(ratio - 1.0), _RATIO_WARNING, _RATIO_ERROR),
        f"{ratio:.5f}",
        f"1 +- {_RATIO_WARNING:g}",
        "Cameras of today have square pixels: calibrate the intrinsics again with the board tilted in both directions.",
    )


def _field_of_view(calibration: Calibration) -> Finding:
    camera = calibration.camera
    angle_deg = float(np.rad2deg(2.0 * np.arctan(camera.width / (2.0 * camera.fx))))
    inside = _FIELD_MIN_DEG <= angle_deg <= _FIELD_MAX_DEG
    return _finding(
        "horizontal field of view",
        Level.OK if inside else Level.ERROR,
        f"{angle_deg:.1f} deg",
        f"{_FIELD_MIN_DEG:g} to {_FIELD_MAX_DEG:g} deg",
        "Check that fx is in pixels of this image size, not in millimetres.",
    )


def _principal_point(calibration: Calibration) -> Finding:
    camera = calibration.camera
    off_x = camera.cx - (camera.width - 1) / 2.0
    off_y = camera.cy - (camera.height - 1) / 2.0
    share = max(abs(off_x) / camera.width, abs(off_y) / camera.height)
    return _finding(
        "principal point off the image centre",
        _graded(share, _CENTRE_WARNING, _CENTRE_ERROR),
        f"{off_x:+.1f}, {off_y:+.1f} px",
        f"{_CENTRE_WARNING:.0%} of the image",
        "Check that the image was not cropped or scaled since; calibrate with the board in all corners.",
    )


def _distortion_monotone(calibration: Calibration) -> Finding:
    """Distorted radius must grow with the true radius over the whole picture, else two rays meet in one pixel."""
    camera = calibration.camera
    k1, k2, _, _, k3 = camera.distortion
    corners_x = np.array([camera.cx, camera.width - 1 - camera.cx]) / camera.fx
    corners_y = np.array([camera.cy, camera.height - 1 - camera.cy]) / camera.fy
    reach = float(np.hypot(np.abs(corners_x).max(), np.abs(corners_y).max()))
    radius = np.linspace(0.0, reach, _FIELD_SAMPLES)
    slope = 1.0 + 3.0 * k1 * radius**2 + 5.0 * k2 * radius**4 + 7.0 * k3 * radius**6
    least = float(slope.min())
    return _finding(
        "distortion grows over the image field",
        Level.OK if least > 0.0 else Level.ERROR,
        f"least slope {least:.3f}",
        "above 0",
        "The radial coefficients fold the picture: calibrate with the board in the corners, or fix k3 to 0.",
    )


def _tangential(calibration: Calibration) -> Finding:
    _, _, p1, p2, _ = calibration.camera.distortion
    largest = max(abs(p1), abs(p2))
    return _finding(
        "tangential distortion",
        Level.OK if largest <= _TANGENTIAL_WARNING else Level.WARNING,
        f"{largest:.5f}",
        f"at most {_TANGENTIAL_WARNING:g}",
        "Check the order k1, k2, p1, p2, k3, and that the board is flat.",
    )


def _hand_eye_distance(calibration: Calibration) -> Finding:
    distance_mm = float(np.linalg.norm(calibration.tcp_T_camera.translation_mm))
    level = _graded(distance_mm, _HAND_EYE_WARNING_MM, _HAND_EYE_ERROR_MM)
    if 0.0 < distance_mm < _HAND_EYE_UNIT_MM:
        level = Level.WARNING
    return _finding(
        "camera to TCP distance",
        level,
        f"{distance_mm:.3f} mm",
        f"{_HAND_EYE_UNIT_MM:g} to {_HAND_EYE_WARNING_MM:g} mm",
        "Check the unit: metres mixed with millimetres pass silently through hand-eye solvers.",
    )


def _hand_eye_tilt(calibration: Calibration) -> Finding:
    cosine = float(np.clip(calibration.tcp_T_camera.rotation[2, 2], -1.0, 1.0))
    tilt_deg = float(np.rad2deg(np.arccos(cosine)))
    return _finding(
        "angle between the camera's optical axis and the tool's z axis",
        _graded(tilt_deg, _TILT_WARNING_DEG, _TILT_ERROR_DEG),
        f"{tilt_deg:.2f} deg",
        f"at most {_TILT_WARNING_DEG:g} deg",
        "The camera should look where the tool points: check that the transform is tcp_T_camera, not its inverse.",
    )


def _stated_uncertainty(calibration: Calibration) -> Finding:
    stated = calibration.uncertainty
    poor = stated.focal_relative > _FOCAL_SIGMA_WARNING or stated.hand_eye_mm > _HAND_EYE_SIGMA_WARNING_MM
    return _finding(
        "stated uncertainty",
        Level.WARNING if poor else Level.OK,
        f"f {stated.focal_relative:.2%}, hand-eye {stated.hand_eye_mm:g} mm",
        f"f {_FOCAL_SIGMA_WARNING:.2%}, hand-eye {_HAND_EYE_SIGMA_WARNING_MM:g} mm",
        "Picks will often be refused: calibrate with 10 to 20 distinct poses.",
    )
