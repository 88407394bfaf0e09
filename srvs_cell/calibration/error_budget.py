"""The error budget: how uncertain a triangulated point is, and what it owes that to.

A pixel pair is turned into a point of the base frame by the estimated focal length, principal point, hand-eye
transform and poses. `point_errors` differentiates that map numerically by each of them. *Random* errors (pixel noise)
differ from point to point; *systematic* ones (calibration, poses) are nearly the same over one scene, so that they
cancel between neighbours and never average out (references/vision.md C, systematics rule).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
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

    @cached_property
    def camera_T_base(self) -> Transform:
        """The base frame in the left rectified camera's."""
        return self.base_T_camera.inverse()

    def jacobian(self, point_mm: ArrayLike) -> Array:
        """Return the derivative of estimated points by each cause: shape (..., 3, 18), millimetres per unit.

        Args:
            point_mm: points in the base frame, shape (..., 3).
        """
        points = self.camera_T_base.apply(np.asarray(point_mm, dtype=np.float64))[..., None, :]
        steps = np.array([_STEPS[unit] for unit in _units()])
        errors = np.diag(steps)
        moved = self._estimate(points, np.concatenate([errors, -errors]))
        slopes = (moved[..., :_COUNT, :] - moved[..., _COUNT:, :]) / (2.0 * steps[:, None])
        columns: Array = np.swapaxes(self.base_T_camera.rotate(slopes), -1, -2)
        return columns

    def point_errors(self, point_mm: ArrayLike, *, sigma_x_px: ArrayLike, sigma_d_px: ArrayLike) -> dict[str, Array]:
        """Return the covariance of points by cause, each of shape (..., 3, 3) in square millimetres, base frame.

        Args:
            point_mm: points in the base frame, shape (..., 3).
            sigma_x_px: standard deviation of their place in the left image, per axis, shape (...) or one for all.
            sigma_d_px: standard deviation of their disparity, likewise.
        """
        jacobian = self.jacobian(point_mm)
        given = self.uncertainty
        sigmas: dict[str, ArrayLike] = {
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
            part = jacobian[..., start : start + count] * np.asarray(sigmas[name], dtype=np.float64)[..., None, None]
            covariances[name] = part @ np.swapaxes(part, -1, -2)
            start += count
        return covariances

    def covariance_mm2(self, point_mm: ArrayLike, *, sigma_x_px: ArrayLike, sigma_d_px: ArrayLike) -> Array:
        """Return the whole covariance of points, (..., 3, 3), square millimetres, base frame; see `point_errors`."""
        return _total(self.point_errors(point_mm, sigma_x_px=sigma_x_px, sigma_d_px=sigma_d_px).values())

    def systematic_mm2(self, point_mm: ArrayLike) -> Array:
        """Return the part of points' covariance that calibration and poses cause, (..., 3, 3), square millimetres."""
        causes = self.point_errors(point_mm, sigma_x_px=0.0, sigma_d_px=0.0)
        return _total(covariance for name, covariance in causes.items() if name not in _RANDOM)

    def _estimate(self, point: Array, errors: Array) -> Array:
        """Return where points (left camera frame) would be placed if the numbers that place them had these errors.

        Args:
            point: shape (..., 3).
            errors: one of each component of the causes, shape (M, 18).
        """
        f_px = self.f_px
        pixel_x, pixel_y, disparity, focal = np.moveaxis(errors[..., :4], -1, 0)
        principal_x, principal_y = np.moveaxis(errors[..., 4:6], -1, 0)
        hand_eye_mm, hand_eye_turn = errors[..., 6:9], Rotation.from_rotvec(errors[..., 9:12]).as_matrix()
        pose_mm, pose_turn = errors[..., 12:15], Rotation.from_rotvec(errors[..., 15:18]).as_matrix()
        x, y, depth = np.moveaxis(point, -1, 0)
        left_x, left_y = f_px * x / depth + pixel_x, f_px * y / depth + pixel_y
        right_x = f_px * (x - self.baseline_mm) / depth + pixel_x - disparity
        believed_f_px = f_px * (1.0 + focal)
        left_ray, right_ray = (
            np.stack(
                np.broadcast_arrays(
                    (column - principal_x) / believed_f_px, (left_y - principal_y) / believed_f_px, 1.0
                ),
                axis=-1,
            )
            for column in (left_x, right_x)
        )
        # the right camera hangs on the TCP: a wrong orientation of the pose also swings it about the TCP
        arm = -np.asarray(self.tcp_in_camera_mm) + hand_eye_mm
        right_centre = np.array([self.baseline_mm, 0.0, 0.0]) - arm + hand_eye_mm + _turned(arm, pose_turn) + pose_mm
        right_ray = _turned(right_ray, pose_turn @ hand_eye_turn)
        return _intersect(hand_eye_mm, _turned(left_ray, hand_eye_turn), right_centre, right_ray)


def _total(covariances: Iterable[Array]) -> Array:
    return np.asarray(sum(covariances), dtype=np.float64)


def _units() -> list[str]:
    return [unit for _, unit, count in _CAUSES for _ in range(count)]


def _turned(vector: Array, rotation: Array) -> Array:
    """Return vectors of shape (..., 3) turned by matrices of shape (..., 3, 3)."""
    return np.asarray((rotation @ vector[..., None])[..., 0])


def _intersect(left_centre: Array, left_ray: Array, right_centre: Array, right_ray: Array) -> Array:
    """Return the points of left rays that are nearest to right rays, shape (..., 3)."""
    between = right_centre - left_centre
    left_left, left_right, right_right = _dot(left_ray, left_ray), _dot(left_ray, right_ray), _dot(right_ray, right_ray)
    along = (right_right * _dot(left_ray, between) - left_right * _dot(right_ray, between)) / (
        left_left * right_right - left_right**2
    )
    return np.asarray(left_centre + along * left_ray)


def _dot(one: Array, other: Array) -> Array:
    return np.asarray((one * other).sum(axis=-1, keepdims=True))
