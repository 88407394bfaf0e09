"""What keeps a FANUC arm from being moved by this PC, the same for every wire. Pure.

A wire's own diagnosis (`modbus_diagnosis`, `rmi.diagnosis`) reads; what it has read is judged here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from srvs_cell.alarms import Alarm
from srvs_cell.ports import Finding, NotReadyError, RobotMode

if TYPE_CHECKING:
    from srvs_cell.ports import PortError, RobotStatus

_LOW_OVERRIDE: Final = 10
"""The override after a cold start (B-83284EN section 5.2.1)."""


@dataclass(frozen=True)
class Conditions:
    """What a wire may tell beside a `RobotStatus`; None where it cannot.

    Attributes:
        single_step: single step mode is on.
        remote: the remote conditions are met (CMDENBL).
        mode_known: whether the wire reads the mode switch, or only infers it from the pendant.
        selects: user frame and tool that the driver selects before it moves; None where those that are active count.
    """

    single_step: bool | None = None
    remote: bool | None = None
    mode_known: bool = True
    selects: tuple[int, int] | None = None


_CONNECTION_REMEDIES: Final = {
    Alarm.CONNECTION_TIMEOUT: "Ping the controller: cable, its IP address, this PC's subnet mask, a firewall between.",
    Alarm.DEVICE_UNAVAILABLE: "Check host in the config, and that this PC's network port is up, in the robot's subnet.",
}
"""What the registry's remedy does not say of a controller that was never reached."""


def not_connected(error: PortError) -> Finding:
    """Return the finding that the controller cannot be reached, or its connection ended during the diagnosis."""
    return Finding.failed("connection", error, _CONNECTION_REMEDIES.get(error.alarm, ""))


def judge(status: RobotStatus, conditions: Conditions) -> list[Finding]:
    """Return what a reading means for whoever wants to start the cell, in the order in which to put it right."""
    return [
        _alarm(status),
        _pendant(status),
        _mode(status, conditions),
        _servo(status),
        *_single_step(conditions),
        *_remote(status, conditions),
        _override(status),
        _pose(status, conditions),
    ]


def _alarm(status: RobotStatus) -> Finding:
    if status.fault is None:
        return Finding.fine("controller alarm", "none")
    return Finding.failed("controller alarm", NotReadyError(Alarm.ROBOT_FAULT, f"{status.fault}."))


def _pendant(status: RobotStatus) -> Finding:
    if not status.pendant_enabled:
        return Finding.fine("teach pendant", "disabled")
    return Finding.failed(
        "teach pendant",
        NotReadyError(Alarm.MODE_NOT_AUTO, "The teach pendant is enabled."),
        "Turn the pendant's own switch to OFF; in AUTO it must be off.",
    )


def _mode(status: RobotStatus, conditions: Conditions) -> Finding:
    if not conditions.mode_known:
        return Finding.fine("mode switch", "this wire cannot read it; with the pendant off, T1 and T2 are alarms")
    if status.mode is RobotMode.AUTO:
        return Finding.fine("mode switch", "AUTO")
    return Finding.failed(
        "mode switch",
        NotReadyError(Alarm.MODE_NOT_AUTO, f"The mode switch is at {status.mode.value}."),
        "Turn the key to AUTO: in T1 and T2 a program is started from the pendant only.",
    )


def _servo(status: RobotStatus) -> Finding:
    if status.servo_on:
        return Finding.fine("servo power", "on")
    return Finding.failed(
        "servo power",
        NotReadyError(Alarm.ROBOT_NOT_READY, "Servo power is off."),
        "Release the E-stop (pendant, panel, external), close the fence, press RESET.",
    )


def _single_step(conditions: Conditions) -> list[Finding]:
    if conditions.single_step is None:
        return []
    if not conditions.single_step:
        return [Finding.fine("single step", "off")]
    error = NotReadyError(Alarm.ROBOT_NOT_READY, "Single step mode is on.")
    return [Finding.failed("single step", error, "Press STEP on the pendant: the light STEP must be off.")]


def _remote(status: RobotStatus, conditions: Conditions) -> list[Finding]:
    """Judge CMDENBL, where what else keeps it off has not been named already."""
    if conditions.remote is None:
        return []
    if conditions.remote:
        return [Finding.fine("remote conditions", "met (CMDENBL)")]
    named = status.fault is not None or status.pendant_enabled or not status.servo_on
    if named or status.mode is not RobotMode.AUTO:
        return []
    error = NotReadyError(Alarm.ROBOT_NOT_READY, "The remote conditions are not met (CMDENBL is off).")
    return [
        Finding.failed(
            "remote conditions",
            error,
            "End single step mode (STEP on the pendant); UI[8] ENBL and UI[3] *SFSPD on; Remote/Local setup = Remote; "
            "$RMT_MASTER = 0.",
        )
    ]


def _override(status: RobotStatus) -> Finding:
    percent = status.override_percent
    if percent > _LOW_OVERRIDE:
        return Finding.fine("speed override", f"{percent} %", override_percent=percent)
    return Finding.doubtful(
        "speed override",
        Alarm.ROBOT_NOT_READY,
        f"The speed override is {percent} %: every move takes {100 / max(percent, 1):.0f} times as long.",
        "A controller starts with 10 %: right for the first run; raise it on the pendant afterwards. "
        "This software never does.",
    )


def _pose(status: RobotStatus, conditions: Conditions) -> Finding:
    active = status.user_frame, status.user_tool
    frames = f"user frame {active[0]}, tool {active[1]}"
    if conditions.selects is not None and conditions.selects != active:
        frames += f"; the driver will select {conditions.selects[0]} and {conditions.selects[1]}"
    numbers = zip(("user_frame", "user_tool"), conditions.selects or active, strict=True)
    facts = {name: number for name, number in numbers if number is not None}
    return Finding.fine("pose", f"{status.pose} in {frames}", **facts)
