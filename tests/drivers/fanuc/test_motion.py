"""Moves and what ends them, over a real socket."""

import asyncio
from dataclasses import replace

import pytest

from srvs_cell.alarms import Alarm
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import (
    CommandRejectedError,
    DeviceFaultError,
    Lifecycle,
    MotionStoppedError,
    NotReadyError,
    OutcomeUnknownError,
    RobotMode,
)
from tests.drivers.fanuc.bench import HOME, SPEED_MM_S, TARGET, bench

MODE_SHOWS_S = 0.3
"""SRVS_HB writes the mode with every beat."""


async def test_a_linear_move_takes_its_time_and_reports_the_pose_reached() -> None:
    async with bench() as b:
        await b.ready()
        target = Xyzwpr(600.0, -50.5, 300.125, 180.0, 0.25, -30.5)
        begun_s = b.clock.now_s()
        assert await b.arm.move_linear(target, 100.0) == target
        path_s = 150.14 / 100.0
        assert path_s < b.clock.now_s() - begun_s < path_s + 0.4
        assert b.controller.motions_started == 1


async def test_a_joint_move_reaches_its_target() -> None:
    async with bench() as b:
        await b.ready()
        assert await b.arm.move_joint(TARGET, 20.0) == TARGET


async def test_moves_follow_one_another_past_the_last_sequence_number() -> None:
    async with bench() as b:
        await b.arm.connect()
        await b.arm._wire.write_words(12031, [29_999])
        b.controller.reboot()
        await b.arm.disconnect()
        await b.ready()
        await b.arm._wire.write_words(12031, [29_999])
        await b.clock.sleep(1.0)  # the double rejects it: an old checksum
        for x_mm in (510.0, 520.0, 530.0):
            await b.arm.move_linear(replace(HOME, x_mm=x_mm), 100.0)
        assert b.controller.motions_started == 3


async def test_a_slow_override_makes_a_move_long_but_not_late() -> None:
    async with bench() as b:
        b.point.override_percent = 10
        await b.ready()
        assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET


async def test_a_stop_in_mid_move_leaves_the_arm_standing_until_it_is_activated_again() -> None:
    async with bench() as b:
        await b.ready()
        task = await b.begun_move()
        await b.arm.request_stop()
        with pytest.raises(MotionStoppedError) as stopped:
            await task
        assert stopped.value.alarm is Alarm.MOTION_STOPPED
        assert b.arm.lifecycle is Lifecycle.INACTIVE
        stood = b.point.pose
        assert HOME.x_mm < stood.x_mm < TARGET.x_mm
        with pytest.raises(NotReadyError):
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        await b.arm.activate()
        await b.clock.sleep(3.0)
        assert b.point.pose == stood
        assert b.controller.motions_started == 1
        assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET


@pytest.mark.parametrize("after_s", [0.0, 0.02, 0.1])
async def test_a_stop_before_the_arm_moves_prevents_the_move(after_s: float) -> None:
    async with bench() as b:
        await b.ready()
        task = b.begin_move()
        await (b.clock.sleep(after_s) if after_s else asyncio.sleep(0))
        await b.arm.request_stop()
        with pytest.raises(MotionStoppedError):
            await task
        assert b.point.pose == HOME


async def test_cancelling_a_move_stops_the_arm() -> None:
    async with bench() as b:
        await b.ready()
        task = await b.begun_move()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        await b.clock.sleep(0.1)
        stood = b.point.pose
        await b.clock.sleep(3.0)
        assert not b.point.moving
        assert b.point.pose == stood


async def test_deactivating_in_mid_move_stops_the_arm() -> None:
    async with bench() as b:
        await b.ready()
        task = await b.begun_move()
        await b.arm.deactivate()
        with pytest.raises(MotionStoppedError):
            await task


async def test_a_second_move_is_refused_while_one_is_under_way() -> None:
    async with bench() as b:
        await b.ready()
        task = await b.begun_move()
        with pytest.raises(NotReadyError) as refused:
            await b.arm.move_linear(HOME, SPEED_MM_S)
        assert refused.value.alarm is Alarm.ROBOT_BUSY
        assert await task == TARGET


async def test_status_tells_of_a_move_under_way() -> None:
    async with bench() as b:
        await b.ready()
        task = await b.begun_move()
        status = await b.arm.status()
        assert status.moving
        assert (status.mode, status.override_percent, status.fault) == (RobotMode.AUTO, 100, None)
        assert (status.user_frame, status.user_tool) == (1, 1)
        assert HOME.x_mm < status.pose.x_mm < TARGET.x_mm
        await task
        assert not (await b.arm.status()).moving


@pytest.mark.parametrize(
    ("target", "speed_mm_s", "code"),
    [
        (replace(TARGET, z_mm=3500.0), SPEED_MM_S, "Program fault 3 "),
        (replace(TARGET, r_deg=361.0), SPEED_MM_S, "Program fault 3 "),
        (TARGET, 0.5, "Program fault 4 "),
        (TARGET, 2500.0, "Program fault 4 "),
    ],
)
async def test_the_robot_rejects_what_is_out_of_its_ranges(target: Xyzwpr, speed_mm_s: float, code: str) -> None:
    async with bench() as b:
        await b.ready()
        with pytest.raises(CommandRejectedError) as rejected:
            await b.arm.move_linear(target, speed_mm_s)
        assert rejected.value.alarm is Alarm.TARGET_REJECTED
        assert code in rejected.value.detail
        assert b.controller.motions_started == 0
        assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET


async def test_the_robot_rejects_a_command_in_another_frame() -> None:
    async with bench() as b:
        await b.ready()
        b.controller.user_frame = 2
        with pytest.raises(CommandRejectedError) as rejected:
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        assert "user frame or tool" in rejected.value.detail


async def test_an_unreachable_target_moves_nothing_and_can_be_reset() -> None:
    async with bench() as b:
        await b.ready()
        with pytest.raises(CommandRejectedError) as rejected:
            await b.arm.move_linear(replace(TARGET, x_mm=2000.0), SPEED_MM_S)
        assert rejected.value.alarm is Alarm.TARGET_UNREACHABLE
        assert "MOTN-018" in rejected.value.detail
        with pytest.raises(NotReadyError) as refused:
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        assert refused.value.alarm is Alarm.ROBOT_FAULT
        await b.arm.reset_fault()
        await b.clock.sleep(1.0)
        assert b.point.pose == HOME
        assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET


async def test_a_collision_is_a_named_fault_and_the_move_is_not_continued_after_the_reset() -> None:
    async with bench() as b:
        await b.ready()
        b.point.collide_after_mm = 40.0
        with pytest.raises(DeviceFaultError) as fault:
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        assert fault.value.alarm is Alarm.COLLISION
        status = await b.arm.status()
        assert status.fault == "SRVO-050"
        await b.arm.reset_fault()
        stood = b.point.pose
        await b.clock.sleep(3.0)
        assert b.point.pose == stood
        assert (await b.arm.status()).fault is None
        assert b.controller.motions_started == 1


async def test_a_reset_that_does_not_help_says_so() -> None:
    async with bench(reset_timeout_s=1.0) as b:
        await b.arm.connect()
        b.point.fault = "SRVO-002 Teach pendant E-stop"
        b.point.reset_fault = lambda: None  # type: ignore[method-assign]
        with pytest.raises(DeviceFaultError) as fault:
            await b.arm.reset_fault()
        assert "SRVO-002" in fault.value.detail


async def test_a_move_that_never_ends_is_unknown_and_stopped() -> None:
    async with bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.point._speed_mm_s = 0.01
        with pytest.raises(OutcomeUnknownError) as unknown:
            await task
        assert unknown.value.alarm is Alarm.MOTION_OUTCOME_UNKNOWN
        assert "not finished after" in unknown.value.detail
        await b.clock.sleep(0.1)
        assert not b.point.moving
        assert b.controller.motions_started == 1


async def test_a_move_that_ends_elsewhere_is_not_taken_for_done() -> None:
    async with bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.point._length_mm = 60.0  # the point stops where it is and claims to be at its target
        b.point._target = replace(TARGET, x_mm=560.0)
        with pytest.raises(DeviceFaultError) as fault:
            await task
        assert "40.000 mm" in fault.value.detail


@pytest.mark.parametrize(
    ("condition", "value", "alarm"),
    [
        ("mode", RobotMode.T1, Alarm.MODE_NOT_AUTO),
        ("pendant_enabled", True, Alarm.MODE_NOT_AUTO),
        ("servo_on", False, Alarm.ROBOT_NOT_READY),
        ("fault", "SRVO-001 Operator panel E-stop", Alarm.ROBOT_FAULT),
    ],
)
async def test_a_robot_that_is_not_ready_is_not_activated_and_not_moved(
    condition: str, value: object, alarm: Alarm
) -> None:
    async with bench() as b:
        await b.ready()
        await b.arm.deactivate()
        before = getattr(b.point, condition)
        setattr(b.point, condition, value)
        await b.clock.sleep(MODE_SHOWS_S)
        with pytest.raises(NotReadyError) as refused:
            await b.arm.activate()
        assert refused.value.alarm is alarm
        setattr(b.point, condition, before)
        await b.clock.sleep(MODE_SHOWS_S)
        await b.arm.reset_fault()
        await b.arm.activate()
        setattr(b.point, condition, value)
        await b.clock.sleep(MODE_SHOWS_S)
        with pytest.raises(NotReadyError) as refused:
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        assert refused.value.alarm is alarm
        assert b.controller.motions_started == 0
