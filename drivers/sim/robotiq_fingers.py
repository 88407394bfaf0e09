"""The fingers of the Robotiq double: in a script, or in the simulated world.

Positions count from 0 (open) to 255 (closed).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager

SLOWEST, FASTEST = 60.0, 450.0
"""Counts per second: about 20 and 150 mm/s of a 2F-85."""

ENDS: Final = (3, 230)
"""Where open and closed fingers stand."""

_HALF_WAY: Final = 128


class Contact(IntEnum):
    """What the fingers feel, as the two bits gOBJ say it."""

    MOVING = 0
    WHILE_OPENING = 1
    WHILE_CLOSING = 2
    ARRIVED = 3


class Fingers(Protocol):
    """What a gripper's motor moves."""

    @property
    def position(self) -> float:
        """Where they are."""
        ...

    def go(self, request: int, speed: float) -> None:
        """Begin to move to a position with so many counts per second."""
        ...

    def stand(self) -> None:
        """Stay where they are: the motor has no power."""
        ...

    def contact(self) -> Contact:
        """Say what they feel on the way to the position asked for last."""
        ...


@dataclass
class _Way:
    """A motion: from a position, towards one, since when, how fast in counts per second."""

    start: float = float(ENDS[0])
    target: float = float(ENDS[0])
    begun_s: float = 0.0
    speed: float = FASTEST

    def at(self, now_s: float) -> float:
        gone = (now_s - self.begun_s) * self.speed
        span = self.target - self.start
        return self.target if gone >= abs(span) else self.start + (gone if span > 0 else -gone)


class ScriptedFingers:
    """Fingers that meet what a test puts between them.

    Attributes:
        part_at: position at which closing fingers meet a part; None where there is none.
        jam_at: position at which opening fingers are stopped; None where they are not.
        stuck: they do not move, and the gripper goes on saying that they do.
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        self.part_at: int | None = None
        self.jam_at: int | None = None
        self.stuck = False
        self._now_s = now_s
        self._request = 0
        self._way = _Way()

    @property
    def position(self) -> float:
        """Where they are."""
        return self._way.at(self._now_s())

    def go(self, request: int, speed: float) -> None:
        """Begin to move, as far as what is in the way lets them."""
        self._request = request
        if not self.stuck:
            self._begin(self._target(), speed)

    def stand(self) -> None:
        """Stay."""
        here = self.position
        self._way = _Way(here, here)

    def contact(self) -> Contact:
        """Say what they feel."""
        if self.position != self._way.target or self.stuck:
            return Contact.MOVING
        asked = self._asked()
        if self._way.target == asked:
            return Contact.ARRIVED
        return Contact.WHILE_CLOSING if asked > self._way.target else Contact.WHILE_OPENING

    def lose_part(self) -> None:
        """Let the part slip out: they go on to the position that was asked for."""
        self.part_at = None
        self._begin(self._target(), self._way.speed)

    def slip_to(self, position: int) -> None:
        """Let the part turn between them; they follow it to another position."""
        self.part_at = position
        self._begin(position, self._way.speed)

    def _asked(self) -> float:
        return float(min(max(self._request, ENDS[0]), ENDS[1]))

    def _target(self) -> float:
        """Where they will end: at what was asked for, at their stops, at a part, at what jams them."""
        target, here = self._asked(), self.position
        if self.part_at is not None and here <= self.part_at < target:
            return float(self.part_at)
        if self.jam_at is not None and target < self.jam_at <= here:
            return float(self.jam_at)
        return target

    def _begin(self, target: float, speed: float) -> None:
        self._way = _Way(self.position, target, self._now_s(), speed)


class Jaws(Protocol):
    """The part of the simulated world that a gripper moves."""

    @property
    def opening_mm(self) -> float:
        """Distance between the inner faces."""
        ...

    @property
    def fully_open(self) -> bool:
        """Whether they stand at their open end."""
        ...

    @property
    def fully_closed(self) -> bool:
        """Whether they touch each other."""
        ...

    def held_part(self) -> int | None:
        """Return the part that both press on, or None."""
        ...

    def close_jaws(self) -> None:
        """Press together."""
        ...

    def open_jaws(self) -> None:
        """Move apart."""
        ...


class WorldFingers:
    """Fingers of the simulated world, which opens and closes them all the way with the force and speed of its own.

    Args:
        jaws: of the world.
        lock: guards the world.
        max_opening_mm: opening at their open end.
    """

    def __init__(self, jaws: Jaws, lock: AbstractContextManager[object], max_opening_mm: float) -> None:
        self._jaws, self._lock, self._max_opening_mm = jaws, lock, max_opening_mm
        self._closing = False

    @property
    def position(self) -> float:
        """Where they are."""
        with self._lock:
            share = min(max(self._jaws.opening_mm / self._max_opening_mm, 0.0), 1.0)
        return ENDS[1] + share * (ENDS[0] - ENDS[1])

    def go(self, request: int, speed: float) -> None:
        """Close for a position beyond the middle, else open."""
        del speed
        self._closing = request >= _HALF_WAY
        with self._lock:
            if self._closing:
                self._jaws.close_jaws()
            else:
                self._jaws.open_jaws()

    def stand(self) -> None:
        """Go on pressing: a 2F holds what it holds without power."""

    def contact(self) -> Contact:
        """Say what they feel."""
        with self._lock:
            if self._jaws.fully_closed if self._closing else self._jaws.fully_open:
                return Contact.ARRIVED
            if self._closing and self._jaws.held_part() is not None:
                return Contact.WHILE_CLOSING
        return Contact.MOVING
