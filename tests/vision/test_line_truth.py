"""The painted truth that planes and lines are judged by, on a scene of known geometry."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erf

from benchmarks.planes_against_lines import Pair, distorted
from benchmarks.scene_truth import depth_mm, position_bound_mm, top_outline_mm, true_disparity
from srvs_cell.calibration import Calibration, CameraIntrinsics, HandEye
from srvs_cell.geometry import Transform, Xyzwpr
from srvs_cell.vision import StereoView
from tests.vision.painted import SIZE, TABLE_Z_MM, rig

CUBOID = {
    "position_mm": [470.0, 100.0, TABLE_Z_MM + 60.0],
    "yaw_deg": 20.0,
    "size_mm": [50.0, 30.0],
    "face_normal": [0.0, 0.0, 1.0],
}
SLOPE = np.deg2rad(25.0)
WEDGE = {
    "position_mm": [560.0, 90.0, TABLE_Z_MM + 20.0],
    "yaw_deg": 0.0,
    "size_mm": [40.0, 30.0],
    "face_normal": [-float(np.sin(SLOPE)), 0.0, float(np.cos(SLOPE))],
}
SHAPE = (SIZE[1], SIZE[0])


def test_table_and_tops_have_their_disparities() -> None:
    cameras = rig()
    disparity = true_disparity([CUBOID, WEDGE], TABLE_Z_MM, cameras, SHAPE)
    places = np.array([[470.0, 100.0, TABLE_Z_MM + 60.0], [560.0, 90.0, TABLE_Z_MM + 20.0], [500.0, -60.0, TABLE_Z_MM]])
    x, y, expected = cameras.project_px(places)
    found = disparity[np.rint(y).astype(int), np.rint(x).astype(int)]
    assert found == pytest.approx(expected, abs=0.05)
    assert depth_mm(cameras, expected[:1]) == pytest.approx(cameras.f_px * cameras.baseline_mm / expected[:1])


def test_what_is_nearer_hides_what_is_farther() -> None:
    cameras = rig()
    table = true_disparity([], TABLE_Z_MM, cameras, SHAPE)
    both = true_disparity([CUBOID, WEDGE], TABLE_Z_MM, cameras, SHAPE)
    assert (both >= table).all()
    assert (both > table + 0.5).sum() > 2000
    assert np.array_equal(both, true_disparity([WEDGE, CUBOID], TABLE_Z_MM, cameras, SHAPE))


def test_a_wedge_is_higher_at_its_high_side_and_centred_at_its_position() -> None:
    corners = top_outline_mm(WEDGE)
    assert corners.mean(axis=0) == pytest.approx(WEDGE["position_mm"])
    assert corners[:, 2].max() - corners[:, 2].min() == pytest.approx(40.0 * np.tan(SLOPE))
    assert corners[corners[:, 2].argmax(), 0] == pytest.approx(580.0)


def test_a_round_top_lies_between_corners_and_flats() -> None:
    prism = {**CUBOID, "yaw_deg": None, "size_mm": [40.0, 36.0]}
    radius = np.hypot(*(top_outline_mm(prism)[:, :2] - (470.0, 100.0)).T)
    assert radius == pytest.approx(19.0)


@pytest.mark.parametrize(("contrast", "noise"), [(60.0, 2.0), (30.0, 2.0), (30.0, 1.0)])
def test_the_bound_of_a_place_is_that_of_its_blurred_edges(contrast: float, noise: float) -> None:
    f_px, depth, baseline_mm, side_px, blur_px = 800.0, 400.0, 30.0, 100.0, 0.8
    lens = CameraIntrinsics(width=640, height=480, fx=f_px, fy=f_px, cx=320.0, cy=240.0, distortion=(0.0,) * 5)
    hand_eye = HandEye(xyz_mm=(0.0, 0.0, 0.0), wpr_deg=(0.0, 0.0, 0.0))
    poses = [Transform.from_xyzwpr("base", "tcp", Xyzwpr(x, 0.0, 450.0, 180.0, 0.0, 0.0)) for x in (0.0, baseline_mm)]
    view = StereoView(Calibration(camera=lens, hand_eye=hand_eye), poses[0], poses[1], 0.0)
    side_mm = side_px * depth / f_px
    top = {
        "kind": "cuboid",
        "position_mm": [0.0, 0.0, 50.0],
        "yaw_deg": 0.0,
        "size_mm": [side_mm, side_mm],
        "face_normal": [0.0, 0.0, 1.0],
    }
    y, x = np.mgrid[:480, :640].astype(np.float64)
    inside = [erf((0.5 * side_px - np.abs(at)) / (np.sqrt(2.0) * blur_px)) for at in (x - 320.0, y - 240.0)]
    grey = 80.0 + contrast * (0.5 + 0.5 * inside[0]) * (0.5 + 0.5 * inside[1])
    left = np.rint(grey + noise * np.random.default_rng(3).standard_normal(grey.shape)).astype(np.uint8)
    # two edges of the length of a side across the baseline, as many along it, each in both images
    squares = 2.0 * side_px * contrast**2 / (2.0 * np.sqrt(np.pi) * blur_px)
    sigma_px = np.sqrt((noise**2 + 1.0 / 12.0) / squares)
    by_disparity, by_place = np.sqrt(2.0) * depth**2 / (f_px * baseline_mm), depth / f_px * np.sqrt(0.5)
    expected = sigma_px * np.sqrt(by_disparity**2 + 2.0 * by_place**2)
    # central differences see a blurred edge as a tenth flatter
    assert expected < position_bound_mm(top, left, view) < 1.25 * expected
    beyond = top | {"position_mm": [10.0 * side_mm, 0.0, 50.0]}
    assert position_bound_mm(beyond, left, view) == np.inf


def test_the_distorted_truth_belongs_to_the_distorted_pictures() -> None:
    # a fine ramp: what stands at a place of the left picture stands a disparity farther left in the right one
    y, x = np.mgrid[:120, :160].astype(np.float64)
    left = np.asarray(np.rint(40.0 + x), dtype=np.uint8)
    right = np.asarray(np.rint(40.0 + x + 8.0), dtype=np.uint8)
    pair = distorted(Pair("ramp", left, right, np.full(left.shape, 8.0)), 10.0)
    middle = np.abs(y - 59.5) < 1.0
    columns = np.arange(30, 150)
    for row in np.unique(y[middle]).astype(int):
        at = np.rint(columns - pair.truth[row, columns]).astype(int)
        assert np.abs(pair.left[row, columns].astype(int) - pair.right[row, at]).max() <= 2
    assert pair.truth[5, 150] > 8.5
    flat = distorted(Pair("ramp", left, right, np.full(left.shape, 8.0)), 0.0)
    assert flat.truth == pytest.approx(8.0)
