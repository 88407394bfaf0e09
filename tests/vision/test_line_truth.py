"""The painted truth that planes and lines are judged by, on a scene of known geometry."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.planes_against_lines import Pair, distorted
from benchmarks.scene_truth import depth_mm, top_outline_mm, true_disparity
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
