"""Simulated time and a point-like arm for tests of drivers against doubles.

Time advances only when every task of the event loop waits for the clock or has an answer outstanding that the double
will give without time passing, and every thread of the double has dealt with what came and sleeps: nothing depends on
the machine's speed.
"""

from __future__ import annotations

import asyncio
import contextlib
import heapq
import itertools
import math
import threading
from typing import TYPE_CHECKING

from drivers.sim.controlled_arm import MotionRefusedError
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import RobotMode

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_QUIET_ROUNDS = 5
_BUSY_ROUNDS = 100
"""So often an answer is looked for at once; one that takes longer may take a wire's whole time-out."""

_LOOK_AGAIN_S = 0.002
"""A thread that ends tells nobody, so it is looked for."""


class SteppedTime:
    """Simulated time for the threads of a double."""

    def __init__(self) -> None:
        self._now_s = 100.0
        self._wakes: dict[threading.Thread, float] = {}
        self._holds = 0
        self._wires: list[Callable[[], bool]] = []
        self._released = False
        self._changed = threading.Condition()

    def now_s(self) -> float:
        return self._now_s

    @contextlib.contextmanager
    def hold(self) -> Iterator[None]:
        with self._changed:
            self._holds += 1
        try:
            yield
        finally:
            with self._changed:
                self._holds -= 1
                self._changed.notify_all()

    def hold_while(self, unread: Callable[[], bool]) -> None:
        self._wires.append(unread)

    @property
    def held(self) -> bool:
        """Whether a double has not yet dealt with what came over its wire."""
        return any(unread() for unread in self._wires) or self._holds > 0

    def awake(self, thread: threading.Thread | None) -> bool:
        """Whether a thread has work to do: it has begun, does not sleep here and has not ended."""
        return thread is not None and thread.is_alive() and thread not in self._wakes

    def sleep(self, seconds: float) -> None:
        me = threading.current_thread()
        with self._changed:
            wake_s = self._now_s + seconds
            self._wakes[me] = wake_s
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._released or self._now_s >= wake_s)
            self._wakes.pop(me, None)

    def release(self) -> None:
        """Let every sleeping thread go for good, at the end of a test."""
        with self._changed:
            self._released = True
            self._changed.notify_all()

    def advance_to(self, target_s: float) -> None:
        """Go to ``target_s``, stopping at every instant at which a thread wants to wake and waiting for its work."""
        with self._changed:
            self._settle([])
            while self._wakes and (wake_s := min(self._wakes.values())) <= target_s:
                self._now_s = max(self._now_s, wake_s)
                due = [thread for thread, at_s in self._wakes.items() if at_s <= self._now_s]
                for thread in due:
                    del self._wakes[thread]
                self._changed.notify_all()
                self._settle(due)
            self._now_s = max(self._now_s, target_s)
            self._changed.notify_all()

    def _settle(self, woken: list[threading.Thread]) -> None:
        """Wait until nothing is held and those that were woken sleep again or have ended."""
        while self.held or any(map(self.awake, woken)):
            self._changed.wait(_LOOK_AGAIN_S)


class SteppedClock:
    """The Clock port on a `SteppedTime`; ``busy`` tells whether an answer is outstanding on the wire."""

    def __init__(self, time: SteppedTime) -> None:
        self.busy: Callable[[], bool] = lambda: False
        self._time = time
        self._queue: list[tuple[float, int, asyncio.Future[None]]] = []
        self._count = itertools.count()
        self._pump: asyncio.Task[None] | None = None

    def now_s(self) -> float:
        return self._time.now_s()

    async def sleep(self, seconds: float) -> None:
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        heapq.heappush(self._queue, (self._time.now_s() + seconds, next(self._count), future))
        if self._pump is None or self._pump.done():
            self._pump = asyncio.create_task(self._run())
        await future

    @contextlib.contextmanager
    def working(self) -> Iterator[None]:
        with self._time.hold():
            yield

    async def _run(self) -> None:
        quiet = busy = 0
        while self._queue:
            await asyncio.sleep(0.0 if busy < _BUSY_ROUNDS else _LOOK_AGAIN_S)
            quiet, busy = (0, busy + 1) if self.busy() or self._time.held else (quiet + 1, 0)
            if quiet < _QUIET_ROUNDS:
                continue
            quiet = 0
            wake_s, _, future = heapq.heappop(self._queue)
            if not future.done():
                self._time.advance_to(wake_s)
                future.set_result(None)


class PointArm:
    """An arm that is a point: it moves on a straight line at constant speed and stops within an instant."""

    def __init__(self, time: SteppedTime) -> None:
        self.mode = RobotMode.AUTO
        self.pendant_enabled = False
        self.servo_on = True
        self.override_percent = 100
        self.fault: str | None = None
        self.reach_mm = 1500.0
        self.stopped_short = False
        self.outputs: dict[int, bool] = {}
        self.inputs: dict[int, bool] = {}
        self.collide_after_mm = math.inf
        self._time = time
        self._start = self._target = Xyzwpr(500.0, 0.0, 400.0, 180.0, 0.0, 0.0)
        self._length_mm, self._speed_mm_s, self._begun_s = 0.0, 1.0, 0.0
        self._stopped_mm: float | None = None

    def _way_mm(self) -> float:
        if self._stopped_mm is not None:
            return self._stopped_mm
        way_mm = min((self._time.now_s() - self._begun_s) * self._speed_mm_s, self._length_mm)
        if way_mm >= self.collide_after_mm:
            self._stopped_mm, self.stopped_short, self.fault = way_mm, True, "SRVO-050 Collision Detect alarm"
        return way_mm

    @property
    def pose(self) -> Xyzwpr:
        share = self._way_mm() / self._length_mm if self._length_mm else 1.0
        pairs = zip(self._start.as_tuple(), self._target.as_tuple(), strict=True)
        return Xyzwpr(*(a + share * (b - a) for a, b in pairs))

    @property
    def moving(self) -> bool:
        return self._stopped_mm is None and self._way_mm() < self._length_mm

    def start_linear(self, target: Xyzwpr, speed_mm_s: float) -> None:
        self._begin(target, speed_mm_s)

    def start_joint(self, target: Xyzwpr, speed_percent: float) -> None:
        self._begin(target, 1000.0 * speed_percent / 100.0)

    def stop(self) -> None:
        if self.moving:
            self._stopped_mm, self.stopped_short = self._way_mm(), True

    def reset_fault(self) -> None:
        self.fault = None
        self.collide_after_mm = math.inf

    def set_output(self, n: int, on: bool) -> None:
        self.outputs[n] = on

    def output(self, n: int) -> bool:
        return self.outputs.get(n, False)

    def input(self, n: int) -> bool:
        return self.inputs.get(n, False)

    def _begin(self, target: Xyzwpr, speed_mm_s: float) -> None:
        if math.dist(target.as_tuple()[:3], (0.0, 0.0, 0.0)) > self.reach_mm:
            raise MotionRefusedError("MOTN-018 Position not reachable")
        self._start, self._target = self.pose, target
        self._length_mm = max(math.dist(self._start.as_tuple()[:3], target.as_tuple()[:3]), 1e-9)
        self._speed_mm_s = speed_mm_s * self.override_percent / 100.0
        self._begun_s, self._stopped_mm, self.stopped_short = self._time.now_s(), None, False
