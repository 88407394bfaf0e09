"""The grey value of a face: of its inside alone, and none where nothing of it is to be seen."""

import cv2
import numpy as np
import pytest

from srvs_cell.vision.recognition.brightness import face_brightness
from tests.vision.painted import Part, cuboid, cylinder, paint, rig

CAMERAS = rig()
BRIGHT = cuboid(470.0, 60.0, 50.0, 20.0, (50.0, 30.0), 220)
DARK = cuboid(540.0, 50.0, 50.0, 70.0, (50.0, 30.0), 40)


@pytest.mark.parametrize("part", [BRIGHT, DARK])
def test_bright_and_dark_top_also_where_the_outline_is_a_little_off(part: Part) -> None:
    grey = paint([BRIGHT, DARK], CAMERAS)[0]
    for off_mm in ((0.0, 0.0, 0.0), (2.0, -2.0, 0.0)):
        seen = face_brightness(part.face.corners_mm() + off_mm, grey, CAMERAS)
        assert seen == pytest.approx(part.top_grey, abs=1.0)


def test_the_rim_of_a_narrow_face_does_not_count() -> None:
    outline = cuboid(500.0, 50.0, 50.0, 0.0, (40.0, 7.0), 0).face.corners_mm()
    x, y, _ = CAMERAS.project_px(outline)
    corners = np.rint(np.column_stack([x, y])).astype(np.int32)
    face = np.zeros((480, 640), np.uint8)
    cv2.fillPoly(face, [corners], 1)
    middle = cv2.erode(face, np.ones((7, 7), np.uint8))
    # most of the face's pixels are rim
    assert 0 < middle.sum() < face.sum() / 2
    assert face_brightness(outline, np.where(middle > 0, 200, 0).astype(np.uint8), CAMERAS) == 200.0


def test_a_face_that_is_cut_by_the_border_is_measured_where_it_is_seen_and_one_outside_is_not() -> None:
    x, y, _ = CAMERAS.project_px(np.array([500.0, 50.0, 55.0]))
    grey = np.full((480, 640), 90, np.uint8)
    outline = cuboid(500.0, 50.0, 50.0, 20.0, (50.0, 30.0), 90).face.corners_mm()
    beyond_mm = np.array([1000.0, 0.0, 0.0])
    assert face_brightness(outline, grey[: int(y)], CAMERAS) == 90.0
    assert face_brightness(outline, grey[:, : int(x)], CAMERAS) == 90.0
    assert face_brightness(outline + beyond_mm, grey, CAMERAS) is None
    assert face_brightness(outline - beyond_mm, grey, CAMERAS) is None


def test_a_face_of_a_few_pixels_has_none() -> None:
    tiny = cylinder(500.0, 50.0, 50.0, 3.0, 200)
    assert face_brightness(tiny.face.corners_mm(), paint([tiny], CAMERAS)[0], CAMERAS) is None
