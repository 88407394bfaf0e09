"""Footprints against each other: the planner's table and the validator's own geometry must agree."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from srvs_cell.planning import Disc, FingerGrip, Footprint, Polygon, Rectangle, validator
from srvs_cell.planning.clearance import convex_hull, finger_polygons, minkowski_sum, signed_distance_mm, too_close
from srvs_cell.scene import Place, PlaceKind

sizes = st.floats(1.0, 40.0)


@st.composite
def polygons(draw: st.DrawFn) -> Polygon:
    """A convex polygon inscribed in an ellipse, so that no vertex lies on the line between its neighbours."""
    angles = sorted(draw(st.lists(st.integers(0, 35), min_size=3, max_size=6, unique=True)))
    a, b = draw(sizes), draw(sizes)
    return Polygon(tuple((a * np.cos(t * np.pi / 18), b * np.sin(t * np.pi / 18)) for t in angles))


shapes = st.one_of(st.builds(Disc, sizes), st.builds(Rectangle, sizes, sizes), polygons())


@given(shapes, shapes, st.floats(-90.0, 90.0), st.floats(-90.0, 90.0), st.sampled_from([0.0, 5.0]))
def test_planner_and_validator_agree_on_what_is_too_close(
    a: Footprint, b: Footprint, dx: float, dy: float, clearance_mm: float
) -> None:
    near = bool(too_close(a, b, np.array([dx, dy]), clearance_mm))
    here, there = Place(0, 10.0, -20.0, PlaceKind.SLOT), Place(1, 10.0 + dx, -20.0 + dy, PlaceKind.SLOT)
    # Within a micrometre of the limit either answer is right.
    certain = bool(too_close(a, b, np.array([dx, dy]), clearance_mm - 1e-3)) == bool(
        too_close(a, b, np.array([dx, dy]), clearance_mm + 1e-3)
    )
    assert not certain or near == validator._near(a, here, b, there, clearance_mm)


@given(shapes, shapes, st.floats(-90.0, 90.0), st.floats(-90.0, 90.0))
def test_too_close_does_not_depend_on_who_is_asked(a: Footprint, b: Footprint, dx: float, dy: float) -> None:
    forward = too_close(a, b, np.array([dx, dy]), 5.0)
    backward = too_close(b, a, np.array([-dx, -dy]), 5.0)
    slack = too_close(a, b, np.array([dx, dy]), 5.001) != too_close(a, b, np.array([dx, dy]), 4.999)
    assert slack or forward == backward


def test_signed_distance_of_a_square() -> None:
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    points = np.array([[5.0, 4.0], [13.0, 14.0], [5.0, -2.0]])
    assert np.allclose(signed_distance_mm(points, square), [-4.0, 5.0, 2.0])


def test_discs_touch_exactly_at_the_clearance() -> None:
    reach = np.array([[25.0, 0.0], [24.99, 0.0]])
    assert too_close(Disc(10.0), Disc(10.0), reach, 5.0).tolist() == [False, True]


def test_oblongs_are_compared_axis_by_axis() -> None:
    a = Rectangle(10.0, 10.0)
    corner_to_corner = np.array([[24.0, 24.0]])  # 4 mm on both axes: nearer than 5 mm on both, although 5.7 mm apart
    assert too_close(a, a, corner_to_corner, 5.0).all()


def test_hull_drops_inner_points_and_turns_left() -> None:
    hull = convex_hull(np.array([[0, 0], [4, 0], [2, 1], [4, 4], [0, 4], [2, 0]], dtype=np.float64))
    assert sorted(map(tuple, hull.tolist())) == [(0.0, 0.0), (0.0, 4.0), (4.0, 0.0), (4.0, 4.0)]
    following = np.roll(hull, -1, axis=0)
    assert (hull[:, 0] * following[:, 1] - hull[:, 1] * following[:, 0]).sum() > 0


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_the_sum_of_two_polygons_is_the_hull_of_all_sums(count: int, other: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    a, b = (convex_hull(random.integers(-4, 5, (n, 2)).astype(np.float64)) for n in (count, other))
    total = minkowski_sum(a, b)
    hull = convex_hull((a[:, None, :] + b[None, :, :]).reshape(-1, 2))
    points = random.uniform(-12.0, 12.0, (40, 2))
    assert np.allclose(convex_hull(total), hull)
    if len(hull) > 2:
        assert np.allclose(signed_distance_mm(points, total), signed_distance_mm(points, hull))


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 37.0])
def test_fingers_stand_on_both_sides_along_the_closing_motion(yaw_deg: float) -> None:
    grip = FingerGrip("test", (3.0, -2.0), yaw_deg, inner_mm=20.0, thick_mm=10.0, width_mm=16.0)
    closing = np.array([np.cos(np.deg2rad(yaw_deg)), np.sin(np.deg2rad(yaw_deg))])
    for finger, side in zip(finger_polygons(grip), (1.0, -1.0), strict=True):
        offset = np.array(finger.vertices_mm) - np.array(grip.centre_mm)
        along, across = side * (offset @ closing), offset @ np.array([-closing[1], closing[0]])
        assert np.allclose([along.min(), along.max()], [20.0, 30.0])
        assert np.allclose([across.min(), across.max()], [-8.0, 8.0])
        edges = np.roll(offset, -1, axis=0) - offset
        turns = edges[:, 0] * np.roll(edges, -1, axis=0)[:, 1] - edges[:, 1] * np.roll(edges, -1, axis=0)[:, 0]
        assert (turns > 0).all()
