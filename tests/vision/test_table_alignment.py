"""A textured table whose right picture is displaced by a known fraction of a pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from srvs_cell.vision.rectification import RectifiedPair
from srvs_cell.vision.table_alignment import TableParameters, align_table
from tests.vision.painted import SIZE, TABLE_Z_MM, cuboid, outline_mm, rig

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tests.vision.painted import Part

UP = np.array([0.0, 0.0, 1.0])
PLAIN_GREY = 110.0


def table_pair(
    u_px: float = 0.0, v_px: float = 0.0, *, contrast: float = 3.0, noise: float = 1.0, part: Part | None = None
) -> RectifiedPair:
    """Paint a table that is seen at (x - d - u, y + v) in the right image, and a part that is where it should be."""
    cameras = rig()
    rng = np.random.default_rng(8)
    width, height = SIZE
    margin = 120
    grain = cv2.GaussianBlur(rng.normal(size=(height + 2 * margin, width + 2 * margin)).astype(np.float32), (0, 0), 2.5)
    grain = PLAIN_GREY + contrast * grain / np.std(grain)
    a, b, c = cameras.plane_disparity(UP, TABLE_Z_MM)
    x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    # the table point of a right pixel, in the left image: its row first, then x - (a x + b y + c) - u solved for x
    left_y = y - v_px
    left_x = (x + b * left_y + c + u_px) / (1.0 - a)
    pictures = []
    for side, (column, row) in enumerate(((x, y), (left_x, left_y))):
        at = [(values + margin).astype(np.float32) for values in (column, row)]
        picture = cv2.remap(grain, at[0], at[1], cv2.INTER_CUBIC)
        if part is not None:
            top = outline_mm(part)
            foot = top * (1.0, 1.0, 0.0) + (0.0, 0.0, TABLE_Z_MM)
            for points, grey in ((np.concatenate([top, foot]), part.side_grey), (top, part.top_grey)):
                columns, rows, disparity = cameras.project_px(points)
                polygon = np.column_stack([columns - side * disparity, rows]).astype(np.float32)
                hull = cv2.convexHull(polygon)
                cv2.fillConvexPoly(picture, np.rint(hull * 16.0).astype(np.int32), grey, cv2.LINE_AA, 4)
        noisy = picture + rng.normal(0.0, noise, picture.shape)
        pictures.append(np.asarray(np.clip(np.rint(noisy), 0, 255), dtype=np.uint8))
    seen: NDArray[np.bool_] = np.ones((height, width), dtype=np.bool_)
    return RectifiedPair(pictures[0], pictures[1], seen, seen, cameras)


@pytest.mark.parametrize(("u_px", "v_px"), [(0.1, -0.06), (0.2, 0.1), (0.3, 0.0)])
def test_a_displacement_of_a_fraction_of_a_pixel_is_measured(u_px: float, v_px: float) -> None:
    reference, check = align_table(table_pair(u_px, v_px), TABLE_Z_MM, TableParameters())
    assert check.refusal == ""
    assert check.blocks > 150
    assert check.disparity_px == pytest.approx(u_px, abs=0.04)
    assert check.row_px == pytest.approx(v_px, abs=0.04)
    assert check.sigma_px < 0.05
    assert np.any(reference.errors)


def test_the_correction_brings_the_table_back_to_its_height() -> None:
    cameras = rig()
    u_px = 0.2
    reference, check = align_table(table_pair(u_px), TABLE_Z_MM, TableParameters())
    a, b, c = cameras.plane_disparity(UP, TABLE_Z_MM)
    for x, y in ((cameras.cx_px, cameras.cy_px), (150.0, 120.0), (520.0, 380.0)):
        seen = cameras.points_mm(np.array([x]), np.array([y]), np.array([a * x + b * y + c + u_px]))[0]
        assert abs(seen[2] - TABLE_Z_MM) > 1.0
        corrected = seen + reference.at(seen)[0]
        assert corrected[2] == pytest.approx(TABLE_Z_MM, abs=0.8)
    assert abs(check.correction_mm[2]) > 1.0


def test_a_table_without_texture_is_refused_with_a_reason() -> None:
    reference, check = align_table(table_pair(0.4, contrast=0.0), TABLE_Z_MM, TableParameters())
    assert "shows too little" in check.refusal
    assert check.correction_mm == (0.0, 0.0, 0.0)
    assert not np.any(reference.errors)


def test_a_strong_texture_reaches_as_far_as_a_faint_one() -> None:
    _, check = align_table(table_pair(0.3, contrast=6.0), TABLE_Z_MM, TableParameters())
    assert check.refusal == ""


def test_too_little_table_in_view_is_refused_with_the_numbers() -> None:
    pair = table_pair(0.2)
    narrow = np.zeros_like(pair.left_valid)
    narrow[200:300, 200:330] = True
    small = RectifiedPair(pair.left, pair.right, narrow, pair.right_valid, pair.rig)
    reference, check = align_table(small, TABLE_Z_MM, TableParameters())
    assert check.refusal == f"{check.blocks} blocks of table in view, 30 needed"
    assert check.blocks < 30
    assert not np.any(reference.errors)


def test_a_table_that_contradicts_the_calibration_is_refused() -> None:
    reference, check = align_table(table_pair(0.2), TABLE_Z_MM, TableParameters(max_surprise=0.01))
    assert "contradicts the calibration" in check.refusal
    assert not np.any(reference.errors)


def test_one_error_that_is_far_off_is_refused_though_the_sum_over_all_is_not() -> None:
    _, check = align_table(table_pair(0.2), TABLE_Z_MM, TableParameters(max_sigmas=1e-3))
    assert "one error, such as its height" in check.refusal


def test_a_refused_calibration_is_doubted_as_much_as_the_table_contradicts_it() -> None:
    point = (500.0, 50.0, TABLE_Z_MM + 40.0)
    calm, check = align_table(table_pair(0.0), TABLE_Z_MM, TableParameters(max_doubt=1e-6))
    assert "too little" in check.refusal
    shifted, check = align_table(table_pair(0.9, 0.6), TABLE_Z_MM, TableParameters())
    assert "contradicts the calibration" in check.refusal
    assert np.trace(shifted.at(point)[1]) > 9.0 * np.trace(calm.at(point)[1])
    bare, check = align_table(table_pair(0.9, 0.6, contrast=0.0), TABLE_Z_MM, TableParameters())
    assert "contradicts" not in check.refusal
    assert np.trace(bare.at(point)[1]) == pytest.approx(np.trace(calm.at(point)[1]), rel=0.5)


def test_a_box_on_the_table_does_not_disturb_the_measurement() -> None:
    box = cuboid(500.0, 50.0, 60.0, 20.0, (90.0, 60.0), 200)
    _, alone = align_table(table_pair(0.2, 0.1), TABLE_Z_MM, TableParameters())
    _, beside = align_table(table_pair(0.2, 0.1, part=box), TABLE_Z_MM, TableParameters())
    assert beside.refusal == ""
    assert beside.blocks < alone.blocks - 20
    assert beside.disparity_px == pytest.approx(alone.disparity_px, abs=0.02)
    assert beside.row_px == pytest.approx(alone.row_px, abs=0.02)
