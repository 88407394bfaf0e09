"""Any request to the gripper double: answered by the protocol, and only a whole write inside its words is a command."""

import struct

from hypothesis import example, given
from hypothesis import strategies as st

from drivers.sim.robotiq_double import RobotiqDouble
from drivers.sim.robotiq_fingers import ScriptedFingers
from drivers.sim.rtu_line import LineFault, checksum

STATUS = bytes([4]) + struct.pack(">HH", 0x07D0, 3)
FUNCTIONS = st.sampled_from([3, 4, 16, 23]) | st.integers(0, 127)
EXCEPTIONS = {1, 2, 3}


def _double() -> RobotiqDouble:
    return RobotiqDouble(ScriptedFingers(lambda: 0.0), lambda: 0.0)


def _ask(double: RobotiqDouble, pdu: bytes) -> bytes:
    """Hand a whole frame to the wire's end; return the answer's PDU."""
    sent: list[bytes] = []

    def send(frame: bytes, fault: LineFault) -> None:
        del fault
        sent.append(frame)

    double.line._send = send  # type: ignore[method-assign]
    frame = bytes([9]) + pdu
    double.line._take(frame + checksum(frame), b"")
    (answer,) = sent
    assert checksum(answer[:-2]) == answer[-2:]
    return answer[1:-2]


@given(FUNCTIONS, st.binary(max_size=24))
@example(16, struct.pack(">HHB", 0x03E8, 1, 2))  # words announced, none sent
@example(16, struct.pack(">HHBH", 0x03E8, 0xFFFF, 2, 0))
@example(23, struct.pack(">HHHHBH", 0x0800, 1, 0x03E8, 1, 2, 0x0900))  # what is to be read is not there
@example(3, b"")
def test_any_request_is_answered_and_garbage_is_no_command(function: int, data: bytes) -> None:
    double = _double()
    answer = _ask(double, bytes([function]) + data)
    if answer[0] != function:
        assert (answer[0], len(answer)) == (function | 0x80, 2)
        assert answer[1] in EXCEPTIONS
        assert double.commands == []
    elif double.commands:
        assert function in {16, 23}
    assert _ask(double, STATUS)[:2] == bytes([4, 6])


@given(st.lists(st.integers(0, 0xFFFF), min_size=1, max_size=4), st.integers(0x03E0, 0x03F0))
def test_a_whole_write_is_a_command_where_its_words_are(words: list[int], first: int) -> None:
    double = _double()
    count = len(words)
    answer = _ask(double, struct.pack(f">BHHB{count}H", 16, first, count, 2 * count, *words))
    inside = first >= 0x03E8 and first + count <= 0x03E8 + 3
    assert answer == (struct.pack(">BHH", 16, first, count) if inside else bytes([0x90, 2]))
    assert len(double.commands) == inside
