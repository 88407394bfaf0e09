"""Whatever comes back over Modbus: the driver names it or takes it for what it says; it never crashes, hangs, moves."""

import asyncio
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from hypothesis import example, given, settings
from hypothesis import strategies as st

from drivers.fanuc import judgement, registers
from drivers.fanuc.modbus import FanucModbusArm, FanucModbusConfig
from drivers.fanuc.registers import PROTOCOL, WORD_COUNT
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import PortError, RobotStatus
from tests.drivers.stepped import SteppedClock, SteppedTime

HOME = Xyzwpr(500.0, 0.0, 400.0, 180.0, 0.0, 0.0)
WORD = st.integers(0, 0xFFFF) | st.sampled_from([0, 1, 2, 3, 0x7FFF, 0x8000, 0xFFFF])
WORDS = st.lists(WORD, min_size=WORD_COUNT, max_size=WORD_COUNT)
SEQUENCE_REGISTER = struct.pack(">BH", 16, registers.SEQUENCE_WORD - 1)


@given(st.sampled_from([PROTOCOL, 0, 4202]), WORDS, st.booleans())
@settings(max_examples=60)
def test_any_words_are_a_reading_or_another_protocol(protocol: int, words: list[int], hold: bool) -> None:
    words[0] = protocol
    try:
        snapshot = registers.decode(words)
    except PortError:
        assert protocol != PROTOCOL
        return
    refusal = judgement.refusal(snapshot)
    assert refusal is None or refusal.detail.isprintable()
    try:
        done = judgement.finished(snapshot, words[30], HOME, hold_requested=hold)
    except PortError as error:
        assert error.detail.isprintable()
    else:
        assert done == (snapshot.acknowledged == words[30])
    budget = judgement.MotionBudget.of(snapshot.pose, HOME, 100.0, 45.0, 3.0)
    assert budget.spend(1.0, snapshot.override_percent) == (budget.allowed_s >= budget.spent_s)
    assert 0.01 <= budget.spent_s <= 1.0


READING = struct.pack(">BB49H", 3, 98, PROTOCOL, *[0] * 48)
PDU = (
    st.binary(max_size=20)
    | st.just(READING)
    | st.builds(lambda cut: READING[:cut], st.integers(0, len(READING)))
    | st.builds(lambda count, rest: bytes([3, count]) + rest, st.integers(0, 255), st.binary(max_size=260))
    | st.builds(lambda function: bytes([function]), st.integers(0, 255))
)


@st.composite
def answers(draw: st.DrawFn) -> tuple[int | None, int, int | None, int, bytes]:
    """Another transaction than the one asked for (None: the right one), protocol, length (None: right), unit, PDU."""
    return (
        draw(st.none() | st.integers(0, 0xFFFF)),
        draw(st.sampled_from([0, 0, 0, 1, 0xFFFF])),
        draw(st.none() | st.sampled_from([0, 1, 2, 255, 260, 0xFFFF])),
        draw(st.sampled_from([1, 1, 1, 0, 255])),
        draw(PDU),
    )


class HostileServer:
    """Answers each request with what it was told, whole or in two pieces, and keeps what it was sent."""

    def __init__(self, script: list[Any], tail: bytes) -> None:
        self.received = b""
        self._script, self._tail = script, tail

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            for transaction, protocol, length, unit, pdu in self._script:
                header = await reader.readexactly(7)
                asked, _, size, _ = struct.unpack(">HHHB", header)
                self.received += header + await reader.readexactly(size - 1)
                size = len(pdu) + 1 if length is None else length
                number = asked if transaction is None else transaction
                packet = struct.pack(">HHHB", number, protocol, size, unit) + pdu
                for piece in (packet[:5], packet[5:]):
                    writer.write(piece)
                    await asyncio.sleep(0)
            writer.write(self._tail)
            await writer.drain()
            self.received += await reader.read()
        except (OSError, asyncio.IncompleteReadError):
            return
        finally:
            writer.close()


@asynccontextmanager
async def facing(script: list[Any], tail: bytes) -> AsyncIterator[tuple[FanucModbusArm, HostileServer]]:
    hostile = HostileServer(script, tail)
    server = await asyncio.start_server(hostile.serve, "127.0.0.1", 0)
    config = FanucModbusConfig(port=server.sockets[0].getsockname()[1], timeout_s=0.03)
    arm = FanucModbusArm(config, SteppedClock(SteppedTime()))
    try:
        yield arm, hostile
    finally:
        await arm.disconnect()
        server.close()


@given(st.lists(answers(), min_size=1, max_size=4), st.binary(max_size=300))
@example([(None, 0, None, 1, b"\x83")], b"")
@example([(None, 0, None, 1, b"\x03")], b"")
@example([(None, 0, 0xFFFF, 1, READING)], b"\x00" * 70_000)
@settings(max_examples=25)
def test_no_answer_crashes_or_hangs_the_driver_or_makes_it_command_a_move(script: list[Any], tail: bytes) -> None:
    async def run() -> None:
        async with asyncio.timeout(20.0), facing(script, tail) as (arm, hostile):
            try:
                await arm.connect()
                assert isinstance(await arm.status(), RobotStatus)
                await arm.activate()
                await arm.move_linear(Xyzwpr(501.0, 0.0, 400.0, 180.0, 0.0, 0.0), 10.0)
            except PortError as error:
                assert error.detail
            await arm.disconnect()
            assert SEQUENCE_REGISTER not in hostile.received

    asyncio.run(run())
