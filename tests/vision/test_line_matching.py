"""Straight line matching on pairs whose disparities are known."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.planes_against_lines import judge_lines, middlebury_pair
from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.calibration import Calibration
from srvs_cell.geometry import Transform, Xyzwpr
from srvs_cell.vision import StereoView, VisionParameters
from srvs_cell.vision.line_matching import LineMatchingParameters, match_function, near_horizontal
from srvs_cell.vision.line_overlay import draw_line_matches
from srvs_cell.vision.lines import (
    BaselineParameters,
    LinePerception,
    line_disparity_map,
    lines_to_json,
    perceive_lines,
)
from tests.vision.pictures import Face, render, square

DATA = Path(os.environ.get("SRVS_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
PARAMETERS = replace(VisionParameters(), min_disparity_px=5.0, max_disparity_px=40.0)
CALIBRATION = {
    "schema_version": 1,
    "camera": {"width": 220, "height": 160, "fx": 400.0, "fy": 400.0, "cx": 110.0, "cy": 80.0, "distortion": [0.0] * 5},
    "tcp_T_camera": {"xyz_mm": [0.0, 0.0, 0.0], "wpr_deg": [0.0, 0.0, 0.0]},
}


def see(faces: list[Face], *, gain: float = 1.0, baseline: BaselineParameters | None = None) -> LinePerception:
    left, right = render(faces, noise=1.0)
    right = np.asarray(np.clip(right * gain, 0, 255), dtype=np.uint8)
    return perceive_lines(left, right, PARAMETERS, baseline=baseline)


def test_every_side_of_a_square_is_matched_at_its_disparity() -> None:
    perception = see([square(110.0, 80.0, 60.0, 160.0, 20.4, angle_deg=30.0)])
    assert len(perception.matches) == 4
    assert perception.matches.disparity_ends_px == pytest.approx(20.4, abs=0.25)
    assert perception.matches.score.min() > 0.9


def test_the_ends_of_a_line_on_an_inclined_plane_have_their_own_disparities() -> None:
    plane = (0.02, 0.05, 12.0)
    corners = ((70.0, 40.0), (150.0, 55.0), (140.0, 125.0), (60.0, 110.0))
    perception = see([Face(corners, 170.0, plane)])
    crossing = ~perception.matches.near_horizontal
    assert crossing.sum() >= 2
    for ends, points in (
        (perception.matches.disparity_ends_px[:, 0], perception.left.start_px),
        (perception.matches.disparity_ends_px[:, 1], perception.left.end_px),
    ):
        at = points[perception.matches.left]
        expected = at @ plane[:2] + plane[2]
        assert ends[crossing] == pytest.approx(expected[crossing], abs=0.35)


def test_a_line_along_the_motion_is_matched_by_its_ends_and_says_so() -> None:
    perception = see([square(110.0, 80.0, 60.0, 160.0, 20.0, angle_deg=0.5)])
    flat = perception.matches.near_horizontal
    assert flat.sum() == 2
    assert perception.matches.disparity_ends_px[flat] == pytest.approx(20.0, abs=2.0)
    assert perception.matches.disparity_ends_px[~flat] == pytest.approx(20.0, abs=0.2)


def test_the_rows_alone_tell_little_of_a_line_along_the_motion() -> None:
    """The paper's second drawback: the crossing with a row is uncertain by sigma / sin(angle)."""
    baseline = BaselineParameters(matching=LineMatchingParameters(near_horizontal_deg=0.1, max_column_margin_px=40.0))
    faces = [square(110.0, 80.0, 60.0, 160.0, 20.0, angle_deg=2.0)]
    matches = see(faces, baseline=baseline).matches
    error_px = np.abs(matches.disparity_ends_px - 20.0).max(axis=1)
    lines = see(faces, baseline=baseline).left
    rise = np.abs(lines.end_px - lines.start_px)[matches.left, 1]
    steep = rise > 30.0
    assert steep.any()
    assert (~steep).any()
    assert error_px[~steep].max() > 3.0 * error_px[steep].max()


def test_each_line_has_at_most_one_partner_and_equals_do_not_cross() -> None:
    faces = [square(60.0, 60.0, 30.0, 160.0, 12.0, 25.0), square(130.0, 60.0, 30.0, 160.0, 18.0, 25.0)]
    matches = see(faces).matches
    assert len(set(matches.left.tolist())) == len(matches)
    assert len(set(matches.right.tolist())) == len(matches)
    assert len(matches) >= 6


def test_lines_of_opposite_contrast_are_no_candidates() -> None:
    face = square(110.0, 80.0, 60.0, 160.0, 20.0, angle_deg=30.0)
    left, right = render([face])
    inverted = np.asarray(255 - right, dtype=np.uint8)
    # each side would find its like only in the opposite side, a square's width away
    found = perceive_lines(left, inverted, PARAMETERS)
    assert not any(abs(ends.mean() - 20.0) < 3.0 for ends in found.matches.disparity_ends_px)


def test_disparities_outside_the_range_are_not_matched() -> None:
    left, right = render([square(110.0, 80.0, 60.0, 160.0, 20.0, angle_deg=30.0)])
    narrow = replace(VisionParameters(), min_disparity_px=30.0, max_disparity_px=40.0)
    assert len(perceive_lines(left, right, narrow).matches) == 0


def test_a_darker_right_image_is_matched_all_the_same() -> None:
    perception = see([square(110.0, 80.0, 60.0, 160.0, 20.4, angle_deg=30.0)], gain=0.85)
    assert len(perception.matches) == 4


def test_the_match_function_is_one_for_a_line_and_itself_and_the_same_both_ways() -> None:
    perception = see([square(110.0, 80.0, 60.0, 160.0, 20.4, angle_deg=30.0)])
    parameters = LineMatchingParameters()
    every = np.arange(len(perception.left))
    assert match_function(perception.left, perception.left, every, every, parameters) == pytest.approx(1.0)
    there = match_function(
        perception.left, perception.right, perception.matches.left, perception.matches.right, parameters
    )
    back = match_function(
        perception.right, perception.left, perception.matches.right, perception.matches.left, parameters
    )
    assert there == pytest.approx(back)
    assert there == pytest.approx(perception.matches.score)


def test_a_high_threshold_leaves_fewer_matches() -> None:
    faces = [square(60.0, 60.0, 30.0, 160.0, 12.0, 25.0), square(130.0, 90.0, 50.0, 90.0, 18.0, 50.0)]
    strict = BaselineParameters(matching=LineMatchingParameters(match_threshold=0.99))
    assert len(see(faces, baseline=strict).matches) < len(see(faces).matches)


def test_near_horizontal_is_a_matter_of_the_angle() -> None:
    lines = see([square(110.0, 80.0, 60.0, 160.0, 20.0, angle_deg=10.0)]).left
    every = np.arange(len(lines))
    assert near_horizontal(lines, every, LineMatchingParameters(near_horizontal_deg=15.0)).sum() == 2
    assert near_horizontal(lines, every, LineMatchingParameters(near_horizontal_deg=5.0)).sum() == 0


def test_with_calibration_the_ends_have_places_in_the_base_frame() -> None:
    left, right = render([square(110.0, 80.0, 60.0, 160.0, 28.4, angle_deg=30.0)])
    poses = [Transform.from_xyzwpr("base", "tcp", Xyzwpr(x_mm, 0.0, 500.0, 180.0, 0.0, 0.0)) for x_mm in (500.0, 530.0)]
    view = StereoView(Calibration.from_mapping(CALIBRATION, "test"), poses[0], poses[1], table_z_mm=0.0)
    perception = perceive_lines(left, right, VisionParameters(), view=view)
    assert perception.ends_mm is not None
    assert perception.ends_mm.shape == (4, 2, 3)
    assert perception.ends_mm[..., 2] == pytest.approx(500.0 - 400.0 * 30.0 / 28.4, abs=3.0)
    corner_mm = np.hypot(*(perception.ends_mm[..., :2] - (500.0, 0.0)).reshape(-1, 2).T)
    assert corner_mm == pytest.approx(60.0 / np.sqrt(2.0) / 28.4 * 30.0, abs=4.0)
    assert "ends_mm" in lines_to_json(perception)["matches"][0]


def test_pictures_without_a_line_are_no_trouble() -> None:
    soft = np.broadcast_to(np.linspace(90.0, 110.0, 220), (160, 220)).astype(np.uint8)
    perception = perceive_lines(soft, soft + np.uint8(1), PARAMETERS)
    assert len(perception.left) == len(perception.matches) == 0
    assert np.isnan(line_disparity_map(perception)).all()
    assert draw_line_matches(perception).dtype == np.uint8
    left, _ = render([square(110.0, 80.0, 60.0, 160.0, 20.4)])
    assert len(perceive_lines(left, soft, PARAMETERS).matches) == 0


def test_blank_pictures_are_refused() -> None:
    left, _ = render([square(110.0, 80.0, 60.0, 160.0, 20.4)])
    blank = np.full_like(left, 90)
    for one, other in ((blank, blank), (left, blank), (blank, left)):
        with pytest.raises(AlarmError) as caught:
            perceive_lines(one, other, PARAMETERS)
        assert caught.value.alarm is Alarm.IMAGE_UNUSABLE


def test_images_of_different_size_are_refused() -> None:
    left = np.full((60, 80), 90, dtype=np.uint8)
    with pytest.raises(AlarmError) as caught:
        perceive_lines(left, left[:, :70].copy(), PARAMETERS)
    assert caught.value.alarm is Alarm.IMAGE_INVALID
    assert "80 x 60" in str(caught.value)


def test_the_disparity_map_has_the_lines_and_nothing_else() -> None:
    perception = see([square(110.0, 80.0, 60.0, 160.0, 20.4, angle_deg=30.0)])
    disparity = line_disparity_map(perception)
    known = np.isfinite(disparity)
    assert disparity.shape == perception.left.grey.shape
    assert 200 <= known.sum() <= 320
    assert disparity[known] == pytest.approx(20.4, abs=0.25)


def test_the_report_numbers_lines_from_one() -> None:
    perception = see([square(110.0, 80.0, 60.0, 160.0, 20.4, angle_deg=30.0)])
    report = lines_to_json(perception)
    assert list(report) == ["method", "lines_left", "lines_right", "matches", "timings_ms"]
    assert [line["id"] for line in report["lines_left"]] == list(range(1, len(perception.left) + 1))
    match = report["matches"][0]
    assert match["disparity_px"] == pytest.approx(20.4, abs=0.25)
    assert {match["left"] for match in report["matches"]} <= {line["id"] for line in report["lines_left"]}
    assert "ends_mm" not in match


def test_a_matched_line_has_one_colour_in_both_images() -> None:
    perception = see([square(110.0, 80.0, 60.0, 160.0, 20.4, angle_deg=30.0)])
    picture = draw_line_matches(perception)
    scale = 5
    bar = picture.shape[0] - 160 * scale
    right_start = picture.shape[1] - 220 * scale
    for left, right in zip(perception.matches.left, perception.matches.right, strict=True):
        colours = []
        for image, line, start in ((perception.left, left, 0), (perception.right, right, right_start)):
            # a quarter along the line: the number stands in its middle
            x, y = (0.8 * image.start_px[line] + 0.2 * image.end_px[line] + 0.5) * scale - 0.5
            colours.append(picture[bar + round(y), start + round(x)].astype(int))
        assert np.abs(colours[0] - colours[1]).max() < 40
        assert np.ptp(colours[0]) > 60


@pytest.mark.skipif(not (DATA / "middlebury2001").is_dir(), reason="no Middlebury pairs: set SRVS_DATA")
def test_most_lines_of_venus_are_right() -> None:
    cv2.setNumThreads(1)
    pair = middlebury_pair(DATA, "venus")
    perception = perceive_lines(pair.left, pair.right, replace(VisionParameters(), max_disparity_px=32.0))
    judged = judge_lines(perception, pair)
    assert len(judged) > 300
    assert np.mean([one.right for one in judged]) > 0.8
    steep = [one.error_px for one in judged if one.angle_deg >= 60.0]
    assert np.median(steep) < 0.1
