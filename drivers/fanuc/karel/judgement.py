"""What the robot's answers mean: may it be moved, has the move ended, and how. Pure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.fanuc.karel.messages import Cause, State
from drivers.fanuc.outcome import alarm_outcome
from drivers.fanuc.readiness import not_remote
from drivers.fanuc.registers import UopOutput
from srvs_cell.alarms import Alarm
from srvs_cell.ports import MotionStoppedError, NotReadyError, OutcomeUnknownError, RobotStatus

if TYPE_CHECKING:
    from drivers.fanuc.karel.messages import Status
    from srvs_cell.geometry import Xyzwpr
    from srvs_cell.ports import PortError

_STOPPED_BY = {
    Cause.PC: (Alarm.MOTION_STOPPED, "on request"),
    Cause.WATCHDOG: (Alarm.HEARTBEAT_LOST, "by the robot's watchdog, because it did not hear this PC"),
    Cause.ROBOT: (Alarm.MOTION_STOPPED, "at the robot (HOLD)"),
}


def robot_status(status: Status, now_s: float) -> RobotStatus:
    """Return a reading, made at ``now_s``, in the words of the port."""
    return RobotStatus(
        pose=status.pose,
        mode=status.mode,
        pendant_enabled=UopOutput.TPENBL in status.uop,
        servo_on=UopOutput.SYSRDY in status.uop,
        moving=status.state is State.BUSY and status.fault is None,
        override_percent=status.override_percent,
        fault=status.fault,
        user_frame=status.user_frame,
        user_tool=status.user_tool,
        session_owner="this cell",
        read_at_s=now_s,
    )


def refusal(status: Status) -> NotReadyError | None:
    """Return why the robot may not be moved by this PC as it stands, or None where it may."""
    if status.fault is not None:
        return NotReadyError(Alarm.ROBOT_FAULT, f"The controller is in fault: {status.fault}.")
    return moving(status) or not_remote(status.mode, status.uop)


def moving(status: Status) -> NotReadyError | None:
    """Return that a move is under way, or None."""
    if status.state is not State.BUSY:
        return None
    return NotReadyError(Alarm.ROBOT_BUSY, f"Move {status.move} is under way.")


def ended(status: Status, sequence: int) -> bool:
    """Say whether the move ``sequence`` has come to its end, at its target or not.

    Raises:
        OutcomeUnknownError: the robot's last move is another one.
    """
    if status.move != sequence:
        raise OutcomeUnknownError(
            Alarm.MOTION_OUTCOME_UNKNOWN,
            f"The robot's last move is {status.move}, this PC sent {sequence}: somebody else moves it.",
        )
    return status.state is not State.BUSY


def shortfall(status: Status, start: Xyzwpr, stands: Xyzwpr) -> PortError | None:
    """Return what has kept a move that has ended from its target; None where nothing has.

    Args:
        status: that says that it has ended.
        start: base_T_tcp before it.
        stands: where the arm stands now.
    """
    if status.state is State.DONE:
        return None
    if status.state is State.STOPPED and status.cause in _STOPPED_BY:
        alarm, how = _STOPPED_BY[status.cause]
        return MotionStoppedError(alarm, f"Stopped {how}, at {stands}.")
    if status.state is State.FAULT:
        detail = f"Controller alarm {status.fault or 'not named'}, the arm stands at {stands}."
        return alarm_outcome(status.fault or "", detail, start, stands)
    return OutcomeUnknownError(
        Alarm.MOTION_OUTCOME_UNKNOWN,
        f"The move is said to be {status.state.name} by {status.cause.name}, the arm stands at {stands}.",
    )
