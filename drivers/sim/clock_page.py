"""The page of shared memory through which a process keeps the simulated time: four aligned 8-byte cells.

The simulator writes the time and its beat; the process that is simulated for writes what it is doing. Each cell has
one writer.
"""

from __future__ import annotations

import mmap
import struct
from typing import TYPE_CHECKING, Final, Self

if TYPE_CHECKING:
    from pathlib import Path

_MAGIC: Final = struct.unpack("<d", b"SRVSCLK1")[0]
_MAGIC_CELL, _NOW_CELL, _BEAT_CELL, _WORKING_CELL, _WAKE_CELL = range(5)
_SIZE: Final = 4096
_CELL_BYTES: Final = 8
NO_WAKE_S: Final = -1.0


class ClockPageError(OSError):
    """The file is no clock page."""


class ClockPage:
    """The page, open in this process."""

    def __init__(self, path: Path, *, create: bool) -> None:
        if create:
            path.write_bytes(bytes(_SIZE))
        with path.open("r+b") as file:
            if path.stat().st_size != _SIZE:
                raise ClockPageError(f"{path} has {path.stat().st_size} bytes, a clock page has {_SIZE}")
            self._map = mmap.mmap(file.fileno(), _SIZE)
        self._cells = memoryview(self._map).cast("d")
        if create:
            self._cells[_WAKE_CELL] = NO_WAKE_S
            self._cells[_MAGIC_CELL] = _MAGIC
        elif self._cells[_MAGIC_CELL] != _MAGIC:
            self.close()
            raise ClockPageError(f"{path} is no clock page of this version")

    @classmethod
    def create(cls, path: Path) -> Self:
        """Make the page, as the simulator does."""
        return cls(path, create=True)

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a page that a simulator has made; raises `OSError`."""
        return cls(path, create=False)

    def close(self) -> None:
        """Let go of the page."""
        self._cells.release()
        self._map.close()

    @property
    def now_s(self) -> float:
        """Simulated seconds."""
        return self._cells[_NOW_CELL]

    @now_s.setter
    def now_s(self, value: float) -> None:
        self._cells[_NOW_CELL] = value

    @property
    def beat_s(self) -> float:
        """When the simulator last showed life, CLOCK_MONOTONIC seconds."""
        return self._cells[_BEAT_CELL]

    @beat_s.setter
    def beat_s(self, value: float) -> None:
        self._cells[_BEAT_CELL] = value

    @property
    def working(self) -> int:
        """How many computations the process has going on."""
        return int(self._cells[_WORKING_CELL])

    @working.setter
    def working(self, value: int) -> None:
        self._cells[_WORKING_CELL] = float(value)

    @property
    def wake_s(self) -> float:
        """When the first of the process's sleeping tasks wants to wake, or `NO_WAKE_S`."""
        return self._cells[_WAKE_CELL]

    @wake_s.setter
    def wake_s(self, value: float) -> None:
        self._cells[_WAKE_CELL] = value
