"""Any bytes to the RMI double: it answers or hangs up, serves on, holds little, and moves only on a whole move."""

import contextlib
import json
import socket
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from drivers.sim.rmi_controller import RmiController
from tests.drivers.fuzz.test_rmi_packets import VALUES, as_line
from tests.drivers.stepped import PointArm, SteppedTime

CONNECT = b'{"Communication":"FRC_Connect"}\r\n'
STATUS = b'{"Command":"FRC_GetStatus"}\r\n'
READY = (b'{"Command":"FRC_Initialize"}\r\n', b'{"Command":"FRC_SetUFrameUTool","UFrameNumber":1,"UToolNumber":1}\r\n')
MOVE = {
    "Instruction": "FRC_LinearMotion",
    "SequenceID": 1,
    "Configuration": {
        "UToolNumber": 1, "UFrameNumber": 1, "Front": 1, "Up": 1, "Left": 0, "Flip": 0,
        "Turn4": 0, "Turn5": 0, "Turn6": 0,
    },
    "Position": {"X": 510.0, "Y": 0.0, "Z": 400.0, "W": 180.0, "P": 0.0, "R": 0.0},
    "SpeedType": "mmSec", "Speed": 20, "TermType": "FINE", "TermValue": 0,
}  # fmt: skip
NAMES = st.sampled_from([
    "FRC_Initialize", "FRC_GetStatus", "FRC_ReadError", "FRC_SetOverRide", "FRC_ReadCartesianPosition", "FRC_Reset",
    "FRC_GetUFrameUTool", "FRC_SetUFrameUTool", "FRC_ReadDIN", "FRC_WriteDOUT", "FRC_ReadIOPort", "FRC_Nothing",
])  # fmt: skip
INSTRUCTIONS = st.sampled_from(["FRC_WaitTime", "FRC_SetUFrame", "FRC_SetUTool", "FRC_Call", "FRC_JointMotion"])
FIELDS = st.dictionaries(
    st.sampled_from([
        "Value", "UFrameNumber", "UToolNumber", "PortNumber", "PortValue", "PortType", "SequenceID", "Time",
        "FrameNumber", "ToolNumber", "Position", "Configuration", "Speed", "TermType",
    ]),
    VALUES,
    max_size=5,
)  # fmt: skip
PACKETS = (
    st.builds(lambda name, fields: {"Command": name, **fields}, NAMES | VALUES, FIELDS)
    | st.builds(lambda name, fields: {"Instruction": name, "SequenceID": 1, **fields}, INSTRUCTIONS | VALUES, FIELDS)
    | VALUES
)


class Double:
    def __init__(self, controller: RmiController, time: SteppedTime) -> None:
        self.controller, self.time = controller, time
        self.port = controller.start()

    def session(self) -> socket.socket:
        with socket.create_connection(("127.0.0.1", self.port), 10.0) as first:
            first.sendall(CONNECT)
            with first.makefile("rb") as reader:
                port = json.loads(reader.readline())["PortNumber"]
        return socket.create_connection(("127.0.0.1", port), 10.0)

    def converse(self, *lines: bytes) -> list[object]:
        """Send lines, hang up, let time pass, return the packets that came."""
        received: list[object] = []
        with (
            self.session() as connection,
            connection.makefile("rb") as reader,
            contextlib.suppress(OSError),  # it has hung up
        ):
            for line in (*lines, STATUS):  # the last answer says that all before it has been looked at
                connection.sendall(line)
            connection.shutdown(socket.SHUT_WR)
            received += [json.loads(line) for line in reader]
        self.time.advance_to(self.time.now_s() + 2.0)
        return received


@pytest.fixture
def double() -> Iterator[Double]:
    time = SteppedTime()
    controller = RmiController(PointArm(time), time)
    try:
        yield Double(controller, time)
    finally:
        time.release()
        controller.close()


@given(packets=st.lists(PACKETS, min_size=1, max_size=4))
@example(packets=[{"Command": ["FRC_GetStatus"]}])
@example(packets=[{"Command": {"a": 1}}, {"Instruction": []}])
@example(packets=[{"Instruction": "FRC_WaitTime", "SequenceID": 1, "Time": "long"}])
@example(packets=[{"Instruction": "FRC_WaitTime", "SequenceID": 1, "Time": float("nan")}])
@example(packets=[{"Instruction": "FRC_SetUFrame", "SequenceID": 1}])
@example(packets=[{"Instruction": "FRC_SetUFrame", "SequenceID": True, "FrameNumber": "1"}])
@example(packets=[{"Command": "FRC_SetUFrameUTool", "UFrameNumber": {}, "UToolNumber": None}])
@example(packets=[{"Command": "FRC_SetOverRide", "Value": [1]}])
@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_packet_ends_the_double_or_moves_it(double: Double, packets: list[object]) -> None:
    double.converse(*READY, *(as_line(packet) + b"\r\n" for packet in packets))
    (last,) = double.converse()[-1:]
    assert isinstance(last, dict)
    assert last["Command"] == "FRC_GetStatus"
    assert double.controller.motions_started == 0
    double.controller.reboot()


@given(data=st.binary(max_size=300))
@example(data=b"[" * 100_000 + b"\r\n")
@example(data=b'{"a":' * 3000 + b"1" + b"}" * 3000 + b"\r\n")
@example(data=b"\xff\xfe\r\n\r\n{}\r\n[]\r\n1\r\nnull\r\n")
@example(data=b'{"Command":' + b"9" * 5000 + b"}\r\n")
@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_bytes_end_the_double(double: Double, data: bytes) -> None:
    double.converse(data)
    with socket.create_connection(("127.0.0.1", double.port), 10.0) as first, contextlib.suppress(OSError):
        first.sendall(data + b"\r\n")
    assert double.converse()
    assert double.controller.motions_started == 0


def test_a_line_without_an_end_takes_a_bounded_memory(double: Double) -> None:
    sent = 0
    with double.session() as connection, contextlib.suppress(ConnectionError):
        while sent < 2**24:
            sent += connection.send(b"x" * 8192)
    assert sent < 2**24, "it has not hung up"
    assert double.converse()


def test_the_whole_move_is_carried_out(double: Double) -> None:
    """What the next test breaks."""
    double.converse(*READY, as_line(MOVE) + b"\r\n")
    assert double.controller.motions_started == 1


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 10**400, True, None, "1", [1], {}])
@pytest.mark.parametrize("field", ["X", "R", "Front", "UFrameNumber", "Speed", "SequenceID", "TermType"])
def test_a_move_with_one_wrong_value_moves_nothing(double: Double, field: str, value: object) -> None:
    move = json.loads(json.dumps(MOVE))
    inside = next((move[group] for group in ("Position", "Configuration") if field in move[group]), move)
    inside[field] = value
    answers = double.converse(*READY, as_line(move) + b"\r\n")
    assert double.controller.motions_started == 0
    assert any(isinstance(answer, dict) and "Instruction" in answer and answer["ErrorID"] for answer in answers)
