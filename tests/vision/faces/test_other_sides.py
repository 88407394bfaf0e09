"""Rectangles whose outline took a neighbouring line for a side."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from srvs_cell.vision.faces.edge_fit import MEASURE, EdgeField, FaceFit, fit_faces
from srvs_cell.vision.faces.other_sides import other_rectangles
from srvs_cell.vision.faces.profiles import Pictures
from srvs_cell.vision.faces.witnesses import Bench, Witnesses
from tests.vision.painted import TABLE_Z_MM, Part, cuboid, cylinder, paint, rig, wedge

if TYPE_CHECKING:
    from srvs_cell.vision.faces.face import Face

MIN_GRADIENT = 1.0
RIG = rig()


def fields_of(parts: list[Part]) -> tuple[EdgeField, EdgeField]:
    left, right = paint(parts, RIG)
    return EdgeField.of(left), EdgeField.of(right)


def bench_of(parts: list[Part], *, printed: Face | None = None) -> Bench:
    images = paint(parts, RIG)
    if printed is not None:
        for side, image in enumerate(images):
            x, y, disparity = RIG.project_px(printed.corners_mm())
            corners = np.rint(np.column_stack([x - side * disparity, y]) * 16.0).astype(np.int32)
            cv2.polylines(image, [corners], isClosed=True, color=40, thickness=2, lineType=cv2.LINE_AA, shift=4)
    fields = (EdgeField.of(images[0]), EdgeField.of(images[1]))
    return Bench(Pictures.of(*images), fields, RIG, TABLE_Z_MM, MIN_GRADIENT, lambda _: True)


def seen_as(face: Face, bench: Bench) -> Witnesses:
    (edges,) = fit_faces([face], [face.slope_u != 0.0], bench.fields, RIG, MEASURE, MIN_GRADIENT)
    assert edges is not None
    (both,) = bench.by_profiles([edges])
    assert both is not None
    return both


# at the picture's border, where a side face is seen as a band of several pixels, and dark like its shadow
BOX = replace(cuboid(560.0, 150.0, 40.0, 20.0, (60.0, 44.0), 150), side_grey=60)


@pytest.mark.parametrize(("axis", "end"), [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)])
def test_a_side_that_was_moved_comes_back(axis: int, end: float) -> None:
    true = BOX.face
    size_mm = (true.length_mm, true.width_mm)[axis]
    shift_mm = 6.0
    unit = np.zeros((1, 2))
    unit[0, axis] = -end * shift_mm / size_mm
    x_mm, y_mm, _ = true.place(unit)[0]
    wrong = replace(true, x_mm=float(x_mm), y_mm=float(y_mm))
    shorter = size_mm - shift_mm
    wrong = replace(wrong, length_mm=shorter) if axis == 0 else replace(wrong, width_mm=shorter)
    others = other_rectangles(wrong, fields_of([BOX])[0], RIG, TABLE_Z_MM, MIN_GRADIENT)
    distances = [abs(other.length_mm - true.length_mm) + abs(other.width_mm - true.width_mm) for other in others]
    best = others[int(np.argmin(distances))]
    # half a pixel is a quarter of a millimetre here
    assert min(distances) < 0.6
    assert (best.x_mm, best.y_mm) == pytest.approx((true.x_mm, true.y_mm), abs=0.6)


def test_an_inclined_face_stays_in_its_plane() -> None:
    part = wedge(500.0, 60.0, 10.0, 40.0, 30.0, (60.0, 40.0), 190)
    wrong = replace(part.face, length_mm=50.0)
    for other in other_rectangles(wrong, fields_of([part])[0], RIG, TABLE_Z_MM, MIN_GRADIENT):
        ahead = np.array([other.x_mm - wrong.x_mm, other.y_mm - wrong.y_mm])
        along = ahead @ np.array([np.cos(wrong.angle_rad), np.sin(wrong.angle_rad)])
        assert other.z_mm - wrong.z_mm == pytest.approx(wrong.slope_u * along, abs=1e-6)


@pytest.mark.parametrize("falling", [1.0, -1.0])
def test_a_wedge_that_ends_over_the_table_may_go_down_to_it(falling: float) -> None:
    true = wedge(500.0, 60.0, 0.0, 30.0, 30.0, (60.0, 40.0), 190).face
    true = replace(true, slope_u=falling * true.slope_u)
    half = true.place(np.array([[falling * 0.25, 0.0]]))[0]
    x_mm, y_mm, z_mm = (float(value) for value in half)
    short = replace(true, x_mm=x_mm, y_mm=y_mm, z_mm=z_mm, length_mm=45.0)
    # nothing is to be seen there
    others = other_rectangles(short, fields_of([])[0], RIG, TABLE_Z_MM, MIN_GRADIENT)
    whole = [other for other in others if other.slope_u != 0.0]
    assert len(whole) == 1
    assert (whole[0].x_mm, whole[0].y_mm, whole[0].z_mm) == pytest.approx((true.x_mm, true.y_mm, true.z_mm))
    assert (whole[0].length_mm, whole[0].width_mm) == pytest.approx((60.0, 40.0))


def test_a_wedge_that_ends_at_the_table_or_far_over_it_is_left_so() -> None:
    at_the_table = wedge(500.0, 60.0, 2.0, 30.0, 30.0, (60.0, 40.0), 190)
    on_a_block = wedge(500.0, 60.0, 40.0, 60.0, 30.0, (30.0, 40.0), 190)
    for part in (at_the_table, on_a_block):
        others = other_rectangles(part.face, fields_of([])[0], RIG, TABLE_Z_MM, MIN_GRADIENT)
        assert [other for other in others if other.slope_u != 0.0] == []


def test_circles_have_no_other_sides() -> None:
    part = cylinder(500.0, 50.0, 40.0, 50.0, 200)
    assert other_rectangles(part.face, fields_of([part])[0], RIG, TABLE_Z_MM, MIN_GRADIENT) == []


def mistaken_for_its_foot(bench: Bench) -> Witnesses:
    """Return the outline of top and visible side face together, which a faint inner edge leads to."""
    true = BOX.face
    wrong = replace(true, length_mm=true.length_mm + 7.0, x_mm=true.x_mm + 3.3, y_mm=true.y_mm + 1.2)
    by_edges, by_profiles = FaceFit(wrong, np.eye(3), 0.5, 0.8), FaceFit(wrong, np.eye(3), 0.6, 0.8)
    return replace(seen_as(true, bench), by_edges=by_edges, by_profiles=by_profiles)


def test_a_top_that_took_the_foot_of_its_side_face_for_a_side_is_mended() -> None:
    bench = bench_of([BOX])
    true = BOX.face
    (settled,) = bench.settled([mistaken_for_its_foot(bench)])
    face = settled.agreed().face
    assert (face.length_mm, face.width_mm) == pytest.approx((true.length_mm, true.width_mm), abs=0.3)
    assert (face.x_mm, face.y_mm) == pytest.approx((true.x_mm, true.y_mm), abs=0.3)
    assert face.z_mm == pytest.approx(true.z_mm, abs=1.5)


def test_what_suits_much_worse_than_another_face_at_its_place_is_not_asked_what_else_it_may_be() -> None:
    bench = bench_of([BOX])
    mistaken = mistaken_for_its_foot(bench)
    elsewhere = replace(BOX.face, x_mm=BOX.face.x_mm + 200.0)
    apart = seen_as(BOX.face, bench)
    apart = replace(
        apart,
        by_edges=replace(apart.by_edges, face=elsewhere),
        by_profiles=replace(apart.by_profiles, face=elsewhere),
    )
    hopeless, _ = bench.settled([mistaken, seen_as(BOX.face, bench)])
    assert hopeless is mistaken
    # a better face at another place is no rival
    mended, _ = bench.settled([mistaken, apart])
    assert mended is not mistaken


def test_a_label_taken_for_the_border_gives_way_to_the_border() -> None:
    true = BOX.face
    label = replace(true, length_mm=44.0, width_mm=30.0)
    bench = bench_of([BOX], printed=label)
    # three sides are the part's, the fourth is the label's and shorter than it should be
    half = np.array([[-4.0 / 30.0, 0.0]])
    x_mm, y_mm, _ = (float(value) for value in true.place(half)[0])
    cut = seen_as(replace(true, x_mm=x_mm, y_mm=y_mm, length_mm=52.0), bench)
    assert cut.agreed().face.length_mm < 55.0
    (settled,) = bench.settled([cut])
    assert settled.agreed().face.length_mm == pytest.approx(true.length_mm, abs=0.5)


def test_a_good_fit_is_not_asked_again() -> None:
    bench = bench_of([BOX])
    good = seen_as(BOX.face, bench)
    assert bench.settled([good]) == [good]


def test_edges_that_led_astray_are_sought_again_from_where_the_grey_values_are() -> None:
    bench = bench_of([BOX])
    there = seen_as(BOX.face, bench)
    astray = replace(there.by_edges, face=replace(BOX.face, x_mm=BOX.face.x_mm + 5.0, length_mm=50.0), rms_px=1.2)
    (sought,) = bench.together([(astray, there.by_profiles)])
    assert sought.by_edges.rms_px < 0.2
    assert sought.by_edges.face.length_mm == pytest.approx(BOX.face.length_mm, abs=0.3)
    good = replace(astray, rms_px=0.45)
    (kept,) = bench.together([(good, there.by_profiles)])
    assert kept.by_edges is good


def test_fits_that_disagree_are_no_surer_than_that() -> None:
    face = BOX.face
    moved = replace(face, z_mm=face.z_mm + 3.0)
    sharp = Witnesses(
        FaceFit(face, 0.01 * np.eye(3), 0.1, 1.0), FaceFit(moved, 0.01 * np.eye(3), 0.2, 1.0), 0.0, 0.0
    ).agreed()
    assert sharp.face == moved
    assert 2.0 < sharp.covariance_mm2[2, 2] ** 0.5 < 3.1
    weak = Witnesses(
        FaceFit(face, 0.01 * np.eye(3), 1.0, 0.6), FaceFit(moved, 0.01 * np.eye(3), 0.2, 1.0), 0.0, 0.0
    ).agreed()
    assert weak.covariance_mm2[2, 2] < 0.2 * sharp.covariance_mm2[2, 2]


def test_grey_values_that_fit_badly_leave_it_to_the_edges() -> None:
    face = BOX.face
    lost = replace(face, z_mm=face.z_mm + 9.0)
    agreed = Witnesses(FaceFit(face, np.eye(3), 0.5, 1.0), FaceFit(lost, np.eye(3), 0.9, 1.0), 0.0, 0.0).agreed()
    assert agreed.face == face
    assert agreed.covariance_mm2[2, 2] >= 81.0


def test_a_level_rectangle_that_is_a_wedges_gets_its_slope() -> None:
    part = wedge(500.0, 60.0, 20.0, 44.0, 30, (50.0, 40.0), 170)
    bench = bench_of([part])
    level = seen_as(replace(part.face, slope_u=0.0), bench)
    assert level.agreed().face.slope_u == 0.0
    (settled,) = bench.settled([level])
    assert settled.twin is not None
    assert not settled.twin.is_inclined
    assert settled.agreed().face.inclination_deg == pytest.approx(part.face.inclination_deg, abs=1.5)
    assert settled.agreed().face.z_mm == pytest.approx(part.face.z_mm, abs=1.5)
