"""The words that PC and robot share, and how they are packed: docs/reference/modbus-map.md in code.

Words are numbered from 1 as ``%R`` words are on the controller. A 32-bit value takes two words, the low word first;
lengths are micrometres, angles are millidegrees, so that the robot's program can add them up exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Final

from srvs_cell.alarms import Alarm
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import PortError, RobotMode

PROTOCOL: Final = 4201
"""Magic 42 and protocol version 01; an unassigned word reads 0, so 0 can never be mistaken for a robot."""

FIRST_WORD: Final = 12001
WORD_COUNT: Final = 49
ROBOT_HEARTBEAT_WORD: Final = 12005
SEQUENCE_WORD: Final = 12031
PC_HEARTBEAT_WORD: Final = 12032
COMMAND_WORD: Final = 12033

COUNTER_LIMIT: Final = 30_000
"""Sequence and heartbeat count 1 to this and start again at 1: one word, never negative, never 0."""

MICRO: Final = 1000
_INT32 = 1 << 32
_INT32_SIGN = 1 << 31
_WORD_MASK = 0xFFFF
_WORD_BITS = 16
_CHECKSUM_SEED = PROTOCOL


class Command(IntEnum):
    """R[102], what the robot is asked to do."""

    MOVE_LINEAR = 1
    MOVE_JOINT = 2


class State(IntEnum):
    """R[112], what has become of the last command."""

    IDLE = 0
    BUSY = 1
    DONE = 2
    FAULT = 3


class FaultCode(IntEnum):
    """R[113], why the robot's program did not finish a command; below 20 nothing has moved."""

    NONE = 0
    UNKNOWN_COMMAND = 1
    CHECKSUM = 2
    POSITION_RANGE = 3
    SPEED_RANGE = 4
    FRAME = 5
    PC_HEARTBEAT = 6
    HOLD_ACTIVE = 7
    STOPPED = 20
    STOPPED_BY_WATCHDOG = 21


FIRST_FAULT_IN_MOTION: Final = 20


class UopOutput(IntFlag):
    """UO[1] to UO[8] in one word, UO[1] in bit 0 (B-83284EN section 3.3)."""

    CMDENBL = 1
    SYSRDY = 2
    PROGRUN = 4
    PAUSED = 8
    HELD = 16
    FAULT = 32
    ATPERCH = 64
    TPENBL = 128


_MODES = {1: RobotMode.AUTO, 2: RobotMode.T1, 3: RobotMode.T2}
_FACILITIES = {7: "MEMO", 9: "TPIF", 11: "SRVO", 12: "INTP", 13: "PRIO", 15: "MOTN", 24: "SYST"}


@dataclass(frozen=True)
class Snapshot:
    """One reading of all words.

    Attributes:
        protocol: R[100].
        acknowledged: R[111], the sequence number that was finished last.
        state: R[112], not yet checked to be a `State`.
        fault_code: R[113].
        robot_heartbeat: R[114].
        mode: R[116].
        uop: UO[1] to UO[16].
        alarm: the controller's active alarm as on the pendant ("SRVO-050"), or None.
        pose: POS[15], in the active user frame.
        override_percent, user_frame, user_tool: as on the pendant.
        sequence: R[101], the last sequence number a PC has written.
    """

    protocol: int
    acknowledged: int
    state: int
    fault_code: int
    robot_heartbeat: int
    mode: RobotMode
    uop: UopOutput
    alarm: str | None
    pose: Xyzwpr
    override_percent: int
    user_frame: int
    user_tool: int
    sequence: int

    @property
    def busy(self) -> bool:
        """Whether a command is being carried out or waits to be taken."""
        return self.state == State.BUSY or self.acknowledged != self.sequence


def to_words(value: int) -> list[int]:
    """Split a 32-bit signed integer into two words, low word first."""
    unsigned = value % _INT32
    return [unsigned & _WORD_MASK, unsigned >> _WORD_BITS]


def from_words(low: int, high: int) -> int:
    """Join two words, low word first, into a 32-bit signed integer."""
    unsigned = low | high << _WORD_BITS
    return unsigned - _INT32 if unsigned & _INT32_SIGN else unsigned


def alarm_name(facility: int, number: int) -> str | None:
    """Return a controller alarm as the pendant spells it; None where there is none."""
    if facility == 0 and number == 0:
        return None
    return f"{_FACILITIES.get(facility, f'facility {facility}')}-{number:03d}"


def decode(words: list[int]) -> Snapshot:
    """Read the `WORD_COUNT` words from `FIRST_WORD` on.

    Raises:
        PortError: PROTOCOL_VERSION where the words are not those of this release's robot programs.
    """
    protocol = words[0]
    if protocol != PROTOCOL:
        where = f"word %R{FIRST_WORD} (R[100]) reads {protocol}, not {PROTOCOL}"
        if not any(words):
            where += "; all words read 0: $SNPX_ASG does not map them, or the program SRVS has not run yet"
        raise PortError(Alarm.PROTOCOL_VERSION, f"{where}.")
    micro = [from_words(low, high) for low, high in zip(words[9:21:2], words[10:21:2], strict=True)]
    return Snapshot(
        protocol=protocol,
        acknowledged=words[1],
        state=words[2],
        fault_code=words[3],
        robot_heartbeat=words[4],
        mode=_MODES.get(words[5], RobotMode.UNKNOWN),
        uop=UopOutput(words[6] & 0xFF),  # UO[9] and up say nothing about readiness
        alarm=alarm_name(words[7], words[8]),
        pose=Xyzwpr(*(value / MICRO for value in micro)),
        override_percent=from_words(words[21], words[22]),
        user_frame=from_words(words[23], words[24]),
        user_tool=from_words(words[25], words[26]),
        sequence=words[30],
    )


def next_sequence(sequence: int) -> int:
    """Return the sequence number after ``sequence``: 1 to `COUNTER_LIMIT`, then 1 again."""
    return sequence % COUNTER_LIMIT + 1


def checksum(sequence: int, command: int, micro: list[int]) -> int:
    """Return ``4201 + 1 seq + 2 cmd + 3 X + 4 Y + 5 Z + 6 W + 7 P + 8 R + 9 speed`` of the integers that are sent.

    Weights make exchanged values visible; with coordinates up to 10 m the sum stays below 2**31, so that the robot
    adds the same integers in its R registers without rounding.
    """
    return _CHECKSUM_SEED + sum(weight * value for weight, value in enumerate([sequence, command, *micro], start=1))


def encode(sequence: int, command: Command, target: Xyzwpr, speed: float) -> list[int]:
    """Return the words from `COMMAND_WORD` on.

    Args:
        sequence: the number that will be written to `SEQUENCE_WORD` afterwards; the checksum covers it.
        command: what to do.
        target: base_T_tcp.
        speed: mm/s of a linear move, percent of a joint move.
    """
    micro = [round(value * MICRO) for value in (*target.as_tuple(), speed)]
    words = [int(command)]
    for value in (*micro, checksum(sequence, command, micro)):
        words += to_words(value)
    return words
