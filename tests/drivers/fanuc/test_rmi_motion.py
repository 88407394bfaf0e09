"""Moves over RMI and what ends them, over real sockets."""

import asyncio
from dataclasses import replace
from typing import Any

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
    PortError,
    RobotMode,
    RobotStatus,
)
from tests.drivers.fanuc.bench import HOME, SPEED_MM_S, TARGET
from tests.drivers.fanuc.rmi_bench import RmiBench, rmi_bench


async def test_a_linear_move_takes_its_time_and_reports_the_pose_reached() -> None:
    async with rmi_bench() as b:
        await b.ready()
        target = Xyzwpr(600.0, -50.5, 300.125, 180.0, 0.25, -30.5)
        begun_s = b.clock.now_s()
        assert await b.arm.move_linear(target, 100.0) == target
        path_s = 150.14 / 100.0
        assert path_s < b.clock.now_s() - begun_s < path_s + 0.2
        assert b.controller.motions_started == 1


async def test_moves_follow_one_another_and_never_wait_for_the_next() -> None:
    async with rmi_bench() as b:
        await b.ready()
        for x_mm in (510.0, 520.0, 530.0):
            assert (await b.arm.move_joint(replace(HOME, x_mm=x_mm), 20.0)).x_mm == x_mm
        assert b.controller.motions_started == 3


async def test_the_controllers_next_sequence_number_is_taken_and_counts_past_the_last() -> None:
    async with rmi_bench() as b:
        await b.ready()
        b.arm._session.number_from(2**31 - 1)
        b.controller._next_sequence = 2**31 - 1
        for x_mm in (510.0, 520.0):
            await b.arm.move_linear(replace(HOME, x_mm=x_mm), 100.0)
        assert b.controller._next_sequence == 2


async def test_the_posture_that_the_arm_is_in_is_kept() -> None:
    async with rmi_bench() as b:
        b.controller.posture = {"Front": 0, "Up": 1, "Left": 1, "Flip": 1, "Turn4": -1, "Turn5": 0, "Turn6": 1}
        await b.ready()
        assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET
        assert await b.arm.move_joint(HOME, 10.0) == HOME


async def test_the_configs_frames_are_selected_before_the_arm_may_move() -> None:
    async with rmi_bench(user_frame=3, user_tool=2) as b:
        await b.ready()
        assert (b.controller.user_frame, b.controller.user_tool) == (3, 2)
        assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET
        b.controller.user_tool = 4
        with pytest.raises(NotReadyError) as refused:
            await b.arm.move_linear(HOME, SPEED_MM_S)
        assert refused.value.alarm is Alarm.FRAME_CHANGED
        assert "tool 4" in refused.value.detail
        assert b.controller.motions_started == 1


async def test_a_slow_override_makes_a_move_long_but_not_late() -> None:
    async with rmi_bench() as b:
        b.point.override_percent = 10
        await b.ready()
        assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET


async def test_an_override_that_is_lowered_in_mid_move_is_no_time_out() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        way_mm = b.point._way_mm()
        b.point._begun_s = b.time.now_s() - way_mm / 1.0
        b.point._speed_mm_s, b.point.override_percent = 1.0, 5
        assert await task == TARGET


async def test_speeds_go_out_as_whole_numbers_that_are_never_higher() -> None:
    async with rmi_bench() as b:
        await b.ready()
        await b.arm.move_linear(TARGET, 40.9)
        assert b.point._speed_mm_s == 40.0
        for move in (b.arm.move_linear(HOME, 0.9), b.arm.move_joint(HOME, 0.5)):
            with pytest.raises(CommandRejectedError):
                await move
        assert b.controller.motions_started == 1


async def test_a_stop_in_mid_move_leaves_the_arm_standing_until_it_is_activated_again() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        await b.arm.request_stop()
        with pytest.raises(MotionStoppedError) as stopped:
            await task
        assert stopped.value.alarm is Alarm.MOTION_STOPPED
        assert b.arm.lifecycle is Lifecycle.INACTIVE
        stood = b.point.pose
        assert HOME.x_mm < stood.x_mm < TARGET.x_mm
        await b.arm.activate()
        await b.clock.sleep(3.0)
        assert b.point.pose == stood
        assert b.controller.motions_started == 1
        assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET


async def test_who_makes_the_arm_active_at_once_after_a_stop_does_not_blur_how_the_move_ended() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        await b.arm.request_stop()
        await b.arm.activate()
        with pytest.raises(MotionStoppedError):
            await task
        assert b.arm.lifecycle is Lifecycle.ACTIVE
        assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET


async def test_an_abort_that_takes_almost_a_minute_is_waited_for_while_nothing_else_is_sent() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.abort_takes_s = 55.0
        begun_s = b.clock.now_s()
        await b.arm.request_stop()
        assert b.clock.now_s() - begun_s < 1.0  # whoever asks for a stop does not wait
        await b.heard()
        assert b.clock.now_s() - begun_s < 1.0  # the arm stands long before the abort is answered
        status = asyncio.create_task(b.arm.status())
        with pytest.raises(MotionStoppedError):
            await task
        assert 55.0 <= b.clock.now_s() - begun_s < 56.0
        await status
        await b.arm.activate()
        assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET


async def test_an_abort_that_is_never_answered_leaves_the_outcome_unknown() -> None:
    async with rmi_bench(abort_timeout_s=20.0) as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.abort_takes_s = 1000.0
        await b.arm.request_stop()
        with pytest.raises(OutcomeUnknownError) as unknown:
            await task
        assert "FRC_Abort: no reply within 20.0 s" in unknown.value.detail
        assert b.arm.lifecycle is Lifecycle.DISCONNECTED


@pytest.mark.parametrize("rounds", [0, 3, 12])
async def test_a_stop_before_the_arm_moves_prevents_the_move(rounds: int) -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = b.begin_move()
        for _ in range(rounds):
            await asyncio.sleep(0)
        await b.arm.request_stop()
        with pytest.raises((MotionStoppedError, NotReadyError)):
            await task
        assert b.point.pose.x_mm < HOME.x_mm + 5.0


async def test_a_stop_that_comes_too_late_finds_the_arm_at_its_target() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.point._length_mm = 0.0
        b.point.stop = lambda: None  # type: ignore[method-assign]
        b.point._start = TARGET
        b.controller._scan()
        await b.arm.request_stop()
        assert await task == TARGET
        assert b.arm.lifecycle is Lifecycle.INACTIVE


async def test_cancelling_a_move_stops_the_arm() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        await b.heard()
        stood = b.point.pose
        await b.arm.activate()
        await b.clock.sleep(3.0)
        assert b.point.pose == stood


async def test_deactivating_in_mid_move_stops_the_arm() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        await b.arm.deactivate()
        with pytest.raises(MotionStoppedError):
            await task


async def test_disconnecting_in_mid_move_aborts_it() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        assert "FRC_Abort" not in b.controller.server.received
        await b.arm.disconnect()
        await b.heard()
        received = b.controller.server.received
        assert "FRC_Abort" in received
        assert received[-1] == "FRC_Disconnect"
        with pytest.raises(OutcomeUnknownError):
            await task


async def test_nothing_is_sent_behind_the_goodbye_although_somebody_waits_for_his_turn() -> None:
    async with rmi_bench() as b:
        await b.ready()
        move = await b.begun_move()
        leaving = asyncio.create_task(b.arm.disconnect())
        stops = [asyncio.create_task(b.arm.request_stop()) for _ in range(3)]
        readings = [asyncio.create_task(b.arm.status()) for _ in range(3)]
        await leaving
        ends = await asyncio.gather(move, *stops, *readings, return_exceptions=True)
        assert all(end is None or isinstance(end, PortError | RobotStatus) for end in ends)
        await b.heard()
        assert b.controller.server.received[-1] == "FRC_Disconnect"
        assert b.controller.server.received.count("FRC_Disconnect") == 1


async def test_a_second_move_is_refused_while_one_is_under_way() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        with pytest.raises(NotReadyError) as refused:
            await b.arm.move_linear(HOME, SPEED_MM_S)
        assert refused.value.alarm is Alarm.ROBOT_BUSY
        assert await task == TARGET


async def test_a_session_lets_two_instructions_wait_and_no_third() -> None:
    async with rmi_bench() as b:
        await b.ready()
        waits = [b.arm._session.instruct("FRC_WaitTime", {"Time": 1.0}) for _ in range(2)]
        with pytest.raises(NotReadyError) as refused:
            b.arm._session.instruct("FRC_WaitTime", {"Time": 1.0})
        assert refused.value.alarm is Alarm.ROBOT_BUSY
        await b.arm.status()
        await b.clock.sleep(3.0)
        await b.arm.status()
        assert [wait.result().sequence for wait in waits] == [1, 2]


async def _ended(b: RmiBench, task: asyncio.Task[Xyzwpr], kind: type[PortError]) -> PortError:
    """Return how the move ended; whatever it was, it is not continued and not begun again."""
    with pytest.raises(kind) as ended:
        await task
    stood = b.point.pose
    assert b.arm.lifecycle is Lifecycle.INACTIVE
    await b.arm.reset_fault()
    await b.clock.sleep(5.0)
    assert b.point.pose == stood
    assert b.controller.motions_started <= 1
    assert (await b.arm.status()).fault is None
    await b.arm.activate()
    await b.clock.sleep(3.0)
    assert b.point.pose == stood
    assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET
    return ended.value


async def test_a_collision_is_a_named_fault_and_the_move_is_not_continued() -> None:
    async with rmi_bench() as b:
        await b.ready()
        b.point.collide_after_mm = 40.0
        error = await _ended(b, b.begin_move(), DeviceFaultError)
        assert error.alarm is Alarm.COLLISION
        assert "SRVO-050" in error.detail


async def test_an_emergency_stop_in_mid_move_is_a_named_fault_and_the_move_is_not_continued() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.point.stop()
        b.point.fault = "SRVO-001 Operator panel E-stop"
        with pytest.raises(DeviceFaultError) as fault:
            await task
        assert "SRVO-001" in fault.value.detail
        status = await b.arm.status()
        assert (status.fault, status.servo_on, status.moving) == ("SRVO-001", False, False)
        with pytest.raises(NotReadyError) as refused:
            await b.arm.activate()
        assert refused.value.alarm is Alarm.ROBOT_FAULT
        await _ended(b, task, DeviceFaultError)


async def test_servo_power_that_goes_without_an_alarm_ends_the_move() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.point.stop()
        b.point.servo_on = False
        with pytest.raises(DeviceFaultError, match="servo power is off"):
            await task
        b.point.servo_on = True


async def test_a_hold_on_the_pendant_ends_the_move_for_good() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.pause()
        error = await _ended(b, task, MotionStoppedError)
        assert "paused at the robot" in error.detail


async def test_the_pendant_is_enabled_in_mid_move() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.point.pendant_enabled = True
        b.point.mode = RobotMode.T1
        b.point.fault = "SYST-040 Operation mode T1 Selected"
        b.point.stop()
        with pytest.raises(DeviceFaultError, match="SYST-040"):
            await task
        status = await b.arm.status()
        assert (status.mode, status.pendant_enabled) == (RobotMode.UNKNOWN, True)
        with pytest.raises(NotReadyError) as refused:
            await b.arm.activate()
        assert refused.value.alarm is Alarm.MODE_NOT_AUTO


async def test_an_unreachable_target_moves_nothing_and_can_be_reset() -> None:
    async with rmi_bench() as b:
        await b.ready()
        far = asyncio.create_task(b.arm.move_linear(replace(TARGET, x_mm=2000.0), SPEED_MM_S))
        error = await _ended(b, far, CommandRejectedError)
        assert error.alarm is Alarm.TARGET_UNREACHABLE
        assert "MOTN-018" in error.detail


async def test_a_frame_that_the_program_does_not_have_moves_nothing() -> None:
    async with rmi_bench() as b:
        await b.ready()
        real = b.controller._begin_move

        def meanwhile_another_tool(name: str, packet: dict[str, Any]) -> None:
            b.controller.user_tool = 5
            real(name, packet)

        b.controller._begin_move = meanwhile_another_tool  # type: ignore[method-assign]
        with pytest.raises(CommandRejectedError) as rejected:
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        assert rejected.value.alarm is Alarm.FRAME_CHANGED
        assert "INTP-253" in rejected.value.detail


async def test_a_refused_instruction_holds_until_an_operator_resets() -> None:
    async with rmi_bench() as b:
        await b.ready()
        b.controller._next_sequence = 9
        with pytest.raises(CommandRejectedError) as rejected:
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        assert rejected.value.alarm is Alarm.ROBOT_FAULT
        assert "RMIT-029" in rejected.value.detail
        assert b.point.pose == HOME
        fault = (await b.arm.status()).fault
        assert fault is not None
        assert "RMIT-029" in fault
        with pytest.raises(NotReadyError):
            await b.arm.activate()
        await b.arm.reset_fault()
        await b.arm.activate()
        assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET
        assert b.controller.motions_started == 1


async def test_a_controller_in_ascii_mode_says_what_to_set() -> None:
    async with rmi_bench() as b:
        await b.ready()
        b.controller.ascii_mode = True
        with pytest.raises(CommandRejectedError, match=r"ASBN_ENB to FALSE"):
            await b.arm.move_linear(TARGET, SPEED_MM_S)


async def test_a_reset_that_does_not_help_says_so() -> None:
    async with rmi_bench(reset_timeout_s=1.0) as b:
        await b.arm.connect()
        b.point.fault = "SRVO-002 Teach pendant E-stop"
        assert (await b.arm.status()).fault == "SRVO-002"
        b.point.reset_fault = lambda: None  # type: ignore[method-assign]
        with pytest.raises(DeviceFaultError, match="SRVO-002"):
            await b.arm.reset_fault()


async def test_a_slow_reset_is_waited_for() -> None:
    async with rmi_bench() as b:
        await b.arm.connect()
        b.point.fault = "SRVO-002 Teach pendant E-stop"
        b.controller.reset_takes_s = 8.0
        await b.arm.reset_fault()
        assert (await b.arm.status()).fault is None


async def test_a_move_that_never_ends_is_unknown_and_stopped() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.point._speed_mm_s = 0.01
        with pytest.raises(OutcomeUnknownError) as unknown:
            await task
        assert "not finished after" in unknown.value.detail
        await b.heard()
        assert b.controller.motions_started == 1


async def test_a_move_that_ends_elsewhere_is_not_taken_for_done() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.point._length_mm = 60.0
        b.point._target = replace(TARGET, x_mm=560.0)
        with pytest.raises(DeviceFaultError) as fault:
            await task
        assert "40.000 mm" in fault.value.detail


@pytest.mark.parametrize(
    ("condition", "value", "alarm"),
    [
        ("pendant_enabled", True, Alarm.MODE_NOT_AUTO),
        ("servo_on", False, Alarm.ROBOT_NOT_READY),
        ("fault", "SRVO-001 Operator panel E-stop", Alarm.ROBOT_FAULT),
    ],
)
async def test_a_robot_that_is_not_ready_is_not_activated_and_not_moved(
    condition: str, value: object, alarm: Alarm
) -> None:
    async with rmi_bench() as b:
        await b.ready()
        await b.arm.deactivate()
        before = getattr(b.point, condition)
        setattr(b.point, condition, value)
        with pytest.raises(NotReadyError) as refused:
            await b.arm.activate()
        assert refused.value.alarm is alarm
        setattr(b.point, condition, before)
        await b.arm.reset_fault()
        await b.arm.activate()
        setattr(b.point, condition, value)
        with pytest.raises(NotReadyError) as refused:
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        assert refused.value.alarm is alarm
        assert b.controller.motions_started == 0


async def test_outputs_are_confirmed_and_read_back_where_the_controller_can() -> None:
    async with rmi_bench() as b:
        await b.arm.connect()
        await b.arm.write_output(5, on=True)
        assert b.point.outputs[5]
        assert await b.arm.read_output(5)
        with pytest.raises(CommandRejectedError) as rejected:
            await b.arm.write_output(600, on=True)
        assert rejected.value.alarm is Alarm.CONFIG_INVALID
        assert "DO[600]" in rejected.value.detail
        b.controller.has_io_port = False
        with pytest.raises(NotReadyError, match="cannot be read back"):
            await b.arm.read_output(5)
