"""A camera that does not exist: OpenCV's VideoCapture in stepped time, with a queue of old frames."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from numpy.typing import NDArray

    from tests.drivers.stepped import SteppedClock, SteppedTime

PERIOD_S = 0.04


async def going_on(clock: SteppedClock, work: Coroutine[Any, Any, None]) -> None:
    """Let time go on while something waits for the camera's thread."""

    async def tick() -> None:
        while True:
            await clock.sleep(1.0)

    ticking = asyncio.create_task(tick())
    try:
        await work
    finally:
        ticking.cancel()


class ScriptedVideo:
    """``cv2.VideoCapture`` of a device that exposes a frame every `PERIOD_S` and hands it out ``lag`` frames later.

    Attributes:
        stuck: property -> the value that it keeps whatever is written.
        fails: every grab fails at once, as after an unplug.
        frozen_at_s: every frame carries this stamp.
        stamp_offset_s: error of the stamps.
        broken: pictures cannot be decoded.
        begins_at_s: before this no frame comes, and a grab waits for it.
        holds_s: a grab is held so long and ends without a frame, as of a frozen device.
    """

    def __init__(self, time: SteppedTime, lag: int = 4, size_px: tuple[int, int] = (64, 48)) -> None:
        self.opened = True
        self.released = False
        self.fails = False
        self.broken = False
        self.begins_at_s = 0.0
        self.holds_s: float | None = None
        self.frozen_at_s: float | None = None
        self.stamp_offset_s = 0.0
        self.stuck: dict[int, float] = {}
        self._misdated = 0
        self.retrieved = 0
        self.grabbed = 0
        self.size_px = size_px
        self._time = time
        self._queue: deque[tuple[int, float]] = deque(maxlen=lag + 1)
        self._current = (0, 0.0)
        self._values: dict[int, float] = {}

    def isOpened(self) -> bool:
        return self.opened

    def grab(self) -> bool:
        if self.holds_s is not None:
            self._time.sleep(self.holds_s)
            return False
        self._time.sleep(max(PERIOD_S, self.begins_at_s - self._time.now_s()))
        if self.fails:
            return False
        self.grabbed += 1
        stamp_s = self._time.now_s() if self.frozen_at_s is None else self.frozen_at_s
        self._queue.append((self.grabbed, stamp_s))
        self._current = self._queue[0]
        if self._misdated > 0:
            self._misdated -= 1
            self._current = (self._current[0], self._time.now_s() + 0.2)
        return True

    def misdate(self, count: int) -> None:
        """Stamp the next frames with an instant that is still to come, as vivid does."""
        self._misdated = count

    def retrieve(self) -> tuple[bool, NDArray[np.uint8] | None]:
        self.retrieved += 1
        if self.broken:
            return False, None
        width, height = self.size_px
        return True, np.full((height, width, 3), self._current[0] % 256, np.uint8)

    def set(self, prop: int, value: float, /) -> bool:
        self._values[prop] = value
        return True

    def get(self, prop: int, /) -> float:
        if prop == cv2.CAP_PROP_POS_MSEC:
            return (self._current[1] + self.stamp_offset_s) * 1000.0
        return self.stuck.get(prop, self._values.get(prop, -1.0))

    def release(self) -> None:
        self.released = True
