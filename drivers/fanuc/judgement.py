"""What a reading of the robot's words means: may it be moved, has it finished, how long may it take. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from drivers.fanuc.outcome import alarm_outcome, apart
from drivers.fanuc.readiness import not_remote
from drivers.fanuc.registers import FIRST_FAULT_IN_MOTION, FaultCode, Snapshot, State, UopOutput
from srvs_cell.alarms import Alarm
from srvs_cell.ports import (
    CommandRejectedError,
    DeviceFaultError,
    MotionStoppedError,
    NotReadyError,
    OutcomeUnknownError,
    RobotStatus,
)

if TYPE_CHECKING:
    from srvs_cell.geometry import Xyzwpr
    from srvs_cell.ports import PortError

_FAULT_TEXTS: Final = {
    FaultCode.UNKNOWN_COMMAND: "unknown command",
    FaultCode.CHECKSUM: "checksum mismatch",
    FaultCode.POSITION_RANGE: "position out of the program's range",
    FaultCode.SPEED_RANGE: "speed out of the program's range",
    FaultCode.FRAME: "user frame or tool is not the program's",
    FaultCode.PC_HEARTBEAT: "SRVS_HB does not run, or does not see this PC's heartbeat",
    FaultCode.HOLD_ACTIVE: "the hold output is on",
    FaultCode.STOPPED: "stopped by the hold output",
    FaultCode.STOPPED_BY_WATCHDOG: "stopped because the PC's heartbeat froze",
}


def fault_text(snapshot: Snapshot) -> str | None:
    """Return what only a reset at the controller can end: its alarm, or that its program does not run; else None."""
    if UopOutput.FAULT in snapshot.uop:
        return snapshot.alarm or "an alarm that is not named"
    if snapshot.uop & (UopOutput.PAUSED | UopOutput.HELD) or UopOutput.PROGRUN not in snapshot.uop:
        return "program SRVS does not run (paused, held or ended)"
    return None


def robot_status(snapshot: Snapshot, now_s: float) -> RobotStatus:
    """Return a reading, made at ``now_s``, in the words of the port."""
    fault = fault_text(snapshot)
    return RobotStatus(
        pose=snapshot.pose,
        mode=snapshot.mode,
        pendant_enabled=UopOutput.TPENBL in snapshot.uop,
        servo_on=UopOutput.SYSRDY in snapshot.uop,
        moving=snapshot.busy and fault is None,
        override_percent=snapshot.override_percent,
        fault=fault,
        user_frame=snapshot.user_frame,
        user_tool=snapshot.user_tool,
        session_owner=None,
        read_at_s=now_s,
    )


def refusal(snapshot: Snapshot) -> NotReadyError | None:
    """Return why the robot may not be moved by this PC as it stands, or None where it may."""
    fault = fault_text(snapshot)
    if fault is not None:
        return NotReadyError(Alarm.ROBOT_FAULT, f"The controller is in fault: {fault}.")
    not_ready = not_remote(snapshot.mode, snapshot.uop)
    if not_ready is not None:
        return not_ready
    if snapshot.busy:
        return NotReadyError(
            Alarm.ROBOT_BUSY,
            f"State {snapshot.state}, sequence {snapshot.sequence} written, {snapshot.acknowledged} acknowledged.",
        )
    return None


def finished(snapshot: Snapshot, sequence: int, start: Xyzwpr, *, hold_requested: bool) -> bool:
    """Say whether the command ``sequence`` has been carried out.

    Args:
        snapshot: the reading.
        sequence: the command's number.
        start: the pose before the command, to tell a refusal from an interrupted move.
        hold_requested: whether this PC has switched the hold output on.

    Raises:
        MotionStoppedError: it was stopped on the way, from here or at the robot.
        CommandRejectedError: the robot refused it and has not moved.
        DeviceFaultError: it ended in a fault.
        OutcomeUnknownError: the words contradict each other.
    """
    done = snapshot.acknowledged == sequence
    if snapshot.sequence != sequence:
        raise _unknown(f"R[101] reads {snapshot.sequence}, this PC wrote {sequence}: somebody else writes commands.")
    if snapshot.state not in set(State):
        raise _unknown(f"R[112] reads {snapshot.state}, which is no state.")
    if done and snapshot.state == State.FAULT:
        raise _program_fault(snapshot)
    if done and snapshot.state == State.DONE:
        return True
    if done:
        raise _unknown(f"sequence {sequence} is acknowledged, but state reads {State(snapshot.state).name}.")
    if UopOutput.FAULT in snapshot.uop:
        raise _controller_fault(snapshot, start)
    if snapshot.uop & (UopOutput.PAUSED | UopOutput.HELD):
        where = "on request" if hold_requested else "at the robot"
        raise MotionStoppedError(
            Alarm.MOTION_STOPPED,
            f"The robot's program was paused {where} at {snapshot.pose}; abort it on the pendant before going on.",
        )
    return False


def arrival_error(reported: Xyzwpr, target: Xyzwpr, tolerance_mm: float, tolerance_deg: float) -> PortError | None:
    """Return an error where a finished move has not ended at its target."""
    distance_mm, angle_deg = apart(reported, target)
    if distance_mm <= tolerance_mm and angle_deg <= tolerance_deg:
        return None
    return DeviceFaultError(
        Alarm.MOTION_OUTCOME_UNKNOWN,
        f"The robot reports the move as done but stands {distance_mm:.3f} mm and {angle_deg:.3f} deg from its target "
        f"{target} (allowed {tolerance_mm} mm, {tolerance_deg} deg): wrong user frame or tool?",
    )


@dataclass
class MotionBudget:
    """How long a move may take, in seconds at 100 % override.

    The override may change at any moment, so time is spent at the override of the moment rather than compared with
    a fixed deadline.
    """

    allowed_s: float
    spent_s: float = 0.0
    _limited: bool = False

    @classmethod
    def of(cls, start: Xyzwpr, target: Xyzwpr, speed_mm_s: float, speed_deg_s: float, grace_s: float) -> MotionBudget:
        """Allow twice the time of the path and of the turn one after the other, and ``grace_s``.

        Twice and the grace cover acceleration, a path that is not straight, and the controller's latency of about
        150 ms from register write to motion (references/fanuc.md 1b).
        """
        distance_mm, angle_deg = apart(start, target)
        return cls(2.0 * (distance_mm / speed_mm_s + angle_deg / speed_deg_s) + grace_s)

    def spend(self, elapsed_s: float, override_percent: int) -> bool:
        """Add ``elapsed_s`` at ``override_percent``; return whether anything is left."""
        self.spent_s += elapsed_s * min(max(override_percent, 1), 100) / 100.0
        return self.spent_s <= self.allowed_s

    def limit(self, left_s: float) -> None:
        """Leave at most ``left_s`` from the first call on."""
        if not self._limited:
            self._limited = True
            self.allowed_s = min(self.allowed_s, self.spent_s + left_s)


def _unknown(detail: str) -> OutcomeUnknownError:
    return OutcomeUnknownError(Alarm.MOTION_OUTCOME_UNKNOWN, detail[0].upper() + detail[1:])


def _program_fault(snapshot: Snapshot) -> PortError:
    code = snapshot.fault_code
    known = code in set(FaultCode)
    text = f"Program fault {code} ({_FAULT_TEXTS.get(FaultCode(code), 'none') if known else 'unknown code'})"
    if code == FaultCode.HOLD_ACTIVE:
        return MotionStoppedError(Alarm.MOTION_STOPPED, f"{text} before the move began.")
    if code == FaultCode.STOPPED:
        return MotionStoppedError(Alarm.MOTION_STOPPED, f"{text} at {snapshot.pose}.")
    if code == FaultCode.STOPPED_BY_WATCHDOG:
        return MotionStoppedError(Alarm.HEARTBEAT_LOST, f"{text} at {snapshot.pose}.")
    if known and FaultCode.NONE < code < FIRST_FAULT_IN_MOTION:
        alarm = Alarm.HEARTBEAT_LOST if code == FaultCode.PC_HEARTBEAT else Alarm.TARGET_REJECTED
        return CommandRejectedError(alarm, f"{text}.")
    return DeviceFaultError(Alarm.ROBOT_FAULT, f"{text} at {snapshot.pose}.")


def _controller_fault(snapshot: Snapshot, start: Xyzwpr) -> PortError:
    detail = f"Controller alarm {snapshot.alarm or 'not named'} at {snapshot.pose}."
    return alarm_outcome(snapshot.alarm or "", detail, start, snapshot.pose)
