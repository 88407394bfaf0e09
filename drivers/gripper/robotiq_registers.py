"""The registers of a Robotiq 2F gripper as words and as values (2F-85 & 2F-140 instruction manual, section 4). Pure.

Three words are written from `FIRST_OUTPUT` on and three are read from `FIRST_INPUT` on; a word holds two of the
manual's bytes, the lower-numbered one above.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from srvs_cell.alarms import Alarm
from srvs_cell.ports import PortError

if TYPE_CHECKING:
    from collections.abc import Sequence

FIRST_OUTPUT: Final = 0x03E8
FIRST_INPUT: Final = 0x07D0
WORD_COUNT: Final = 3

FULLY_OPEN: Final = 0
FULLY_CLOSED: Final = 255
"""What is asked for; the fingers end a few counts before either and still report that they have arrived."""

_COUNTS: Final = 255
_WORD: Final = 0xFFFF
_BYTE: Final = 0xFF
_BYTE_BITS: Final = 8
_NIBBLE: Final = 0x0F
_MA_PER_COUNT: Final = 10
_ACT: Final = 0x01
_GTO: Final = 0x08
_STA_SHIFT: Final = 4
_OBJ_SHIFT: Final = 6
_TWO_BITS: Final = 0x03
_FEWEST_POINTS: Final = 2


class Action(IntFlag):
    """Byte 0 of the output: rACT and rGTO. rATR and rARD, the automatic release, are left to the robot's own program.

    The release opens or closes the fingers slowly whatever they hold, and asks for a new activation.
    """

    ACTIVATE = 0x01
    GO = 0x08


class Activation(IntEnum):
    """The two bits gSTA; 2 is not used."""

    RESET = 0
    ACTIVATING = 1
    ACTIVE = 3


class Contact(IntEnum):
    """The two bits gOBJ; they mean something only while gGTO is 1."""

    MOVING = 0
    WHILE_OPENING = 1
    WHILE_CLOSING = 2
    ARRIVED = 3


@dataclass(frozen=True)
class Status:
    """One reading of the gripper.

    Attributes:
        activated: gACT, echo of rACT.
        going: gGTO, echo of rGTO; False while it is activated or releases.
        activation: gSTA.
        contact: gOBJ.
        fault: gFLT, see `robotiq_faults`.
        controller_fault: kFLT, of the universal controller where there is one.
        request: gPR, echo of the position asked for last, 0 open to 255 closed.
        position: gPO, where the fingers are, in the same counts.
        current_ma: gCU, of the motor.
    """

    activated: bool
    going: bool
    activation: Activation
    contact: Contact
    fault: int
    controller_fault: int
    request: int
    position: int
    current_ma: int


def decode(words: Sequence[int]) -> Status:
    """Read the words from `FIRST_INPUT` on; raises `PortError` PROTOCOL_ERROR where they are no gripper's."""
    shown = " ".join(f"{word:04X}" for word in words)
    if len(words) != WORD_COUNT or not all(0 <= word <= _WORD for word in words):
        raise PortError(Alarm.PROTOCOL_ERROR, f"The gripper's status is {WORD_COUNT} words, not {shown or 'nothing'}.")
    state, echo = words[0] >> _BYTE_BITS, words[1] & _BYTE
    activation = state >> _STA_SHIFT & _TWO_BITS
    if activation not in set(Activation):
        raise PortError(
            Alarm.PROTOCOL_ERROR, f"The gripper's status {shown} has gSTA = {activation}, which is no state."
        )
    faults = words[1] >> _BYTE_BITS
    return Status(
        activated=bool(state & _ACT),
        going=bool(state & _GTO),
        activation=Activation(activation),
        contact=Contact(state >> _OBJ_SHIFT),
        fault=faults & _NIBBLE,
        controller_fault=faults >> _STA_SHIFT,
        request=echo,
        position=words[2] >> _BYTE_BITS,
        current_ma=(words[2] & _BYTE) * _MA_PER_COUNT,
    )


def encode(action: Action, request: int = 0, speed: int = 0, force: int = 0) -> list[int]:
    """Return the words from `FIRST_OUTPUT` on.

    Args:
        action: rACT and rGTO.
        request: rPR, 0 open to 255 closed.
        speed: rSP, 0 to 255.
        force: rFR, 0 to 255; from 1 on the gripper closes on when the part slips or yields.

    Raises:
        ValueError: a count outside 0 to 255.
    """
    for name, value in (("rPR", request), ("rSP", speed), ("rFR", force)):
        if not 0 <= value <= _COUNTS:
            raise ValueError(f"{name} = {value} is outside 0 to {_COUNTS}")
    return [int(action) << _BYTE_BITS, request, speed << _BYTE_BITS | force]


@dataclass(frozen=True)
class Model:
    """What a model can do (manual, section 6.1).

    Attributes:
        stroke_mm: opening of the open fingers.
        speed_mm_s: least and greatest speed.
        force_n: least and greatest grip force.
    """

    stroke_mm: float
    speed_mm_s: tuple[float, float]
    force_n: tuple[float, float]


MODELS: Final = {
    "2f85": Model(85.0, (20.0, 150.0), (20.0, 235.0)),
    "2f140": Model(140.0, (30.0, 250.0), (10.0, 125.0)),
}

_USUAL_OPEN, _USUAL_CLOSED = 3, 230
"""Counts that a 2F reports at its ends with its own finger tips (Robotiq's knowledge base)."""


def to_count(value: float, bounds: tuple[float, float]) -> int:
    """Return the count 0 to 255 that stands for a speed or force between its bounds; linear, as the manual has it."""
    least, greatest = bounds
    return round(_COUNTS * (value - least) / (greatest - least))


@dataclass(frozen=True)
class Stroke:
    """How far the fingers are open at a position: measured points, straight lines between them.

    Attributes:
        points: (gPO, opening in mm), at least two, counts rising and openings falling.
    """

    points: tuple[tuple[int, float], ...]

    def __post_init__(self) -> None:
        falls = all(a[0] < b[0] and a[1] > b[1] for a, b in pairwise(self.points))
        if len(self.points) < _FEWEST_POINTS or not falls:
            raise ValueError(f"stroke needs two or more points with rising counts and falling openings: {self.points}")

    @classmethod
    def usual(cls, model: Model) -> Stroke:
        """Return the line between the usual ends of a model that nobody has measured."""
        return cls(((_USUAL_OPEN, model.stroke_mm), (_USUAL_CLOSED, 0.0)))

    @property
    def widest_mm(self) -> float:
        """Opening of the open fingers."""
        return self.points[0][1]

    def opening_mm(self, position: int) -> float:
        """Return the opening at a position; beyond the ends, that of the end."""
        counts, openings = zip(*self.points, strict=True)
        return float(np.interp(position, counts, openings))

    def request(self, opening_mm: float) -> int:
        """Return the position to ask for; at or beyond the ends, 0 or 255, so that the fingers reach their stops."""
        if opening_mm >= self.widest_mm:
            return FULLY_OPEN
        if opening_mm <= self.points[-1][1]:
            return FULLY_CLOSED
        counts, openings = zip(*reversed(self.points), strict=True)
        return round(float(np.interp(opening_mm, openings, counts)))
