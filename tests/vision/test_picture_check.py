"""What cannot be seen is refused with its own alarm, and what can be seen is not."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.sim.parts import CYLINDER
from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.geometry import Transform
from srvs_cell.vision import StereoView, VisionParameters, perceive
from srvs_cell.vision.lines import perceive_lines
from srvs_cell.vision.picture_check import check_pair, check_picture
from srvs_cell.vision.rectification import RectifiedPair, rectify_pair
from tests.vision.painted import SIZE, TABLE_Z_MM, rig
from tests.vision.rendered import part, stereo_pair

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Scene = tuple[NDArray[np.uint8], NDArray[np.uint8], StereoView]

SHAPE = (60, 80)


def refusal(scene: Scene) -> AlarmError:
    left, right, view = scene
    with pytest.raises(AlarmError) as caught:
        perceive(left, right, VisionParameters(), view=view)
    return caught.value


def checked(left: NDArray[np.uint8], right: NDArray[np.uint8], view: StereoView) -> None:
    pair = rectify_pair(left, right, view.calibration, view.base_T_tcp_left, view.base_T_tcp_right)
    check_pair(pair, view.table_z_mm, view.max_height_mm)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return stereo_pair([part(at_mm=(720.0, -60.0)), part(CYLINDER, (40.0, 40.0), 60.0, (780.0, 50.0), albedo=0.6)])


@given(st.integers(0, 255), st.floats(0.0, 1.2), st.integers(0, 2**31))
@settings(max_examples=25)
def test_a_picture_of_one_grey_is_refused_whatever_its_grey_and_read_noise(grey: int, noise: float, seed: int) -> None:
    picture = np.clip(np.rint(grey + np.random.default_rng(seed).normal(0.0, 0.25 * noise, SHAPE)), 0, 255)
    with pytest.raises(AlarmError, match="one grey") as caught:
        check_picture(picture.astype(np.uint8), "left")
    assert caught.value.alarm is Alarm.IMAGE_UNUSABLE


@given(st.integers(0, 2**31), st.floats(30.0, 300.0))
@settings(max_examples=25)
def test_pure_noise_is_refused(seed: int, sigma: float) -> None:
    picture = np.clip(np.random.default_rng(seed).normal(128.0, sigma, SHAPE), 0, 255).astype(np.uint8)
    with pytest.raises(AlarmError, match="noise") as caught:
        check_picture(picture, "right")
    assert caught.value.alarm is Alarm.IMAGE_UNUSABLE


def test_a_real_picture_passes_darkened_noisy_and_half_overexposed(scene: Scene) -> None:
    left = scene[0].astype(np.float64)
    noise = np.random.default_rng(0).normal(0.0, 12.0, left.shape)
    for picture in (left, 0.1 * left, left + noise, 2.5 * left):
        check_picture(np.clip(picture, 0, 255).astype(np.uint8), "left")


def degenerate(scene: Scene) -> dict[str, tuple[NDArray[np.uint8], NDArray[np.uint8], Alarm]]:
    """Return pictures that show no scene from their poses, and the alarm that says so."""
    left, right, _ = scene
    blank = np.full_like(left, 90)
    white = tuple(np.clip(8.0 * image, 0, 255).astype(np.uint8) for image in (left, right))
    noise = np.random.default_rng(3).integers(0, 256, (2, *left.shape), dtype=np.uint8)
    return {
        "blank": (blank, blank + 1, Alarm.IMAGE_UNUSABLE),
        "saturated": (white[0], white[1], Alarm.IMAGE_UNUSABLE),
        "noise": (noise[0], noise[1], Alarm.IMAGE_UNUSABLE),
        "identical": (left, left, Alarm.PAIR_INCONSISTENT),
        "exchanged": (right, left, Alarm.PAIR_INCONSISTENT),
    }


@pytest.mark.parametrize("what", ["blank", "saturated", "noise", "identical", "exchanged"])
def test_the_papers_steps_and_the_lines_refuse_what_the_default_refuses(scene: Scene, what: str) -> None:
    left, right, alarm = degenerate(scene)[what]
    view = scene[2]
    with pytest.raises(AlarmError) as of_planes:
        perceive(left, right, VisionParameters.faithful(), view=view)
    with pytest.raises(AlarmError) as of_lines:
        perceive_lines(left, right, VisionParameters(), view=view)
    assert of_planes.value.alarm is of_lines.value.alarm is refusal((left, right, view)).alarm is alarm


def test_the_papers_steps_and_the_lines_see_what_can_be_seen(scene: Scene) -> None:
    left, right, view = scene
    assert perceive(left, right, VisionParameters.faithful(), view=view).matches
    assert len(perceive_lines(left, right, VisionParameters(), view=view).matches)


def test_a_good_pair_passes_at_any_brightness(scene: Scene) -> None:
    left, right, view = scene
    checked(left, right, view)
    checked((0.4 * left).astype(np.uint8), (0.5 * right).astype(np.uint8), view)


def test_an_overexposed_pair_is_refused(scene: Scene) -> None:
    left, right, view = scene
    white = tuple(np.clip(8.0 * image, 0, 255).astype(np.uint8) for image in (left, right))
    assert refusal((white[0], white[1], view)).alarm is Alarm.IMAGE_UNUSABLE


def test_exchanged_images_are_refused(scene: Scene) -> None:
    left, right, view = scene
    caught = refusal((right, left, view))
    assert caught.alarm is Alarm.PAIR_INCONSISTENT
    assert "exchanged images" in caught.detail


def test_the_same_picture_twice_is_refused(scene: Scene) -> None:
    left, _, view = scene
    caught = refusal((left, left, view))
    assert caught.alarm is Alarm.PAIR_INCONSISTENT
    assert "same picture" in caught.detail


def test_images_of_different_scenes_are_refused(scene: Scene) -> None:
    left, right, view = scene
    caught = refusal((left, np.ascontiguousarray(right[::-1]), view))
    assert caught.alarm is Alarm.PAIR_INCONSISTENT
    assert "different scenes" in caught.detail


@pytest.mark.parametrize(
    ("w_deg", "p_deg", "r_deg"), [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)]
)
def test_a_pose_that_is_turned_by_a_degree_is_refused(scene: Scene, w_deg: float, p_deg: float, r_deg: float) -> None:
    left, right, view = scene
    pose = view.base_T_tcp_right.to_xyzwpr()
    turned = replace(pose, w_deg=pose.w_deg + w_deg, p_deg=pose.p_deg + p_deg, r_deg=pose.r_deg + r_deg)
    with pytest.raises(AlarmError, match="poses or a table height") as caught:
        checked(left, right, replace(view, base_T_tcp_right=Transform.from_xyzwpr("base", "tcp", turned)))
    assert caught.value.alarm is Alarm.PAIR_INCONSISTENT


def at_height(left: NDArray[np.float32], z_mm: float) -> NDArray[np.float32]:
    """Return the right picture of a level surface whose left one is given."""
    height, width = left.shape
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    a, b, c = rig().plane_disparity(np.array([0.0, 0.0, 1.0]), z_mm)
    # the point of the surface that a right pixel shows, in the left image
    return np.asarray(cv2.remap(left, (x + b * y + c).astype(np.float32) / np.float32(1.0 - a), y, cv2.INTER_CUBIC))


def photographed(
    left: NDArray[np.float32], right: NDArray[np.float32], noise: float, rng: np.random.Generator
) -> RectifiedPair:
    pictures = [
        np.clip(picture + rng.normal(0.0, noise, picture.shape), 0, 255).astype(np.uint8) for picture in (left, right)
    ]
    seen = np.ones(left.shape, dtype=np.bool_)
    return RectifiedPair(pictures[0], pictures[1], seen, seen, rig())


def grain(sigma_px: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return a texture of standard deviation 1."""
    width, height = SIZE
    texture = cv2.GaussianBlur(rng.normal(size=(height, width)).astype(np.float32), (0, 0), sigma_px)
    return np.asarray(texture / texture.std(), dtype=np.float32)


@pytest.mark.parametrize("off_mm", [0.0, 60.0])
def test_a_table_is_found_between_parts_that_show_more_than_it(off_mm: float) -> None:
    """What is clearest may all be parts, but a table that is elsewhere is found nowhere."""
    rng = np.random.default_rng(1)
    texture = grain(6.0, rng)
    table, parts = 128.0 + 12.0 * texture, 128.0 + 40.0 * texture
    rows = np.arange(len(texture))[:, None] < 0.75 * len(texture)
    left = np.where(rows, parts, table)
    right = np.where(rows, at_height(parts, TABLE_Z_MM + 110.0), at_height(table, TABLE_Z_MM + off_mm))
    pair = photographed(left, right, 1.0, rng)
    if off_mm == 0.0:
        check_pair(pair, TABLE_Z_MM, 150.0)
    else:
        with pytest.raises(AlarmError, match=" 0 on the table"):
            check_pair(pair, TABLE_Z_MM, 150.0)


@pytest.mark.parametrize("seed", range(6))
def test_a_straight_edge_alone_does_not_tell_a_turn(seed: int) -> None:
    """Along the only edge of the right third every row looks alike: which is found is the noise's choice."""
    rng = np.random.default_rng(seed)
    width, height = SIZE
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    left = 110.0 + 20.0 * grain(2.5, rng) * (x < 0.6 * width) + 60.0 * (x - 0.7 * y > 300.0) * (x > 0.7 * width)
    left = left.astype(np.float32)
    check_pair(photographed(left, at_height(left, TABLE_Z_MM), 2.0, rng), TABLE_Z_MM, 120.0)


def test_a_table_that_is_elsewhere_is_refused(scene: Scene) -> None:
    left, right, view = scene
    for off_mm in (-150.0, 100.0):
        with pytest.raises(AlarmError, match="table height") as caught:
            checked(left, right, replace(view, table_z_mm=view.table_z_mm + off_mm))
        assert caught.value.alarm is Alarm.PAIR_INCONSISTENT


def test_poses_that_make_no_baseline_are_refused(scene: Scene) -> None:
    left, right, view = scene
    there = view.base_T_tcp_left
    assert refusal((left, right, replace(view, base_T_tcp_right=there))).alarm is Alarm.BASELINE_INVALID
    back = replace(view, base_T_tcp_left=view.base_T_tcp_right, base_T_tcp_right=there)
    assert refusal((left, right, back)).alarm is Alarm.BASELINE_INVALID


@pytest.mark.parametrize("beyond_mm", [-30.0, 0.0, 40.0, 1000.0])
def test_heights_up_to_the_camera_and_beyond_are_what_can_be_seen(scene: Scene, beyond_mm: float) -> None:
    left, right, view = scene
    cameras = rectify_pair(left, right, view.calibration, view.base_T_tcp_left, view.base_T_tcp_right).rig
    up_to_mm = float(cameras.base_T_camera.translation_mm[2]) - view.table_z_mm + beyond_mm
    limits = VisionParameters()
    high = replace(limits, recognition=replace(limits.recognition, max_height_mm=up_to_mm))
    usual = perceive(left, right, limits, view=view).workpieces
    seen = perceive(left, right, high, view=replace(view, max_height_mm=up_to_mm)).workpieces
    assert [one.kind for one in seen] == [one.kind for one in usual]
    assert [one.height_mm for one in seen] == pytest.approx([one.height_mm for one in usual], abs=1.0)
    assert len(perceive_lines(left, right, high, view=replace(view, max_height_mm=up_to_mm)).matches)


def test_a_table_as_high_as_the_camera_is_refused(scene: Scene) -> None:
    left, right, view = scene
    cameras = rectify_pair(left, right, view.calibration, view.base_T_tcp_left, view.base_T_tcp_right).rig
    camera_z_mm = float(cameras.base_T_camera.translation_mm[2])
    for table_z_mm in (camera_z_mm - 30.0, camera_z_mm, camera_z_mm + 100.0):
        caught = refusal((left, right, replace(view, table_z_mm=table_z_mm)))
        assert caught.alarm is Alarm.PAIR_INCONSISTENT
        assert "nothing that stands there" in caught.detail
