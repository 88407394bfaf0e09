"""The fault table: what wire or robot do wrong, and the alarm that it ends in. Nothing is sent twice."""

import asyncio
import time

import pytest

from drivers.sim.modbus_server import WireFault
from srvs_cell.alarms import Alarm
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import (
    Lifecycle,
    MotionStoppedError,
    NotConnectedError,
    NotReadyError,
    OutcomeUnknownError,
    PortError,
)
from tests.drivers.fanuc.bench import HOME, TARGET, Bench, bench

_HARMLESS = {WireFault.NONE, WireFault.DUPLICATE}
_FAULTS = [fault for fault in WireFault if fault not in _HARMLESS]


async def _watchdog_stops(b: Bench) -> Xyzwpr:
    """Let the time of the robot's watchdog pass; return where the arm then stands for good."""
    await b.clock.sleep(2.5)
    assert not b.point.moving
    stood = b.point.pose
    await b.clock.sleep(5.0)
    assert b.point.pose == stood
    return stood


@pytest.mark.parametrize("fault", _FAULTS)
async def test_a_fault_of_the_wire_in_mid_move_leaves_the_outcome_unknown(fault: WireFault) -> None:
    async with bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.break_wire(fault)
        with pytest.raises(OutcomeUnknownError) as unknown:
            await task
        assert unknown.value.alarm is Alarm.MOTION_OUTCOME_UNKNOWN
        assert "After the command to move" in unknown.value.detail
        b.controller.server.fault = WireFault.NONE
        stood = await _watchdog_stops(b)
        assert stood != TARGET
        assert b.controller.motions_started == 1


async def test_answers_that_come_twice_are_told_apart_by_their_transaction() -> None:
    async with bench() as b:
        await b.ready()
        b.break_wire(WireFault.DUPLICATE)
        assert await b.arm.move_linear(TARGET, 100.0) == TARGET
        assert b.controller.motions_started == 1


@pytest.mark.parametrize("fault", [WireFault.HALF_PACKET, WireFault.CUT])
async def test_a_cut_is_noticed_without_waiting_for_the_time_out(fault: WireFault) -> None:
    """The wire's time-out is longer than this test may take."""
    async with bench(timeout_s=10.0) as b:
        await b.ready()
        task = await b.begun_move()
        begun_s = time.monotonic()
        b.controller.server.fault = fault
        with pytest.raises(OutcomeUnknownError) as unknown:
            await task
        assert "the connection was cut" in unknown.value.detail
        with pytest.raises(NotConnectedError):
            await asyncio.gather(*(b.arm.status() for _ in range(3)))
        assert time.monotonic() - begun_s < 9.0


@pytest.mark.parametrize("fault", [WireFault.SILENT, WireFault.HALF_PACKET, WireFault.CUT])
async def test_after_such_a_fault_the_robot_is_found_again_and_moves_only_on_a_new_command(fault: WireFault) -> None:
    async with bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.break_wire(fault)
        with pytest.raises(OutcomeUnknownError):
            await task
        b.controller.server.fault = WireFault.NONE
        stood = await _watchdog_stops(b)
        await b.arm.disconnect()
        await b.ready()
        await b.clock.sleep(3.0)
        assert b.point.pose == stood
        assert b.controller.motions_started == 1
        assert await b.arm.move_linear(HOME, 100.0) == HOME
        assert b.controller.motions_started == 2


@pytest.mark.parametrize("fault", _FAULTS)
async def test_a_fault_of_the_wire_before_the_command_moves_nothing(fault: WireFault) -> None:
    async with bench() as b:
        await b.ready()
        b.break_wire(fault)
        with pytest.raises(PortError) as error:
            await b.arm.move_linear(TARGET, 100.0)
        assert not isinstance(error.value, OutcomeUnknownError)
        assert error.value.alarm in {Alarm.CONNECTION_LOST, Alarm.CONNECTION_TIMEOUT, Alarm.PROTOCOL_ERROR}
        assert b.controller.motions_started == 0
        assert b.point.pose == HOME


async def test_silence_ends_in_disconnected_by_the_heartbeat() -> None:
    async with bench() as b:
        await b.ready()
        b.break_wire(WireFault.DEAF)
        with pytest.raises(NotConnectedError) as error:
            await b.arm.status()
        assert error.value.alarm is Alarm.CONNECTION_TIMEOUT
        await b.clock.sleep(1.0)
        assert b.arm.lifecycle is Lifecycle.DISCONNECTED
        with pytest.raises(NotConnectedError) as error:
            await b.arm.status()
        assert "given up" in error.value.detail
        assert "no usable answer within" in error.value.detail


async def test_a_frozen_robot_heartbeat_stops_the_move_and_is_named() -> None:
    async with bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.heartbeat_frozen = True
        with pytest.raises(MotionStoppedError) as stopped:
            await task
        assert stopped.value.alarm is Alarm.HEARTBEAT_LOST
        with pytest.raises(NotReadyError) as refused:
            await b.arm.move_linear(TARGET, 100.0)
        assert refused.value.alarm is Alarm.HEARTBEAT_LOST
        with pytest.raises(NotReadyError) as refused:
            await b.arm.activate()
        assert refused.value.alarm is Alarm.HEARTBEAT_LOST
        b.controller.heartbeat_frozen = False
        await b.arm.activate()
        await b.clock.sleep(3.0)
        assert not b.point.moving
        assert b.controller.motions_started == 1


async def test_a_robot_whose_program_does_not_heed_the_stop_is_unknown() -> None:
    async with bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.heartbeat_frozen = True
        b.point.stop = lambda: None  # type: ignore[method-assign]
        b.point._speed_mm_s = 0.01
        with pytest.raises(OutcomeUnknownError) as unknown:
            await task
        assert unknown.value.alarm is Alarm.HEARTBEAT_LOST


async def test_a_frozen_pc_heartbeat_makes_the_robot_stop_by_itself() -> None:
    async with bench() as b:
        await b.ready()
        task = await b.begun_move()
        heartbeat = b.arm._heartbeat
        assert heartbeat is not None
        heartbeat.cancel()
        b.point._speed_mm_s = 5.0  # long enough for the watchdog
        with pytest.raises(MotionStoppedError) as stopped:
            await task
        assert stopped.value.alarm is Alarm.HEARTBEAT_LOST
        assert "PC's heartbeat froze" in stopped.value.detail
        await _watchdog_stops(b)


async def test_a_reboot_in_mid_move_is_unknown_and_the_old_command_is_not_executed() -> None:
    async with bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.reboot()
        with pytest.raises(OutcomeUnknownError):
            await task
        stood = b.point.pose
        await b.clock.sleep(1.0)
        await b.arm.disconnect()
        await b.ready()
        await b.clock.sleep(5.0)
        assert b.point.pose == stood
        assert b.controller.motions_started == 1


async def test_somebody_else_who_writes_commands_is_noticed() -> None:
    async with bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.write_words(12030, [29])
        with pytest.raises(OutcomeUnknownError) as unknown:
            await task
        assert "somebody else" in unknown.value.detail


async def test_a_stale_command_is_rejected_by_its_checksum() -> None:
    """A sequence number without new parameters, as a torn or repeated write would leave it."""
    async with bench() as b:
        await b.ready()
        await b.arm.move_linear(TARGET, 100.0)
        b.controller.write_words(12030, [2])
        await b.clock.sleep(1.0)
        state = b.controller.read_words(12001, 3)
        assert state == [2, 3, 2]  # acknowledged, fault, checksum
        assert b.controller.motions_started == 1


async def test_outputs_are_confirmed_and_the_hold_output_is_the_drivers_own() -> None:
    async with bench() as b:
        await b.arm.connect()
        await b.arm.write_output(5, on=True)
        assert b.point.outputs[5]
        assert await b.arm.read_output(5)
        b.point.inputs[7] = True
        assert await b.arm.read_input(7)
        with pytest.raises(PortError):
            await b.arm.write_output(3, on=False)
        b.point.set_output = lambda n, on: None  # type: ignore[method-assign]  # noqa: ARG005 - a stuck output
        with pytest.raises(OutcomeUnknownError):
            await b.arm.write_output(5, on=False)
        b.break_wire(WireFault.SILENT)
        with pytest.raises(OutcomeUnknownError) as unknown:
            await b.arm.write_output(5, on=False)
        assert unknown.value.alarm is Alarm.CONNECTION_TIMEOUT
