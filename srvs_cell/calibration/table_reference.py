"""The table as reference: what a wrong calibration or pose does to the picture of a plane whose place is known.

If focal length, principal point, hand-eye transform, lens or the lateral move were other than believed, the known
table would show a disparity and a row difference that it should not have. To first order both are linear in the
errors, and so is the place of everything else: what the table shows corrects what stands on it. Errors that the table
does not show (a sideways hand-eye error) keep their doubt: this is a Kalman update, not a calibration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from srvs_cell.calibration.calibration import Uncertainty
    from srvs_cell.calibration.error_budget import ErrorBudget
    from srvs_cell.geometry import Array

_FOCAL, _PRINCIPAL, _HAND_EYE, _HAND_EYE_TURN, _POSE, _POSE_TURN = (
    slice(0, 1),
    slice(1, 3),
    slice(3, 6),
    slice(6, 9),
    slice(9, 12),
    slice(12, 15),
)
_BUDGET_CAUSES = 15
_K1, _K2, _TABLE = 15, 16, 17
_COUNT = 18
_HOMOGRAPHY = 8
BASIS = 10
"""Coefficients of a deviation field: a homography's eight, and one of each radial lens coefficient."""
_LIFT = slice(15, 16)
_STEPS = np.array([1e-6, 1e-3, 1e-3, *[1e-3] * 3, *[1e-6] * 3, *[1e-3] * 3, *[1e-6] * 3, 1e-3])
"""Half steps of the central differences (share, pixels, millimetres, radians), of the table's height at last."""
_GRID = 7
_REACHES2 = np.array([0.0, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0]) ** 2
"""Squared shares of the claimed sigmas that the errors may really reach."""
_LEAST_TOLD = 1e-6
"""Share of its variance that a measurement must take from an error to tell anything of it."""
_RANDOM_CAUSES = 3
"""The first columns of the error budget's Jacobian: pixel x, pixel y, disparity."""


@dataclass(frozen=True, eq=False)
class TableReference:
    """Errors of calibration and poses, as far as a picture of the table tells.

    An error is *believed minus true*, in the order: focal length (share), principal point (2, pixels), hand-eye
    position (3, mm) and orientation (3, rad), pose position (3, mm) and orientation (3, rad), k1, k2, table height
    (mm). Before any measurement they are 0 with the covariance of the calibration's uncertainty.

    Attributes:
        budget: how a point depends on the errors.
        principal_point_px: of the rectified images.
        table_z_mm: believed height of the table, base frame.
        image_size: (width, height) of the rectified images.
        errors: best estimate, shape (18,).
        covariance: of them, shape (18, 18).
        response: coefficients of the deviation field that each error causes, shape (10, 18).
    """

    budget: ErrorBudget
    principal_point_px: tuple[float, float]
    table_z_mm: float
    image_size: tuple[int, int]
    errors: Array
    covariance: Array
    response: Array

    @classmethod
    def unmeasured(
        cls,
        budget: ErrorBudget,
        principal_point_px: tuple[float, float],
        table_z_mm: float,
        image_size: tuple[int, int],
    ) -> Self:
        """Return what is known without a look at the table."""
        covariance = np.diag(_sigmas(budget.uncertainty) ** 2)
        unknown = np.zeros((BASIS, _COUNT))
        bare = cls(budget, principal_point_px, table_z_mm, image_size, np.zeros(_COUNT), covariance, unknown)
        return replace(bare, response=bare._responses())

    def basis(self, x_px: Array, y_px: Array, disparity_px: Array) -> tuple[Array, Array]:
        """Return the fields that a deviation is composed of, at pixels of the left image.

        A pixel (x, y) of the table is seen at (x - d - u, y + v) in the right image, d being the believed disparity.

        Args:
            x_px: column, shape (...).
            y_px: row, the same shape.
            disparity_px: believed disparity of the table there.

        Returns:
            u and v of each of the ten coefficients, each of shape (..., 10).
        """
        budget = self.budget
        c_x, c_y = self.principal_point_px
        x, y = (x_px - c_x) / budget.f_px, (y_px - c_y) / budget.f_px
        one, none = np.ones_like(x), np.zeros_like(x)
        u = [one, x, y, none, none, none, x * x, x * y]
        # u counts to the left, v downwards
        v = [none, none, none, one, x, y, -x * y, -y * y]
        x_right = x - disparity_px / budget.f_px
        for power in (1, 2):
            left, right = (x**2 + y**2) ** power, (x_right**2 + y**2) ** power
            u.append(budget.f_px * (right * x_right - left * x))
            v.append(budget.f_px * (left - right) * y)
        return np.stack(u, axis=-1), np.stack(v, axis=-1)

    @property
    def expected_field(self) -> Array:
        """Coefficients of the deviation field that the estimated errors cause, shape (10,)."""
        expected: Array = self.response @ self.errors
        return expected

    def measured(self, information: Array, vector: Array) -> Self:
        """Return what is known after a measurement of the field, starting from the uncertainty of the calibration.

        A calibration may be better than it claims to be: how far its errors reach, up to what it claims, is what makes
        the measurement most likely (empirical Bayes). So an exact calibration is not moved by noise. The covariance
        is that of the claim: what the table does not show is no surer for what it shows.

        Args:
            information: inverse covariance of the measured coefficients, shape (10, 10); may be singular.
            vector: information times the measured coefficients, shape (10,).
        """
        # in units of the claimed sigmas: a number that is known exactly has sigma 0 and stays where it is
        sigmas = _sigmas(self.budget.uncertainty)
        response = self.response * sigmas
        # along the eigenvectors of what the table tells the errors are independent, whatever their reach
        gain, axes = np.linalg.eigh(response.T @ information @ response)
        gain = np.maximum(gain, 0.0)
        shown = axes.T @ (response.T @ vector)
        # the log likelihood for each reach, up to a constant
        known = 1.0 + _REACHES2[:, None] * gain
        evidence = (_REACHES2[:, None] * shown**2 / known - np.log(known)).sum(axis=1)
        likely2 = _REACHES2[np.argmax(evidence)]
        errors = axes @ (likely2 * shown / (1.0 + likely2 * gain))
        covariance = (axes / (1.0 + gain)) @ axes.T
        return replace(self, errors=sigmas * errors, covariance=covariance * np.outer(sigmas, sigmas))

    def surprise(self) -> float:
        """Return the squared size of the estimated errors in sigmas of the calibration's own uncertainty."""
        sigmas = _sigmas(self.budget.uncertainty)
        doubtful = sigmas > 0.0
        return float(((self.errors[doubtful] / sigmas[doubtful]) ** 2).sum())

    def worst_sigmas(self) -> float:
        """Return the largest estimated error over what it should be by chance (Baarda's w-test).

        By chance an estimate scatters by the variance that the measurement took from it.
        """
        before = _sigmas(self.budget.uncertainty) ** 2
        told = before - np.diag(self.covariance)
        shown = told > _LEAST_TOLD * before
        return float((np.abs(self.errors[shown]) / np.sqrt(told[shown])).max(initial=0.0))

    def doubted(self, surprise: float) -> Self:
        """Return the same with the doubt that a surprise asks for, where the errors themselves cannot be told.

        Args:
            surprise: squared size of errors in sigmas, as `surprise` of a measurement that was refused.
        """
        return replace(self, covariance=self.covariance * max(1.0, surprise / BASIS))

    def at(self, point_mm: ArrayLike) -> tuple[Array, Array]:
        """Return what to add to a triangulated point, shape (3,), and the systematic part of its covariance, 3x3.

        Args:
            point_mm: base frame, shape (3,).
        """
        jacobian = self._jacobian(point_mm)
        return -jacobian @ self.errors, jacobian @ self.covariance @ jacobian.T

    def _jacobian(self, point_mm: ArrayLike) -> Array:
        """Return how a triangulated point moves with each error, shape (3, 18), base frame."""
        by_cause = self.budget.jacobian(point_mm)
        by_x, by_y, by_disparity = by_cause[:, :_RANDOM_CAUSES].T
        camera = self.budget.camera_T_base.apply(np.asarray(point_mm, dtype=np.float64))
        x, y = camera[:2] / camera[2]
        x_right = x - self.budget.baseline_mm / camera[2]
        columns = [by_cause[:, _RANDOM_CAUSES:]]
        for power in (1, 2):
            left, right = -((x * x + y * y) ** power), -((x_right * x_right + y * y) ** power)
            shift = by_x * left * x + by_y * left * y + by_disparity * (left * x - right * x_right)
            columns.append(self.budget.f_px * shift[:, None])
        return np.hstack([*columns, np.zeros((3, 1))])

    def _responses(self) -> Array:
        """Return the coefficients of the deviation field that each error causes, shape (10, 18)."""
        width, height = self.image_size
        x, y = (
            axis.ravel() for axis in np.meshgrid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, _GRID))
        )
        steps = np.diag(_STEPS)
        disparity, x_right, y_right = self._seen(x, y, np.concatenate([steps, -steps]))
        u, v = self.basis(x, y, disparity)
        fields = np.concatenate([u, v])[:, :_HOMOGRAPHY]
        # u counts to the left, v downwards
        shown = np.hstack([x_right, -y_right])
        shown = (shown[: _STEPS.size] - shown[_STEPS.size :]) / (2.0 * _STEPS[:, None])
        response = np.zeros((BASIS, _COUNT))
        solved = np.linalg.lstsq(fields, shown.T, rcond=None)[0]
        response[:_HOMOGRAPHY, :_BUDGET_CAUSES] = solved[:, :_BUDGET_CAUSES]
        response[:_HOMOGRAPHY, _TABLE] = solved[:, _BUDGET_CAUSES]
        response[_HOMOGRAPHY, _K1] = response[_HOMOGRAPHY + 1, _K2] = 1.0
        return response

    def _seen(self, x_px: Array, y_px: Array, errors: Array) -> tuple[Array, Array, Array]:
        """Return the true disparity of the table, and where the believed geometry expects it in the right image.

        Args:
            x_px: column, shape (N,).
            y_px: row, the same shape.
            errors: of calibration and pose, and of the table's height, one set a row, shape (M, 16).

        Returns:
            Disparities of shape (N,), columns and rows of shape (M, N).
        """
        budget = self.budget
        centre = np.array(self.principal_point_px)
        pixels = np.column_stack([x_px, y_px])
        up = budget.base_T_camera.rotation.T @ np.array([0.0, 0.0, 1.0])
        distance = self.table_z_mm - float(budget.base_T_camera.translation_mm[2])
        rays = np.column_stack([(pixels - centre) / budget.f_px, np.ones(len(pixels))])
        depth = distance / (rays @ up)
        f_px = budget.f_px * (1.0 + errors[:, _FOCAL, None])
        turn = Rotation.from_rotvec(errors[:, _HAND_EYE_TURN]).as_matrix()
        pose_turn = Rotation.from_rotvec(errors[:, _POSE_TURN]).as_matrix()
        principal = centre + errors[:, None, _PRINCIPAL]
        ideal = np.concatenate([(pixels - principal) / f_px, np.ones((len(errors), len(pixels), 1))], axis=2)
        believed = ideal @ turn.swapaxes(1, 2)
        start = errors[:, _HAND_EYE]
        along = (distance + errors[:, _LIFT] - (start @ up)[:, None]) / (believed @ up)
        points = start[:, None] + along[..., None] * believed
        # the right camera hangs on the TCP: a wrong orientation of the pose also swings it about the TCP
        arm = -np.asarray(budget.tcp_in_camera_mm) + start
        swung = (pose_turn @ arm[..., None])[..., 0]
        right = np.array([budget.baseline_mm, 0.0, 0.0]) - arm + start + swung + errors[:, _POSE]
        seen = (points - right[:, None]) @ (pose_turn @ turn)
        expected = f_px * seen[..., :2] / seen[..., 2:] + principal
        return budget.f_px * budget.baseline_mm / depth, expected[..., 0], expected[..., 1]


def _sigmas(given: Uncertainty) -> Array:
    """Return one standard deviation of each error, in their order, shape (18,)."""
    return np.array(
        [
            given.focal_relative,
            *[given.principal_point_px] * 2,
            *[given.hand_eye_mm] * 3,
            *[float(np.deg2rad(given.hand_eye_deg))] * 3,
            *[given.pose_mm] * 3,
            *[float(np.deg2rad(given.pose_deg))] * 3,
            given.distortion_k1,
            given.distortion_k2,
            given.table_mm,
        ]
    )
