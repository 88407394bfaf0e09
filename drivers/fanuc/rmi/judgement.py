"""What the controller's words mean: may the arm be moved, how did a move end. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from drivers.fanuc.outcome import alarm_outcome, moved
from drivers.fanuc.rmi.errors import describe, meaning
from srvs_cell.alarms import Alarm
from srvs_cell.ports import (
    CommandRejectedError,
    DeviceFaultError,
    MotionStoppedError,
    NotReadyError,
    RobotMode,
)

if TYPE_CHECKING:
    from drivers.fanuc.rmi.messages import Packet, Place, Status
    from srvs_cell.geometry import Xyzwpr
    from srvs_cell.ports import PortError

_FRAMES: Final = ("INTP-252", "INTP-253")
"""User frame and tool frame number mismatch."""


def mode(status: Status) -> RobotMode:
    """Return the mode switch as far as it can be told: with the pendant off, T1 and T2 are alarms, so it is AUTO."""
    return RobotMode.UNKNOWN if status.pendant_enabled else RobotMode.AUTO


def refusal(status: Status, fault: str | None) -> NotReadyError | None:
    """Return why the robot may not be moved by this PC as it stands, or None where it may."""
    if status.pendant_enabled:
        return NotReadyError(Alarm.MODE_NOT_AUTO, "The teach pendant is enabled (TPMode).")
    if fault is not None:
        return NotReadyError(Alarm.ROBOT_FAULT, f"The controller is in fault: {fault}.")
    if not status.servo_ready:
        return NotReadyError(Alarm.ROBOT_NOT_READY, "Servo power is off (ServoReady): E-stop or fence.")
    if status.single_step:
        return NotReadyError(Alarm.ROBOT_NOT_READY, "Single step mode is on: press STEP on the pendant.")
    return None


def frame_refusal(place: Place, user_frame: int, user_tool: int) -> NotReadyError | None:
    """Return why a pose would mean another place than the config's frames make it mean, or None."""
    active = place.configuration
    if (active.user_frame, active.user_tool) == (user_frame, user_tool):
        return None
    return NotReadyError(
        Alarm.FRAME_CHANGED,
        f"Active are user frame {active.user_frame} and tool {active.user_tool}, "
        f"the config has {user_frame} and {user_tool}.",
    )


def instruction_error(reply: Packet, target: Xyzwpr, start: Xyzwpr, stands: Xyzwpr) -> PortError:
    """Return what a reply with an ErrorID makes of a move.

    Args:
        reply: the reply to the instruction.
        target: of the move.
        start: of the move.
        stands: where the arm is now.
    """
    error_id = reply.error_id or 0
    row = meaning(error_id)
    detail = f"The move to {target}: {describe(error_id)}"
    if row.may_have_moved or moved(start, stands):
        return DeviceFaultError(Alarm.ROBOT_FAULT, f"{detail} The arm stands at {stands}.")
    return CommandRejectedError(row.alarm, detail)


def holds_until_reset(reply: Packet) -> str | None:
    """Return why the controller takes no instruction any more until it is reset (section 3.3); None where it does."""
    error_id = reply.error_id or 0
    return None if meaning(error_id).may_have_moved else describe(error_id).rstrip(".")


def alarm_error(alarm: str | None, target: Xyzwpr, start: Xyzwpr, stands: Xyzwpr) -> PortError:
    """Return what an alarm, or a pause without one, makes of the move under way; arguments as above."""
    if alarm is None:
        return MotionStoppedError(
            Alarm.MOTION_STOPPED, f"The move to {target} was paused at the robot and is aborted, at {stands}."
        )
    detail = f"Controller alarm {alarm} on the way to {target}, the arm stands at {stands}."
    if alarm.startswith(_FRAMES) and not moved(start, stands):
        return CommandRejectedError(Alarm.FRAME_CHANGED, detail)
    return alarm_outcome(alarm, detail, start, stands)
