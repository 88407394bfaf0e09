"""The robot's KAREL program spoken to directly: no socket, no thread, no driver, and a checksum of the tests' own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.sim.karel_controller import KarelController
from srvs_cell.ports import RobotMode
from tests.drivers.stepped import PointArm, SteppedTime

if TYPE_CHECKING:
    from collections.abc import Mapping

    from drivers.sim.karel_server import KarelDevice

HOME = (500000, 0, 400000, 180000, 0, 0)
TARGET = (600000, 0, 400000, 170000, 5000, -7000)
SPEED = 20_000
DEEP = 3_000_000


def fletcher(text: bytes) -> int:
    """RFC 1146, appendix II: A = sum of D[i], B = sum of (n - i) D[i], each modulo 255."""
    n = len(text)
    return sum((n - i) * d for i, d in enumerate(text)) % 255 * 256 + sum(text) % 255


class MemoryCarrier:
    """A wire that is a list."""

    connected = True
    unread = False

    def __init__(self) -> None:
        self.answers: list[bytes] = []

    def let_in(self) -> bool:
        return True

    def start(self, device: KarelDevice) -> str:
        del device
        return "memory"

    def close(self) -> None: ...

    def hang_up(self) -> None: ...

    def send(self, data: bytes) -> None:
        self.answers.append(data)


class Conversation:
    """Commands go in, answers come out, time passes when it is told to."""

    def __init__(self, sources: Mapping[str, str] | None = None) -> None:
        self.time = SteppedTime()
        self.point = PointArm(self.time)
        self.carrier = MemoryCarrier()
        self.controller = KarelController(self.point, self.time, self.carrier, sources)
        self.controller.task.start(self.time.now_s())
        self.controller._scan()
        self.sequence = 0

    def line(self, name: str, *values: int, sequence: int | None = None) -> bytes:
        self.sequence = self.sequence + 1 if sequence is None else sequence
        body = f">{self.sequence},{','.join((name, *map(str, values)))}".encode()
        return b"%b*%d\r\n" % (body, fletcher(body))

    def send(self, data: bytes) -> list[bytes]:
        """Return what is answered."""
        before = len(self.carrier.answers)
        self.controller.wire.take(data)
        assert self.controller.task.aborted is None, self.controller.task.aborted
        return self.carrier.answers[before:]

    def say(self, name: str, *values: int, sequence: int | None = None) -> tuple[int, str, list[int]]:
        """Return sequence number, OK or NO, and the numbers of the one answer."""
        (answer,) = self.send(self.line(name, *values, sequence=sequence))
        body, _, digits = answer.removesuffix(b"\r\n").partition(b"*")
        assert answer.endswith(b"\r\n")
        assert int(digits) == fletcher(body)
        number, verdict, *rest = body.removeprefix(b"<").decode().split(",")
        return int(number), verdict, [int(value) for value in rest]

    def agreed(self, name: str, *values: int) -> list[int]:
        """Return the numbers of an answer that is OK."""
        number, verdict, rest = self.say(name, *values)
        assert (number, verdict) == (self.sequence, "OK"), (name, verdict, rest)
        return rest

    def agreed_at(self, sequence: int) -> None:
        """Go on from a number."""
        assert self.say("BEAT", sequence=sequence) == (sequence, "OK", [])

    def refused(self, name: str, *values: int) -> int:
        """Return the code of an answer that is NO."""
        number, verdict, rest = self.say(name, *values)
        assert (number, verdict) == (self.sequence, "NO"), (name, verdict, rest)
        return rest[0]

    def moving(self) -> bool:
        return self.point.moving

    def pass_s(self, seconds: float) -> None:
        """Let time pass in steps of the controller's scan."""
        end_s = self.time.now_s() + seconds
        while self.time.now_s() < end_s:
            self.time.advance_to(min(self.time.now_s() + 0.05, end_s))
            self.controller._scan()
        assert self.controller.task.aborted is None, self.controller.task.aborted

    def ready(self) -> None:
        self.agreed("HELO", 4301)
        self.agreed("ENBL")


def judge_lines(sources: Mapping[str, str]) -> None:
    """What is a line and what is none."""
    c = Conversation(sources)
    assert c.send(b"\r\n\r\n\n") == []
    assert c.refused("STAT") == 7
    assert c.say("HELO", 4302) == (2, "NO", [15, 4301])
    assert c.agreed("HELO", 4301) == [4301, 0]
    good = c.line("BEAT", sequence=30000)
    for bad in (
        b"?\r\n",
        good.replace(b">", b"<"),
        good.replace(b"BEAT", b"BEAR"),
        good.replace(b"*", b"**"),
        good.replace(b"\r\n", b"0\r\n"),
        good.replace(b"\r\n", b"x\r\n"),
        c.line("BEAT", sequence=30001),
        c.line("BEAT", sequence=0),
        c.line("BEATS", sequence=4),
        c.line("BEA", sequence=4),
        b">4*%d\r\n" % fletcher(b">4"),
        b">4,,*%d\r\n" % fletcher(b">4,,"),
        b">4,BEAT,*%d\r\n" % fletcher(b">4,BEAT,"),
        b">4,BEAT,-*%d\r\n" % fletcher(b">4,BEAT,-"),
        b">4,BEAT,1.5*%d\r\n" % fletcher(b">4,BEAT,1.5"),
        b">4,BEAT,:*%d\r\n" % fletcher(b">4,BEAT,:"),
        c.line("BEAT", 1234567890, sequence=4),
        c.line("BEAT", *range(9), sequence=4),
        b">4,BEAT" + b" " * 130 + b"*0\r\n",
        b"\x80" + good,
        b"\x00" + good,
        b"\x1f" + good,
        b"\x7f" + good,
    ):
        (answer,) = c.send(bad)
        assert answer.startswith(b"<0,NO,1*"), bad
    assert c.send(good)[0].startswith(b"<30000,OK*")
    longest = c.line("RDIN", *[-123456789] * 8, sequence=30000).removesuffix(b"\r\n")
    assert len(longest) <= 120
    assert c.send(longest + b"\n")[0].startswith(b"<30000,NO,3*")
    for i in range(len(good)):
        assert c.send(good[i : i + 1]) == ([b"<30000,OK*%d\r\n" % fletcher(b"<30000,OK")] if i == len(good) - 2 else [])
    assert len(c.send(c.line("BEAT", sequence=7) * 30)) == 30
    assert c.refused("NOPE") == 2
    c.sequence = 100
    assert c.refused("HELO") == 3


def judge_status(sources: Mapping[str, str]) -> None:
    """What STAT and JNTS say."""
    c = Conversation(sources)
    c.agreed("HELO", 4301)
    assert c.agreed("STAT") == [0, 0, 0, 1, 3, 100, 1, 1, 0, *HOME]
    c.point.override_percent, c.point.mode = 37, RobotMode.T1
    assert c.agreed("STAT")[3:6] == [2, 2, 37]
    c.point.mode = RobotMode.T2
    assert c.agreed("STAT")[3:5] == [3, 2]
    c.point.mode, c.point.pendant_enabled = RobotMode.AUTO, True
    assert c.agreed("STAT")[3:5] == [1, 130]
    c.point.pendant_enabled, c.point.servo_on = False, False
    assert c.agreed("STAT")[4] == 0
    c.point.servo_on = True
    c.controller.robot.user_frame, c.controller.robot.user_tool = 4, 5
    assert c.agreed("STAT")[6:8] == [4, 5]
    c.agreed("ENBL")
    assert c.agreed("STAT")[6:8] == [1, 1]
    c.point.fault = "SRVO-002 Teach pendant E-stop"
    c.pass_s(0.05)
    status = c.agreed("STAT")
    assert (status[4], status[8]) == (34, 11002)
    assert c.agreed("RSET") == []
    assert c.agreed("STAT")[8] == 0
    assert c.controller.robot.program_frames == {
        "$GROUP[1].$UFRAME": "$MNUFRAME[1,1]",
        "$GROUP[1].$UTOOL": "$MNUTOOL[1,1]",
    }
    assert c.refused("JNTS") == 16
    c.controller._robot.joints = lambda: (1.5, -2.25, 3.0, -4.125, 90.0, 180.0)  # type: ignore[method-assign]
    assert c.agreed("JNTS") == [1500, -2250, 3000, -4125, 90000, 180000]
    c.point.fault, c.point.reset_fault = "SRVO-001", lambda: None  # type: ignore[method-assign]
    c.pass_s(0.05)
    assert c.refused("RSET") == 13


def judge_moves(sources: Mapping[str, str]) -> None:
    """Moves arrive, once."""
    c = Conversation(sources)
    c.agreed("HELO", 4301)
    assert c.refused("MOVL", *TARGET, SPEED) == 8
    c.agreed("ENBL")
    for axis in range(6):
        for sign in (1, -1):
            limit = 3_000_000 if axis < 3 else 360_000
            over = [*TARGET, SPEED]
            over[axis] = sign * (limit + 1)
            assert c.refused("MOVL", *over) == 4
    assert [c.refused("MOVL", *TARGET, speed) for speed in (999, 0, -5, 2_000_001)] == [5, 5, 5, 5]
    assert c.refused("MOVJ", *TARGET, 100_001) == 5
    assert [c.refused("MOVL", *TARGET), c.refused("MOVL", *TARGET, SPEED, 1)] == [3, 3]
    c.controller.robot.user_tool = 2
    assert c.refused("MOVL", *TARGET, SPEED) == 6
    c.controller.robot.user_tool, c.controller.robot.user_frame = 1, 2
    assert c.refused("MOVL", *TARGET, SPEED) == 6
    c.controller.robot.user_frame = 1
    c.point.mode = RobotMode.T2
    assert c.refused("MOVL", *TARGET, SPEED) == 11
    c.point.mode, c.point.servo_on = RobotMode.AUTO, False
    assert c.refused("MOVL", *TARGET, SPEED) == 11
    c.point.servo_on = True
    assert c.controller.motions_started == 0
    c.agreed("MOVL", *TARGET, SPEED)
    move = c.sequence
    assert c.agreed("STAT")[:3] == [1, 0, move]
    assert c.refused("MOVL", *HOME, SPEED) == 9
    assert c.refused("ENBL") == 9
    for _ in range(11):
        c.pass_s(0.5)
        c.agreed("BEAT")
    assert c.agreed("STAT")[:3] == [2, 0, move]
    assert c.agreed("STAT")[9:] == list(TARGET)
    newest = c.sequence
    for old in (move, move + 1, newest, newest + 15_001):
        assert c.say("MOVJ", *HOME, SPEED, sequence=old) == (old, "NO", [10])
        c.agreed_at(newest)
    c.pass_s(1.0)
    assert c.controller.motions_started == 1
    c.agreed_at(29_990)
    assert c.say("MOVJ", *TARGET, 1_000, sequence=14_990) == (14_990, "OK", [])
    c.pass_s(0.5)
    c.agreed_at(29_990)
    assert c.say("MOVJ", *HOME, 100_000, sequence=5) == (5, "OK", [])


def judge_duplicates(sources: Mapping[str, str]) -> None:
    """A line that comes twice is answered twice and moves once, also where it was refused."""
    c = Conversation(sources)
    c.agreed("HELO", 4301)
    line = c.line("MOVJ", *TARGET, 100_000, sequence=50)
    assert [c.send(line)[0].split(b"*")[0] for _ in range(2)] == [b"<50,NO,8"] * 2
    c.agreed("ENBL")
    assert c.send(line)[0].startswith(b"<50,NO,8*")
    line = c.line("MOVJ", *TARGET, 100_000, sequence=51)
    assert [c.send(line)[0].split(b"*")[0] for _ in range(3)] == [b"<51,OK"] * 3
    c.pass_s(0.5)
    assert c.agreed("STAT")[:3] == [2, 0, 51]
    assert c.agreed("STAT")[9:] == list(TARGET)
    assert c.send(line)[0].startswith(b"<51,OK*")
    assert c.say("MOVJ", *HOME, 100_000, sequence=51) == (51, "NO", [10])
    assert c.say("MOVL", *TARGET, 100_000, sequence=51) == (51, "NO", [10])
    c.pass_s(1.0)
    assert c.controller.motions_started == 1
    assert c.say("HELO", 4301, sequence=52) == (52, "OK", [4301, 51])


def judge_stops(sources: Mapping[str, str]) -> None:
    """Every way in which a move ends early."""
    c = Conversation(sources)
    c.ready()
    c.agreed("STOP")
    assert c.refused("MOVL", *TARGET, SPEED) == 8
    c.agreed("ENBL")
    c.agreed("MOVL", *TARGET, SPEED)
    c.pass_s(1.0)
    c.agreed("STOP")
    stood = c.point.pose
    c.pass_s(0.1)
    assert c.agreed("STAT")[:3] == [4, 1, c.sequence - 2]
    c.agreed("ENBL")
    c.pass_s(1.0)
    assert c.point.pose == stood
    c.agreed("MOVL", *TARGET, SPEED)
    c.pass_s(0.5)
    c.controller.hold()
    c.pass_s(0.1)
    assert c.agreed("STAT")[:2] == [4, 3]
    assert c.refused("MOVL", *TARGET, SPEED) == 8
    c.agreed("ENBL")
    c.agreed("MOVL", *TARGET, SPEED)
    c.pass_s(0.5)
    c.point.stop()
    c.point.fault = "SRVO-001 Operator panel E-stop"
    c.pass_s(0.1)
    assert c.agreed("STAT")[:2] == [3, 0]
    c.agreed("RSET")
    assert c.refused("MOVL", *TARGET, SPEED) == 8
    c.agreed("ENBL")
    c.agreed("MOVL", *TARGET, SPEED)
    c.pass_s(0.5)
    c.agreed("RSET")
    c.pass_s(0.1)
    assert c.agreed("STAT")[:2] == [4, 1]
    c.agreed("ENBL")
    c.agreed("MOVL", DEEP, 0, 0, 0, 0, 0, SPEED)
    c.pass_s(0.5)
    status = c.agreed("STAT")
    assert (status[:2], status[8]) == ([3, 0], 15018)


def judge_watchdog(sources: Mapping[str, str]) -> None:
    """A PC that is not heard for two seconds."""
    c = Conversation(sources)
    c.ready()
    c.agreed("MOVL", *TARGET, SPEED)
    c.pass_s(1.9)
    assert c.moving()
    c.agreed("BEAT")
    c.pass_s(1.9)
    assert c.moving()
    c.pass_s(0.3)
    assert not c.moving()
    assert c.agreed("STAT")[:2] == [4, 2]
    assert c.refused("MOVL", *TARGET, SPEED) == 8
    c.agreed("ENBL")
    c.pass_s(2.2)
    assert c.refused("MOVL", *TARGET, SPEED) == 8
    c.agreed("ENBL")
    c.agreed("MOVL", *TARGET, SPEED)
    c.pass_s(0.5)
    c.send(b"garbage\r\n" * 3)
    c.pass_s(1.7)
    assert not c.moving()  # garbage is no sign of life
    c.agreed("ENBL")
    c.agreed("MOVL", *TARGET, SPEED)
    c.pass_s(0.5)
    c.agreed("QUIT")
    assert not c.moving()
    assert c.refused("BEAT") == 7
    c.ready()
    c.agreed("MOVL", *TARGET, SPEED)
    c.pass_s(0.5)
    c.agreed("HELO", 4301)
    assert not c.moving()
    assert c.refused("MOVL", *TARGET, SPEED) == 8


def judge_signals(sources: Mapping[str, str]) -> None:
    """Inputs and outputs, by number."""
    c = Conversation(sources)
    c.agreed("HELO", 4301)
    c.point.inputs[7] = True
    assert [c.agreed("RDIN", 7), c.agreed("RDIN", 8)] == [[1], [0]]
    assert [c.agreed("RDOU", 7), c.agreed("WDOU", 7, 1), c.agreed("RDOU", 7), c.agreed("WDOU", 7, 0)] == [
        [0],
        [1],
        [1],
        [0],
    ]
    assert [c.refused("RDIN", 0), c.refused("RDOU", 600), c.refused("WDOU", 600, 1)] == [14, 14, 14]
    assert [c.refused("RDIN"), c.refused("WDOU", 7), c.refused("WDOU", 7, 2), c.refused("WDOU", 7, -1)] == [3, 3, 3, 3]
    assert c.point.outputs == {7: False}


JUDGES = (
    judge_lines,
    judge_status,
    judge_moves,
    judge_duplicates,
    judge_stops,
    judge_watchdog,
    judge_signals,
)


def content(sources: Mapping[str, str]) -> bool:
    """Return whether all judges are content with the robot's sources."""
    try:
        for judge in JUDGES:
            judge(sources)
    except Exception:  # noqa: BLE001 - however a mistake shows, it shows
        return False
    return True
