import numpy as np
import pytest

from srvs_cell.scene import Perception, PlaneImage
from srvs_cell.vision.lateral_stereo import surfaces_from_matches
from srvs_cell.vision.overlay import draw_locations, draw_matches
from srvs_cell.vision.recognition import recognise
from tests.vision.painted import TABLE_Z_MM, cuboid, cylinder, paint, planes, rig

PARTS = [cuboid(470.0, 100.0, 60.0, 20.0, (50.0, 30.0), 200), cylinder(560.0, 90.0, 80.0, 36.0, 60)]


@pytest.fixture(scope="module")
def perception() -> Perception:
    cameras = rig()
    left, right, matches = planes(PARTS, cameras, paint(PARTS, cameras), disparity_noise_px=0.0)
    surfaces = surfaces_from_matches(left, matches, cameras)
    workpieces = recognise(surfaces, left, right, cameras, TABLE_Z_MM)
    disparity = np.full(left.grey.shape, np.nan, np.float32)
    return Perception(left, right, tuple(matches), disparity, surfaces, workpieces, {})


def colourfulness(pixels: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> float:
    return float(np.ptp(pixels.astype(int), axis=-1).mean())


def test_matched_planes_have_one_colour_in_both_images(perception: Perception) -> None:
    picture = draw_matches(perception)
    assert picture.dtype == np.uint8
    height, width, _ = picture.shape
    assert width > 2 * 640
    bar = height - 480
    right_start = width - 640
    tints = []
    for number in (1, 2):
        for image, start in ((perception.left, 0), (perception.right, right_start)):
            rows, columns = np.nonzero(image.labels == number)
            painted = picture[bar + rows, start + columns].astype(float)
            tint = np.median(painted - image.grey[rows, columns][:, None], axis=0)
            assert colourfulness(picture[bar + rows, start + columns]) > 20.0
            tints.append(tint)
    # a tint is the colour's share, so that equal colours on equal grey give equal tints
    assert tints[0] == pytest.approx(tints[1], abs=6.0)
    assert tints[2] == pytest.approx(tints[3], abs=6.0)
    assert np.abs(tints[0] - tints[2]).max() > 20.0


def test_unmatched_pixels_stay_grey(perception: Perception) -> None:
    picture = draw_matches(perception)
    bar = picture.shape[0] - 480
    assert colourfulness(picture[bar : bar + 30, :600]) == 0.0


def test_small_images_are_enlarged() -> None:
    grey = np.full((60, 80), 100, np.uint8)
    image = PlaneImage(grey, np.zeros((60, 80), np.int32), ())
    nothing = Perception(image, image, (), np.full((60, 80), np.nan, np.float32), (), (), {})
    assert draw_matches(nothing).shape[1] > 2 * 480


def test_locations_show_workpieces_and_truth(perception: Perception) -> None:
    plain = draw_locations(perception.workpieces)
    true = [(part.face.x_mm, part.face.y_mm, part.face.z_mm) for part in PARTS]
    with_truth = draw_locations(perception.workpieces, true)
    assert colourfulness(plain) > 1.0
    assert plain.shape == with_truth.shape
    assert not np.array_equal(plain, with_truth)


def test_an_empty_table_can_be_drawn(perception: Perception) -> None:
    nothing = Perception(perception.left, perception.right, (), perception.disparity_px, (), (), {})
    assert draw_locations(nothing.workpieces).dtype == np.uint8
    assert colourfulness(draw_matches(nothing)) == 0.0
