"""The arm as a TP program sees it, for every double whose controller runs one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from drivers.sim.controlled_arm import MotionRefusedError
from drivers.sim.tp import TpAlarm
from srvs_cell.geometry import Xyzwpr

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.sim.controlled_arm import ControlledArm

MODE_SIGNALS: Final = {"AUTO": {8, 9}, "T1": {9}, "T2": set[int]()}
"""SI[8] and SI[9] of the mode switch [?]."""


class TpArm:
    """Motion, active frames and system variables.

    Attributes:
        motions_started: how many motions the arm was told to begin.
        user_frame, user_tool: active frame numbers.
    """

    def __init__(self, arm: ControlledArm) -> None:
        self.motions_started = 0
        self.user_frame = 1
        self.user_tool = 1
        self._arm = arm

    def variable(self, name: str) -> int:
        """Return a system variable; raises KeyError where there is none."""
        return {
            "$MNUFRAMENUM[1]": self.user_frame,
            "$MNUTOOLNUM[1]": self.user_tool,
            "$MCR.$GENOVERRIDE": self._arm.override_percent,
        }[name]

    def select_frame(self, name: str, number: int) -> None:
        """Make a user frame or a tool the active one."""
        if name == "UFRAME_NUM":
            self.user_frame = number
        else:
            self.user_tool = number

    @property
    def moving(self) -> bool:
        """Whether a motion is under way."""
        return self._arm.moving

    @property
    def stopped_short(self) -> bool:
        """Whether the last motion ended before its target; an arm in fault has not arrived."""
        return self._arm.stopped_short

    def position(self) -> tuple[float, ...]:
        """Return the TCP's pose."""
        return self._arm.pose.as_tuple()

    def start(self, position: Sequence[float], speed: float, *, joint: bool) -> None:
        """Begin a motion."""
        target = Xyzwpr(*position)
        try:
            if joint:
                self._arm.start_joint(target, speed)
            else:
                self._arm.start_linear(target, speed)
        except MotionRefusedError as error:
            raise TpAlarm(str(error)) from error
        self.motions_started += 1

    def stop(self) -> None:
        """Cancel the motion under way."""
        self._arm.stop()
