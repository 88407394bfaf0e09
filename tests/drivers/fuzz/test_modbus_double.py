"""Any bytes to the Modbus double: it answers by the protocol or hangs up, goes on serving, and moves nothing."""

import contextlib
import socket
import struct
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from drivers.sim.modbus_controller import ModbusController
from tests.drivers.stepped import PointArm, SteppedTime

HELLO = struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 12000, 1)
MAGIC = struct.pack(">HHHBBBH", 1, 0, 5, 1, 3, 2, 4201)
FUNCTIONS = st.sampled_from([1, 2, 3, 4, 5, 6, 15, 16, 22, 23, 43, 0, 127, 128, 255])


@st.composite
def requests(draw: st.DrawFn) -> bytes:
    """A request whose header is right and whose rest is anything."""
    pdu = bytes([draw(FUNCTIONS)]) + draw(st.binary(max_size=40))
    length = draw(st.sampled_from([len(pdu) + 1] * 3 + [0, 1, 2, 0xFFFF]))
    return struct.pack(">HHHB", draw(st.integers(0, 0xFFFF)), draw(st.sampled_from([0, 0, 0, 1])), length, 1) + pdu


@pytest.fixture
def double() -> Iterator[tuple[ModbusController, int]]:
    time = SteppedTime()
    controller = ModbusController(PointArm(time), time)
    try:
        yield controller, controller.start()
    finally:
        time.release()
        controller.close()


def ask(port: int, data: bytes) -> bytes:
    """Send, hang up, return all that came until the double did so, too."""
    received = b""
    with socket.create_connection(("127.0.0.1", port), 10.0) as connection, contextlib.suppress(ConnectionError):
        connection.sendall(data)
        with contextlib.suppress(OSError):  # it has hung up already
            connection.shutdown(socket.SHUT_WR)
        while piece := connection.recv(4096):
            received += piece
    return received


@given(data=st.lists(requests() | st.binary(max_size=30), max_size=5).map(b"".join))
@example(data=struct.pack(">HHHBBHHB", 1, 0, 7, 1, 15, 0, 8, 1))  # coils announced, none sent
@example(data=struct.pack(">HHHBBHHBH", 1, 0, 9, 1, 16, 0, 2, 4, 7))  # words announced, half sent
@example(data=struct.pack(">HHHBBHH", 1, 0, 6, 1, 5, 2, 7))  # a coil that is neither on nor off
@example(data=b"\x00" * 100_000)
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_the_double_survives(double: tuple[ModbusController, int], data: bytes) -> None:
    controller, port = double
    received = ask(port, data)
    while received:  # what it has answered are whole Modbus packets
        _, protocol, length, unit = struct.unpack(">HHHB", received[:7])
        assert (protocol, unit) == (0, 1)
        assert len(received) >= 6 + length >= 8
        received = received[6 + length :]
    assert ask(port, HELLO) == MAGIC
    assert controller.motions_started == 0


@pytest.mark.parametrize(
    "pdu",
    [
        struct.pack(">BHHB", 15, 0, 8, 1),  # 8 coils, no byte of them
        struct.pack(">BHHBB", 15, 0, 8, 2, 0),  # 1 byte, said to be 2
        struct.pack(">BHHBH", 16, 0, 2, 4, 7),  # 2 words, one sent
        struct.pack(">BHHBHH", 16, 0, 2, 2, 7, 7),  # 2 words, said to be 2 bytes
        struct.pack(">BHHBH", 16, 0, 124, 248, 7),  # more than one request may write
        struct.pack(">BHH", 5, 0, 7),  # neither 0x0000 nor 0xFF00
        struct.pack(">BH", 3, 0),
        struct.pack(">BHHB", 3, 0, 1, 0),  # a byte too many
    ],
)
def test_what_contradicts_itself_is_an_illegal_value_and_writes_nothing(
    double: tuple[ModbusController, int], pdu: bytes
) -> None:
    _, port = double
    before = ask(port, struct.pack(">HHHBBHH", 1, 0, 6, 1, 1, 0, 8))
    answer = ask(port, struct.pack(">HHHB", 9, 0, len(pdu) + 1, 1) + pdu)
    assert answer == struct.pack(">HHHBBB", 9, 0, 3, 1, pdu[0] | 0x80, 3)
    assert ask(port, struct.pack(">HHHBBHH", 1, 0, 6, 1, 1, 0, 8)) == before


@pytest.mark.parametrize(
    "pdu",
    [
        struct.pack(">BHH", 3, 16380, 5),  # one word more than there are
        struct.pack(">BHH", 3, 65535, 2),
        struct.pack(">BHH", 6, 16384, 7),
        struct.pack(">BHHBH", 16, 16384, 1, 2, 7),
        struct.pack(">BHH", 1, 505, 8),
        struct.pack(">BHH", 2, 512, 1),
        struct.pack(">BHH", 5, 512, 0xFF00),
        struct.pack(">BHHBB", 15, 508, 8, 1, 255),
    ],
)
def test_what_is_beyond_the_last_one_is_an_illegal_address(double: tuple[ModbusController, int], pdu: bytes) -> None:
    _, port = double
    answer = ask(port, struct.pack(">HHHB", 9, 0, len(pdu) + 1, 1) + pdu)
    assert answer == struct.pack(">HHHBBB", 9, 0, 3, 1, pdu[0] | 0x80, 2)
    last = struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 16383, 1)
    assert ask(port, last) == struct.pack(">HHHBBBH", 1, 0, 5, 1, 3, 2, 0)
