"""Region growing and the six parameters, against shapes whose numbers are known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from srvs_cell.vision.parameters import PlaneParameters
from srvs_cell.vision.planes import BorderWindows, measure_planes
from srvs_cell.vision.region_growing import grow_regions

GREY = np.full((80, 100), 100, dtype=np.uint8)


def frame(gap: int = 0) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return the edges of a rectangle, with a gap in its upper side."""
    edges = np.zeros(GREY.shape, dtype=np.bool_)
    edges[20, 30:71] = edges[60, 30:71] = True
    edges[20:61, 30] = edges[20:61, 70] = True
    edges[20, 50 : 50 + gap] = False
    return edges


def test_a_closed_border_makes_two_regions() -> None:
    labels = grow_regions(GREY, frame(), PlaneParameters())
    assert np.unique(labels).size == 2
    inner = labels == labels[40, 50]
    assert abs(int(inner.sum()) - 40 * 40) < 170


@pytest.mark.parametrize("gap", [1, 4, 10])
def test_a_gap_lets_no_region_leak(gap: int) -> None:
    labels = grow_regions(GREY, frame(gap), PlaneParameters())
    assert labels[40, 50] != labels[5, 5]
    assert abs(int((labels == labels[40, 50]).sum()) - 40 * 40) < 250


def test_regions_without_an_edge_between_them_are_one() -> None:
    edges = np.zeros(GREY.shape, dtype=np.bool_)
    edges[38:42, 50] = True
    assert np.unique(grow_regions(GREY, edges, PlaneParameters())).tolist() == [1]


def test_brightness_bounds_the_joining() -> None:
    grey = GREY.copy()
    grey[:, 50:] = 180
    edges = np.zeros(GREY.shape, dtype=np.bool_)
    edges[:35, 50] = edges[60:, 50] = True
    parameters = PlaneParameters(min_open_share=0.2)
    assert np.unique(grow_regions(grey, edges, parameters)).size > 1
    assert np.unique(grow_regions(GREY, edges, parameters)).size == 1


def test_what_the_camera_did_not_see_belongs_to_no_region() -> None:
    valid = np.ones(GREY.shape, dtype=np.bool_)
    valid[:, :10] = False
    labels = grow_regions(GREY, frame(), PlaneParameters(), valid)
    assert not labels[:, :10].any()
    assert labels[:, 10:].all()


def test_edges_everywhere_leave_no_region() -> None:
    assert not grow_regions(GREY, np.ones(GREY.shape, dtype=np.bool_), PlaneParameters()).any()


def test_the_six_parameters_of_a_rectangle() -> None:
    labels = np.zeros((60, 80), dtype=np.int32)
    labels[10:31, 20:61] = 5
    grey = np.where(labels > 0, 130, 40).astype(np.uint8)
    numbered, planes = measure_planes(grey, labels, PlaneParameters())
    assert numbered.max() == 1
    (plane,) = planes
    assert plane.id == 1
    assert plane.centre_px == pytest.approx((40.0, 20.0))
    assert plane.area_px == 21 * 41
    # the boundary cuts the four corners
    assert plane.perimeter_px == pytest.approx(2 * (21 + 41) - 4 * (2 - np.sqrt(2.0)) / 1.0, abs=2.5)
    assert plane.short_cut_px == pytest.approx(10.0)
    assert plane.long_cut_px == pytest.approx(np.hypot(20.0, 10.0))
    assert plane.brightness == pytest.approx(130.0)
    assert plane.box_px == (20, 10, 41, 21)
    assert not plane.touches_border


def test_the_perimeter_of_a_turned_square_is_that_of_the_square() -> None:
    for angle_deg in (0.0, 15.0, 30.0, 45.0):
        labels = np.zeros((120, 120), dtype=np.int32)
        box = cv2.boxPoints(((60.0, 60.0), (60.0, 60.0), angle_deg))
        cv2.fillPoly(labels, [np.rint(box).astype(np.int32)], 1)
        assert BorderWindows.of(labels).perimeters(2)[1] == pytest.approx(240.0, rel=0.09)


def test_degenerate_regions_are_rejected_by_each_limit() -> None:
    labels = np.zeros((60, 80), dtype=np.int32)
    labels[5:8, 5:8] = 1  # small
    labels[15, 5:75] = 2  # thin
    labels[30:50, 10:40] = 3
    grey = np.full(labels.shape, 90, dtype=np.uint8)
    _, planes = measure_planes(grey, labels, PlaneParameters())
    assert [plane.area_px for plane in planes] == [600.0]
    _, none = measure_planes(grey, labels, PlaneParameters(max_area_share=0.1))
    assert none == ()


def test_a_region_at_the_border_of_the_valid_image_says_so() -> None:
    labels = np.zeros((60, 80), dtype=np.int32)
    labels[20:40, 10:40] = 1
    labels[20:40, 50:70] = 2
    valid = np.ones(labels.shape, dtype=np.bool_)
    valid[:, :10] = False
    _, planes = measure_planes(np.full(labels.shape, 90, dtype=np.uint8), labels, PlaneParameters(), valid)
    assert [plane.touches_border for plane in planes] == [True, False]
