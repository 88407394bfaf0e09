"""Any lines from an RMI controller: they are packets or are named; memory is bounded, nothing moves or crashes."""

import asyncio
import contextlib
import json
import sys

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drivers.fanuc.rmi import framing, messages
from drivers.fanuc.rmi.framing import LINE_LIMIT, LineBuffer
from srvs_cell.ports import PortError
from tests.drivers.fanuc.bench import HOME, TARGET
from tests.drivers.fanuc.rmi_bench import rmi_bench

NUMBERS = st.integers() | st.floats() | st.sampled_from([0, 1, -1, 2**31, 10**400, float("nan"), float("inf")])
VALUES = st.recursive(
    st.none() | st.booleans() | NUMBERS | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)
KEYS = st.sampled_from([
    "ErrorID", "SequenceID", "ServoReady", "TPMode", "RMIMotionStatus", "ProgramStatus", "SingleStepMode", "Override",
    "NextSequenceID", "Position", "Configuration", "ErrorData", "PortValue", "X", "UToolNumber",
])  # fmt: skip
KINDS = st.sampled_from(["Command", "Communication", "Instruction", "command", "Kommando", ""])
NAMES = st.sampled_from([
    "FRC_GetStatus", "FRC_ReadCartesianPosition", "FRC_LinearMotion", "FRC_Abort", "FRC_Terminate", "FRC_SystemFault",
    "FRC_Disconnect", "Unknown",
])  # fmt: skip
PACKETS = st.builds(
    lambda kind, name, fields: {kind: name, **fields},
    KINDS,
    NAMES | VALUES,
    st.dictionaries(KEYS | st.text(max_size=6), VALUES, max_size=8),
)
READERS = (messages.read_status, messages.read_place, messages.read_errors)


def as_line(packet: object) -> bytes:
    """Write JSON as loosely as a controller might: NaN and huge numbers stay in it."""
    limit = sys.get_int_max_str_digits()
    sys.set_int_max_str_digits(0)
    try:
        return json.dumps(packet).encode()
    finally:
        sys.set_int_max_str_digits(limit)


def read(line: bytes) -> None:
    """Read a line as every reader would; only what a person can read may come of it."""
    try:
        packet = messages.decode(line)
    except PortError as error:
        assert error.detail.isprintable()
        return
    for reader in READERS:
        try:
            found = reader(packet)
        except PortError as error:
            assert error.detail.isprintable()
        else:
            assert found is None or not isinstance(found, str) or (found.isascii() and found.isprintable())


@given(PACKETS)
@example({"Command": "FRC_ReadError", "ErrorID": 0, "ErrorData": "\ud800\x00\x1b[31m SRVO-001"})
@example({"Command": "\ud800", "ErrorID": 0})
@example({"Command": "FRC_GetStatus", "ErrorID": 10**400})
@settings(max_examples=100)
def test_any_packet_is_read_or_named(packet: object) -> None:
    read(as_line(packet))


@given(st.binary(max_size=200))
@settings(max_examples=80)
def test_any_line_is_read_or_named(line: bytes) -> None:
    read(line)


@pytest.mark.parametrize("depth", [100, 300, 900, 950, 990, 1000, 1500, 4000])
@pytest.mark.parametrize("key", ["ServoReady", "Position", "ErrorData", "ErrorID"])
def test_a_packet_nested_however_deeply_is_named(depth: int, key: str) -> None:
    for opened, closed in ((b"[", b"]"), (b'{"a":', b"}")):
        nested = opened * depth + b"1" + closed * depth
        read(b'{"Command":"FRC_GetStatus","%s":%s}' % (key.encode(), nested))


@given(st.lists(st.binary(max_size=60), max_size=12))
@settings(max_examples=100)
def test_lines_are_the_same_however_their_bytes_are_cut(pieces: list[bytes]) -> None:
    data = b"".join(pieces)
    whole, cut, single = LineBuffer(), LineBuffer(), LineBuffer()
    lines = whole.feed(data)
    assert [line for piece in pieces for line in cut.feed(piece)] == lines
    assert [line for i in range(len(data)) for line in single.feed(data[i : i + 1])] == lines
    assert framing.END.join(lines).count(b"\n") == max(0, len(lines) - 1)


def test_bytes_without_an_end_take_a_bounded_memory() -> None:
    buffer = LineBuffer()
    for _ in range(LINE_LIMIT // 64):
        assert buffer.feed(b"x" * 64) == []
    with pytest.raises(PortError, match="this is not RMI"):
        buffer.feed(b"x")


@given(st.lists(PACKETS, min_size=1, max_size=3), st.booleans())
@example([{"Instruction": "FRC_LinearMotion", "SequenceID": 1, "ErrorID": float("nan")}], True)
@example([{"Instruction": "FRC_LinearMotion", "SequenceID": 1, "ErrorID": 10**30}], True)
@settings(max_examples=15)
def test_no_packet_begins_a_move_or_repeats_one(packets: list[object], moving: bool) -> None:
    async def run() -> None:
        async with asyncio.timeout(30.0), rmi_bench() as b:
            await b.ready()
            task = await b.begun_move() if moving else None
            for packet in packets:
                b.controller.server.send_raw(as_line(packet) + b"\r\n")
            with contextlib.suppress(PortError):
                await b.arm.status()
            if task is not None:
                with contextlib.suppress(PortError):
                    assert await task == TARGET
            await b.arm.disconnect()
            await b.heard()
            assert b.controller.motions_started == int(moving)
            assert moving or b.point.pose == HOME

    asyncio.run(run())
