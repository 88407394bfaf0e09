"""The fault table of the RMI wire: what goes wrong, the alarm that it ends in; nothing is sent twice."""

import asyncio
import contextlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.sim.rmi_server import RmiFault
from srvs_cell.alarms import Alarm
from srvs_cell.ports import Lifecycle, NotConnectedError, NotReadyError, OutcomeUnknownError, PortError
from tests.drivers.fanuc.bench import HOME, PATIENT_S, SPEED_MM_S, TARGET
from tests.drivers.fanuc.rmi_bench import RmiBench, rmi_bench

ALLOWED = {RmiFault.NONE, RmiFault.BYTE_BY_BYTE}
FAULTS = [fault for fault in RmiFault if fault not in ALLOWED]
IN_COMMANDS = [fault for fault in FAULTS if fault is not RmiFault.WRONG_SEQUENCE]
AT_THE_END = [fault for fault in FAULTS if fault not in {RmiFault.SILENT, RmiFault.DEAF}]
HASTY_S = 0.15
"""A wire time-out that a test waits for."""


def _break(b: RmiBench, fault: RmiFault, at: str | None = None) -> None:
    """Let the wire go wrong; only where a time-out is what ends it, it is short."""
    b.controller.server.fault, b.controller.server.fault_at = fault, at
    if fault in {RmiFault.SILENT, RmiFault.DEAF}:
        b.arm._session._timeout_s = HASTY_S


def _moves(b: RmiBench) -> int:
    return b.controller.server.received.count("FRC_LinearMotion")


async def _two_readings(b: RmiBench) -> None:
    """What comes unasked may come just after the first one's reply."""
    await b.arm.status()
    await b.arm.status()


async def _found_again(b: RmiBench, moves: int) -> None:
    """After the fault the robot is connected afresh, does nothing by itself, and moves on a new command."""
    b.controller.server.fault = RmiFault.NONE
    b.arm._session._timeout_s = PATIENT_S
    await b.clock.sleep(10.0)
    stood = b.point.pose
    await b.arm.disconnect()
    await b.ready()
    await b.clock.sleep(3.0)
    assert b.point.pose == stood
    assert _moves(b) == moves
    assert await b.arm.move_linear(HOME, 100.0) == HOME
    assert _moves(b) == moves + 1


@pytest.mark.parametrize("fault", IN_COMMANDS)
async def test_a_fault_of_the_wire_in_mid_move_leaves_the_outcome_unknown(fault: RmiFault) -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        _break(b, fault)
        with pytest.raises(OutcomeUnknownError) as unknown:
            await task
        assert unknown.value.alarm is Alarm.MOTION_OUTCOME_UNKNOWN
        assert "After the command to move" in unknown.value.detail
        assert b.arm.lifecycle is Lifecycle.DISCONNECTED
        await _found_again(b, 1)


@pytest.mark.parametrize("fault", AT_THE_END)
async def test_a_fault_of_the_wire_in_the_reply_to_the_move_leaves_the_outcome_unknown(fault: RmiFault) -> None:
    async with rmi_bench() as b:
        await b.ready()
        _break(b, fault, "FRC_LinearMotion")
        with pytest.raises(OutcomeUnknownError):
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        assert b.arm.lifecycle is Lifecycle.DISCONNECTED
        await _found_again(b, 1)


async def test_a_reply_to_a_move_that_never_comes_leaves_the_outcome_unknown() -> None:
    async with rmi_bench() as b:
        await b.ready()
        b.controller.server.fault, b.controller.server.fault_at = RmiFault.SILENT, "FRC_LinearMotion"
        with pytest.raises(OutcomeUnknownError, match="not finished after"):
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        await _found_again(b, 1)


@pytest.mark.parametrize("fault", IN_COMMANDS)
async def test_a_fault_of_the_wire_before_the_command_moves_nothing(fault: RmiFault) -> None:
    async with rmi_bench() as b:
        await b.ready()
        _break(b, fault)
        with pytest.raises(PortError) as error:
            await b.arm.move_linear(TARGET, 100.0)
        if fault is not RmiFault.DUPLICATE:  # a duplicate is noticed with the next reply, or before
            assert not isinstance(error.value, OutcomeUnknownError)
            assert error.value.alarm in {Alarm.CONNECTION_LOST, Alarm.CONNECTION_TIMEOUT, Alarm.PROTOCOL_ERROR}
            assert b.controller.motions_started == 0
            assert b.point.pose == HOME
        await _found_again(b, _moves(b))


async def test_bytes_that_come_one_by_one_are_no_fault() -> None:
    async with rmi_bench() as b:
        b.controller.server.fault = RmiFault.BYTE_BY_BYTE
        await b.ready()
        assert await b.arm.move_linear(TARGET, 100.0) == TARGET


async def test_an_answer_to_an_aborted_instruction_is_let_pass_once() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        await b.arm.request_stop()
        with pytest.raises(PortError):
            await task
        late = {"Instruction": "FRC_LinearMotion", "ErrorID": 2556943, "SequenceID": 1}
        b.controller.server.send(late)
        await b.arm.status()
        b.controller.server.send(late)
        with pytest.raises(PortError) as error:
            await _two_readings(b)
        assert error.value.alarm is Alarm.PROTOCOL_ERROR
        assert "answers nothing that was asked" in error.value.detail


async def test_an_instruction_that_the_controller_could_not_read_is_matched_by_its_number() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.point.stop()
        b.controller._current = None
        b.controller.server.send({"Instruction": "Unknown", "SequenceID": 1, "ErrorID": 2556950})
        with pytest.raises(PortError, match="RMIT-022"):
            await task


@pytest.mark.parametrize(
    "notice",
    [
        {"Command": "FRC_Record", "PositionID": 3, "Representation": "Cartesian"},
        {"Communication": "FRC_SomethingNew", "Value": 1},
    ],
)
async def test_a_notice_that_asks_for_nothing_is_let_pass(notice: dict[str, object]) -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.server.send(notice)
        assert await task == TARGET


async def test_a_controller_that_turns_to_ascii_mode_ends_the_session_with_the_reason() -> None:
    async with rmi_bench() as b:
        await b.arm.connect()
        b.controller.server.send({"Communication": "FRC_AsbnReady"})
        with pytest.raises(PortError, match="ASBN_ENB"):
            await _two_readings(b)


async def test_a_cut_cable_in_mid_move_is_unknown_because_the_arm_goes_on() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.server.cut()
        with pytest.raises(OutcomeUnknownError) as unknown:
            await task
        assert "the connection was cut" in unknown.value.detail
        with pytest.raises(NotConnectedError, match="given up"):
            await b.arm.status()
        await b.clock.sleep(10.0)
        assert b.point.pose == TARGET
        await _found_again(b, 1)


async def test_a_reboot_in_mid_move_is_unknown_and_nothing_is_continued() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.reboot()
        with pytest.raises(OutcomeUnknownError):
            await task
        await _found_again(b, 1)


async def test_a_program_aborted_on_the_pendant_before_a_move_is_noticed() -> None:
    async with rmi_bench() as b:
        await b.ready()
        b.controller._end_program()
        with pytest.raises(PortError, match="RMIT-009"):
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        assert b.controller.motions_started == 0
        await b.arm.activate()
        assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET


async def test_an_output_whose_write_is_not_answered_is_unknown() -> None:
    async with rmi_bench() as b:
        await b.ready()
        _break(b, RmiFault.SILENT, "FRC_WriteDOUT")
        with pytest.raises(OutcomeUnknownError) as unknown:
            await b.arm.write_output(5, on=True)
        assert unknown.value.alarm is Alarm.CONNECTION_TIMEOUT
        assert b.controller.server.received.count("FRC_WriteDOUT") == 1


async def test_garbage_is_answered_with_an_abort_and_goodbye() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.server.send_raw(b"\x00\xff garbage\r\n")
        with pytest.raises(OutcomeUnknownError):
            await task
        await b.heard()
        assert b.controller.server.received[-2:] == ["FRC_Abort", "FRC_Disconnect"]


@given(st.lists(st.binary(max_size=64), min_size=1, max_size=4))
@settings(max_examples=30)
def test_no_garbage_makes_the_arm_move_or_the_driver_hang(pieces: list[bytes]) -> None:
    async def run() -> None:
        async with rmi_bench() as b:
            await b.ready()
            for piece in pieces:
                b.controller.server.send_raw(piece)
            b.controller.server.send_raw(b"\r\n")
            with contextlib.suppress(PortError):
                assert (await b.arm.status()).pose == HOME
            await b.arm.disconnect()
            assert b.controller.motions_started == 0
            assert b.point.pose == HOME

    asyncio.run(run())


async def test_a_robot_whose_stop_is_refused_is_unknown() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller._begin_lengthy = lambda name: b.controller._answer(name, 2556943)  # type: ignore[method-assign]
        await b.arm.request_stop()
        with pytest.raises(OutcomeUnknownError, match="RMIT-015"):
            await task
        with pytest.raises(NotReadyError):
            await b.arm.move_linear(TARGET, SPEED_MM_S)
