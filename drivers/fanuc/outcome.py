"""What a controller's alarm makes of a move, for every wire alike. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from srvs_cell.alarms import Alarm
from srvs_cell.geometry import Transform, Xyzwpr, pose_difference
from srvs_cell.ports import CommandRejectedError, DeviceFaultError

if TYPE_CHECKING:
    from srvs_cell.ports import PortError

_UNREACHABLE: Final = ("MOTN-017", "MOTN-018")
"""Limit error, position not reachable."""

_COLLISION: Final = ("SRVO-050",)
"""Collision detect alarm."""

_STANDING_MM: Final = 0.5
"""An arm nearer than this to where it started has not moved: above the repeatability of reported poses."""

_STILL_MM, _STILL_DEG = 0.02, 0.02


def alarm_outcome(alarm: str, detail: str, start: Xyzwpr, stands: Xyzwpr) -> PortError:
    """Return what an alarm makes of the move under way.

    Args:
        alarm: the controller's name of it, with or without its text.
        detail: what happened, for people.
        start: base_T_tcp before the move.
        stands: where the arm is now.
    """
    if alarm.startswith(_COLLISION):
        return DeviceFaultError(Alarm.COLLISION, detail)
    if alarm.startswith(_UNREACHABLE):
        refused = not moved(start, stands)
        return (CommandRejectedError if refused else DeviceFaultError)(Alarm.TARGET_UNREACHABLE, detail)
    return DeviceFaultError(Alarm.ROBOT_FAULT, detail)


def moved(start: Xyzwpr, stands: Xyzwpr) -> bool:
    """Say whether an arm has left its start."""
    return apart(start, stands)[0] > _STANDING_MM


def still(earlier: Xyzwpr, later: Xyzwpr) -> bool:
    """Say whether two readings are of a standing arm."""
    distance_mm, angle_deg = apart(earlier, later)
    return distance_mm < _STILL_MM and angle_deg < _STILL_DEG


def apart(a: Xyzwpr, b: Xyzwpr) -> tuple[float, float]:
    """Return the distance of two poses in millimetres and the angle between them in degrees."""
    return pose_difference(Transform.from_xyzwpr("base", "tcp", a), Transform.from_xyzwpr("base", "tcp", b))
