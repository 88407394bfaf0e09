"""Judges the robot's programs as a PC sees them: written by hand from docs/reference/modbus-map.md.

Shares no code with the driver, needs no socket, and looks so often that the order of two lines can be seen.
"""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING

from drivers.sim.modbus_controller import ModbusController
from srvs_cell.ports import RobotMode
from tests.drivers.stepped import PointArm, SteppedTime

if TYPE_CHECKING:
    from collections.abc import Mapping

HOME = (500.0, 0.0, 400.0, 180.0, 0.0, 0.0)
TARGET = (520.0, -10.0, 405.0, 179.0, 1.5, -30.0)
LINEAR, JOINT = 1, 2
IDLE, BUSY, DONE, FAULT = 0, 1, 2, 3
HOLD, RESET = 3, 4
FIRST = 12000
SHORT_S, COARSE_S, BEAT_S, PATIENCE_S = 0.0005, 0.004, 0.25, 1.2


class Robot:
    """A controller and a PC that counts its heartbeat as long as ``beats`` is set."""

    def __init__(self, sources: Mapping[str, str]) -> None:
        self.time = SteppedTime()
        self.point = PointArm(self.time)
        self.controller = ModbusController(self.point, self.time, sources=sources)
        self.beats = False
        self.sequence = 0
        self._beat, self._beat_s = 0, 0.0

    def words(self) -> list[int]:
        return self.controller.read_words(FIRST, 49)

    def go(self, seconds: float) -> list[int]:
        self._pass(seconds)
        return self.words()

    def _pass(self, seconds: float) -> None:
        """Let time pass; the programs catch up when somebody looks."""
        self.time.advance_to(self.time.now_s() + seconds)
        if self.beats and self.time.now_s() - self._beat_s >= BEAT_S:
            self.beat()

    def pass_s(self, seconds: float) -> list[int]:
        for _ in range(round(seconds / 0.05)):
            self._pass(0.05)
            self.held()
        return self.words()

    def beat(self) -> None:
        self._beat, self._beat_s = self._beat % 30_000 + 1, self.time.now_s()
        self.controller.write_words(FIRST + 31, [self._beat])

    def send(
        self,
        target: tuple[float, ...] = TARGET,
        speed: float = 100.0,
        command: int = LINEAR,
        *,
        sequence: int | None = None,
        spoil: int = 0,
    ) -> None:
        self.sequence = self.sequence + 1 if sequence is None else sequence
        micro = [round(value * 1000) for value in (*target, speed)]
        total = 4201 + self.sequence + 2 * command + sum(w * v for w, v in enumerate(micro, start=3)) + spoil
        self.controller.write_words(
            FIRST + 32, list(struct.unpack("<17H", struct.pack("<H8i", command, *micro, total)))
        )
        self.controller.write_words(FIRST + 30, [self.sequence])

    def answer(self) -> tuple[int, int]:
        """Return state and fault of the command that was sent; every reading until then must make sense."""
        begun_s, was_busy = self.time.now_s(), False
        while self.time.now_s() - begun_s < PATIENCE_S:
            self._pass(COARSE_S if self.point.moving else SHORT_S)
            words = self.controller.read_words(FIRST, 4)
            state, fault = words[2], words[3]
            was_busy = was_busy or (state == BUSY and words[1] != self.sequence)
            if words[1] == self.sequence:
                assert was_busy
                assert (state, fault == 0) in {(DONE, True), (FAULT, False)}
                return state, fault
        raise AssertionError(f"no answer: {words}")

    def hold(self, on: bool) -> None:
        self.controller.write_coils(HOLD - 1, [on])

    def held(self) -> bool:
        return self.controller.read_coils(HOLD - 1, 1)[0]

    def reset(self) -> None:
        self.controller.write_coils(RESET - 1, [True])
        self.controller.write_coils(RESET - 1, [False])

    def begun(self) -> None:
        """Wait until the arm moves."""
        begun_s = self.time.now_s()
        while not self.point.moving:
            self._pass(0.005)
            self.held()
            assert self.time.now_s() - begun_s < PATIENCE_S

    def at(self, pose: tuple[float, ...]) -> bool:
        return all(math.isclose(a, b, abs_tol=1e-3) for a, b in zip(self.point.pose.as_tuple(), pose, strict=True))


def ready(sources: Mapping[str, str]) -> Robot:
    robot = Robot(sources)
    robot.beats = True
    robot.beat()
    robot.pass_s(0.3)
    return robot


def judge_switching_on(sources: Mapping[str, str]) -> None:
    robot = Robot(sources)
    words = robot.words()
    assert words[:4] == [4201, 0, IDLE, 0]
    assert words[23] == words[25] == 1  # frame and tool
    assert not robot.held()
    robot.send()
    assert robot.answer() == (FAULT, 6)  # no PC counts
    assert not robot.held()
    for mode, word in ((RobotMode.T1, 2), (RobotMode.T2, 3), (RobotMode.AUTO, 1)):
        robot.point.mode = mode
        robot.pass_s(0.2)
        assert robot.words()[5] == word
    before = robot.words()[4]
    assert 28 <= robot.pass_s(3.0)[4] - before <= 30
    robot.controller.write_words(FIRST + 4, [29_998])
    beats = [robot.go(SHORT_S)[4] for _ in range(600)]
    assert {30_000, 1} <= set(beats) <= {29_998, 29_999, 30_000, 1, 2}


def judge_moves(sources: Mapping[str, str]) -> None:
    robot = ready(sources)
    robot.send()
    assert robot.answer() == (DONE, 0)
    assert robot.at(TARGET)
    micro = struct.unpack("<6i", struct.pack("<12H", *robot.words()[9:21]))
    assert micro == tuple(round(value * 1000) for value in TARGET)
    begun_s = robot.time.now_s()
    robot.send(HOME, 50.0)
    assert robot.answer() == (DONE, 0)
    assert 0.45 < robot.time.now_s() - begun_s < 0.75
    begun_s = robot.time.now_s()
    robot.send(TARGET, 100.0, JOINT)  # the point's joints are fast
    assert robot.answer() == (DONE, 0)
    assert robot.time.now_s() - begun_s < 0.35
    assert robot.at(TARGET)
    robot.send(HOME, sequence=30_000)
    assert robot.answer() == (DONE, 0)
    robot.send(TARGET, sequence=1)
    assert robot.answer() == (DONE, 0)
    robot.send(HOME, sequence=2)
    robot.begun()
    robot.controller.write_words(FIRST + 30, [77])  # somebody else writes
    assert robot.answer() == (DONE, 0)
    robot.sequence = 77
    assert robot.answer() == (FAULT, 2)
    assert robot.controller.motions_started == 6


def judge_refusals(sources: Mapping[str, str]) -> None:
    robot = ready(sources)
    cases: list[tuple[int, tuple[float, ...], float, int, int]] = [
        (1, TARGET, 100.0, 0, 0),
        (1, TARGET, 100.0, 3, 0),
        (2, TARGET, 100.0, LINEAR, 1),
        (4, TARGET, 0.999, LINEAR, 0),
        (4, TARGET, 0.999, JOINT, 0),
        (4, TARGET, 2000.001, LINEAR, 0),
        (4, TARGET, 100.001, JOINT, 0),
    ]
    for axis in range(6):
        limit = 3000.0 if axis < 3 else 360.0
        beyond = (limit + 0.001, -limit - 0.001)
        targets = [(*TARGET[:axis], value, *TARGET[axis + 1 :]) for value in beyond]
        cases += [(3, target, 100.0, LINEAR, 0) for target in targets]
    for fault, target, speed, command, spoil in cases:
        robot.send(target, speed, command, spoil=spoil)
        assert robot.answer() == (FAULT, fault)
    for sequence in (30_001, 0):
        robot.send(sequence=sequence)
        assert robot.answer() == (FAULT, 2)
    for frame, tool in ((2, 1), (1, 2)):
        robot.controller.user_frame, robot.controller.user_tool = frame, tool
        robot.send()
        assert robot.answer() == (FAULT, 5)
    robot.controller.user_frame = robot.controller.user_tool = 1
    robot.hold(True)
    robot.send()
    assert robot.answer() == (FAULT, 7)
    robot.hold(False)
    robot.controller.heartbeat_frozen = True
    robot.send()
    assert robot.answer() == (FAULT, 6)
    robot.controller.heartbeat_frozen = False
    assert robot.controller.motions_started == 0
    assert robot.at(HOME)
    robot.send()
    assert robot.answer() == (DONE, 0)


def judge_stops(sources: Mapping[str, str]) -> None:
    robot = ready(sources)
    for command, speed in ((LINEAR, 20.0), (JOINT, 2.0)):
        robot.send(TARGET if command == LINEAR else HOME, speed, command)
        robot.begun()
        stop, asked = robot.point.stop, list[bool]()
        robot.point.stop = lambda asked=asked: asked.append(True)  # type: ignore[method-assign,misc]
        robot.hold(True)
        robot.go(0.02)
        robot.hold(False)  # a short pulse while the arm decelerates: the move is gone for good all the same
        assert asked == [True]
        robot.go(0.02)
        stop()
        robot.point.stop = stop  # type: ignore[method-assign]
        assert robot.pass_s(0.3)[1:4] == [robot.sequence, FAULT, 20]
        stood = robot.point.pose.as_tuple()
        robot.pass_s(0.5)
        assert robot.at(stood)
    assert robot.controller.motions_started == 2
    robot.send(TARGET, 2.0)
    robot.begun()
    robot.beats = False
    robot.pass_s(2.6)
    assert not robot.point.moving
    assert robot.words()[1:4] == [robot.sequence, FAULT, 21]
    assert robot.held()
    robot.beats = True
    robot.pass_s(0.5)
    assert robot.held()
    robot.hold(False)
    robot.pass_s(0.5)
    assert not robot.held()
    robot.send()
    assert robot.answer() == (DONE, 0)


def judge_resets(sources: Mapping[str, str]) -> None:
    robot = ready(sources)
    robot.point.collide_after_mm = 5.0
    robot.send()
    robot.begun()
    words = robot.pass_s(0.5)
    assert words[1:4] == [robot.sequence - 1, BUSY, 0]
    assert words[7:9] == [11, 50]
    before = words[4]
    assert robot.pass_s(0.5)[4] > before  # the heartbeat goes on
    robot.controller.user_frame = robot.controller.user_tool = 2
    before = robot.words()[4]
    robot.reset()
    assert robot.go(0.1)[1:4] == [robot.sequence, BUSY, 0]
    assert robot.go(0.1)[4] != before
    words = robot.pass_s(0.5)
    assert words[1:4] == [robot.sequence, IDLE, 0]
    assert words[7:9] == [0, 0]
    assert words[23] == words[25] == 1
    assert robot.controller.motions_started == 1
    robot.send(HOME, spoil=1)
    assert robot.answer() == (FAULT, 2)
    robot.reset()
    assert robot.go(0.1)[1:4] == [robot.sequence, BUSY, 0]
    assert robot.pass_s(0.5)[1:4] == [robot.sequence, IDLE, 0]
    robot.send(HOME)
    robot.begun()
    robot.beats = False
    robot.beat()
    robot.controller.reboot()
    before = robot.words()[4]
    assert robot.pass_s(0.5)[4] != before
    assert robot.words()[1:4] == [robot.sequence, IDLE, 0]
    assert robot.controller.motions_started == 2
    robot.send()
    assert robot.answer() == (FAULT, 6)  # the PC has not counted since
    robot.beats = True
    robot.pass_s(0.5)
    robot.send()
    assert robot.answer() == (DONE, 0)


class Valve:
    """A gripper on DO[1], DO[2], DI[1] to DI[3], whose sensors say what a test wants, when it wants."""

    def __init__(self, robot: Robot) -> None:
        self.robot, self.opened, self.closed, self.both = robot, 0, 0, False
        robot.point.outputs[1] = True
        robot.point.set_output = self.switch  # type: ignore[method-assign]

    def switch(self, n: int, on: bool) -> None:
        outputs = self.robot.point.outputs
        outputs[n] = on
        self.both = self.both or (outputs.get(1, False) and outputs.get(2, False))
        self.opened += on and n == 2
        self.closed += on and n == 1

    def test(self, *steps: tuple[float, int | None]) -> tuple[list[str], float]:
        """Run SRVS_TST; after each time the sensor says so, alone; return what was shown and R[137]."""
        before = len(self.robot.controller.messages)
        self.robot.controller.run_program("SRVS_TST")
        for seconds, sensor in steps:
            self.robot.pass_s(seconds)
            self.robot.point.inputs.update({n: n == sensor for n in (1, 2, 3)})
        self.robot.pass_s(3.5)
        assert not self.both
        return self.robot.controller.messages[before:], self.robot.controller._robot.register(137)


HELD, OPEN, EMPTY = 1, 2, 3
OPENS, CLOSES, AGAIN, OK = "SRVS: GRIPPER OPENS", "SRVS: GRIPPER CLOSES", "SRVS: OPENS AGAIN", "SRVS: GRIPPER OK"
ALL = [OPENS, CLOSES, AGAIN, OK]


def judge_grip(sources: Mapping[str, str]) -> None:
    """SRVS_TST: the gripper's test, run from the pendant."""
    cases: list[tuple[list[tuple[float, int | None]], tuple[list[str], float]]] = [
        ([(0.5, OPEN), (0.1, None), (1.0, HELD), (0.5, OPEN)], (ALL, 2)),
        ([(0.5, OPEN), (0.1, None), (1.0, EMPTY), (0.5, OPEN)], (ALL, 2)),
        ([(0.5, OPEN), (0.1, HELD), (0.1, EMPTY), (0.5, OPEN)], (ALL, 2)),  # the part slips
        ([(0.5, OPEN), (0.1, HELD), (0.05, None)], ([OPENS, CLOSES], 8)),  # and the sensors say nothing
        ([(0.5, OPEN), (0.1, None)], ([OPENS, CLOSES], 8)),
        ([(0.5, OPEN), (0.1, HELD), (0.3, None)], ([OPENS, CLOSES, AGAIN], 8)),
        ([(0.5, None)], ([OPENS], 8)),
    ]
    for steps, expected in cases:
        robot = ready(sources)
        assert Valve(robot).test(*steps) == expected
        assert robot.words()[7:9] == ([0, 0] if expected[1] == 2 else [12, 213])  # UALM
    robot = ready({**sources, "SRVS_TST.LS": sources["SRVS_TST.LS"].replace("SRVS_GRP(2)", "SRVS_GRP(3)")})
    assert Valve(robot).test() == ([OPENS], 9)
    robot = ready({**sources, "SRVS_TST.LS": sources["SRVS_TST.LS"].replace("MESSAGE[SRVS: OPENS AGAIN]", "END")})
    for slipping, result in ((HELD, 1), (EMPTY, 3)):
        valve = Valve(robot)
        assert valve.test((0.1, OPEN), (0.05, HELD), (0.05, slipping)) == ([OPENS, CLOSES], result)
    assert (valve.opened, valve.closed) == (1, 1)


JUDGES = (judge_resets, judge_stops, judge_switching_on, judge_refusals, judge_moves)
