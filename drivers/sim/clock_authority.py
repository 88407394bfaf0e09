"""The time authority of the simulated cell: the world's time is the only time, and it never runs ahead of anybody.

How fast simulated time runs against real time:
- 0 while a wire request or a render is outstanding (`SimTime.hold`, `SimTime.hold_while`), and while a task of the
  simulator that has been woken has not gone to sleep again;
- ``speed`` while the process that is simulated for only waits: it says on the clock page until when, and time does
  not go past that;
- 1 otherwise: while it computes, and for others' clients that have no clock page.
"""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from drivers.sim.world_model import TIMESTEP_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from drivers.sim.clock_page import ClockPage

_BATCH_STEPS: Final = 5
_IDLE_S: Final = 0.0005
_MAX_DEBT_S: Final = 0.05
_JOIN_S: Final = 5.0


class SimTime:
    """Simulated time for the threads of the simulator.

    Args:
        step: advances the world by one time step and returns the new time; called under `lock`.
        page: where the time is shown to the process that is simulated for.
        speed: how much faster than life time runs while nobody needs it slow.

    Attributes:
        lock: the one lock of the simulated world; a condition that is notified whenever time has advanced.
    """

    def __init__(self, step: Callable[[], float], page: ClockPage, speed: float) -> None:
        self.lock = threading.Condition(threading.RLock())
        self._step, self._page, self._speed = step, page, speed
        self._now_s = page.now_s
        self._holds = 0
        self._wires: list[Callable[[], bool]] = []
        self._wakes: dict[threading.Thread, float] = {}
        self._awake: set[threading.Thread] = set()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="time", daemon=True)
        self.failure: BaseException | None = None

    def start(self) -> None:
        """Let time begin."""
        self._thread.start()

    def close(self) -> None:
        """End time; every sleeping thread returns."""
        self._closing.set()
        with self.lock:
            self.lock.notify_all()
        if self._thread.is_alive():
            self._thread.join(_JOIN_S)

    @property
    def closed(self) -> bool:
        """Whether time has ended."""
        return self._closing.is_set()

    def now_s(self) -> float:
        """Return simulated seconds."""
        return self._now_s

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Let time stand still inside the block; it stands before the block begins."""
        with self.lock:
            self._holds += 1
        try:
            yield
        finally:
            with self.lock:
                self._holds -= 1

    def hold_while(self, unread: Callable[[], bool]) -> None:
        """Let time stand still also while ``unread`` says that something has come over a wire."""
        self._wires.append(unread)

    def sleep(self, seconds: float) -> None:
        """Return after simulated ``seconds``, or at the end of time.

        From its first call on a thread is a task of the simulator: when it is woken, time stands still until it
        sleeps again or ends.
        """
        me = threading.current_thread()
        with self.lock:
            wake_s = self._now_s + seconds
            self._awake.discard(me)
            self._wakes[me] = wake_s
            self.lock.wait_for(lambda: self.closed or me in self._awake)
            self._wakes.pop(me, None)

    def _run(self) -> None:
        """The body of the thread: spend real time on simulated time."""
        last_s, debt_s = time.monotonic(), 0.0
        try:
            while not self.closed:
                real_s = time.monotonic()
                with self.lock:
                    rate = self._rate()
                    debt_s = min(debt_s + (real_s - last_s) * rate, _MAX_DEBT_S * max(rate, 1.0)) if rate else 0.0
                    debt_s -= self._advance(debt_s) * TIMESTEP_S
                last_s = real_s
                self._page.beat_s = real_s
                if debt_s < TIMESTEP_S:
                    self._closing.wait(_IDLE_S)
        except BaseException as error:
            self.failure = error
            self._closing.set()
            raise

    def _rate(self) -> float:
        self._awake = {thread for thread in self._awake if thread.is_alive()}
        if any(unread() for unread in self._wires) or self._holds or self._awake:
            return 0.0
        waiting = self._page.working == 0 and self._page.wake_s > self._now_s
        return self._speed if waiting else 1.0

    def _advance(self, seconds: float) -> int:
        """Make as many steps as fit, at most a batch, stopping where somebody wakes; return how many."""
        steps = min(int(seconds / TIMESTEP_S), _BATCH_STEPS)
        for count in range(1, steps + 1):
            wake_s = self._page.wake_s
            waited = wake_s > self._now_s
            self._now_s = self._step()
            self._page.now_s = self._now_s
            for thread in [thread for thread, at_s in self._wakes.items() if at_s <= self._now_s]:
                self._awake.add(thread)
                del self._wakes[thread]
            if self._awake or (waited and wake_s <= self._now_s):
                steps = count
                break
        if steps:
            self.lock.notify_all()  # nobody could have looked before: the lock is held for the whole batch
        return steps
