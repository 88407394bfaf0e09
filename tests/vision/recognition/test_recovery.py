"""Faces without a matched plane get their place by their grey values."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from srvs_cell.scene import PlaneImage
from srvs_cell.vision.recognition import RecognitionParameters
from srvs_cell.vision.recognition.evidence import Evidence
from srvs_cell.vision.recognition.recovery import (
    NO_PLANE,
    Region,
    find_places,
    is_cut_off,
    place_unknown,
    rising_regions,
)
from srvs_cell.vision.rectification import RectifiedPair
from srvs_cell.vision.refinement import GreyPair
from srvs_cell.vision.relief import Relief, measure_relief
from tests.vision.painted import SIZE, TABLE_Z_MM, Part, cuboid, cylinder, paint, rig

Picture = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]
DISC = cylinder(500.0, 50.0, 20.0, 40.0, 170)
TALL = cuboid(531.0, 50.0, 100.0, 35.0, (40.0, 50.0), 250)


def region_of(part: Part, image: Picture) -> Region:
    """Return the pixels of the left image that show a part's top face."""
    mask = np.zeros((SIZE[1], SIZE[0]), dtype=np.uint8)
    x, y, _ = rig().project_px(part.face.corners_mm())
    cv2.fillConvexPoly(mask, np.rint(np.column_stack([x, y])).astype(np.int32), 1)
    seen = (mask > 0) & (np.abs(image.astype(int) - part.top_grey) < 10)
    left, top, width, height = cv2.boundingRect(seen.astype(np.uint8))
    return Region(NO_PLANE, seen[top : top + height, left : left + width], (left, top))


def relief_of(left: Picture, right: Picture) -> Relief:
    seen = np.ones((SIZE[1], SIZE[0]), dtype=np.bool_)
    return measure_relief(RectifiedPair(left, right, seen, seen, rig()), GreyPair.of(left, right), TABLE_Z_MM, None)


@pytest.mark.parametrize("others", [[], [TALL]])
def test_a_face_beside_a_brighter_part_at_another_height_gets_its_own_height(others: list[Part]) -> None:
    """In the right image the tall part covers a piece of the disc; its parallax must not be taken for the disc's."""
    left, right = paint([DISC, *others], rig())
    nothing = np.zeros((SIZE[1], SIZE[0]), np.int32)
    images = (PlaneImage(left, nothing, ()), PlaneImage(right, nothing, ()))
    evidence = Evidence.of(*images, rig(), TABLE_Z_MM, RecognitionParameters())
    (surface,) = find_places([region_of(DISC, left)], evidence)
    assert surface.centre_mm[2] == pytest.approx(DISC.face.z_mm, abs=4.0)


def test_what_the_grey_values_do_not_place_is_there_all_the_same() -> None:
    """Bare table in the right image: nothing correlates, but something rises in the left one."""
    left, right = paint([DISC], rig())[0], paint([], rig())[1]
    nothing = np.zeros((SIZE[1], SIZE[0]), np.int32)
    images = (PlaneImage(left, nothing, ()), PlaneImage(right, nothing, ()))
    limits = RecognitionParameters()
    evidence = Evidence.of(*images, rig(), TABLE_Z_MM, limits)
    region = region_of(DISC, left)
    assert find_places([region], evidence) == ()
    (surface,) = place_unknown([region], relief_of(left, right), evidence)
    assert surface is not None
    assert np.hypot(surface.centre_mm[0] - 500.0, surface.centre_mm[1] - 50.0) < 20.0
    half_mm = limits.max_height_mm / 2.0
    assert surface.centre_mm[2] - TABLE_Z_MM == pytest.approx(half_mm, abs=0.3 * half_mm)
    # any height that a part may have lies within two sigma
    assert 2.0 * surface.covariance_mm2[2, 2] ** 0.5 > half_mm


@pytest.mark.parametrize("part", [DISC, TALL, cuboid(500.0, 50.0, 60.0, 20.0, (60.0, 40.0), 118)])
def test_what_rises_tells_its_height_though_its_shadow_is_darker(part: Part) -> None:
    """The region holds the shadow too, whose edges are stronger and lie on the table."""
    shadow = cuboid(part.face.x_mm - 30.0, part.face.y_mm, 0.0, 30.0, (60.0, 50.0), 25)
    left, right = paint([shadow, part], rig())
    nothing = np.zeros((SIZE[1], SIZE[0]), np.int32)
    images = (PlaneImage(left, nothing, ()), PlaneImage(right, nothing, ()))
    evidence = Evidence.of(*images, rig(), TABLE_Z_MM, RecognitionParameters())
    x, y, _ = rig().project_px(np.concatenate([part.face.corners_mm(), shadow.face.corners_mm()]))
    hull = cv2.convexHull(np.column_stack([x, y]).astype(np.float32)).reshape(-1, 2).astype(np.float64)
    (region,) = rising_regions([hull], [], left.shape)
    (surface,) = place_unknown([region], relief_of(left, right), evidence)
    assert surface is not None
    assert surface.centre_mm[2] == pytest.approx(part.face.z_mm, abs=6.0)
    assert abs(surface.centre_mm[2] - part.face.z_mm) < 2.0 * surface.covariance_mm2[2, 2] ** 0.5


def test_a_region_in_which_hardly_anything_rises_has_any_height() -> None:
    left, right = paint([], rig())
    nothing = np.zeros((SIZE[1], SIZE[0]), np.int32)
    images = (PlaneImage(left, nothing, ()), PlaneImage(right, nothing, ()))
    limits = RecognitionParameters()
    evidence = Evidence.of(*images, rig(), TABLE_Z_MM, limits)
    (surface,) = place_unknown([region_of(DISC, paint([DISC], rig())[0])], relief_of(left, right), evidence)
    assert surface is not None
    assert 2.0 * surface.covariance_mm2[2, 2] ** 0.5 > limits.max_height_mm / 2.0


def test_what_known_parts_explain_is_no_part_of_something_unknown() -> None:
    outline = np.array([[20.0, 20.0], [80.0, 20.0], [80.0, 60.0], [20.0, 60.0]])
    known = np.array([[50.0, 10.0], [90.0, 10.0], [90.0, 70.0], [50.0, 70.0]])
    (alone,) = rising_regions([outline], [], (100, 120))
    (beside,) = rising_regions([outline], [known], (100, 120))
    assert alone.mask.sum() == 61 * 41
    assert beside.mask.sum() == 30 * 41
    assert beside.centre_px[0] == pytest.approx(34.5)
    assert rising_regions([outline], [outline], (100, 120)) == []


@pytest.mark.parametrize(
    ("left", "top", "cut_off"), [(50, 40, False), (0, 40, True), (90, 40, True), (50, 70, True), (24, 40, True)]
)
def test_what_reaches_to_where_a_picture_ends_is_cut_off(left: int, top: int, *, cut_off: bool) -> None:
    valid = np.ones((80, 100), dtype=np.bool_)
    # what the right picture does not show
    valid[:, :20] = False
    region = Region(NO_PLANE, np.ones((10, 10), dtype=np.bool_), (left, top))
    assert is_cut_off(region, Relief(np.zeros_like(valid), 1.0, valid)) is cut_off


@pytest.mark.parametrize(
    ("at_px", "held"),
    [
        ((10.0, 20.0), True),
        ((12.4, 21.4), True),
        # the corner that is missing
        ((12.0, 20.0), False),
        ((9.4, 20.0), False),
        ((10.0, 19.4), False),
        ((12.6, 21.0), False),
        ((10.0, 21.6), False),
    ],
)
def test_a_region_holds_its_own_pixels_alone(at_px: tuple[float, float], *, held: bool) -> None:
    mask = np.array([[True, True, False], [True, True, True]])
    assert Region(NO_PLANE, mask, (10, 20)).holds(*at_px) is held
