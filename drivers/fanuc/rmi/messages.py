"""The packets of the Remote Motion Interface (B-84184EN/03 chapter 2) as bytes and as values. Pure."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final

from drivers.fanuc.rmi.framing import END
from srvs_cell.alarms import Alarm
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import PortError

LAST_SEQUENCE: Final = 2**31 - 1
"""Sequence numbers count 1 to this and start again at 1."""

UNKNOWN: Final = "Unknown"
"""The name in a reply to a packet that the controller could not read."""

_PAUSED: Final = 1
_COORDINATE_LIMIT: Final = 1e5
_POSITION_DIGITS: Final = 4
_SHOWN: Final = 120
_NUMBER_LIMIT: Final = 9999


class Kind(StrEnum):
    """The first key of every packet."""

    COMMAND = "Command"
    COMMUNICATION = "Communication"
    INSTRUCTION = "Instruction"


@dataclass(frozen=True)
class Packet:
    """A packet from the controller.

    Attributes:
        kind, name: the first key and its value.
        sequence: ``SequenceID``, where there is one.
        error_id: ``ErrorID``; None in packets that the controller sends by itself.
        fields: everything else; empty where ``error_id`` is not 0, because then it means nothing (section 2.2).
    """

    kind: Kind
    name: str
    sequence: int | None = None
    error_id: int | None = None
    fields: dict[str, Any] = field(default_factory=dict)

    def answers(self, kind: Kind, name: str) -> bool:
        """Whether this may be the reply to such a packet; the controller is not exact about upper case."""
        return self.kind is kind and self.name.casefold() in {name.casefold(), UNKNOWN.casefold()}


@dataclass(frozen=True)
class Status:
    """What ``FRC_GetStatus`` says; mode switch and alarm are not among it.

    Attributes:
        servo_ready: drives powered and no E-stop.
        pendant_enabled: ``TPMode`` is not 0.
        rmi_running: the controller's program RMI_MOVE runs or is paused.
        paused: RMI_MOVE is paused.
        single_step: single step mode is on.
        override_percent: speed override.
        next_sequence: the sequence number that the controller expects, where it says so.
    """

    servo_ready: bool
    pendant_enabled: bool
    rmi_running: bool
    paused: bool
    single_step: bool
    override_percent: int
    next_sequence: int | None


@dataclass(frozen=True)
class Configuration:
    """Which of the arm's postures reaches a pose, and in which frames the pose is given."""

    user_tool: int
    user_frame: int
    front: int
    up: int
    left: int
    flip: int
    turn_4: int
    turn_5: int
    turn_6: int


_CONFIGURATION_KEYS: Final = {
    "user_tool": "UToolNumber",
    "user_frame": "UFrameNumber",
    "front": "Front",
    "up": "Up",
    "left": "Left",
    "flip": "Flip",
    "turn_4": "Turn4",
    "turn_5": "Turn5",
    "turn_6": "Turn6",
}


@dataclass(frozen=True)
class Place:
    """Where the TCP is, in the frames that ``configuration`` names."""

    pose: Xyzwpr
    configuration: Configuration


class Path(StrEnum):
    """The two instructions that move the TCP to a pose."""

    LINEAR = "FRC_LinearMotion"
    JOINT = "FRC_JointMotion"


_SPEED_TYPES: Final = {Path.LINEAR: "mmSec", Path.JOINT: "Percent"}


def encode(kind: Kind, name: str, fields: dict[str, Any]) -> bytes:
    """Return one packet with its line end; the key of the kind comes first, as the controller demands (RMIT-022)."""
    return json.dumps({kind.value: name, **fields}, allow_nan=False).encode("ascii") + END


def move_fields(target: Xyzwpr, configuration: Configuration, path: Path, speed: float) -> dict[str, Any]:
    """Return the fields of a move that ends standing (FINE), besides ``SequenceID``.

    Args:
        target: in the frames of ``configuration``.
        configuration: the posture that the arm is in.
        path: how to get there.
        speed: mm/s or per cent; the wire takes whole numbers, rounded down so that it is never exceeded.
    """
    return {
        "Configuration": {key: getattr(configuration, name) for name, key in _CONFIGURATION_KEYS.items()},
        "Position": {
            key: round(value, _POSITION_DIGITS) for key, value in zip("XYZWPR", target.as_tuple(), strict=True)
        },
        "SpeedType": _SPEED_TYPES[path],
        "Speed": int(speed),
        "TermType": "FINE",
        "TermValue": 0,
    }


def decode(line: bytes) -> Packet:
    """Read one line.

    Raises:
        PortError: PROTOCOL_ERROR where it is no packet of the interface; the detail quotes it.
    """
    try:
        content = json.loads(line.decode("ascii"))
    except (ValueError, RecursionError) as error:
        raise _wrong(line, "is no JSON") from error
    if not isinstance(content, dict) or not content:
        raise _wrong(line, "is no packet")
    first, name = next(iter(content.items()))
    if first not in set(Kind) or not isinstance(name, str) or not _readable(name):
        raise _wrong(line, "does not begin with Command, Communication or Instruction")
    error_id, sequence = content.get("ErrorID"), content.get("SequenceID")
    for value in (error_id, sequence):
        if value is not None and (not isinstance(value, int) or isinstance(value, bool)):
            raise _wrong(line, "has an ErrorID or SequenceID that is no whole number")
    fields = {key: value for key, value in content.items() if key not in {first, "ErrorID", "SequenceID"}}
    return Packet(Kind(first), name, sequence, error_id, {} if error_id else fields)


def read_status(reply: Packet) -> Status:
    """Read a reply to ``FRC_GetStatus``; raises as `whole`."""
    sequence = reply.fields.get("NextSequenceID")
    return Status(
        servo_ready=whole(reply, "ServoReady") == 1,
        pendant_enabled=whole(reply, "TPMode") != 0,
        rmi_running=whole(reply, "RMIMotionStatus") != 0,
        paused=whole(reply, "ProgramStatus") == _PAUSED,
        single_step=whole(reply, "SingleStepMode") != 0,
        override_percent=whole(reply, "Override", 0, 100),
        next_sequence=whole(reply, "NextSequenceID", 1, LAST_SEQUENCE) if sequence else None,
    )


def read_place(reply: Packet) -> Place:
    """Read a reply to ``FRC_ReadCartesianPosition``; raises as `whole`."""
    position = _inner(reply, "Position")
    inner = _inner(reply, "Configuration")
    numbers = {name: whole(inner, key, -_NUMBER_LIMIT, _NUMBER_LIMIT) for name, key in _CONFIGURATION_KEYS.items()}
    return Place(Xyzwpr(*(_real(position, key) for key in "XYZWPR")), Configuration(**numbers))


def read_errors(reply: Packet) -> str | None:
    """Read a reply to ``FRC_ReadError``: the newest alarm, spelt as on the pendant, or None."""
    text = reply.fields.get("ErrorData")
    if not isinstance(text, str):
        raise _missing(reply, "ErrorData", "text")
    cleaned = "".join(char if _readable(char) else "?" for char in " ".join(text.split())[:_SHOWN])
    return None if cleaned.casefold() in {"", "no error"} else cleaned


def whole(reply: Packet, key: str, low: int = -LAST_SEQUENCE, high: int = LAST_SEQUENCE) -> int:
    """Return a whole number of a reply; raises `PortError` PROTOCOL_ERROR where it is missing or out of bounds."""
    value = reply.fields.get(key)
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise _missing(reply, key, f"a whole number from {low} to {high}")
    return value


def _readable(text: str) -> bool:
    """Return whether a page, a log and a database can hold a text; JSON may escape what they cannot."""
    return text.isascii() and text.isprintable()


def _real(reply: Packet, key: str) -> float:
    value = reply.fields.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _COORDINATE_LIMIT:
        raise _missing(reply, key, f"a number within +-{_COORDINATE_LIMIT:.0f}")  # NaN comes here, too
    return float(value)


def _inner(reply: Packet, key: str) -> Packet:
    value = reply.fields.get(key)
    if not isinstance(value, dict):
        raise _missing(reply, key, "a group of numbers")
    return Packet(reply.kind, f"{reply.name} {key}", fields=value)


def _missing(reply: Packet, key: str, wanted: str) -> PortError:
    shown = repr(reply.fields.get(key))[:_SHOWN]
    return PortError(Alarm.PROTOCOL_ERROR, f"{reply.name}: {key} reads {shown}, not {wanted}.")


def _wrong(line: bytes, what: str) -> PortError:
    return PortError(Alarm.PROTOCOL_ERROR, f"The packet {line[:_SHOWN]!r} {what}.")
