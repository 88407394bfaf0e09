"""This PC's own silence: a robot's watchdog that has acted on it says so only of a move that was under way."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from srvs_cell.ports import Clock

_WATCHDOG_S: Final = 1.8
"""The robot's programs (SRVS_HB, srvscell.kl) bear 2 s, which they count in steps of their own."""


class OwnSilence:
    """The longest time without a heartbeat of this PC since the robot was last allowed to move."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._heard_s, self._longest_s = math.inf, 0.0

    def begin_anew(self) -> None:
        """Forget what was: the robot hears this PC, and what its watchdog may have done is taken back."""
        self._heard_s, self._longest_s = self._clock.now_s(), 0.0

    def end(self) -> None:
        """Take note that the robot has just heard this PC."""
        now_s = self._clock.now_s()
        self._longest_s = max(self._longest_s, now_s - self._heard_s)
        self._heard_s = now_s

    @property
    def noticed(self) -> str | None:
        """What to say where the robot's watchdog must have noticed a silence; None where it need not have."""
        longest_s = max(self._longest_s, self._clock.now_s() - self._heard_s)
        if longest_s < _WATCHDOG_S:
            return None
        return f"This PC was silent for {longest_s:.1f} s: the robot's watchdog has forbidden motion."
