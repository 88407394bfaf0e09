"""The virtual stream of the simulated camera: exposures on simulated time, a short queue, pictures on demand.

Like a V4L2 driver it hands out the oldest frame first and drops new ones while the queue is full, so that after a
pause the first frames are stale. What is queued is where everything was at the exposure; a picture is only rendered
for the frame whose pixels somebody wants.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from drivers.sim.renderer import Renderer
    from drivers.sim.sensor import Sensor
    from drivers.sim.world import Snapshot

FRAME_RATE_HZ: Final = 15.0


@dataclass(frozen=True, eq=False)
class Exposure:
    """A frame of the stream.

    Attributes:
        sequence: counts exposures, dropped ones too.
        stamp_s: start of exposure, simulated seconds.
        snapshot: where everything was.
    """

    sequence: int
    stamp_s: float
    snapshot: Snapshot


class Seen(Protocol):
    """What a stream asks of a world."""

    @property
    def time_s(self) -> float:
        """Simulated seconds."""
        ...

    def snapshot(self) -> Snapshot:
        """Return where everything is now."""
        ...


class CameraStream:
    """Exposes frames as time goes on. `step` and `take` are called under the world's lock.

    Args:
        world: what is seen.
        lag_s: from exposure to the moment at which a frame can be had.
        depth: of the queue.

    Attributes:
        running: while false, no frame is exposed any more.
        frozen: while true, the device repeats its last exposure, time stamp included.
    """

    def __init__(self, world: Seen, lag_s: float, depth: int) -> None:
        self.running = True
        self.frozen = False
        self._world, self._lag_s, self._depth = world, lag_s, depth
        self._queue: deque[Exposure] = deque()
        self._sequence = 0
        self._next_s = 0.0
        self._last: Exposure | None = None

    def step(self) -> None:
        """Expose a frame when it is time."""
        if self._world.time_s < self._next_s:
            return
        self._next_s = self._world.time_s + 1.0 / FRAME_RATE_HZ
        if not self.running:
            return
        self._sequence += 1
        if len(self._queue) >= self._depth:
            return
        if self.frozen and self._last is not None:
            exposure = Exposure(self._sequence, self._last.stamp_s, self._last.snapshot)
        else:
            exposure = Exposure(self._sequence, self._world.time_s, self._world.snapshot())
        self._last = exposure
        self._queue.append(exposure)

    def take(self) -> Exposure | None:
        """Return the oldest frame that can be had by now, or None."""
        if self._queue and self._queue[0].stamp_s + self._lag_s <= self._world.time_s:
            return self._queue.popleft()
        return None


class PictureMaker:
    """Renders exposures, one at a time; the same exposure always gives the same picture."""

    def __init__(self, renderer: Renderer, sensor: Sensor, seed: int) -> None:
        self._renderer, self._sensor, self._seed = renderer, sensor, seed
        self._lock = threading.Lock()

    def picture(self, exposure: Exposure) -> NDArray[np.uint8]:
        """Return the 8-bit picture, shape (H, W)."""
        random = np.random.default_rng([self._seed, 2, exposure.sequence])
        with self._lock:
            irradiance = self._renderer.render(exposure.snapshot)
        return self._sensor.expose(irradiance, random)
