"""What the interface's ErrorIDs mean and what to do about each (B-84184EN/03 appendix A). Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from srvs_cell.alarms import Alarm

_RMIT: Final = 2_556_928
_LAST_RMIT: Final = 99


def rmit(number: int) -> int:
    """Return the ErrorID of the alarm RMIT-``number``."""
    return _RMIT + number


@dataclass(frozen=True)
class Meaning:
    """One row of the table.

    Attributes:
        alarm: the cell's alarm.
        cause: what the controller says.
        remedy: what a person does about it.
        may_have_moved: an instruction that ends so may have been begun; otherwise it was refused before it moved.
    """

    alarm: Alarm
    cause: str
    remedy: str
    may_have_moved: bool = False


_REPORT: Final = "Report this with the log: the driver sent what this controller's software does not accept."
_ASCII_OFF: Final = "Set $RMI_CFG.$ASBN_ENB to FALSE and restart the controller."
_READY, _MODE, _FAULT = Alarm.ROBOT_NOT_READY, Alarm.MODE_NOT_AUTO, Alarm.ROBOT_FAULT
_TARGET, _BUSY, _PROTOCOL = Alarm.TARGET_REJECTED, Alarm.ROBOT_BUSY, Alarm.PROTOCOL_ERROR

_RMIT_ROWS: Final = {
    1: Meaning(
        _FAULT,
        "Internal error of the interface.",
        "Cycle the controller's power; if it comes back, save the controller's log.",
        may_have_moved=True,
    ),
    2: Meaning(
        Alarm.FRAME_CHANGED,
        "Invalid tool frame number.",
        "Correct user_tool in the config (1 to 10, set on the controller).",
    ),
    3: Meaning(
        Alarm.FRAME_CHANGED,
        "Invalid user frame number.",
        "Correct user_frame in the config (0 to 9, set on the controller).",
    ),
    4: Meaning(_TARGET, "Invalid position register.", _REPORT),
    5: Meaning(_TARGET, "Invalid speed override.", "Set the override on the pendant to 1 to 100 %."),
    6: Meaning(
        _READY,
        "The controller cannot execute a TP program.",
        "Check for alarms, remote conditions (AUTO, pendant off, *HOLD and ENBL on) and other programs.",
    ),
    7: Meaning(
        _READY, "Servo power is off.", "Release the E-stop, close the fence, reset the controller.", may_have_moved=True
    ),
    8: Meaning(_MODE, "The teach pendant is enabled.", "Turn the pendant's switch off and the mode switch to AUTO."),
    9: Meaning(_READY, "RMI does not run.", "Reset the cell: it initialises the interface again.", may_have_moved=True),
    10: Meaning(_READY, "The program is not paused.", "None needed."),
    11: Meaning(_READY, "The program cannot be resumed.", "Abort it on the pendant, then reset the cell."),
    12: Meaning(
        _FAULT,
        "The controller cannot be reset.",
        "Remove the alarm's cause (E-stop, fence, collision) and reset again.",
    ),
    13: Meaning(
        _PROTOCOL,
        "Invalid command.",
        "This controller's RMI does not know the command: its software is older than the driver expects.",
    ),
    14: Meaning(_READY, "The command failed.", "Read the alarm on the pendant. After an abort: nothing was running."),
    15: Meaning(
        _READY,
        "Invalid controller state.",
        "Clear alarms, disable the pendant, abort all programs, then reset the cell.",
        may_have_moved=True,
    ),
    16: Meaning(
        _READY,
        "The controller must be restarted for RMI.",
        "Cycle the controller's power once; it says so the first time that RMI is used.",
    ),
    17: Meaning(_TARGET, "Invalid payload schedule.", _REPORT),
    18: Meaning(_TARGET, "Invalid motion option.", _REPORT),
    19: Meaning(_TARGET, "Invalid vision register.", _REPORT),
    20: Meaning(
        _TARGET,
        "Invalid instruction.",
        "This controller's RMI does not know the instruction: its software is older than the driver expects.",
    ),
    21: Meaning(_TARGET, "Invalid value.", _REPORT),
    22: Meaning(_PROTOCOL, "Invalid text string.", _REPORT),
    23: Meaning(_TARGET, "Invalid position data.", "Check target, user frame and tool; the detail names the target."),
    24: Meaning(
        _FAULT, "RMI is in HOLD after a refused instruction.", "Clear the cell: the operator's reset sends FRC_Reset."
    ),
    25: Meaning(
        Alarm.CONNECTION_LOST,
        "The remote device was disconnected.",
        "Check the cable, then clear.",
        may_have_moved=True,
    ),
    26: Meaning(Alarm.SESSION_HELD, "Another client is connected.", "End the other client; RMI takes one at a time."),
    27: Meaning(_BUSY, "A command is still being carried out.", "Wait, then clear; an abort may take a minute."),
    28: Meaning(_BUSY, "Eight instructions wait already.", _REPORT),
    29: Meaning(
        _FAULT,
        "Unexpected sequence number; RMI is in HOLD.",
        "Clear the cell: the operator's reset sends FRC_Reset. If it comes back, another client sends instructions.",
    ),
    30: Meaning(_TARGET, "Invalid speed type.", _REPORT),
    31: Meaning(
        _TARGET, "Invalid speed.", "Correct the speed in the config: whole mm/s or per cent within the robot's limits."
    ),
    32: Meaning(_TARGET, "Invalid termination type.", _REPORT),
    33: Meaning(_TARGET, "Invalid termination value.", _REPORT),
    34: Meaning(_TARGET, "Invalid port type of a local condition.", _REPORT),
    35: Meaning(_TARGET, "Invalid acceleration override.", _REPORT),
    36: Meaning(_TARGET, "Invalid destination.", "Check target, user frame and tool; the detail names the target."),
    37: Meaning(_TARGET, "Invalid via position.", _REPORT),
    38: Meaning(
        Alarm.CONFIG_INVALID, "Invalid port number.", "Correct the number of the input or output in the config."
    ),
    39: Meaning(Alarm.CONFIG_INVALID, "Invalid motion group.", "The driver moves group 1: the arm must be in it."),
    40: Meaning(
        Alarm.CONFIG_INVALID,
        "Invalid group mask.",
        "On a controller with several groups set group_mask in the config (1 is group 1).",
    ),
    41: Meaning(_TARGET, "Coordinated motion needs its leader group.", _REPORT),
    42: Meaning(_TARGET, "Coordinated motion is not allowed here.", _REPORT),
    43: Meaning(_READY, "Single step mode is on.", "Press STEP on the pendant to end single step mode."),
    44: Meaning(_TARGET, "Invalid position data type.", _REPORT),
    45: Meaning(_READY, "Not ready for ASCII packets.", _ASCII_OFF),
    46: Meaning(_TARGET, "An ASCII packet could not be converted.", _ASCII_OFF),
    47: Meaning(_TARGET, "Invalid ASCII instruction.", _ASCII_OFF),
    48: Meaning(
        Alarm.CONFIG_INVALID, "Invalid number of groups.", "Correct group_mask in the config: at most two groups."
    ),
    49: Meaning(_READY, "The controller is in ASCII mode and takes no JSON instruction.", _ASCII_OFF),
    50: Meaning(_TARGET, "Invalid ASCII packet.", _ASCII_OFF),
    51: Meaning(_TARGET, "ASCII packet too long.", _ASCII_OFF),
    52: Meaning(_READY, "Invalid application tool.", _ASCII_OFF),
    53: Meaning(_TARGET, "Invalid name of a program to call.", _REPORT),
    54: Meaning(_TARGET, "A joint move does not take ALIM.", _REPORT),
    55: Meaning(_TARGET, "The option ALIM is not loaded.", _REPORT),
    56: Meaning(_TARGET, "A spline must be finished first.", _REPORT),
    57: Meaning(_TARGET, "The option spline motion is not loaded.", _REPORT),
}

_OTHERS: Final = {
    7004: Meaning(
        _READY,
        "MEMO-004: the program RMI_MOVE is in use.",
        "Select another program on the pendant (SELECT), abort all, then reset the cell.",
    ),
    7015: Meaning(
        _READY,
        "MEMO-015: the program RMI_MOVE exists already.",
        "Select another program on the pendant and abort all; if an earlier client died without an abort, delete "
        "RMI_MOVE on the pendant.",
    ),
    1_441_794: Meaning(_READY, "ASBN-002: ASCII program conversion.", _ASCII_OFF),
}

_UNLISTED: Final = Meaning(
    _FAULT, "an id that the manual does not list", "Read the alarm on the pendant (MENU, ALARM).", may_have_moved=True
)

NOT_RUNNING: Final = frozenset({rmit(9), rmit(15)})
"""What a command that needs FRC_Initialize ends in without it."""

NOTHING_RUNNING: Final = frozenset({rmit(9), rmit(14)})
"""What an abort ends in where there is nothing to abort."""

ASCII_MODE: Final = rmit(49)

UNKNOWN_COMMAND: Final = frozenset({rmit(13), rmit(20), rmit(22)})


def meaning(error_id: int) -> Meaning:
    """Return the row of an ErrorID; one for all where it is not listed."""
    return _OTHERS.get(error_id) or _RMIT_ROWS.get(error_id - _RMIT, _UNLISTED)


def describe(error_id: int) -> str:
    """Return id, name, cause and remedy for people."""
    number = error_id - _RMIT
    name = f" RMIT-{number:03d}" if 0 < number <= _LAST_RMIT else ""
    row = meaning(error_id)
    return f"ErrorID {error_id}{name}: {row.cause} {row.remedy}"
