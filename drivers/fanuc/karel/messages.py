"""What the numbers in the robot's replies mean. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Final

from drivers.fanuc.karel.lines import NUMBER_LIMIT
from drivers.fanuc.registers import UopOutput, alarm_name
from srvs_cell.alarms import Alarm
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import CommandRejectedError, DeviceFaultError, NotReadyError, PortError, RobotMode

if TYPE_CHECKING:
    from drivers.fanuc.karel.lines import Reply

MICRO: Final = 1000
_UOP_WORD: Final = 255
_FACILITY_STEP: Final = 1000
_MODES: Final = {1: RobotMode.AUTO, 2: RobotMode.T1, 3: RobotMode.T2}


class State(IntEnum):
    """What has become of the last move."""

    IDLE = 0
    BUSY = 1
    DONE = 2
    FAULT = 3
    STOPPED = 4


class Cause(IntEnum):
    """Why it was stopped."""

    NOBODY = 0
    PC = 1
    WATCHDOG = 2
    ROBOT = 3


class Refusal(IntEnum):
    """Why the robot does not carry out a command; it has moved nothing."""

    LINE = 1
    COMMAND = 2
    FIELDS = 3
    POSITION = 4
    SPEED = 5
    FRAME = 6
    GREETING = 7
    ENABLE = 8
    IDLE = 9
    SEQUENCE = 10
    READY = 11
    START = 12
    RESET = 13
    PORT = 14
    PROTOCOL = 15
    POSE = 16
    STOP = 17


_REFUSALS: Final[dict[Refusal, tuple[type[PortError], Alarm, str]]] = {
    Refusal.LINE: (PortError, Alarm.PROTOCOL_ERROR, "the robot could not read the line"),
    Refusal.COMMAND: (PortError, Alarm.PROTOCOL_VERSION, "the robot's program does not know this command"),
    Refusal.FIELDS: (CommandRejectedError, Alarm.TARGET_REJECTED, "wrong number or range of arguments"),
    Refusal.POSITION: (CommandRejectedError, Alarm.TARGET_REJECTED, "position out of the program's range"),
    Refusal.SPEED: (CommandRejectedError, Alarm.TARGET_REJECTED, "speed out of the program's range"),
    Refusal.FRAME: (NotReadyError, Alarm.FRAME_CHANGED, "user frame or tool is not the program's"),
    Refusal.GREETING: (PortError, Alarm.CONNECTION_LOST, "the robot's program was started anew"),
    Refusal.ENABLE: (
        NotReadyError,
        Alarm.ROBOT_NOT_READY,
        "its program has seen a stop since it was enabled",
    ),
    Refusal.IDLE: (NotReadyError, Alarm.ROBOT_BUSY, "a move is under way"),
    Refusal.SEQUENCE: (CommandRejectedError, Alarm.PROTOCOL_ERROR, "the sequence number was used for another move"),
    Refusal.READY: (NotReadyError, Alarm.ROBOT_NOT_READY, "mode or remote conditions (CMDENBL) forbid it"),
    Refusal.START: (NotReadyError, Alarm.ROBOT_NOT_READY, "the controller does not start SRVS_KMV: is it loaded?"),
    Refusal.RESET: (DeviceFaultError, Alarm.ROBOT_FAULT, "the controller is not reset"),
    Refusal.PORT: (CommandRejectedError, Alarm.TARGET_REJECTED, "there is no such signal"),
    Refusal.PROTOCOL: (PortError, Alarm.PROTOCOL_VERSION, "the robot's program is of another protocol version"),
    Refusal.POSE: (NotReadyError, Alarm.ROBOT_NOT_READY, "the controller does not tell or take a position"),
    Refusal.STOP: (DeviceFaultError, Alarm.ROBOT_FAULT, "the controller does not abort SRVS_KMV"),
}


@dataclass(frozen=True)
class Status:
    """What STAT answers.

    Attributes:
        state, cause: of the last move.
        move: its sequence number.
        mode: mode switch.
        uop: UO[1] to UO[8].
        override_percent, user_frame, user_tool: as on the pendant.
        alarm: the controller's active alarm as on the pendant ("SRVO-050"), or None.
        pose: of the tool in the user frame that the robot's program works in.
    """

    state: State
    cause: Cause
    move: int
    mode: RobotMode
    uop: UopOutput
    override_percent: int
    user_frame: int
    user_tool: int
    alarm: str | None
    pose: Xyzwpr

    @property
    def fault(self) -> str | None:
        """What only a reset ends, or None."""
        return (self.alarm or "an alarm that is not named") if UopOutput.FAULT in self.uop else None


def move_values(target: Xyzwpr, speed: float) -> tuple[int, ...]:
    """Return the arguments of a move: micrometres, thousandths of a degree, thousandths of mm/s or per cent.

    Raises:
        CommandRejectedError: no robot is so large.
    """
    values = (*target.as_tuple(), speed)
    if not all(abs(value) * MICRO < NUMBER_LIMIT for value in values):  # NaN comes here, too
        raise CommandRejectedError(Alarm.TARGET_REJECTED, f"{target} at speed {speed} cannot be sent.")
    return tuple(round(value * MICRO) for value in values)


def refused(name: str, reply: Reply) -> PortError:
    """Return the error that a refusal is."""
    code = reply.values[0]
    if code not in set(Refusal):
        return PortError(Alarm.PROTOCOL_ERROR, f"{name} is refused with the unknown code {code}.")
    kind, alarm, text = _REFUSALS[Refusal(code)]
    extra = f" ({', '.join(map(str, reply.values[1:]))})" if len(reply.values) > 1 else ""
    return kind(alarm, f"{name} is refused, code {code}: {text}{extra}.")


def read_status(reply: Reply) -> Status:
    """Read a reply to STAT; raises as `numbers`."""
    state, cause, move, mode, uop, override, frame, tool, alarm, *pose = numbers("STAT", reply, 15)
    limits = (
        ("state", state in set(State)),
        ("cause", cause in set(Cause)),
        ("UO", 0 <= uop <= _UOP_WORD),
        ("override", 0 <= override <= 100),  # noqa: PLR2004 - per cent
        ("alarm", alarm >= 0),
    )
    for name, holds in limits:
        if not holds:
            raise PortError(Alarm.PROTOCOL_ERROR, f"STAT: {name} is out of range in {reply.values}.")
    return Status(
        state=State(state),
        cause=Cause(cause),
        move=move,
        mode=_MODES.get(mode, RobotMode.UNKNOWN),
        uop=UopOutput(uop),
        override_percent=override,
        user_frame=frame,
        user_tool=tool,
        alarm=alarm_name(*divmod(alarm, _FACILITY_STEP)),
        pose=Xyzwpr(*(value / MICRO for value in pose)),
    )


def read_signal(name: str, reply: Reply) -> bool:
    """Read the value of a signal; raises as `numbers`."""
    (value,) = numbers(name, reply, 1)
    if value not in {0, 1}:
        raise PortError(Alarm.PROTOCOL_ERROR, f"{name} answers {value}, which is no signal.")
    return value == 1


def numbers(name: str, reply: Reply, count: int) -> tuple[int, ...]:
    """Return the values of a reply; raises `PortError` PROTOCOL_ERROR where there are more or fewer."""
    if len(reply.values) != count:
        raise PortError(Alarm.PROTOCOL_ERROR, f"{name} answers {len(reply.values)} numbers, not {count}.")
    return reply.values
