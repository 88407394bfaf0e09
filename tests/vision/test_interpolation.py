"""Row ends to a part of a pixel, and the robust disparity plane."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from srvs_cell.scene import Plane
from srvs_cell.vision.edges import smooth
from srvs_cell.vision.interpolation import RowEnds, fill_rows, find_row_ends, fit_disparity_plane, robust_plane
from srvs_cell.vision.parameters import InterpolationParameters

PARAMETERS = InterpolationParameters()


def bar(first: float, last: float, rows: int = 12, width: int = 60) -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
    """Return a bright bar between two borders, each pixel by the share of it that the bar covers."""
    x = np.arange(width)
    covered = np.clip(np.minimum(x + 0.5, last) - np.maximum(x - 0.5, first), 0.0, 1.0)
    return np.asarray(np.rint(np.tile(50.0 + 150.0 * covered, (rows, 1))), dtype=np.uint8)


@pytest.mark.parametrize(("first", "last"), [(12.5, 40.5), (12.8, 40.1), (13.2, 39.7)])
def test_row_ends_are_found_to_a_tenth_of_a_pixel(first: float, last: float) -> None:
    grey = bar(first, last)
    labels = np.asarray(grey > 125, dtype=np.int32)
    ends = find_row_ends(smooth(grey, 1.0), labels, 1, PARAMETERS)
    assert ends.first[1] == pytest.approx(np.full(12, first), abs=0.1)
    assert ends.last[1] == pytest.approx(np.full(12, last), abs=0.1)
    whole = find_row_ends(smooth(grey, 1.0), labels, 1, InterpolationParameters(sub_pixel=False))
    assert np.abs(whole.first[1] - first).max() <= 0.51


def test_an_end_at_the_border_of_the_image_counts_nothing() -> None:
    grey = bar(-5.0, 30.5)
    ends = find_row_ends(smooth(grey, 1.0), np.asarray(grey > 125, dtype=np.int32), 1, PARAMETERS)
    assert not ends.first_weight[1].any()
    assert (ends.last_weight[1] > 0.5).all()


@settings(max_examples=50)
@given(a=st.floats(-0.15, 0.15), b=st.floats(-0.15, 0.15), c=st.floats(0.0, 80.0), seed=st.integers(0, 1000))
def test_the_plane_comes_through_a_fifth_of_outliers(a: float, b: float, c: float, seed: int) -> None:
    generator = np.random.default_rng(seed)
    x, y = generator.uniform(0, 80, (2, 100))
    disparity = a * x + b * y + c
    disparity[:20] += generator.uniform(8.0, 20.0, 20)
    (fit_a, fit_b, fit_c), sigma = robust_plane(x, y, disparity, np.ones(100), PARAMETERS)
    assert fit_a * 40 + fit_b * 40 + fit_c == pytest.approx(a * 40 + b * 40 + c, abs=0.3)
    assert 0.0 < sigma < 1.0


def test_planes_without_a_common_row_have_no_disparity() -> None:
    def ends(rows: slice) -> RowEnds:
        first, last = np.full((2, 20), np.nan), np.full((2, 20), np.nan)
        first[1, rows], last[1, rows] = 5.0, 9.0
        weight = np.where(np.isfinite(first), 1.0, np.nan)
        return RowEnds(first, last, weight, weight)

    assert fit_disparity_plane(1, 1, ends(slice(0, 8)), ends(slice(10, 18)), PARAMETERS) is None
    assert fit_disparity_plane(1, 1, ends(slice(0, 8)), ends(slice(4, 18)), PARAMETERS) is not None


def test_pixels_between_the_ends_correspond_linearly() -> None:
    labels = np.zeros((4, 30), dtype=np.int32)
    labels[1, 10:21] = 1
    plane = Plane(1, (15.0, 1.0), 11.0, 24.0, 1.0, 5.0, 100.0, (10, 1, 11, 1), touches_border=False)

    def ends(first: float, last: float) -> RowEnds:
        table = np.full((2, 4), np.nan)
        firsts, lasts = table.copy(), table.copy()
        firsts[1, 1], lasts[1, 1] = first, last
        return RowEnds(firsts, lasts, table, table)

    disparity = np.full(labels.shape, np.nan, dtype=np.float32)
    fill_rows(disparity, labels, (plane, plane), (ends(10.0, 20.0), ends(4.0, 12.0)), (0.0, 64.0))
    assert disparity[1, 10] == pytest.approx(6.0)
    assert disparity[1, 15] == pytest.approx(7.0)
    assert disparity[1, 20] == pytest.approx(8.0)
    assert np.isfinite(disparity).sum() == 11


def test_pixels_whose_correspondence_is_impossible_stay_unknown() -> None:
    labels = np.zeros((4, 30), dtype=np.int32)
    labels[1, 10:21] = 1
    plane = Plane(1, (15.0, 1.0), 11.0, 24.0, 1.0, 5.0, 100.0, (10, 1, 11, 1), touches_border=False)

    def ends(first: float, last: float) -> RowEnds:
        table = np.full((2, 4), np.nan)
        firsts, lasts = table.copy(), table.copy()
        firsts[1, 1], lasts[1, 1] = first, last
        return RowEnds(firsts, lasts, table, table)

    disparity = np.full(labels.shape, np.nan, dtype=np.float32)
    # the right row reaches beyond the left one: disparities from +5 to -5
    fill_rows(disparity, labels, (plane, plane), (ends(10.0, 20.0), ends(5.0, 25.0)), (0.0, 3.0))
    assert disparity[1, 12:15].tolist() == pytest.approx([3.0, 2.0, 1.0])
    assert np.isfinite(disparity).sum() == 3
