"""What mode switch and UOP signals say about moving the robot, for every wire that tells them. Pure."""

from __future__ import annotations

from drivers.fanuc.registers import UopOutput
from srvs_cell.alarms import Alarm
from srvs_cell.ports import NotReadyError, RobotMode


def not_remote(mode: RobotMode, uop: UopOutput) -> NotReadyError | None:
    """Return why a PC may not move the robot: mode, pendant, servo, remote conditions; None where it may."""
    if mode != RobotMode.AUTO or UopOutput.TPENBL in uop:
        pendant = "enabled" if UopOutput.TPENBL in uop else "disabled"
        return NotReadyError(Alarm.MODE_NOT_AUTO, f"Mode {mode.value}, pendant {pendant}.")
    if UopOutput.SYSRDY not in uop:
        return NotReadyError(Alarm.ROBOT_NOT_READY, "Servo power is off (SYSRDY): E-stop or fence.")
    if UopOutput.CMDENBL not in uop:
        return NotReadyError(Alarm.ROBOT_NOT_READY, "Remote conditions are not met (CMDENBL is off).")
    return None
