"""Faces without a matched plane get their place by their grey values."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from srvs_cell.scene import PlaneImage
from srvs_cell.vision.evidence import Evidence
from srvs_cell.vision.recognition import RecognitionParameters
from srvs_cell.vision.recovery import NO_PLANE, Region, find_places, place_unknown, rising_regions
from tests.vision.painted import SIZE, TABLE_Z_MM, Part, cuboid, cylinder, paint, rig

DISC = cylinder(500.0, 50.0, 20.0, 40.0, 170)
TALL = cuboid(531.0, 50.0, 100.0, 35.0, (40.0, 50.0), 250)


def region_of(part: Part, image: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> Region:
    """Return the pixels of the left image that show a part's top face."""
    mask = np.zeros((SIZE[1], SIZE[0]), dtype=np.uint8)
    x, y, _ = rig().project_px(part.face.corners_mm())
    cv2.fillConvexPoly(mask, np.rint(np.column_stack([x, y])).astype(np.int32), 1)
    seen = (mask > 0) & (np.abs(image.astype(int) - part.top_grey) < 10)
    left, top, width, height = cv2.boundingRect(seen.astype(np.uint8))
    return Region(NO_PLANE, seen[top : top + height, left : left + width], (left, top))


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
    (surface,) = place_unknown([region], evidence)
    assert np.hypot(surface.centre_mm[0] - 500.0, surface.centre_mm[1] - 50.0) < 20.0
    half_mm = limits.max_height_mm / 2.0
    assert surface.centre_mm[2] - TABLE_Z_MM == pytest.approx(half_mm, abs=0.3 * half_mm)
    # any height that a part may have lies within two sigma
    assert 2.0 * surface.covariance_mm2[2, 2] ** 0.5 > half_mm


def test_what_known_parts_explain_is_no_part_of_something_unknown() -> None:
    outline = np.array([[20.0, 20.0], [80.0, 20.0], [80.0, 60.0], [20.0, 60.0]])
    known = np.array([[50.0, 10.0], [90.0, 10.0], [90.0, 70.0], [50.0, 70.0]])
    (alone,) = rising_regions([outline], [], (100, 120))
    (beside,) = rising_regions([outline], [known], (100, 120))
    assert alone.mask.sum() == 61 * 41
    assert beside.mask.sum() == 30 * 41
    assert beside.centre_px[0] == pytest.approx(34.5)
    assert rising_regions([outline], [outline], (100, 120)) == []
