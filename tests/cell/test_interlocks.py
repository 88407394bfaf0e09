"""The interlocks refuse with values and bounds."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from drivers.sim.doubles import Block, World
from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.calibration import RobotFrames
from srvs_cell.cell.interlocks import check_certainty, check_frame, check_robot_ready, check_speed, check_target
from srvs_cell.config import ToleranceParameters
from srvs_cell.ports import Frame, RobotMode, RobotStatus
from tests.cell.support import CALIBRATION, HEIGHT_PX, OBSERVE, PARAMETERS, WIDTH_PX, seen

if TYPE_CHECKING:
    from srvs_cell.geometry import Xyzwpr

READY = RobotStatus(OBSERVE, RobotMode.AUTO, False, True, False, 100, None, 0, 1, None, 0.0)
FRAMES = RobotFrames(user_frame=0, user_tool=1)


def test_a_ready_robot_passes() -> None:
    check_robot_ready(READY, FRAMES)
    check_robot_ready(replace(READY, user_frame=None, user_tool=None), FRAMES)


@pytest.mark.parametrize(
    ("status", "alarm"),
    [
        (replace(READY, fault="SRVO-050"), Alarm.ROBOT_FAULT),
        (replace(READY, mode=RobotMode.T1), Alarm.MODE_NOT_AUTO),
        (replace(READY, mode=RobotMode.UNKNOWN), Alarm.MODE_NOT_AUTO),
        (replace(READY, pendant_enabled=True), Alarm.MODE_NOT_AUTO),
        (replace(READY, servo_on=False), Alarm.ROBOT_NOT_READY),
        (replace(READY, user_frame=3), Alarm.FRAME_CHANGED),
        (replace(READY, user_tool=2), Alarm.FRAME_CHANGED),
    ],
)
def test_a_robot_that_is_not_ready_is_not_moved(status: RobotStatus, alarm: Alarm) -> None:
    with pytest.raises(AlarmError) as caught:
        check_robot_ready(status, FRAMES)
    assert caught.value.alarm is alarm


@pytest.mark.parametrize(
    ("pose", "named"),
    [
        (replace(OBSERVE, x_mm=-0.1), r"X = -0\.1 mm is outside 0\.0 to 600\.0"),
        (replace(OBSERVE, y_mm=301.0), r"Y = 301\.0"),
        (replace(OBSERVE, z_mm=float("nan")), r"Z = nan"),
    ],
)
def test_a_target_outside_the_box_is_refused(pose: Xyzwpr, named: str) -> None:
    with pytest.raises(AlarmError, match=named):
        check_target(pose, PARAMETERS.workspace)
    check_target(OBSERVE, PARAMETERS.workspace)


@pytest.mark.parametrize("speed_mm_s", [500.1, 0.0, -1.0, float("nan")])
def test_a_speed_beyond_the_limit_is_refused(speed_mm_s: float) -> None:
    with pytest.raises(AlarmError, match="limit is 500"):
        check_speed(speed_mm_s, PARAMETERS.motion)
    check_speed(500.0, PARAMETERS.motion)


@pytest.mark.parametrize(
    ("variances_mm2", "certain"),
    [((6.0, 6.0, 15.0), True), ((6.3, 1.0, 1.0), False), ((1.0, 1.0, 17.0), False), ((float("nan"), 1.0, 1.0), False)],
)
def test_two_sigma_are_held_against_what_a_grasp_allows(variances_mm2: tuple[float, ...], certain: bool) -> None:
    world = World([Block("part", 300.0, 0.0, 30.0)])
    (workpiece,) = seen(world, np.diag(variances_mm2)).workpieces
    tolerance = ToleranceParameters(grasp_mm=5.0, grasp_height_mm=8.0)
    if certain:
        check_certainty(workpiece, tolerance)
    else:
        with pytest.raises(AlarmError) as caught:
            check_certainty(workpiece, tolerance)
        assert caught.value.alarm is Alarm.UNCERTAIN_POSITION


def test_old_frames_and_frames_of_another_size_are_refused() -> None:
    image = np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8)
    check_frame(Frame(image, 2.0, 1), 2.0, CALIBRATION.camera)
    with pytest.raises(AlarmError, match="500 ms before"):
        check_frame(Frame(image, 1.5, 1), 2.0, CALIBRATION.camera)
    with pytest.raises(AlarmError, match="63 x 48 px, the calibration is for 64 x 48"):
        check_frame(Frame(image[:, 1:], 2.0, 1), 2.0, CALIBRATION.camera)
