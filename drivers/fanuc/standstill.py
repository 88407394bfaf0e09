"""Wait until an arm that was told to stop stands still, for every wire that reports its pose."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from drivers.fanuc.outcome import still
from srvs_cell.alarms import Alarm
from srvs_cell.ports import OutcomeUnknownError

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from srvs_cell.geometry import Xyzwpr
    from srvs_cell.ports import Clock


class Patience(Protocol):
    """How long a stop may take, and how often the arm is read meanwhile, clock seconds."""

    @property
    def poll_s(self) -> float:
        """Between two readings."""
        ...

    @property
    def stop_timeout_s(self) -> float:
        """From the stop to the stand."""
        ...


async def standstill(
    read_pose: Callable[[], Awaitable[Xyzwpr]], clock: Clock, patience: Patience, after: str
) -> Xyzwpr:
    """Return the pose of the arm as soon as two readings agree.

    Args:
        read_pose: reads base_T_tcp.
        clock: waits between readings.
        patience: how often and how long.
        after: what should have stopped the arm, for people.

    Raises:
        OutcomeUnknownError: the arm still moves.
    """
    deadline_s = clock.now_s() + patience.stop_timeout_s
    last = await read_pose()
    while True:
        await clock.sleep(patience.poll_s)
        pose = await read_pose()
        if still(last, pose):
            return pose
        if clock.now_s() > deadline_s:
            raise OutcomeUnknownError(
                Alarm.MOTION_OUTCOME_UNKNOWN,
                f"the arm still moves {patience.stop_timeout_s} s after {after}, at {pose}.",
            )
        last = pose
