"""What the Remote Motion Interface says of a packet before anything is carried out: spelling, values, ErrorIDs. Pure.

Written from the operator's manual B-84184EN/03; it shares no code with the driver.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, TypeGuard

if TYPE_CHECKING:
    from collections.abc import Mapping

_RMIT: Final = 2556928
(TOOL, FRAME, BAD_OVERRIDE, CANNOT_EXECUTE) = (_RMIT + n for n in (2, 3, 5, 6))
(NO_SERVO, PENDANT, NOT_RUNNING, NOT_PAUSED) = (_RMIT + n for n in (7, 8, 9, 10))
(BAD_COMMAND, FAILED, BAD_STATE, BAD_INSTRUCTION) = (_RMIT + n for n in (13, 14, 15, 20))
(BAD_VALUE, BAD_TEXT, BAD_POSITION, IN_HOLD) = (_RMIT + n for n in (21, 22, 23, 24))
(ALREADY_CONNECTED, COMMAND_OUT, BUFFER_FULL, SEQUENCE) = (_RMIT + n for n in (26, 27, 28, 29))
(_SPEED_TYPE, _SPEED, _TERM_TYPE, _PORT, SINGLE_STEP, ASCII) = (_RMIT + n for n in (30, 31, 32, 38, 43, 49))

LAST_SEQUENCE: Final = 2**31 - 1
POSTURE: Final = ("Front", "Up", "Left", "Flip", "Turn4", "Turn5", "Turn6")
AXES: Final = "XYZWPR"
JOINTS: Final = ("J1", "J2", "J3", "J4", "J5", "J6")
_FRAME_KEYS: Final = ("UToolNumber", "UFrameNumber")
_FARTHEST: Final = 1e6
_FASTEST: Final = {"mmSec": 2**15 - 1, "Percent": 100}
_SIGNALS: Final = 512
_SPEED_TYPES: Final = {
    "FRC_LinearMotion": "mmSec",
    "FRC_LinearRelative": "mmSec",
    "FRC_JointMotion": "Percent",
    "FRC_JointRelative": "Percent",
    "FRC_JointMotionJRep": "Percent",
    "FRC_JointRelativeJRep": "Percent",
}
MOVES: Final = frozenset(_SPEED_TYPES)
JOINT_MOVES: Final = frozenset({"FRC_JointMotionJRep", "FRC_JointRelativeJRep"})
"""Moves whose target is told in joint angles."""

_ABBREVIATIONS: Final = {
    "SID": "SequenceID",
    "T4": "Turn4",
    "T5": "Turn5",
    "T6": "Turn6",
    "UTNum": "UToolNumber",
    "UFNum": "UFrameNumber",
}


def spelled_out(packet: dict[str, Any]) -> dict[str, Any]:
    """Return a packet with the keys in full that the manual lets a client abbreviate: its own and its groups'."""
    full = _with_full_keys(packet)
    return {key: _with_full_keys(value) if isinstance(value, dict) else value for key, value in full.items()}


def _with_full_keys(values: Mapping[str, Any]) -> dict[str, Any]:
    return {_ABBREVIATIONS.get(key, key): value for key, value in values.items()}


def refusal(name: str, packet: Mapping[str, Any], posture: Mapping[str, int], *, jointed: bool) -> int:
    """Return the ErrorID for which an instruction is not queued whatever the controller does, 0 where it is.

    Args:
        name: of the instruction.
        packet: all of it.
        posture: the arm's configuration; a move into another one is refused.
        jointed: whether the arm has joints that can be told to move.
    """
    if name in JOINT_MOVES and jointed:
        angles = packet.get("JointAngle")
        if not isinstance(angles, dict):
            return BAD_TEXT
        return _first((BAD_POSITION, all(is_real(angles.get(joint)) for joint in JOINTS)), *_manner(name, packet))
    if name in MOVES - JOINT_MOVES:
        position, configuration = packet.get("Position"), packet.get("Configuration")
        if not isinstance(position, dict) or not isinstance(configuration, dict):
            return BAD_TEXT
        return _first(
            (BAD_POSITION, all(is_real(position.get(axis)) for axis in AXES)),
            (BAD_POSITION, all(is_whole(configuration.get(key)) for key in (*POSTURE, *_FRAME_KEYS))),
            (BAD_POSITION, all(configuration.get(key) == value for key, value in posture.items())),
            *_manner(name, packet),
        )
    others = {
        "FRC_WaitTime": ((BAD_VALUE, is_real(packet.get("Time"))),),
        "FRC_WaitDIN": ((_PORT, _is_signal(packet.get("PortNumber"))), (BAD_VALUE, _is_switch(packet))),
        "FRC_SetUFrame": ((FRAME, is_whole(packet.get("FrameNumber"))),),
        "FRC_SetUTool": ((TOOL, is_whole(packet.get("ToolNumber"))),),
    }
    return _first(*others[name]) if name in others else BAD_INSTRUCTION


def _manner(name: str, packet: Mapping[str, Any]) -> tuple[tuple[int, bool], ...]:
    """Return the checks of how a move is made."""
    return (
        (_SPEED_TYPE, packet.get("SpeedType") == _SPEED_TYPES[name]),
        (_SPEED, is_whole(speed := packet.get("Speed")) and 1 <= speed <= _FASTEST[_SPEED_TYPES[name]]),
        (_TERM_TYPE, packet.get("TermType") in ("FINE", "CNT")),
    )


def _first(*checks: tuple[int, bool]) -> int:
    return next((error_id for error_id, passed in checks if not passed), 0)


def is_whole(value: object) -> TypeGuard[int]:
    """Whether a value is an integer of 32 bits; JSON's true is none."""
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) <= LAST_SEQUENCE


def is_real(value: object) -> TypeGuard[float]:
    """Whether a value is a number that a coordinate or a time can be; NaN, which JSON libraries read, is none."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _FARTHEST


def signal_number(packet: Mapping[str, Any]) -> int:
    """Return the number of a DI or DO; raises ValueError with the ErrorID where there is none."""
    n = packet["PortNumber"]
    if not _is_signal(n):
        raise ValueError(_PORT)
    return n


def _is_signal(value: object) -> TypeGuard[int]:
    return is_whole(value) and 1 <= value <= _SIGNALS


def _is_switch(packet: Mapping[str, Any]) -> bool:
    return packet.get("PortValue") in ("ON", "OFF")
