"""Straight borders in space, and the faces that two of them span."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from srvs_cell.vision.faces.face import Figure
from srvs_cell.vision.recognition.ledges import Ledges, find_ledges, find_lines
from srvs_cell.vision.recognition.spanned_faces import spanned_faces
from tests.vision.painted import TABLE_Z_MM, cuboid, paint, prism, rig, wedge

if TYPE_CHECKING:
    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces.face import Face
    from tests.vision.painted import Part

RIG = rig()
MAX_HEIGHT_MM = 200.0
WHOLE_PICTURE = np.array([[0.0, 0.0], [640.0, 0.0], [640.0, 480.0], [0.0, 480.0]])
TABLE_GREY = 110


def ledges_of(*parts: Part) -> Ledges:
    left, right = paint(list(parts), RIG)
    return find_ledges((find_lines(left), find_lines(right)), RIG, TABLE_Z_MM, MAX_HEIGHT_MM)


def outline_px(face: Face) -> Array:
    x, y, _ = RIG.project_px(face.corners_mm())
    return np.column_stack([x, y])


def nearest(faces: list[Face], true: Face) -> Face:
    alike = [face for face in faces if face.figure is true.figure]
    return min(alike, key=lambda face: np.abs(corners_of(face) - corners_of(true)).max())


def corners_of(face: Face) -> Array:
    """The corners in an order that does not depend on which side is called the length."""
    corners = face.corners_mm()
    return np.asarray(corners[np.lexsort(np.round(corners[:, :2], 0).T)])


def off_mm(face: Face, true: Face) -> float:
    return float(np.linalg.norm([face.x_mm - true.x_mm, face.y_mm - true.y_mm, face.z_mm - true.z_mm]))


@pytest.mark.parametrize("height_mm", [20.0, 60.0, 105.0])
def test_level_borders_tell_their_height(height_mm: float) -> None:
    part = cuboid(490.0, 80.0, height_mm, 20.0, (60.0, 40.0), 180)
    heights = ledges_of(part).ends_mm[:, :, 2]
    level = heights[np.abs(heights[:, 0] - heights[:, 1]) < 1e-6]
    assert (level[:, 0] == level[:, 1]).all()
    level = level[:, 0]
    # three quarters of a millimetre are a tenth of a pixel's disparity
    assert np.count_nonzero(np.abs(level - TABLE_Z_MM - height_mm) < 1.5) >= 2


def test_the_table_alone_has_no_ledges() -> None:
    assert len(ledges_of().ends_mm) == 0


def test_what_lies_above_the_highest_part_is_left_out() -> None:
    left, right = paint([cuboid(490.0, 80.0, 60.0, 20.0, (60.0, 40.0), 180)], RIG)
    ledges = find_ledges((find_lines(left), find_lines(right)), RIG, TABLE_Z_MM, 30.0)
    assert (ledges.ends_mm[:, :, 2].mean(axis=1) < TABLE_Z_MM + 30.0).all()


@pytest.mark.parametrize(
    "part",
    [
        cuboid(490.0, 80.0, 60.0, 20.0, (60.0, 40.0), 180),
        cuboid(520.0, 20.0, 25.0, 75.0, (45.0, 30.0), 40),
        wedge(500.0, 60.0, 10.0, 40.0, 30.0, (60.0, 40.0), 190),
        prism(500.0, 60.0, 50.0, 10.0, 60.0, 190),
    ],
    ids=["cuboid", "dark cuboid", "wedge", "prism"],
)
def test_two_borders_span_the_face(part: Part) -> None:
    true = part.face
    found = nearest(spanned_faces(ledges_of(part), [outline_px(true)], RIG), true)
    assert off_mm(found, true) < 3.0
    assert sorted((found.length_mm, found.width_mm)) == pytest.approx(sorted((true.length_mm, true.width_mm)), abs=3.0)
    assert abs(found.slope_u) == pytest.approx(abs(true.slope_u), abs=0.1)


def test_a_face_is_spanned_though_two_of_its_sides_do_not_show() -> None:
    # a top with the grey of the table, whose side faces show on two sides alone
    part = replace(cuboid(560.0, 150.0, 80.0, 20.0, (60.0, 44.0), TABLE_GREY), side_grey=50)
    found = nearest(spanned_faces(ledges_of(part), [outline_px(part.face)], RIG), part.face)
    assert off_mm(found, part.face) < 4.0


def test_faces_elsewhere_are_left_out() -> None:
    part = cuboid(490.0, 80.0, 60.0, 20.0, (60.0, 40.0), 180)
    elsewhere = WHOLE_PICTURE / 8.0
    assert spanned_faces(ledges_of(part), [WHOLE_PICTURE], RIG)
    assert spanned_faces(ledges_of(part), [elsewhere], RIG) == []


def border(start: tuple[float, float, float], end: tuple[float, float, float]) -> Array:
    return np.array([start, end])


def ledges_at(*borders: Array) -> Ledges:
    ends_mm = np.stack(borders)
    x, y, _ = RIG.project_px(ends_mm.mean(axis=1))
    return Ledges(ends_mm, np.column_stack([x, y]))


def test_borders_at_two_heights_span_no_level_face() -> None:
    low, high = border((480.0, 40.0, 25.0), (530.0, 40.0, 25.0)), border((480.0, 80.0, 45.0), (530.0, 80.0, 45.0))
    (face,) = spanned_faces(ledges_at(low, high), [WHOLE_PICTURE], RIG)
    assert face.figure is Figure.RECTANGLE
    assert abs(face.slope_u) == pytest.approx(0.5)
    assert sorted(face.corners_mm()[:, 2].tolist()) == pytest.approx([25.0, 25.0, 45.0, 45.0])


def test_borders_beside_each_other_end_to_end_span_nothing() -> None:
    one, other = border((430.0, 40.0, 45.0), (480.0, 40.0, 45.0)), border((490.0, 60.0, 45.0), (540.0, 60.0, 45.0))
    assert spanned_faces(ledges_at(one, other), [WHOLE_PICTURE], RIG) == []


def test_a_corner_whose_sides_do_not_meet_spans_nothing() -> None:
    along, across = border((480.0, 40.0, 45.0), (530.0, 40.0, 45.0)), border((532.0, 42.0, 45.0), (532.0, 80.0, 45.0))
    assert len(spanned_faces(ledges_at(along, across), [WHOLE_PICTURE], RIG)) == 1
    higher = across + np.array([0.0, 0.0, 12.0])
    assert spanned_faces(ledges_at(along, higher), [WHOLE_PICTURE], RIG) == []
