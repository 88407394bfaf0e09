"""What rises over a table, and what only lies on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from srvs_cell.vision.faces.edge_fit import FaceFit
from srvs_cell.vision.recognition.tops import Top, explained_polygons, rising_test
from srvs_cell.vision.rectification import RectifiedPair
from srvs_cell.vision.refinement import GreyPair
from srvs_cell.vision.relief import Relief, measure_relief, risen, rising_outlines, rising_share
from tests.vision.painted import SIZE, TABLE_Z_MM, Part, cuboid, outline_mm, paint, rig

if TYPE_CHECKING:
    from srvs_cell.geometry import Array

BOX = cuboid(490.0, 80.0, 40.0, 20.0, (60.0, 40.0), 180)
SHADOW = cuboid(520.0, 10.0, 0.0, 40.0, (50.0, 40.0), 70)


def pair_of(parts: list[Part], *, noise: float = 1.0) -> RectifiedPair:
    left, right = paint(parts, rig(), noise=noise)
    seen = np.ones((SIZE[1], SIZE[0]), dtype=np.bool_)
    return RectifiedPair(left, right, seen, seen, rig())


def relief_of(parts: list[Part]) -> Relief:
    return measured(pair_of(parts))


def measured(pair: RectifiedPair) -> Relief:
    return measure_relief(pair, GreyPair.of(pair.left, pair.right), TABLE_Z_MM, None)


def picture(part: Part) -> Array:
    """Return the outline of a part's top face in the left image, shape (N, 2)."""
    x, y, _ = rig().project_px(outline_mm(part))
    return np.column_stack([x, y])


def length_px(outline: Array) -> float:
    return float(cv2.arcLength(outline.astype(np.float32), closed=True))


def around(part: Part, grown_px: float) -> Array:
    outline = picture(part)
    rays = outline - outline.mean(axis=0)
    grown: Array = outline + grown_px * rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return grown


@pytest.fixture(scope="module")
def both() -> Relief:
    return relief_of([BOX, SHADOW])


def test_a_face_at_a_height_rises_and_a_shadow_does_not(both: Relief) -> None:
    face, shadow = risen(both, [around(BOX, 25.0), around(SHADOW, 25.0)])
    assert face > 2.0 * length_px(picture(BOX))
    assert shadow < 0.02 * length_px(picture(SHADOW))


def test_bare_noise_rises_nowhere_and_is_measured() -> None:
    relief = relief_of([])
    assert relief.rises.mean() < 2e-3
    assert 0.1 < relief.noise < 1.0
    assert rising_outlines(relief, [], 100) == []


@pytest.mark.parametrize("height_mm", [10.0, 20.0, 80.0])
def test_every_height_leaves_its_seam(height_mm: float) -> None:
    part = cuboid(500.0, 50.0, height_mm, 20.0, (60.0, 40.0), 180)
    (pixels,) = risen(relief_of([part]), [around(part, 30.0)])
    assert pixels > 1.5 * length_px(picture(part))


def test_the_outline_of_what_rises_encloses_the_face(both: Relief) -> None:
    (outline,) = rising_outlines(both, [], 500)
    hull = outline.astype(np.float32)
    for x, y in picture(BOX):
        assert cv2.pointPolygonTest(hull, (float(x), float(y)), measureDist=True) > -3.0
    # it is doubled by the parallax, and no more than that
    assert cv2.contourArea(hull) < 2.0 * cv2.contourArea(picture(BOX).astype(np.float32))


def test_a_face_whose_border_shows_in_two_pieces_is_enclosed_by_both_together() -> None:
    """Borders along the baseline fall on themselves: only the left and the right border of a face rise."""
    shape = (200, 200)
    rises = np.zeros(shape, dtype=np.bool_)
    rises[60:120, 50:56] = rises[60:120, 130:136] = True
    relief = Relief(rises, 0.5, np.ones(shape, dtype=np.bool_))
    boxes = [(tuple(outline.min(axis=0)), tuple(outline.max(axis=0))) for outline in rising_outlines(relief, [])]
    assert ((50.0, 60.0), (135.0, 119.0)) in boxes
    # what is left at the end is taken together where it is too little by itself, and is not beside a known part
    (left_over,) = rising_outlines(relief, [], 100)
    assert (*left_over.min(axis=0), *left_over.max(axis=0)) == (50.0, 60.0, 135.0, 119.0)
    between = np.array([[62.0, 55.0], [124.0, 55.0], [124.0, 125.0], [62.0, 125.0]])
    assert rising_outlines(relief, [between], 100) == []
    rises[60:120, 44:62] = rises[60:120, 124:142] = True
    assert len(rising_outlines(relief, [], 100)) == 2
    rises[60:120, 44:50] = rises[60:120, 56:62] = rises[60:120, 124:130] = rises[60:120, 136:142] = False
    # one above the other they are not two borders of one face
    rises[:] = False
    rises[20:60, 50:56] = rises[120:160, 130:136] = True
    assert ((50.0, 20.0), (135.0, 159.0)) not in [
        (tuple(outline.min(axis=0)), tuple(outline.max(axis=0))) for outline in rising_outlines(relief, [])
    ]


def test_the_short_border_of_a_wedge_is_taken_together_with_the_long_one() -> None:
    shape = (200, 200)
    rises = np.zeros(shape, dtype=np.bool_)
    rises[60:120, 50:56] = True
    rises[95:120, 130:136] = True
    outlines = rising_outlines(Relief(rises, 0.5, np.ones(shape, dtype=np.bool_)), [])
    assert ((50.0, 60.0), (135.0, 119.0)) in [
        (tuple(outline.min(axis=0)), tuple(outline.max(axis=0))) for outline in outlines
    ]


def test_what_a_known_part_explains_is_taken_away(both: Relief) -> None:
    top = Top(FaceFit(BOX.face, np.eye(3), 0.1, 1.0), ())
    polygons = explained_polygons([top], rig(), TABLE_Z_MM)
    assert rising_outlines(both, polygons, 500) == []
    assert rising_outlines(both, [around(SHADOW, 25.0)], 500) != []


def test_a_known_part_explains_as_much_beside_its_long_sides_as_beside_its_short_ones() -> None:
    part = cuboid(490.0, 80.0, 40.0, 20.0, (80.0, 12.0), 180)
    (polygon,) = explained_polygons([Top(FaceFit(part.face, np.eye(3), 0.1, 1.0), ())], rig(), TABLE_Z_MM)
    corners = picture(part)
    middles = (corners + np.roll(corners, -1, axis=0)) / 2.0
    for x, y in np.concatenate([corners, middles]):
        assert cv2.pointPolygonTest(polygon.astype(np.float32), (float(x), float(y)), measureDist=True) > 4.5


def test_a_thin_seam_beside_a_known_part_does_not_join_what_is_left_over() -> None:
    shape = (200, 300)
    rises = np.zeros(shape, dtype=np.bool_)
    rises[80:110, 40:70] = rises[80:110, 200:230] = True
    rises[80:82, 40:230] = True
    relief = Relief(rises, 0.5, np.ones(shape, dtype=np.bool_))
    left_over = rising_outlines(relief, [], 200)
    assert sorted((outline[:, 0].min(), outline[:, 0].max()) for outline in left_over) == [(40.0, 69.0), (200.0, 229.0)]
    # while faces are sought nothing is left out: a faint border is as thin
    (sought,) = rising_outlines(relief, [])
    assert (sought[:, 0].min(), sought[:, 0].max()) == (40.0, 229.0)


def test_each_rising_pixel_counts_once() -> None:
    shape = (100, 100)
    rises = np.zeros(shape, dtype=np.bool_)
    rises[20:40, 30:60] = True
    relief = Relief(rises, 0.5, np.ones(shape, dtype=np.bool_))
    left_half = np.array([[0.0, 0.0], [44.0, 0.0], [44.0, 99.0], [0.0, 99.0]])
    whole = np.array([[0.0, 0.0], [99.0, 0.0], [99.0, 99.0], [0.0, 99.0]])
    assert risen(relief, [left_half, whole]) == [300, 300]
    assert risen(relief, [whole, left_half]) == [600, 0]
    assert risen(relief, []) == []
    assert rises.sum() == 600


def test_what_one_image_did_not_see_does_not_rise() -> None:
    pair = pair_of([BOX])
    blind = np.ones_like(pair.left_valid)
    x, y = np.rint(picture(BOX).mean(axis=0)).astype(int)
    blind[y - 90 : y + 90, x - 110 : x + 110] = False
    relief = measured(RectifiedPair(pair.left, pair.right, blind, pair.right_valid, pair.rig))
    assert not relief.valid[y, x]
    assert risen(relief, [around(BOX, 25.0)]) == [0]
    assert risen(measured(pair), [around(BOX, 25.0)])[0] > 300


def test_only_what_rises_and_is_not_explained_is_looked_at(both: Relief) -> None:
    face, shadow = (picture(part).astype(np.float32) for part in (BOX, SHADOW))
    rises = rising_test([], both, rig(), TABLE_Z_MM)
    assert rises(face)
    assert not rises(shadow)
    found = Top(FaceFit(BOX.face, 0.01 * np.eye(3), 0.1, 1.0), ())
    assert not rising_test([found], both, rig(), TABLE_Z_MM)(face)


def test_a_doubtful_face_explains_nothing(both: Relief) -> None:
    doubtful = Top(FaceFit(BOX.face, 0.01 * np.eye(3), 0.6, 1.0), ())
    rises = rising_test([doubtful], both, rig(), TABLE_Z_MM)
    assert rises(picture(BOX).astype(np.float32))


@pytest.mark.parametrize(("left", "share"), [(0.0, 1.0), (10.0, 0.5), (40.0, 0.0), (-15.0, 1.0), (-90.0, 0.0)])
def test_the_share_of_an_outline_that_rises(left: float, share: float) -> None:
    rising = np.zeros((40, 60), dtype=np.uint8)
    rising[:, :20] = 1
    square = np.array([[left, 5.0], [left + 19.0, 5.0], [left + 19.0, 24.0], [left, 24.0]], dtype=np.float32)
    assert rising_share(rising, square) == pytest.approx(share, abs=0.03)
