"""The linear model of the table as reference, against two simulated cameras with wrong calibration and poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from srvs_cell.calibration import Calibration, CameraIntrinsics, HandEye, TableReference, Uncertainty
from srvs_cell.geometry import Transform, Xyzwpr
from srvs_cell.vision.rectification import RectifiedRig, rectification_maps

if TYPE_CHECKING:
    from srvs_cell.geometry import Array

SIZE = (640, 480)
TABLE_Z_MM = 5.0
TCP_IN_CAMERA_MM = (-40.0, 25.0, -60.0)
LEFT = Transform.from_xyzwpr("base", "camera", Xyzwpr(500.0, 50.0, 450.0, 176.0, 3.0, 30.0))
FOCAL, PRINCIPAL, HAND_EYE, HAND_EYE_TURN, POSE, POSE_TURN, K1, K2, TABLE = (
    slice(0, 1),
    slice(1, 3),
    slice(3, 6),
    slice(6, 9),
    slice(9, 12),
    slice(12, 15),
    15,
    16,
    17,
)
COUNT, COEFFICIENTS = 18, 10
SMALL = np.array([1e-4, 0.05, 0.05, *[0.02] * 3, *[5e-5] * 3, *[0.005] * 3, *[1e-5] * 3, 2e-4, 2e-4, 0.02])
"""Errors so small that their squares do not count."""
EXACT = Uncertainty(
    focal_relative=0.0,
    principal_point_px=0.0,
    hand_eye_mm=0.0,
    hand_eye_deg=0.0,
    pose_mm=0.0,
    pose_deg=0.0,
    distortion_k1=0.0,
    distortion_k2=0.0,
    table_mm=0.0,
)


@dataclass(frozen=True)
class Cell:
    """Two cameras with a lens, and a table: as they are, or as they are believed to be."""

    f_px: float
    centre_px: Array
    k1: float
    k2: float
    left: Transform
    tcp_left: Transform
    tcp_right: Transform
    table_z_mm: float

    @classmethod
    def true(cls) -> Cell:
        tcp = Transform.from_parts("base", "tcp", LEFT.rotation, LEFT.apply(np.array(TCP_IN_CAMERA_MM)))
        right = replace_place(tcp, tcp.translation_mm + LEFT.rotate(np.array([30.0, 0.0, 0.0])))
        return cls(800.0, np.array([322.0, 237.0]), 0.0, 0.0, LEFT, tcp, right, TABLE_Z_MM)

    def believed(self, errors: Array) -> Cell:
        """Return the cell that somebody with these errors believes in; vectors are given in the camera's frame."""
        axes = self.left.rotation
        left = Transform.from_parts(
            "base",
            "camera",
            axes @ Rotation.from_rotvec(errors[HAND_EYE_TURN]).as_matrix(),
            self.left.translation_mm + axes @ errors[HAND_EYE],
        )
        turn = axes @ Rotation.from_rotvec(errors[POSE_TURN]).as_matrix() @ axes.T
        tcp_right = Transform.from_parts(
            "base", "tcp", turn @ self.tcp_right.rotation, self.tcp_right.translation_mm + axes @ errors[POSE]
        )
        return replace(
            self,
            f_px=self.f_px * (1.0 + float(errors[FOCAL][0])),
            centre_px=self.centre_px + errors[PRINCIPAL],
            k1=self.k1 + float(errors[K1]),
            k2=self.k2 + float(errors[K2]),
            left=left,
            tcp_right=tcp_right,
            table_z_mm=self.table_z_mm + float(errors[TABLE]),
        )

    @property
    def right(self) -> Transform:
        return self.tcp_right @ (self.tcp_left.inverse() @ self.left)

    def rig(self, uncertainty: Uncertainty) -> RectifiedRig:
        """Return the rig that the vision makes of what is believed."""
        x, y, z, w, p, r = (self.tcp_left.inverse() @ self.left).to_xyzwpr().as_tuple()
        calibration = Calibration(
            CameraIntrinsics(
                width=SIZE[0],
                height=SIZE[1],
                fx=self.f_px,
                fy=self.f_px,
                cx=float(self.centre_px[0]),
                cy=float(self.centre_px[1]),
                distortion=(self.k1, self.k2, 0.0, 0.0, 0.0),
            ),
            HandEye(xyz_mm=(x, y, z), wpr_deg=(w, p, r)),
            uncertainty=uncertainty,
        )
        return rectification_maps(calibration, self.tcp_left, self.tcp_right).rig

    def taken(self, camera: Transform, directions: Array) -> Array:
        """Return the raw pixels of directions in the base frame, shape (N, 2)."""
        seen = directions @ camera.rotation
        x, y = seen[:, 0] / seen[:, 2], seen[:, 1] / seen[:, 2]
        radius2 = x * x + y * y
        wide = 1.0 + self.k1 * radius2 + self.k2 * radius2**2
        pixels: Array = self.f_px * np.column_stack([x * wide, y * wide]) + self.centre_px
        return pixels

    def directions(self, camera: Transform, pixels: Array) -> Array:
        """Return the directions of raw pixels in the base frame, shape (N, 3)."""
        distorted = (pixels - self.centre_px) / self.f_px
        straight = distorted
        for _ in range(50):
            radius2 = (straight**2).sum(axis=1, keepdims=True)
            straight = distorted / (1.0 + self.k1 * radius2 + self.k2 * radius2**2)
        rays: Array = np.column_stack([straight, np.ones(len(pixels))]) @ camera.rotation.T
        return rays


def replace_place(pose: Transform, translation_mm: Array) -> Transform:
    return Transform.from_parts("base", "tcp", pose.rotation, translation_mm)


def rectified(rig: RectifiedRig, directions: Array) -> Array:
    seen = directions @ rig.base_T_camera.rotation
    pixels: Array = rig.f_px * seen[:, :2] / seen[:, 2:] + (rig.cx_px, rig.cy_px)
    return pixels


def reference_of(rig: RectifiedRig, errors: Array | None = None, table_z_mm: float = TABLE_Z_MM) -> TableReference:
    reference = TableReference.unmeasured(rig.error_budget, (rig.cx_px, rig.cy_px), table_z_mm, SIZE)
    return reference if errors is None else replace(reference, errors=errors)


def deviation(errors: Array) -> tuple[Array, Array]:
    """Return the deviation that the cameras show, and the one that the reference expects; shape (2 N,) each."""
    true = Cell.true()
    believed = true.believed(errors)
    rig = believed.rig(Uncertainty())
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(40.0, 600.0, 9), np.linspace(40.0, 440.0, 7)))
    rays = np.column_stack([(x - rig.cx_px) / rig.f_px, (y - rig.cy_px) / rig.f_px, np.ones_like(x)])
    raw_left = believed.taken(believed.left, rays @ rig.base_T_camera.rotation.T)
    seen = true.directions(true.left, raw_left)
    start = true.left.translation_mm
    points = start + seen * ((true.table_z_mm - start[2]) / seen[:, 2:])
    raw_right = true.taken(true.right, points - true.right.translation_mm)
    right = rectified(rig, believed.directions(believed.right, raw_right))
    disparity = np.column_stack([x, y, np.ones_like(x)]) @ rig.plane_disparity(
        np.array([0.0, 0.0, 1.0]), believed.table_z_mm
    )
    reference = reference_of(rig, errors, believed.table_z_mm)
    u, v = reference.basis(x, y, disparity)
    field = reference.expected_field
    return np.concatenate([x - disparity - right[:, 0], right[:, 1] - y]), np.concatenate([u @ field, v @ field])


@pytest.mark.parametrize("cause", range(COUNT))
def test_the_field_of_each_error_is_what_two_wrong_cameras_show(cause: int) -> None:
    errors = np.zeros(COUNT)
    errors[cause] = SMALL[cause]
    exact, _ = deviation(np.zeros(COUNT))
    shown, expected = deviation(errors)
    assert np.abs(exact).max() < 1e-6
    # a hand-eye position along the table shows nothing: there the bound is absolute
    assert np.abs(shown - expected).max() < 0.03 * np.abs(shown).max() + 2e-5


def test_errors_together_show_the_sum_of_their_fields() -> None:
    shown, expected = deviation(SMALL * np.where(np.arange(COUNT) % 3 == 1, -1.0, 1.0))
    assert np.abs(shown).max() > 0.02
    assert np.abs(shown - expected).max() < 0.03 * np.abs(shown).max()


@pytest.mark.parametrize("cause", range(COUNT - 1))
@pytest.mark.parametrize("place", [(20.0, -30.0, 400.0), (-90.0, 60.0, 380.0)])
def test_correction_brings_a_triangulated_point_back(cause: int, place: tuple[float, float, float]) -> None:
    true = Cell.true()
    point = true.left.apply(np.array(place))
    errors = np.zeros(COUNT)
    errors[cause] = SMALL[cause]
    believed = true.believed(errors)
    left, right = (
        believed.directions(wrong, true.taken(camera, (point - camera.translation_mm)[None]))[0]
        for camera, wrong in ((true.left, believed.left), (true.right, believed.right))
    )
    # the point of the left ray that is nearest to the right ray
    between = believed.right.translation_mm - believed.left.translation_mm
    along, _ = np.linalg.lstsq(np.column_stack([left, -right]), between, rcond=None)[0]
    triangulated = believed.left.translation_mm + along * left
    corrected = triangulated + reference_of(believed.rig(Uncertainty()), errors).at(triangulated)[0]
    moved_mm = float(np.linalg.norm(triangulated - point))
    assert moved_mm > 1e-6
    assert np.linalg.norm(corrected - point) < 0.05 * moved_mm + 2e-5


def test_nothing_measured_corrects_nothing_and_keeps_the_doubt_of_the_calibration() -> None:
    rig = Cell.true().rig(Uncertainty())
    reference = reference_of(rig)
    point = LEFT.apply(np.array([20.0, -30.0, 400.0]))
    assert np.array_equal(reference.at(point)[0], np.zeros(3))
    assert np.array_equal(reference.expected_field, np.zeros(COEFFICIENTS))
    assert reference.surprise() == 0.0
    systematic = rig.error_budget.systematic_mm2(point)
    # the lens has a doubt of its own that the error budget does not know
    lens = reference.at(point)[1] - systematic
    assert np.linalg.eigvalsh(lens).min() > -1e-12
    blind = replace(rig, uncertainty=Uncertainty(distortion_k1=0.0, distortion_k2=0.0))
    assert reference_of(blind).at(point)[1] == pytest.approx(systematic)


def informed(field: Array, sigma_px: float, uncertainty: Uncertainty | None = None) -> TableReference:
    """Return what is known after blocks all over the image showed a field, each as sure as given."""
    reference = reference_of(Cell.true().rig(uncertainty or Uncertainty()))
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(20.0, 620.0, 20), np.linspace(20.0, 460.0, 15)))
    distance_mm = LEFT.translation_mm[2] - TABLE_Z_MM
    u, v = reference.basis(x, y, np.full_like(x, 800.0 * 30.0 / distance_mm))
    both = np.concatenate([u, v])
    information = both.T @ both / sigma_px**2
    return reference.measured(information, information @ field)


def test_a_measurement_never_adds_doubt_and_takes_some_of_it() -> None:
    before = reference_of(Cell.true().rig(Uncertainty()))
    after = informed(before.response @ (SMALL * 5.0), 0.1)
    assert np.linalg.eigvalsh(before.covariance - after.covariance).min() > -1e-12
    point = LEFT.apply(np.array([20.0, -30.0, 400.0]))
    gained = before.at(point)[1] - after.at(point)[1]
    assert np.linalg.eigvalsh(gained).min() > -1e-9
    assert after.at(point)[1][2, 2] < 0.5 * before.at(point)[1][2, 2]


def test_a_sideways_hand_eye_error_keeps_its_doubt() -> None:
    """The table looks the same from beside: nothing may be learnt of where along it the camera is."""
    before = reference_of(Cell.true().rig(Uncertainty()))
    after = informed(np.zeros(COEFFICIENTS), 0.01)
    along = LEFT.rotation.T @ np.array([1.0, 0.0, 0.0])
    doubt = [float(along @ one.covariance[HAND_EYE, HAND_EYE] @ along) for one in (before, after)]
    assert doubt[1] == pytest.approx(doubt[0], rel=1e-3)


def test_errors_beyond_their_noise_are_found_again_in_their_field() -> None:
    errors = np.zeros(COUNT)
    errors[POSE_TURN] = np.deg2rad(0.005) * np.array([1.0, -1.5, 1.0])
    before = reference_of(Cell.true().rig(Uncertainty()))
    after = informed(before.response @ errors, 0.02)
    assert np.abs(before.response @ errors).max() > 0.05
    point = LEFT.apply(np.array([20.0, -30.0, 400.0]))
    wrong_mm = float(before.budget.jacobian(point)[2, 3 + 12 :] @ errors[POSE_TURN])
    # the table cannot tell a wrong pose from all other errors, but its height stays the table's
    assert float(after.at(point)[0][2]) == pytest.approx(-wrong_mm, rel=0.2)


def test_a_field_of_zero_leaves_the_errors_at_zero() -> None:
    after = informed(np.zeros(COEFFICIENTS), 0.05)
    assert np.array_equal(after.errors, np.zeros(COUNT))
    assert after.surprise() == 0.0


def test_noise_does_not_move_an_exact_calibration() -> None:
    noise = np.random.default_rng(3).normal(0.0, 1.0, COEFFICIENTS)
    reference = informed(np.zeros(COEFFICIENTS), 0.1)
    x = np.array([322.0])
    u, _ = reference.basis(x, np.array([237.0]), np.array([54.0]))
    # a tenth of what one block may show, well within the noise of 300 of them
    after = informed(noise * 0.002, 0.1)
    assert np.array_equal(after.errors, np.zeros(COUNT))
    assert float(np.abs(u @ after.expected_field)[0]) == 0.0


def test_what_is_known_exactly_stays_where_it_is() -> None:
    field = np.zeros(COEFFICIENTS)
    field[0] = 0.5
    after = informed(field, 0.02, EXACT)
    assert np.array_equal(after.errors, np.zeros(COUNT))
    assert np.array_equal(after.covariance, np.zeros((COUNT, COUNT)))
    loose = informed(field, 0.02, replace_uncertainty(pose_mm=0.03))
    moved = np.flatnonzero(loose.errors)
    assert set(moved) <= set(range(COUNT)[POSE])
    assert moved.size > 0
    assert loose.surprise() > 1.0


def replace_uncertainty(**sigmas: float) -> Uncertainty:
    return replace(EXACT, **sigmas)
