"""The gripper on the robot's I/O: what it writes and what it believes."""

import pytest

from drivers.gripper.robot_io import DRIVER, RobotIoGripper, RobotIoGripperConfig
from srvs_cell.alarms import Alarm
from srvs_cell.ports import DriverContext, GripState, Lifecycle, NotReadyError, OutcomeUnknownError, PortError
from tests.drivers.gripper.valve import CONFIG, TRAVEL_S, Valve
from tests.drivers.stepped import SteppedClock, SteppedTime


async def _gripper() -> tuple[RobotIoGripper, Valve, SteppedClock]:
    clock = SteppedClock(SteppedTime())
    valve = Valve(clock)
    gripper = DRIVER.factory(CONFIG, DriverContext(clock, valve))
    assert isinstance(gripper, RobotIoGripper)
    await gripper.connect()
    await gripper.activate()
    return gripper, valve, clock


async def test_one_coil_is_switched_off_before_the_other_is_switched_on() -> None:
    gripper, valve, _ = await _gripper()
    await gripper.close()
    await gripper.open()
    assert valve.writes == [(12, False), (11, True), (11, False), (12, True)]


async def test_nothing_is_written_before_a_grip_is_asked_for() -> None:
    gripper, valve, _ = await _gripper()
    await gripper.state()
    await gripper.deactivate()
    await gripper.disconnect()
    assert valve.writes == []


async def test_closing_returns_only_when_the_sensor_has_settled() -> None:
    gripper, valve, clock = await _gripper()
    valve.part = True
    begun_s = clock.now_s()
    assert await gripper.close() is GripState.HOLDING
    assert clock.now_s() - begun_s >= TRAVEL_S + CONFIG.settle_s


async def test_a_part_that_slips_out_at_once_is_not_held() -> None:
    gripper, valve, _ = await _gripper()
    valve.flickers = True
    assert await gripper.close() is GripState.CLOSED_EMPTY


@pytest.mark.parametrize("action", ["open", "close"])
async def test_fingers_that_do_not_move_leave_the_outcome_unknown(action: str) -> None:
    gripper, valve, clock = await _gripper()
    valve.stuck = True
    begun_s = clock.now_s()
    with pytest.raises(OutcomeUnknownError) as unknown:
        await (gripper.open() if action == "open" else gripper.close())
    assert unknown.value.alarm is Alarm.GRIP_TIMEOUT
    assert "the sensors say moving" in unknown.value.detail
    assert CONFIG.timeout_s < clock.now_s() - begun_s < CONFIG.timeout_s + 0.2


async def test_sensors_that_contradict_each_other_are_not_believed() -> None:
    gripper, valve, _ = await _gripper()
    valve.forced[21] = True
    assert await gripper.state() is GripState.UNKNOWN
    with pytest.raises(OutcomeUnknownError):
        await gripper.open()
    await gripper.disconnect()
    with pytest.raises(PortError) as error:
        await gripper.connect()
    assert error.value.alarm is Alarm.GRIPPER_STATE_UNKNOWN
    assert gripper.lifecycle is Lifecycle.DISCONNECTED


async def test_between_the_sensors_the_gripper_is_moving() -> None:
    gripper, valve, _ = await _gripper()
    valve.stuck = True
    assert await gripper.state() is GripState.MOVING


async def test_an_inactive_gripper_writes_nothing() -> None:
    gripper, valve, _ = await _gripper()
    await gripper.deactivate()
    for action in (gripper.open, gripper.close):
        with pytest.raises(NotReadyError):
            await action()
    assert valve.writes == []


def test_an_arm_without_io_is_a_config_error() -> None:
    with pytest.raises(PortError) as error:
        DRIVER.factory(CONFIG, DriverContext(SteppedClock(SteppedTime())))
    assert error.value.alarm is Alarm.CONFIG_INVALID


@pytest.mark.parametrize("settings", [{"open_output": 1}, {"held_input": 2}, {"timeout_s": 0.0}, {"pressure": 6}])
def test_an_impossible_config_is_an_error(settings: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="validation error"):
        RobotIoGripperConfig.model_validate(settings)
