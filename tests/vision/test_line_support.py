"""Straight lines and their eight parameters on pictures whose edges are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray  # noqa: TC002 - read by people and mypy

from srvs_cell.vision.edges import EdgeParameters, extract_edges
from srvs_cell.vision.line_support import LineImage, LineParameters, extract_lines, voted_regions
from tests.vision.pictures import render, square

EDGES = EdgeParameters()


def lines_of(grey: NDArray[np.uint8], parameters: LineParameters | None = None) -> LineImage:
    mask = extract_edges(grey, EDGES).mask
    return extract_lines(grey, mask, EDGES.smoothing_px, parameters or LineParameters())


def step_image(angle_deg: float, offset_px: float, dark: float = 60.0, bright: float = 140.0) -> NDArray[np.uint8]:
    """A straight edge, a pixel wide, that is brighter towards ``angle_deg``."""
    y, x = np.indices((80, 80)) - 39.5
    turn = np.deg2rad(angle_deg)
    distance = x * np.cos(turn) + y * np.sin(turn) - offset_px
    return np.asarray(np.rint(dark + (bright - dark) * np.clip(distance + 0.5, 0.0, 1.0)), dtype=np.uint8)


def difference_deg(first: float, second: float) -> float:
    return abs((first - second + 180.0) % 360.0 - 180.0)


@settings(max_examples=40)
@given(angle_deg=st.floats(0.0, 359.9), offset_px=st.floats(-3.0, 3.0))
@example(angle_deg=179.984375, offset_px=0.0)
# one grey value in the corner: there the directions lie on both sides of a partition's border
@example(angle_deg=0.00390625, offset_px=0.00390625)
def test_a_straight_edge_is_one_line_at_its_place(angle_deg: float, offset_px: float) -> None:
    lines = lines_of(step_image(angle_deg, offset_px))
    longest = int(lines.length_px.argmax())
    assert lines.length_px[longest] > 70.0
    assert difference_deg(float(lines.orientation_deg[longest]), angle_deg) < 0.6
    turn = np.deg2rad(angle_deg)
    for end in (lines.start_px[longest], lines.centre_px[longest], lines.end_px[longest]):
        distance = (end - 39.5) @ (np.cos(turn), np.sin(turn)) - offset_px
        assert abs(distance) < 0.4
    assert np.delete(lines.length_px, longest).max(initial=0.0) < 12.0


def test_the_bright_side_lies_on_the_left_hand() -> None:
    # brighter towards +x: whoever walks down the picture has it on the left
    lines = lines_of(step_image(0.0, 0.0))
    along = lines.end_px[0] - lines.start_px[0]
    assert along[1] > 70.0
    assert abs(along[0]) < 1.0


def test_contrast_brightness_and_steepness_are_those_of_the_step() -> None:
    weak, strong = lines_of(step_image(20.0, 0.0, 60.0, 80.0)), lines_of(step_image(20.0, 0.0, 60.0, 140.0))
    assert strong.contrast[0] == pytest.approx(80.0, rel=0.1)
    assert weak.contrast[0] == pytest.approx(20.0, rel=0.1)
    assert strong.brightness[0] == pytest.approx(100.0, abs=3.0)
    assert strong.steepness[0] / weak.steepness[0] == pytest.approx(4.0, rel=0.15)
    # the same smoothing makes the support of both about as wide
    assert 2.0 < strong.width_px[0] < 8.0


def test_a_square_has_four_lines_that_end_at_its_corners() -> None:
    left, _ = render([square(100.0, 80.0, 60.0, 160.0, 10.0, angle_deg=12.0)])
    lines = lines_of(left)
    assert len(lines) == 4
    assert lines.length_px == pytest.approx(60.0, abs=6.0)
    seen = np.sort(lines.orientation_deg % 90.0)
    assert seen == pytest.approx(12.0, abs=1.0)
    reach = np.hypot(*(lines.start_px - (100.0, 80.0)).T)
    assert reach == pytest.approx(60.0 / np.sqrt(2.0), abs=4.0)


def test_a_corner_is_two_regions_and_a_curve_is_several() -> None:
    y, x = np.indices((60, 60))
    corner = np.asarray(np.where((x > 30) & (y > 30), 150, 60), dtype=np.uint8)
    assert len(lines_of(corner)) == 2
    ring = np.asarray(np.where(np.hypot(x - 30.0, y - 30.0) < 22.0, 150, 60), dtype=np.uint8)
    assert 6 <= len(lines_of(ring)) <= 10


def test_a_picture_without_edges_has_no_lines() -> None:
    lines = lines_of(np.full((40, 50), 90, dtype=np.uint8))
    assert len(lines) == 0
    assert lines.centre_px.shape == (0, 2)


def test_short_lines_and_small_regions_are_left_out() -> None:
    left, _ = render([square(100.0, 80.0, 60.0, 160.0, 10.0)])
    assert len(lines_of(left, LineParameters(min_length_px=80.0))) == 0
    assert len(lines_of(left, LineParameters(min_pixels=2000))) == 0


def test_a_region_needs_support() -> None:
    # a row of pixels of one direction, and beside it pixels whose direction lies on the border of the first partition:
    # the second partition holds all of them, so that every pixel votes for it
    columns = np.arange(20)
    rows = np.full(20, 5)
    direction = np.where(columns < 10, 44.0, 46.0).astype(np.float32)
    region = voted_regions(rows * 24 + columns, direction, 24, 0.5)
    assert (region == region[0]).all()
    assert region[0] >= 0


def test_an_unfittable_region_is_no_line() -> None:
    grey = np.full((20, 40), 80, dtype=np.uint8)
    edges = np.zeros(grey.shape, dtype=np.bool_)
    edges[10, 5:35] = True
    # one pixel wide and without any gradient under it
    assert len(extract_lines(grey, edges, 1.0, LineParameters())) == 0
