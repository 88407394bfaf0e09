"""The error budget: how uncertain a triangulated point is, and what it owes that to.

A pixel pair is turned into a point of the base frame by the estimated focal length, principal point, hand-eye
transform and poses. `point_errors` differentiates that map numerically by each of them. *Random* errors (pixel noise)
differ from point to point; *systematic* ones (calibration, poses) are nearly the same over one scene, so that they
cancel between neighbours and never average out (references/vision.md C, systematics rule).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from srvs_cell.calibration.calibration import Uncertainty

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike

    from srvs_cell.geometry import Array, Transform

_STEPS = {"px": 1e-3, "relative": 1e-6, "mm": 1e-3, "rad": 1e-6}
"""Half steps of the central differences; the map is smooth, so that only rounding bounds them from below."""
_CAUSES: tuple[tuple[str, str, int], ...] = (
    ("pixel_x", "px", 1),
    ("pixel_y", "px", 1),
    ("disparity", "px", 1),
    ("focal", "relative", 1),
    ("principal_point", "px", 2),
    ("hand_eye_position", "mm", 3),
    ("hand_eye_orientation", "rad", 3),
    ("pose_position", "mm", 3),
    ("pose_orientation", "rad", 3),
)
"""Name, unit, number of components of each cause, in the order of the parameter vector."""
_COUNT = sum(count for _, _, count in _CAUSES)
_RANDOM = ("pixel_x", "pixel_y", "disparity")


@dataclass(frozen=True)
class ErrorBudget:
    """What the uncertainty of points seen by one rectified pair depends on.

    Attributes:
        f_px: focal length of the rectified cameras.
        baseline_mm: distance between them.
        base_T_camera: the left rectified camera in the base frame.
        tcp_in_camera_mm: the TCP in the left rectified camera's frame; the right pose turns about it.
        uncertainty: one standard deviation of each calibrated number.
    """

    f_px: float
    baseline_mm: float
    base_T_camera: Transform  # noqa: N815 - the house's notation for transforms
    tcp_in_camera_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    uncertainty: Uncertainty = field(default_factory=Uncertainty)

    def jacobian(self, point_mm: ArrayLike) -> Array:
        """Return the derivative of an estimated point by each cause: shape (3, 18), millimetres per unit.

        Args:
            point_mm: the point in the base frame, shape (3,).
        """
        point = self.base_T_camera.inverse().apply(np.asarray(point_mm, dtype=np.float64))
        columns = []
        for unit, index in zip(_units(), range(_COUNT), strict=True):
            errors = np.zeros(_COUNT)
            errors[index] = _STEPS[unit]
            slope = (self._estimate(point, errors) - self._estimate(point, -errors)) / (2.0 * _STEPS[unit])
            columns.append(self.base_T_camera.rotate(slope))
        return np.column_stack(columns)

    def point_errors(self, point_mm: ArrayLike, *, sigma_x_px: float, sigma_d_px: float) -> dict[str, Array]:
        """Return the covariance of a point by cause, each 3x3 in square millimetres, base frame.

        Args:
            point_mm: the point in the base frame, shape (3,).
            sigma_x_px: standard deviation of its place in the left image, per axis.
            sigma_d_px: standard deviation of its disparity.
        """
        jacobian = self.jacobian(point_mm)
        given = self.uncertainty
        sigmas = {
            "pixel_x": sigma_x_px,
            "pixel_y": sigma_x_px,
            "disparity": sigma_d_px,
            "focal": given.focal_relative,
            "principal_point": given.principal_point_px,
            "hand_eye_position": given.hand_eye_mm,
            "hand_eye_orientation": float(np.deg2rad(given.hand_eye_deg)),
            "pose_position": given.pose_mm,
            "pose_orientation": float(np.deg2rad(given.pose_deg)),
        }
        covariances = {}
        start = 0
        for name, _, count in _CAUSES:
            part = jacobian[:, start : start + count] * sigmas[name]
            covariances[name] = part @ part.T
            start += count
        return covariances

    def covariance_mm2(self, point_mm: ArrayLike, *, sigma_x_px: float, sigma_d_px: float) -> Array:
        """Return the whole covariance of a point, 3x3, square millimetres, base frame; arguments as `point_errors`."""
        return _total(self.point_errors(point_mm, sigma_x_px=sigma_x_px, sigma_d_px=sigma_d_px).values())

    def systematic_mm2(self, point_mm: ArrayLike) -> Array:
        """Return the part of a point's covariance that calibration and poses cause, 3x3, square millimetres."""
        causes = self.point_errors(point_mm, sigma_x_px=0.0, sigma_d_px=0.0)
        return _total(covariance for name, covariance in causes.items() if name not in _RANDOM)

    def _estimate(self, point: Array, errors: Array) -> Array:
        """Return where a point (left camera frame) would be placed if the numbers that place it had these errors."""
        f_px = self.f_px
        pixel_x, pixel_y, disparity, focal = errors[:4]
        principal = errors[4:6]
        hand_eye_mm, hand_eye_rad = errors[6:9], errors[9:12]
        pose_mm, pose_rad = errors[12:15], errors[15:18]
        x, y, depth = point
        left = np.array([f_px * x / depth + pixel_x, f_px * y / depth + pixel_y])
        right = np.array([f_px * (x - self.baseline_mm) / depth + pixel_x - disparity, left[1]])
        believed_f_px = f_px * (1.0 + focal)
        left_ray = np.append((left - principal) / believed_f_px, 1.0)
        right_ray = np.append((right - principal) / believed_f_px, 1.0)
        turn = Rotation.from_rotvec(hand_eye_rad)
        pose_turn = Rotation.from_rotvec(pose_rad)
        left_centre = hand_eye_mm
        # the right camera hangs on the TCP: a wrong orientation of the pose also swings it about the TCP
        arm = -np.asarray(self.tcp_in_camera_mm) + hand_eye_mm
        right_centre = np.array([self.baseline_mm, 0.0, 0.0]) - arm + hand_eye_mm + pose_turn.apply(arm) + pose_mm
        return _intersect(left_centre, turn.apply(left_ray), right_centre, pose_turn.apply(turn.apply(right_ray)))


def _total(covariances: Iterable[Array]) -> Array:
    total = np.zeros((3, 3))
    for covariance in covariances:
        total += covariance
    return total


def _units() -> list[str]:
    return [unit for _, unit, count in _CAUSES for _ in range(count)]


def _intersect(left_centre: Array, left_ray: Array, right_centre: Array, right_ray: Array) -> Array:
    """Return the point of the left ray that is nearest to the right ray."""
    between = right_centre - left_centre
    left_left, left_right, right_right = left_ray @ left_ray, left_ray @ right_ray, right_ray @ right_ray
    along = (right_right * (left_ray @ between) - left_right * (right_ray @ between)) / (
        left_left * right_right - left_right**2
    )
    point: Array = left_centre + along * left_ray
    return point
