import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.calibration import (
    Calibration,
    CameraIntrinsics,
    HandEye,
    check_baseline,
    measure_baseline,
    plan_right_pose,
)
from srvs_cell.geometry import Transform, Xyzwpr

CALIBRATION = Calibration(
    camera=CameraIntrinsics(width=640, height=480, fx=800.0, fy=800.0, cx=320.0, cy=240.0, distortion=(0, 0, 0, 0, 0)),
    hand_eye=HandEye(xyz_mm=(40.0, -25.0, 12.0), wpr_deg=(10.0, -5.0, 30.0)),
)
LEFT = Transform.from_xyzwpr("base", "tcp", Xyzwpr(500.0, 100.0, 480.0, 178.0, 3.0, 40.0))


def camera_moved(x_mm: float, y_mm: float, z_mm: float, w_deg: float = 0.0, p_deg: float = 0.0) -> Transform:
    """Return the TCP pose whose camera is moved and turned in the left camera's frame."""
    eye = CALIBRATION.tcp_T_camera
    step = Transform.from_xyzwpr("camera", "camera", Xyzwpr(x_mm, y_mm, z_mm, w_deg, p_deg, 0.0))
    return LEFT @ eye @ step @ eye.inverse()


angle = st.floats(-180, 180)


@given(pose=st.tuples(*[st.floats(-900, 900)] * 3, *[angle] * 3), baseline_mm=st.floats(3, 300))
def test_planned_pose_moves_the_camera_along_its_x_axis(
    pose: tuple[float, float, float, float, float, float], baseline_mm: float
) -> None:
    left = Transform.from_xyzwpr("base", "tcp", Xyzwpr(*pose))
    report = check_baseline(CALIBRATION, left, plan_right_pose(CALIBRATION, left, baseline_mm))
    assert report.along_x_mm == pytest.approx(baseline_mm, rel=1e-9)
    assert abs(report.along_y_mm) + abs(report.along_z_mm) < 1e-9 * (baseline_mm + 1000)
    assert report.rotation_deg < 1e-5


@pytest.mark.parametrize(
    ("right", "says"),
    [
        (camera_moved(1.0, 0.0, 0.0), "moved 1.000 mm; at least 2 mm"),
        (LEFT, "moved 0.000 mm"),
        (camera_moved(30.0, 0.0, 0.0, p_deg=7.0), "turned by 7.000 deg"),
        (camera_moved(0.0, 0.0, 30.0), "optical axis"),
        (camera_moved(0.0, 30.0, 0.0), "vertical axis"),
        (camera_moved(20.0, 0.0, -10.0), "26.6 deg off"),
        (camera_moved(-30.0, 0.0, 0.0), "left and right are exchanged"),
    ],
)
def test_unusable_baselines_are_refused_with_the_reason(right: Transform, says: str) -> None:
    with pytest.raises(AlarmError, match=says) as caught:
        check_baseline(CALIBRATION, LEFT, right)
    assert caught.value.alarm is Alarm.BASELINE_INVALID


def test_small_errors_of_a_real_robot_are_accepted_and_measured() -> None:
    report = check_baseline(CALIBRATION, LEFT, camera_moved(30.0, 0.4, -0.3, w_deg=0.02))
    assert report.baseline_mm == pytest.approx(np.sqrt(30.0**2 + 0.4**2 + 0.3**2))
    assert report.rotation_deg == pytest.approx(0.02, abs=1e-6)
    assert measure_baseline(CALIBRATION, LEFT, LEFT).baseline_mm == 0.0


@pytest.mark.parametrize("baseline_mm", [0.0, 2.5, -30.0, float("nan")])
def test_a_path_that_is_too_short_is_not_planned(baseline_mm: float) -> None:
    with pytest.raises(AlarmError, match="must be at least 3"):
        plan_right_pose(CALIBRATION, LEFT, baseline_mm)
