"""The alignment on its own: known disparity planes of textured faces."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray  # noqa: TC002 - read by people and mypy

from srvs_cell.scene import PlaneImage, PlaneMatch
from srvs_cell.vision.parameters import PlaneParameters, RefinementParameters
from srvs_cell.vision.planes import measure_planes
from srvs_cell.vision.refinement import GreyPair, align_plane, refine_matches
from tests.vision.pictures import Face, render

TRUE = (0.04, -0.03, 16.37)
FACE = Face(((60.0, 30.0), (150.0, 30.0), (150.0, 120.0), (60.0, 120.0)), 140.0, TRUE, grain=25.0)
CORNERS = np.array([[65.0, 35.0], [145.0, 35.0], [65.0, 115.0], [145.0, 115.0]])
RANGE = (5.0, 30.0)


def worst_px(plane: tuple[float, float, float]) -> float:
    difference = np.array(plane) - np.array(TRUE)
    return float(np.abs(CORNERS @ difference[:2] + difference[2]).max())


def images(noise: float = 1.5) -> tuple[PlaneImage, PlaneImage]:
    pictures = render([FACE], noise=noise)
    labels = np.zeros(pictures[0].shape, dtype=np.int32)
    cv2.fillPoly(labels, [np.rint(np.array(FACE.corners_px)).astype(np.int32)], 1)
    _, planes = measure_planes(pictures[0], labels, PlaneParameters())
    # the alignment reads the right image's grey values alone
    return PlaneImage(pictures[0], labels, planes), PlaneImage(pictures[1], np.zeros_like(labels), ())


def refined_by(
    left: PlaneImage, right: PlaneImage, matches: list[PlaneMatch], range_px: tuple[float, float] = RANGE
) -> list[PlaneMatch]:
    return refine_matches(left, matches, GreyPair.of(left.grey, right.grey), range_px, RefinementParameters())


def match_of(image: PlaneImage, plane: tuple[float, float, float]) -> PlaneMatch:
    x, y = image.planes[0].centre_px
    return PlaneMatch(1, 1, 0.9, plane[0] * x + plane[1] * y + plane[2], plane, 0.5)


@pytest.mark.parametrize(
    "start",
    [
        pytest.param((0.03, -0.02, 17.0), id="a pixel off"),
        pytest.param((0.0, 0.0, 17.6), id="level"),
        pytest.param((-0.05, 0.03, 21.2), id="inclined the wrong way"),
    ],
)
def test_a_slanted_plane_is_found_to_a_small_part_of_a_pixel(start: tuple[float, float, float]) -> None:
    left, right = images()
    (refined,) = refined_by(left, right, [match_of(left, start)])
    assert worst_px(start) > 0.5
    assert worst_px(refined.disparity_plane) < 0.06
    x, y = left.planes[0].centre_px
    true = TRUE[0] * x + TRUE[1] * y + TRUE[2]
    assert refined.disparity_px == pytest.approx(true, abs=min(0.06, 4.0 * refined.disparity_sigma_px))


def test_a_right_plane_is_not_left_worse() -> None:
    left, right = images(noise=3.0)
    (refined,) = refined_by(left, right, [match_of(left, TRUE)])
    assert worst_px(refined.disparity_plane) < 0.06


@pytest.mark.parametrize("seed", range(7))
def test_a_plane_is_left_where_it_was_found_when_another_one_explains_no_more(seed: int) -> None:
    # half of the face is hidden in the right image: what least squares makes of that pulls the right plane away
    generator = np.random.default_rng(seed)

    def texture(width: int) -> NDArray[np.uint8]:
        grain = generator.integers(0, 256, (100, width)).astype(np.uint8)
        return np.asarray(cv2.GaussianBlur(grain, (0, 0), 2.0), dtype=np.uint8)

    left = texture(160)
    right = np.roll(left, -6, axis=1)
    right[:, 40:70] = texture(30)
    rows, columns = (index.ravel() for index in np.mgrid[20:80, 40:100])
    assert align_plane(GreyPair.of(left, right), rows, columns, (0.0, 0.0, 6.0), RefinementParameters()) is None


def test_a_match_whose_grey_values_disagree_is_dropped() -> None:
    left, right = images()
    generator = np.random.default_rng(4)
    other = cv2.GaussianBlur(generator.integers(0, 256, right.grey.shape).astype(np.uint8), (0, 0), 2.0)
    wrong = replace(right, grey=np.asarray(other, dtype=np.uint8))
    assert refined_by(left, wrong, [match_of(left, TRUE)]) == []


def test_a_face_without_contrast_keeps_the_plane_of_its_borders() -> None:
    left, right = images()
    blank = np.full_like(left.grey, 120)
    match = match_of(left, (0.01, 0.02, 15.0))
    (kept,) = refined_by(replace(left, grey=blank), replace(right, grey=blank), [match])
    assert np.allclose(kept.disparity_plane, match.disparity_plane, atol=0.02)


def test_a_disparity_out_of_range_is_dropped() -> None:
    left, right = images()
    assert refined_by(left, right, [match_of(left, TRUE)], (25.0, 30.0)) == []


def test_rows_that_are_apart_are_not_taken_for_a_disparity() -> None:
    y, x = np.mgrid[0:100, 0:160].astype(np.float64)

    def texture(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.uint8]:
        # mostly inclined: along such a pattern a part of a row looks like a part of a column
        grey = 128.0 + 50.0 * np.sin(0.5 * x + 0.5 * y) + 15.0 * np.sin(0.7 * x - 0.2 * y) + 15.0 * np.sin(0.4 * y)
        return np.rint(grey).astype(np.uint8)

    pair = GreyPair.of(texture(x, y), texture(x + 6.0, y + 0.15))
    rows, columns = (index.ravel() for index in np.mgrid[20:80, 40:120])
    errors = []
    for row_sigma_px in (0.0, 0.1):
        found = align_plane(pair, rows, columns, (0.0, 0.0, 6.5), RefinementParameters(), row_sigma_px=row_sigma_px)
        assert found is not None
        a, b, c = found.plane
        errors.append(abs(80.0 * a + 50.0 * b + c - 6.0))
    assert errors[0] > 0.08
    assert errors[1] < 0.02
