"""The RMI double before clients of other people: spelling, greeting, pause and wait, moves told in joint angles."""

from __future__ import annotations

import json
import socket
from typing import TYPE_CHECKING, Any

import pytest

from drivers.sim.rmi_controller import RmiController
from tests.drivers.fuzz.test_rmi_double import CONNECT, MOVE, READY, Double
from tests.drivers.stepped import PointArm, SteppedTime

if TYPE_CHECKING:
    from collections.abc import Iterator

OK = 0


class JointArm(PointArm):
    """A point whose joints are three coordinates and three angles."""

    @property
    def joints_deg(self) -> tuple[float, ...]:
        return self.pose.as_tuple()

    def start_joints(self, target_deg: list[float], speed_percent: float) -> None:
        self.start_joint(type(self.pose)(*target_deg), speed_percent)


@pytest.fixture
def point() -> JointArm:
    return JointArm(SteppedTime())


@pytest.fixture
def double(point: JointArm) -> Iterator[Double]:
    controller = RmiController(point, point._time)
    try:
        yield Double(controller, point._time)
    finally:
        point._time.release()
        controller.close()


class Session:
    def __init__(self, double: Double) -> None:
        self._time = double.time
        self._connection = double.session()
        self._reader = self._connection.makefile("rb")
        for line in READY:
            self._connection.sendall(line)
            assert json.loads(self._reader.readline())["ErrorID"] == OK

    def say(self, packet: dict[str, object]) -> dict[str, Any]:
        self.send(packet)
        return self.hear()

    def carry_out(self, packet: dict[str, object], takes_s: float) -> dict[str, Any]:
        """Send an instruction, let time pass, return what it ended with."""
        self.send(packet)
        self._time.advance_to(self._time.now_s() + takes_s)
        return self.hear()

    def send(self, packet: dict[str, object]) -> None:
        self._connection.sendall(json.dumps(packet).encode() + b"\r\n")

    def hear(self) -> dict[str, Any]:
        packet: dict[str, Any] = json.loads(self._reader.readline())
        return packet

    def close(self) -> None:
        self._reader.close()
        self._connection.close()


@pytest.fixture
def session(double: Double) -> Iterator[Session]:
    talk = Session(double)
    yield talk
    talk.close()


def test_abbreviated_keys_are_the_manuals(session: Session, double: Double) -> None:
    configuration = {"UTNum": 1, "UFNum": 1, "Front": 1, "Up": 1, "Left": 0, "Flip": 0, "T4": 0, "T5": 0, "T6": 0}
    move = {key: value for key, value in MOVE.items() if key != "SequenceID"}
    session.send({**move, "SID": 1, "Configuration": configuration})
    assert session.say({"Command": "FRC_GetStatus"})["NextSequenceID"] == 2
    assert double.controller.motions_started == 1


@pytest.mark.parametrize("speed", [0, 101, 50.5])
def test_joint_speeds_are_whole_percents(session: Session, double: Double, speed: float) -> None:
    move = {**MOVE, "Instruction": "FRC_JointMotion", "SpeedType": "Percent", "Speed": speed}
    assert session.say(move)["ErrorID"] == 2556959
    assert double.controller.motions_started == 0


def test_a_paused_move_goes_on_to_the_target_that_it_had(session: Session, point: JointArm, double: Double) -> None:
    session.send({**MOVE, "Instruction": "FRC_LinearRelative", "Position": {**dict.fromkeys("XYZWPR", 0.0), "X": 20.0}})
    assert session.say({"Command": "FRC_GetStatus"})["ProgramStatus"] == 0
    double.time.advance_to(double.time.now_s() + 0.5)
    assert session.say({"Command": "FRC_Pause"})["ErrorID"] == OK
    here_mm = point.pose.x_mm
    assert 500.0 < here_mm < 520.0
    double.time.advance_to(double.time.now_s() + 5.0)
    assert (point.pose.x_mm, point.moving) == (here_mm, False)
    assert session.say({"Command": "FRC_GetStatus"})["ProgramStatus"] == 1
    assert session.say({"Command": "FRC_Continue"})["ErrorID"] == OK
    assert session.say({"Command": "FRC_Continue"})["ErrorID"] == 2556938, "not paused"
    double.time.advance_to(double.time.now_s() + 5.0)
    assert session.hear() == {"Instruction": "FRC_LinearRelative", "ErrorID": OK, "SequenceID": 1}
    assert point.pose.x_mm == pytest.approx(520.0)


def test_waiting_for_an_input_ends_with_it(session: Session, point: JointArm, double: Double) -> None:
    assert session.say({"Instruction": "FRC_WaitDIN", "SequenceID": 1, "PortNumber": 0, "PortValue": "ON"})["ErrorID"]
    assert session.say({"Command": "FRC_Reset"})["ErrorID"] == OK
    session.send({"Instruction": "FRC_WaitDIN", "SequenceID": 1, "PortNumber": 4, "PortValue": "ON"})
    assert session.say({"Command": "FRC_ReadDIN", "PortNumber": 4})["PortValue"] == 0
    double.time.advance_to(double.time.now_s() + 9.0)
    assert session.say({"Command": "FRC_ReadDIN", "PortNumber": 4})["PortValue"] == 0
    point.inputs[4] = True
    assert session.say({"Command": "FRC_GetStatus"}) == {"Instruction": "FRC_WaitDIN", "ErrorID": OK, "SequenceID": 1}


def test_moves_told_in_joint_angles(session: Session, point: JointArm) -> None:
    angles = session.say({"Command": "FRC_ReadJointAngles"})["JointAngle"]
    assert list(angles) == [f"J{n}" for n in range(1, 10)]
    manner = {"SpeedType": "Percent", "Speed": 20, "TermType": "FINE"}
    turn = {**dict.fromkeys(angles, 0.0), "J3": -10.0}
    move = {"Instruction": "FRC_JointRelativeJRep", "SequenceID": 1, "JointAngle": turn, **manner}
    assert session.carry_out(move, takes_s=2.0)["ErrorID"] == OK
    assert point.pose.z_mm == pytest.approx(390.0)
    back = {"Instruction": "FRC_JointMotionJRep", "SequenceID": 2, "JointAngle": angles, **manner}
    assert session.carry_out(back, takes_s=2.0)["ErrorID"] == OK
    assert point.pose.z_mm == pytest.approx(400.0)
    wrong = {**back, "SequenceID": 3, "JointAngle": {**angles, "J6": None}}
    assert session.say(wrong)["ErrorID"] == 2556951


def test_an_arm_without_joints_refuses_them() -> None:
    time = SteppedTime()
    controller = RmiController(PointArm(time), time)
    session = Session(Double(controller, time))
    try:
        assert session.say({"Command": "FRC_ReadJointAngles"})["ErrorID"] == 2556941
        move = {"Instruction": "FRC_JointMotionJRep", "SequenceID": 1, "JointAngle": dict.fromkeys(("J1", "J2"), 0.0)}
        assert session.say(move)["ErrorID"] == 2556948
    finally:
        session.close()
        time.release()
        controller.close()


@pytest.mark.parametrize(
    ("line", "reply"),
    [
        (b'{"Communication":"FRC_Connect_STMO"}\r\n', {"Communication": "FRC_Connect_STMO", "ErrorID": 2556941}),
        (b'{"Command":"FRC_GetStatus"}\r\n', {"Command": "Unknown", "ErrorID": 2556950}),
        (CONNECT.replace(b"\r", b""), {"Command": "Unknown", "ErrorID": 2556950}),
        (b"hello\r\n", {"Command": "Unknown", "ErrorID": 2556950}),
    ],
)
def test_the_first_port_refuses_in_words_whatever_is_no_connect(
    double: Double, line: bytes, reply: dict[str, object]
) -> None:
    with socket.create_connection(("127.0.0.1", double.port), 10.0) as silent:
        with socket.create_connection(("127.0.0.1", double.port), 10.0) as first, first.makefile("rb") as reader:
            first.sendall(line)
            assert json.loads(reader.readline()) == reply
            assert reader.read() == b"", "it hangs up afterwards"
        assert double.converse(), "beside a client that says nothing"
        silent.sendall(CONNECT)


def test_a_line_that_ends_without_cr_is_refused_and_carries_out_nothing(double: Double) -> None:
    (refused, status) = double.converse(b'{"Command":"FRC_SetOverRide","Value":3}\n')
    assert refused == {"Command": "Unknown", "ErrorID": 2556950}
    assert isinstance(status, dict)
    assert status["Override"] == 100


def test_nothing_but_a_goodbye_ends_the_program(session: Session) -> None:
    assert session.say({"Communication": "FRC_Hello"})["ErrorID"] == 2556941
    assert session.say({"Command": "FRC_GetStatus"})["RMIMotionStatus"] == 1
