"""Types, variables and values."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field, replace
from typing import Any, Final

from drivers.sim.karel.errors import KarelAbort

STRING_CHARS: Final = 254
AXES: Final = ("X", "Y", "Z", "W", "P", "R")
_INT32: Final = 1 << 31


@dataclass(frozen=True)
class Type:
    """A type; two strings are of one type whatever their lengths."""

    name: str
    length: int = field(default=0, compare=False)
    of: Type | None = None


INTEGER, REAL, BOOLEAN = Type("INTEGER"), Type("REAL"), Type("BOOLEAN")
STRING, FILE = Type("STRING", STRING_CHARS), Type("FILE")
XYZWPR, JOINTPOS, FRAME = Type("XYZWPR"), Type("JOINTPOS"), Type("a frame")
NOTHING: Final = Type("nothing")
"""What a procedure returns."""

NAMED: Final = {type_.name: type_ for type_ in (INTEGER, REAL, BOOLEAN, STRING, FILE, XYZWPR, JOINTPOS)}


@dataclass
class Pose:
    """An XYZWPR: elements in mm and degrees, and the configuration that is handed on with it."""

    elements: dict[str, float]
    configuration: str


class Cell:
    """A variable; None is one that was never written."""

    __slots__ = ("type", "value")

    def __init__(self, type_: Type, value: Any = None) -> None:
        self.type = type_
        self.value = value
        if value is None and type_.of is not None:
            self.value = [Cell(type_.of) for _ in range(type_.length)]
        elif value is None and type_ == FILE:
            self.value = FileVariable()

    def set(self, value: Any) -> None:
        """Write a value as the variable holds it: strings are cut, reals have 32 bits, structures are copied."""
        name = self.type.name
        if name == "STRING":
            value = value[: self.type.length]
        elif name == "REAL":
            value = real(value)
        elif isinstance(value, Pose):
            value = replace(value, elements=dict(value.elements))
        self.value = value


@dataclass
class FileVariable:
    """What a FILE variable knows.

    Attributes:
        device: what is open, or None.
        status: of the last operation; 0 is good.
        attributes: set with SET_FILE_ATR.
    """

    device: str | None = None
    status: int = 0
    attributes: set[int] = field(default_factory=set)


def integer(value: int) -> int:
    """Return an integer that fits; raises `KarelAbort` where it does not."""
    if not -_INT32 <= value < _INT32:
        raise KarelAbort("INTP-323 Value overflow")
    return value


def real(value: float) -> float:
    """Return a number as 32 bits hold it."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])
