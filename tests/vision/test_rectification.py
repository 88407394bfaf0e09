import cv2
import numpy as np
import pytest

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.calibration import Calibration, CameraIntrinsics, HandEye, plan_right_pose
from srvs_cell.geometry import Transform, Xyzwpr
from srvs_cell.vision.rectification import doubled, rectification_maps, rectify_pair, remap_pair

CALIBRATION = Calibration(
    camera=CameraIntrinsics(
        width=640, height=480, fx=801.0, fy=799.0, cx=315.0, cy=247.0, distortion=(0.04, -0.1, 3e-4, -5e-4, 0.02)
    ),
    hand_eye=HandEye(xyz_mm=(40.0, -25.0, 12.0), wpr_deg=(1.5, -0.8, 2.0)),
)
LEFT = Transform.from_xyzwpr("base", "tcp", Xyzwpr(500.0, 100.0, 480.0, 178.0, 3.0, 40.0))
STRAIGHT = plan_right_pose(CALIBRATION, LEFT, 30.0)


def turned(pose: Transform, w_deg: float, p_deg: float, r_deg: float) -> Transform:
    return pose @ Transform.from_xyzwpr("tcp", "tcp", Xyzwpr(0.0, 0.2, -0.3, w_deg, p_deg, r_deg))


RIGHTS = {"straight": STRAIGHT, "turned": turned(STRAIGHT, 0.4, -0.3, 0.6)}


def grid_mm() -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    x, y, z = np.meshgrid(np.linspace(-70, 70, 6), np.linspace(-50, 50, 5), [0.0, 60.0])
    centre = (LEFT @ CALIBRATION.tcp_T_camera).apply([0.0, 0.0, 480.0])
    return np.stack([x.ravel() + centre[0], y.ravel() + centre[1], z.ravel()], axis=-1)


@pytest.mark.parametrize("right", RIGHTS.values(), ids=RIGHTS.keys())
def test_a_point_is_read_from_where_opencvs_model_puts_it(right: Transform) -> None:
    maps = rectification_maps(CALIBRATION, LEFT, right)
    points = grid_mm()
    x, y, disparity = maps.rig.project_px(points)
    for pose, columns, fixed_map in ((LEFT, x, maps.left), (right, x - disparity, maps.right)):
        map_x, map_y = (np.asarray(part / 2.0, dtype=np.float32) for part in cv2.convertMaps(*fixed_map, cv2.CV_32FC1))
        seen = (pose @ CALIBRATION.tcp_T_camera).inverse()
        true, _ = cv2.projectPoints(
            seen.apply(points), np.zeros(3), np.zeros(3), CALIBRATION.camera_matrix, CALIBRATION.distortion
        )
        inside = (columns > 1) & (columns < 638) & (y > 1) & (y < 478)
        assert inside.sum() > 20
        at = columns[inside].astype(np.float32), y[inside].astype(np.float32)
        source = np.column_stack([cv2.remap(part, *at, cv2.INTER_LINEAR).ravel() for part in (map_x, map_y)])
        # OpenCV interpolates maps on a grid of 1/32 pixel
        assert np.abs(source - true.reshape(-1, 2)[inside]).max() < 0.04


def test_rectified_points_triangulate_to_themselves() -> None:
    maps = rectification_maps(CALIBRATION, LEFT, RIGHTS["turned"])
    points = grid_mm()
    x, y, disparity = maps.rig.project_px(points)
    assert maps.rig.points_mm(x, y, disparity) == pytest.approx(points, rel=1e-9)
    assert maps.rig.baseline_mm == pytest.approx(30.0, abs=0.6)


def test_disparity_plane_of_a_horizontal_plane() -> None:
    rig = rectification_maps(CALIBRATION, LEFT, STRAIGHT).rig
    points = grid_mm()
    points = points[points[:, 2] == 60.0]
    x, y, disparity = rig.project_px(points)
    a, b, c = rig.plane_disparity(np.array([0.0, 0.0, 1.0]), 60.0)
    assert a * x + b * y + c == pytest.approx(disparity, rel=1e-9)


def test_disparity_range_holds_every_height_in_between() -> None:
    rig = rectification_maps(CALIBRATION, LEFT, STRAIGHT).rig
    low, high = rig.disparity_range(0.0, 60.0, (640, 480))
    x, y, disparity = rig.project_px(grid_mm())
    inside = (x >= 0) & (x <= 639) & (y >= 0) & (y <= 479)
    assert inside.any()
    assert low <= disparity[inside].min()
    assert disparity[inside].max() <= high
    assert rig.disparity_range(0.0, 5000.0, (640, 480))[1] == 640.0


def test_colour_and_grey_give_the_same_picture() -> None:
    rng = np.random.default_rng(1)
    grey = rng.integers(0, 255, (480, 640), dtype=np.uint8)
    maps = rectification_maps(CALIBRATION, LEFT, STRAIGHT)
    from_grey = remap_pair(grey, grey, maps)
    colour = np.repeat(grey[:, :, None], 3, axis=2)
    from_colour = rectify_pair(colour, colour, CALIBRATION, LEFT, STRAIGHT)
    assert np.array_equal(from_grey.left, from_colour.left)
    assert from_grey.left.shape == (480, 640)
    assert not from_grey.left_valid.all()
    assert from_grey.left_valid.mean() > 0.9


def test_wrong_size_is_an_invalid_image() -> None:
    good, bad = np.zeros((480, 640), np.uint8), np.zeros((470, 640), np.uint8)
    with pytest.raises(AlarmError, match="right image is 640 x 470") as caught:
        rectify_pair(good, bad, CALIBRATION, LEFT, STRAIGHT)
    assert caught.value.alarm is Alarm.IMAGE_INVALID


def test_exchanged_images_are_no_baseline() -> None:
    with pytest.raises(AlarmError, match="left and right are exchanged") as caught:
        rectification_maps(CALIBRATION, STRAIGHT, LEFT)
    assert caught.value.alarm is Alarm.BASELINE_INVALID


def test_what_lies_between_two_pixels_is_placed_to_a_hundredth_of_a_pixel() -> None:
    x = np.arange(120.0)
    for shift_px in (0.0, 0.13, 0.5, 0.71):
        grey = np.tile(np.rint(128.0 + 100.0 * np.tanh((x - 60.0 - shift_px) / 1.5)), (40, 1)).astype(np.uint8)
        twice = doubled(grey)
        assert np.array_equal(twice[::2, ::2], grey)
        row = twice[20].astype(np.float64)
        crossing = int(np.flatnonzero(row > 128.0)[0])
        before, after = row[crossing - 1], row[crossing]
        found = (crossing - 1 + (128.0 - before) / (after - before)) / 2.0
        assert found == pytest.approx(60.0 + shift_px, abs=0.015)


def test_a_second_pair_from_the_same_place_is_rectified_alike_and_another_place_is_not_mistaken_for_it() -> None:
    rng = np.random.default_rng(2)
    noise = rng.integers(0, 255, (480, 640), dtype=np.uint8)
    grey = np.asarray(cv2.GaussianBlur(noise, (0, 0), 2.0), dtype=np.uint8)
    first = rectify_pair(grey, grey, CALIBRATION, LEFT, STRAIGHT)
    other = rectify_pair(grey, grey, CALIBRATION, LEFT, RIGHTS["turned"])
    again = rectify_pair(grey, grey, CALIBRATION, LEFT, STRAIGHT)
    assert np.array_equal(first.right, again.right)
    assert not np.array_equal(first.right, other.right)
