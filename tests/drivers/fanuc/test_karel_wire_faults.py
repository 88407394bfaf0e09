"""The fault table of the KAREL wire, over both carriers: what goes wrong, what is known; nothing moves twice."""

import asyncio
import contextlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.fanuc.karel.lines import Reply
from drivers.sim.karel_server import KarelFault
from srvs_cell.alarms import Alarm
from srvs_cell.ports import (
    Lifecycle,
    MotionStoppedError,
    NotConnectedError,
    NotReadyError,
    OutcomeUnknownError,
    PortError,
)
from tests.drivers.fanuc.bench import HOME, PATIENT_S, SPEED_MM_S, TARGET
from tests.drivers.fanuc.karel_bench import CARRIERS, KarelBench, karel_bench

HASTY_S = 0.06
"""A wire time-out that a test waits for."""

DAMAGED = [KarelFault.NONSENSE, KarelFault.WRONG_CHECKSUM, KarelFault.GARBLED, KarelFault.SILENT, KarelFault.DEAF]
LASTING = [
    *(("tcp", fault) for fault in (*DAMAGED, KarelFault.HALF_LINE, KarelFault.WRONG_SEQUENCE, KarelFault.CUT)),
    *(("serial", fault) for fault in (KarelFault.SILENT, KarelFault.GARBLED_COMMAND)),
]
NOISE = [
    *(("tcp", fault) for fault in (*DAMAGED[:-1], KarelFault.DUPLICATE, KarelFault.BYTE_BY_BYTE)),
    ("serial", KarelFault.GARBLED),
]


def _break(b: KarelBench, fault: KarelFault, at: str | None = None) -> None:
    """Let the wire go wrong from now on; nobody waits long for what will not come."""
    b.controller.wire.fault, b.controller.wire.fault_at = fault, at
    b.arm._session._timeout_s = HASTY_S


def _break_once(b: KarelBench, fault: KarelFault, at: str) -> None:
    """Let the wire go wrong at the next command of a name; only that one is not waited for long."""
    wire, session = b.controller.wire, b.arm._session
    wire.fault, wire.fault_at, wire.count = fault, at, 1
    exchange = session._exchange

    async def once(name: str, values: tuple[int, ...], timeout_s: float) -> Reply:
        if name != at:
            return await exchange(name, values, timeout_s)
        session._exchange = exchange  # type: ignore[method-assign]
        return await exchange(name, values, HASTY_S)

    session._exchange = once  # type: ignore[method-assign]


def _moves(b: KarelBench) -> int:
    return b.controller.wire.received.count("MOVL")


async def _found_again(b: KarelBench) -> None:
    """After the fault the robot is connected afresh, does nothing by itself, and moves on a new command."""
    b.controller.wire.fault, b.controller.wire.fault_at = KarelFault.NONE, None
    await b.clock.sleep(10.0)
    stood, moves = b.point.pose, _moves(b)
    await b.arm.disconnect()
    b.arm._session._timeout_s = PATIENT_S
    await b.ready()
    await b.clock.sleep(3.0)
    assert b.point.pose == stood
    assert _moves(b) == moves
    assert await b.arm.move_linear(HOME, 100.0) == HOME
    assert _moves(b) == moves + 1


@pytest.mark.parametrize(("carrier", "fault"), LASTING)
async def test_a_fault_that_lasts_in_mid_move_leaves_the_outcome_unknown(carrier: str, fault: KarelFault) -> None:
    async with karel_bench(carrier) as b:
        await b.ready()
        task = await b.begun_move()
        _break(b, fault)
        with pytest.raises(OutcomeUnknownError) as unknown:
            await task
        assert unknown.value.alarm is Alarm.MOTION_OUTCOME_UNKNOWN
        assert "After the command to move" in unknown.value.detail
        assert b.arm.lifecycle is Lifecycle.DISCONNECTED
        assert b.controller.motions_started == _moves(b) == 1
        with pytest.raises(NotConnectedError):
            await b.arm.status()
        await _found_again(b)
        assert b.controller.motions_started == 2


@pytest.mark.parametrize(("carrier", "fault"), LASTING)
async def test_a_fault_that_lasts_before_the_command_moves_nothing(carrier: str, fault: KarelFault) -> None:
    async with karel_bench(carrier) as b:
        await b.ready()
        _break(b, fault)
        with pytest.raises(PortError) as error:
            await b.arm.move_linear(TARGET, 100.0)
        assert not isinstance(error.value, OutcomeUnknownError)
        assert error.value.alarm in {Alarm.CONNECTION_LOST, Alarm.CONNECTION_TIMEOUT, Alarm.PROTOCOL_ERROR}
        assert b.controller.motions_started == _moves(b) == 0
        assert b.point.pose == HOME


@pytest.mark.parametrize(("carrier", "fault"), NOISE)
async def test_noise_in_a_reading_is_asked_away_and_the_move_arrives(carrier: str, fault: KarelFault) -> None:
    async with karel_bench(carrier) as b:
        await b.ready()
        task = await b.begun_move()
        for _ in range(3):
            _break_once(b, fault, "STAT")
            await b.clock.sleep(0.3)
        assert await task == TARGET
        assert b.controller.motions_started == _moves(b) == 1


@pytest.mark.parametrize(
    ("carrier", "fault"), [*(("tcp", fault) for fault in DAMAGED[:-1]), ("serial", KarelFault.SILENT)]
)
async def test_a_lost_answer_to_a_move_is_asked_for_by_number(carrier: str, fault: KarelFault) -> None:
    async with karel_bench(carrier) as b:
        await b.ready()
        _break_once(b, fault, "MOVL")
        assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET
        assert b.controller.motions_started == _moves(b) == 1


@pytest.mark.parametrize(("carrier", "fault"), [("tcp", KarelFault.DEAF), ("serial", KarelFault.GARBLED_COMMAND)])
async def test_a_move_that_is_lost_on_the_way_is_known_not_to_have_begun(carrier: str, fault: KarelFault) -> None:
    async with karel_bench(carrier) as b:
        await b.ready()
        _break_once(b, fault, "MOVL")
        with pytest.raises(NotReadyError, match="has not taken the move"):
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        await b.clock.sleep(5.0)
        assert b.controller.motions_started == 0
        assert b.point.pose == HOME
        assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET
        assert _moves(b) == 2


@pytest.mark.parametrize("fault", [KarelFault.SILENT, KarelFault.CUT])
async def test_a_wire_that_dies_with_the_move_leaves_it_unknown(fault: KarelFault) -> None:
    async with karel_bench() as b:
        await b.ready()
        exchange = b.arm._session.move

        async def dies(name: str, *values: int) -> Reply:
            _break(b, fault)
            return await exchange(name, *values)

        b.arm._session.move = dies  # type: ignore[method-assign]
        with pytest.raises(OutcomeUnknownError):
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        assert b.controller.motions_started <= 1 == _moves(b)


@pytest.mark.parametrize("carrier", CARRIERS)
async def test_a_cable_cut_in_mid_move_lets_the_robots_watchdog_end_it(carrier: str) -> None:
    async with karel_bench(carrier) as b:
        await b.ready()
        task = await b.begun_move()
        _break(b, KarelFault.DEAF)
        with pytest.raises(OutcomeUnknownError):
            await task
        await b.clock.sleep(3.0)
        assert not b.point.moving
        assert b.point.pose.x_mm < TARGET.x_mm
        await _found_again(b)


async def test_a_pc_that_stands_still_finds_its_move_stopped_by_the_watchdog() -> None:
    async with karel_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.time.advance_to(b.time.now_s() + 2.5)
        with pytest.raises(MotionStoppedError) as error:
            await task
        assert error.value.alarm is Alarm.HEARTBEAT_LOST
        with pytest.raises(NotReadyError):
            await b.arm.move_linear(HOME, SPEED_MM_S)
        await b.arm.activate()
        assert await b.arm.move_linear(HOME, 100.0) == HOME


@pytest.mark.parametrize("carrier", CARRIERS)
async def test_a_robot_whose_program_stands_still_is_lost_within_its_time(carrier: str) -> None:
    async with karel_bench(carrier) as b:
        await b.arm.connect()
        b.arm._session._timeout_s = HASTY_S
        b.controller.frozen = True
        await b.clock.sleep(1.0)
        assert b.arm.lifecycle is Lifecycle.DISCONNECTED
        with pytest.raises(NotConnectedError, match="given up") as error:
            await b.arm.status()
        assert error.value.alarm is Alarm.CONNECTION_TIMEOUT
        b.controller.frozen = False


@pytest.mark.parametrize("carrier", CARRIERS)
async def test_a_reboot_in_mid_move_is_unknown_and_nothing_is_continued(carrier: str) -> None:
    async with karel_bench(carrier) as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.reboot()
        with pytest.raises(OutcomeUnknownError) as error:
            await task
        assert ("started anew" if carrier == "serial" else "was cut") in error.value.detail
        assert b.arm.lifecycle is Lifecycle.DISCONNECTED
        await _found_again(b)


async def test_a_stop_overtakes_a_command_that_waits_for_its_answer() -> None:
    async with karel_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.wire.fault, b.controller.wire.fault_at, b.controller.wire.count = KarelFault.SILENT, "RDIN", 1
        reading = asyncio.create_task(b.arm.read_input(1))
        while "RDIN" not in b.controller.wire.received:  # noqa: ASYNC110 - a thread has no asyncio event
            await asyncio.sleep(0)
        await b.arm.request_stop()
        assert not b.point.moving
        reading.cancel()
        with pytest.raises(MotionStoppedError):
            await task


@pytest.mark.parametrize("fault", DAMAGED)
async def test_a_stop_whose_answer_is_lost_is_sent_again(fault: KarelFault) -> None:
    async with karel_bench() as b:
        await b.ready()
        task = await b.begun_move()
        _break_once(b, fault, "STOP")
        await b.arm.request_stop()
        with pytest.raises(MotionStoppedError):
            await task
        assert b.controller.wire.received.count("STOP") == 2


async def test_a_controller_that_does_not_abort_its_program_is_unknown() -> None:
    async with karel_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.robot.abort_task = lambda *_, **__: 1  # type: ignore[method-assign]
        with pytest.raises(PortError, match="code 17"):
            await b.arm.request_stop()
        with pytest.raises(OutcomeUnknownError):
            await task


@pytest.mark.parametrize("fault", DAMAGED)
async def test_an_output_whose_write_is_not_answered_is_unknown_and_not_written_again(fault: KarelFault) -> None:
    async with karel_bench() as b:
        await b.ready()
        _break_once(b, fault, "WDOU")
        with pytest.raises(OutcomeUnknownError):
            await b.arm.write_output(5, on=True)
        assert b.controller.wire.received.count("WDOU") == 1
        assert b.arm.lifecycle is Lifecycle.ACTIVE


async def test_the_end_of_the_robots_program_leaves_the_arm_on_its_way_and_the_outcome_unknown() -> None:
    async with karel_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.task.stop()
        b.arm._session._timeout_s = HASTY_S
        with pytest.raises(OutcomeUnknownError):
            await task
        await b.clock.sleep(6.0)
        assert b.point.pose == TARGET


async def test_sequence_numbers_go_round() -> None:
    async with karel_bench() as b:
        await b.ready()
        b.arm._session._sequence = 29_999
        await b.arm.status()
        assert await b.arm.move_linear(TARGET, 100.0) == TARGET
        b.arm._session._sequence = b.arm._session._last_move - 1
        b.arm._session._done_with.clear()
        await b.arm.status()
        assert b.arm._session._sequence == b.arm._session._last_move + 1


@given(st.lists(st.binary(max_size=40), min_size=1, max_size=3))
@settings(max_examples=6)
def test_no_garbage_from_the_wire_moves_the_arm_or_hangs_the_driver(pieces: list[bytes]) -> None:
    async def run() -> None:
        async with karel_bench() as b:
            await b.ready()
            b.arm._session._timeout_s = HASTY_S
            for piece in pieces:
                b.controller.wire.send_raw(piece)
            with contextlib.suppress(PortError):
                assert (await b.arm.status()).pose == HOME
            await b.arm.disconnect()
            assert b.controller.motions_started == 0
            assert b.point.pose == HOME

    asyncio.run(run())
