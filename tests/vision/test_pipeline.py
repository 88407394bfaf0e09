"""Two images in, planes, matches and disparities out."""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from typing import TYPE_CHECKING

import numpy as np
import pytest

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.vision import VisionParameters, analyse_image, perceive
from tests.vision.pictures import Face, render, square

if TYPE_CHECKING:
    from srvs_cell.scene import Perception

SLANTED = Face(((30.0, 95.0), (90.0, 95.0), (90.0, 145.0), (30.0, 145.0)), 190.0, (0.05, -0.03, 14.0))
FACES = [square(60.0, 45.0, 44.0, 150.0, 18.25), square(150.0, 60.0, 36.0, 110.0, 12.6), SLANTED]
PARAMETERS = VisionParameters(min_disparity_px=5.0, max_disparity_px=30.0)


def disparity(perception: Perception, x: int, y: int) -> float:
    return float(perception.disparity_px[y, x])


def test_flat_and_slanted_faces_come_out_to_a_tenth_of_a_pixel() -> None:
    perception = perceive(*render(FACES, noise=1.0), PARAMETERS)
    assert disparity(perception, 60, 45) == pytest.approx(18.25, abs=0.1)
    assert disparity(perception, 150, 60) == pytest.approx(12.6, abs=0.1)
    for x, y in ((40, 105), (80, 105), (60, 120), (40, 135), (80, 135)):
        assert disparity(perception, x, y) == pytest.approx(0.05 * x - 0.03 * y + 14.0, abs=0.15)


def test_the_working_environment_has_no_disparity() -> None:
    perception = perceive(*render(FACES), PARAMETERS)
    assert perception.disparity_px.dtype == np.float32
    assert perception.disparity_px.shape == (160, 220)
    matched = {match.left for match in perception.matches}
    inside = np.isin(perception.left.labels, list(matched))
    assert np.array_equal(np.isfinite(perception.disparity_px), inside)


def test_the_paper_alone_finds_the_faces_to_a_pixel() -> None:
    faithful = replace(VisionParameters.faithful(), min_disparity_px=5.0, max_disparity_px=30.0)
    perception = perceive(*render(FACES), faithful)
    assert "refinement" not in perception.timings_ms
    assert disparity(perception, 60, 45) == pytest.approx(18.25, abs=1.0)
    assert disparity(perception, 60, 120) == pytest.approx(13.4, abs=1.0)


def test_the_paper_alone_has_every_switch_beyond_it_off_and_keeps_the_limits() -> None:
    own = replace(VisionParameters(), recognition=replace(VisionParameters().recognition, max_height_mm=90.0))
    paper = own.as_the_paper()
    assert paper.recognition == replace(own.recognition, recover=False)
    assert not paper.table.enabled
    assert VisionParameters.faithful() == VisionParameters().as_the_paper()


def test_without_sub_pixels_joined_regions_have_their_surface_in_the_map() -> None:
    label = square(60.0, 45.0, 16.0, 60.0, 18.25, angle_deg=12.0)
    coarse = replace(PARAMETERS, interpolation=replace(PARAMETERS.interpolation, sub_pixel=False))
    perception = perceive(*render([*FACES, label], background=90.0), coarse)
    assert perception.left.labels[45, 60] == perception.left.labels[32, 52] != 0
    for x, y in ((60, 45), (45, 45), (75, 45), (60, 30)):
        assert disparity(perception, x, y) == pytest.approx(18.25, abs=0.5)
    for match in perception.matches:
        rows, columns = np.nonzero(perception.left.labels == match.left)
        a, b, c = match.disparity_plane
        assert np.allclose(perception.disparity_px[rows, columns], a * columns + b * rows + c, atol=1e-3)


def test_print_on_a_face_becomes_part_of_its_plane() -> None:
    label = square(60.0, 45.0, 16.0, 60.0, 18.25, angle_deg=12.0)
    perception = perceive(*render([*FACES, label], background=90.0), PARAMETERS)
    labels = perception.left.labels
    assert labels[45, 60] == labels[32, 52] != 0
    assert disparity(perception, 60, 45) == pytest.approx(18.25, abs=0.15)


def test_colour_and_grey_are_the_same_picture() -> None:
    left, right = render(FACES)
    grey = perceive(left, right, PARAMETERS)
    colour = perceive(np.repeat(left[..., None], 3, axis=2), np.repeat(right[..., None], 3, axis=2), PARAMETERS)
    assert [match.disparity_plane for match in grey.matches] == [match.disparity_plane for match in colour.matches]


def test_every_step_is_timed_in_milliseconds_and_none_without_a_stopwatch() -> None:
    ticks = count()
    perception = perceive(*render(FACES), PARAMETERS, stopwatch=lambda: next(ticks) * 0.001)
    steps = ["edges", "filtering", "thinning", "tracking", "region_growing", "plane_parameters", "matching"]
    assert list(perception.timings_ms)[:7] == steps
    assert perception.timings_ms["edges"] == pytest.approx(2.0)
    assert perceive(*render(FACES), PARAMETERS).timings_ms == {}


@pytest.mark.parametrize("grey", [0, 128, 255])
def test_constant_images_are_refused(grey: int) -> None:
    image = np.full((48, 64), grey, dtype=np.uint8)
    with pytest.raises(AlarmError, match="one grey") as caught:
        perceive(image, image, PARAMETERS)
    assert caught.value.alarm is Alarm.IMAGE_UNUSABLE


def test_pure_noise_is_refused() -> None:
    left, right = np.random.default_rng(2).integers(0, 256, (2, 60, 80), dtype=np.uint8)
    for parameters in (PARAMETERS, VisionParameters.faithful()):
        with pytest.raises(AlarmError, match="noise") as caught:
            perceive(left, right, parameters)
        assert caught.value.alarm is Alarm.IMAGE_UNUSABLE


@pytest.mark.parametrize(
    ("left", "right", "reason"),
    [
        ((40, 60), (40, 61), "60 x 40"),
        ((8, 60), (8, 60), "at least"),
        ((40, 60, 4), (40, 60, 4), "shape"),
        ((40,), (40,), "shape"),
    ],
)
def test_a_bad_image_is_refused_with_its_size(left: tuple[int, ...], right: tuple[int, ...], reason: str) -> None:
    with pytest.raises(AlarmError, match=reason) as caught:
        perceive(np.zeros(left, dtype=np.uint8), np.zeros(right, dtype=np.uint8), PARAMETERS)
    assert caught.value.alarm is Alarm.IMAGE_INVALID


def test_an_image_analysed_alone_has_the_planes_that_the_pair_has() -> None:
    left, right = render(FACES)
    alone = analyse_image(left, PARAMETERS)
    off = replace(PARAMETERS, grouping=replace(PARAMETERS.grouping, enabled=False))
    assert alone.planes == perceive(left, right, off).left.planes
