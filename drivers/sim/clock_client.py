"""The Clock port on a simulator's clock page: the entry point ``clock.sim``."""

from __future__ import annotations

import asyncio
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pydantic import BaseModel, ConfigDict, Field

from drivers.sim.clock_page import NO_WAKE_S, ClockPage
from srvs_cell.alarms import Alarm
from srvs_cell.ports import DriverContext, DriverSpec, NotConnectedError

if TYPE_CHECKING:
    from collections.abc import Iterator

_POLL_S: Final = 0.001
_FAR_POLL_S: Final = 0.004
_FAR_S: Final = 0.2
_LONGEST_POLL_S: Final = 0.1
_LOST_AFTER_S: Final = 4.0


class SimClockConfig(BaseModel):
    """Which simulated cell's time to keep.

    Attributes:
        path: the clock page, as the simulator names it on its first line.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    path: Path = Field(description="clock page of the simulated cell")


class SimClock:
    """Simulated time. It runs fast only while every task of this process that uses it sleeps."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._page: ClockPage | None = None
        self._lock = threading.Lock()
        self._working = 0
        self._wakes: list[float] = []

    def now_s(self) -> float:
        """Return simulated seconds.

        Raises:
            NotConnectedError: CLOCK_LOST where there is no clock page.
        """
        return self._opened().now_s

    async def sleep(self, seconds: float) -> None:
        """Return after simulated ``seconds``.

        Raises:
            NotConnectedError: CLOCK_LOST where the simulator has not shown life for 4 s of real time.
        """
        page = self._opened()
        wake_s = page.now_s + seconds
        self._wakes.append(wake_s)
        self._publish(page)
        beat_s, silent_s, last_s = page.beat_s, 0.0, time.monotonic()
        try:
            await asyncio.sleep(0)
            while (remaining_s := wake_s - page.now_s) > 0.0:
                real_s = time.monotonic()
                # a gap between two polls is this process's or the machine's own pause: it says little of the simulator
                silent_s = silent_s + min(real_s - last_s, _LONGEST_POLL_S) if page.beat_s == beat_s else 0.0
                beat_s, last_s = page.beat_s, real_s
                if silent_s > _LOST_AFTER_S:
                    raise NotConnectedError(
                        Alarm.CLOCK_LOST, f"{self._path}: no beat for {silent_s:.1f} s of real time."
                    )
                await asyncio.sleep(_POLL_S if remaining_s < _FAR_S else _FAR_POLL_S)
        finally:
            self._wakes.remove(wake_s)
            self._publish(page)

    @contextmanager
    def working(self) -> Iterator[None]:
        """Say that a computation is going on: simulated time passes no faster than real time inside the block."""
        page = self._opened()
        with self._lock:
            self._working += 1
            page.working = self._working
        try:
            yield
        finally:
            with self._lock:
                self._working -= 1
                page.working = self._working

    def _publish(self, page: ClockPage) -> None:
        with self._lock:
            page.wake_s = min(self._wakes, default=NO_WAKE_S)

    def _opened(self) -> ClockPage:
        if self._page is None:
            try:
                self._page = ClockPage.open(self._path)
            except OSError as error:
                raise NotConnectedError(Alarm.CLOCK_LOST, f"{self._path}: {error}") from error
        return self._page


def _make(config: SimClockConfig, _context: DriverContext) -> SimClock:
    return SimClock(config.path)


DRIVER = DriverSpec(SimClockConfig, _make)
