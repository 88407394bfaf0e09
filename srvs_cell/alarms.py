"""The one registry of what can go wrong: code, severity, cause, remedy, PackML reaction.

Codes: 1xxx communication and devices, 2xxx robot and gripper, 3xxx camera and vision, 4xxx planning,
5xxx cell and operator, 6xxx configuration and files. docs/reference/alarms.md is generated from this table.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import Self


class Severity(StrEnum):
    """How much attention an alarm asks for."""

    WARNING = "warning"
    ERROR = "error"
    CRITICAL = "critical"


class Reaction(StrEnum):
    """What an alarm does to the PackML unit when nothing milder (a retry, a skip) is decided by the recovery policy."""

    NONE = "none"
    SUSPEND = "suspend"
    HOLD = "hold"
    STOP = "stop"
    ABORT = "abort"


@dataclass(frozen=True)
class AlarmDefinition:
    """One row of the registry."""

    code: int
    severity: Severity
    reaction: Reaction
    cause: str
    remedy: str


_W, _E, _C = Severity.WARNING, Severity.ERROR, Severity.CRITICAL


class Alarm(Enum):
    """Every failure that a person can meet."""

    # fmt: off
    CONNECTION_REFUSED = AlarmDefinition(1001, _C, Reaction.ABORT, "The controller is reachable but refuses the connection.", "Check that the robot's server option is enabled (Modbus: R553, $SNPX_PARAM.$NUM_MODBUS > 0, power-cycled; RMI: R912; KAREL: srvstcp runs and its server tag is started) and the port in the config.")
    CONNECTION_TIMEOUT = AlarmDefinition(1002, _C, Reaction.ABORT, "The device did not answer in time.", "Check cable, IP address, unit id and firewall; then clear and reset.")
    CONNECTION_LOST = AlarmDefinition(1003, _C, Reaction.ABORT, "The connection to the controller was cut.", "Check the cable and the controller's power; clear, reset, and let the cell look again before it moves.")
    HEARTBEAT_LOST = AlarmDefinition(1004, _C, Reaction.ABORT, "The heartbeat of the robot or of this PC has stopped; the detail says whose.", "Check that the heartbeat task runs on the robot (RUN SRVS_HB), that the controller is not in a fault and that this PC is not overloaded.")
    PROTOCOL_ERROR = AlarmDefinition(1005, _C, Reaction.ABORT, "A device sent something that its protocol does not allow.", "Check that the protocol version on the device matches this software; note the raw data in the log.")
    PROTOCOL_VERSION = AlarmDefinition(1006, _C, Reaction.ABORT, "The robot's program is of another protocol version, or its registers are not mapped.", "Load the robot programs of this release and check $SNPX_ASG; unassigned words read 0.")
    DEVICE_UNAVAILABLE = AlarmDefinition(1007, _C, Reaction.ABORT, "A device is not connected.", "Check power and cable; clear to reconnect.")
    CLOCK_LOST = AlarmDefinition(1008, _C, Reaction.ABORT, "The simulated cell's clock has stopped.", "Start the simulated cell again.")
    SESSION_HELD = AlarmDefinition(1009, _C, Reaction.ABORT, "Somebody else holds the robot's motion session.", "End the other client (another PC, a tool, a hung program), or wait until the controller lets go of it (RMI: $RMI_CFG.$DISCNT_TIM; KAREL: 5 s of silence); then clear.")

    ROBOT_NOT_READY = AlarmDefinition(2001, _E, Reaction.STOP, "The robot is not ready to be moved by this PC.", "Switch to AUTO, disable the pendant, clear robot faults, then reset.")
    ROBOT_FAULT = AlarmDefinition(2002, _C, Reaction.ABORT, "The robot controller reports a fault.", "Read the alarm on the pendant, remove its cause, reset the controller, then clear and reset the cell.")
    MOTION_STOPPED = AlarmDefinition(2003, _E, Reaction.HOLD, "A move was stopped on request before it reached its target.", "The interrupted move is not continued; the cell looks again after the next operator command.")
    MOTION_OUTCOME_UNKNOWN = AlarmDefinition(2004, _C, Reaction.ABORT, "It is not known whether a commanded move was carried out.", "Look at the robot and the gripper, then 'resolve gripper empty|holding', clear and reset.")
    TARGET_UNREACHABLE = AlarmDefinition(2005, _E, Reaction.HOLD, "The target is out of the arm's reach or joint limits.", "Move the part nearer, or correct the workspace in the config.")
    TARGET_REJECTED = AlarmDefinition(2006, _E, Reaction.HOLD, "The robot's program rejected the command before moving.", "Read the fault code in the detail: checksum, range, frame or unknown command.")
    WORKSPACE_LIMIT = AlarmDefinition(2007, _E, Reaction.HOLD, "The target lies outside the cell's workspace box.", "Correct the workspace box in the config, or remove the part from the border.")
    SPEED_LIMIT = AlarmDefinition(2008, _E, Reaction.HOLD, "A speed above the cell's limit was asked for.", "Lower the speed in the config.")
    FRAME_CHANGED = AlarmDefinition(2009, _C, Reaction.ABORT, "User frame or tool number differs from the calibration's.", "Select the frame and tool of the calibration, or calibrate again.")
    MODE_NOT_AUTO = AlarmDefinition(2010, _E, Reaction.STOP, "The robot is not in AUTO or its pendant is enabled.", "Turn the key to AUTO and disable the pendant.")
    ROBOT_BUSY = AlarmDefinition(2011, _E, Reaction.STOP, "The robot's program is busy with somebody else's command.", "Wait until it has finished or abort the program on the pendant, then clear.")
    COLLISION = AlarmDefinition(2012, _C, Reaction.ABORT, "The robot controller has detected a collision.", "Free the arm, inspect gripper and parts, reset the controller, clear and reset.")
    GRIP_EMPTY = AlarmDefinition(2101, _E, Reaction.HOLD, "The gripper closed and holds nothing.", "Check the part and the gripper's sensor; unhold to look again.")
    GRIP_LOST = AlarmDefinition(2102, _C, Reaction.HOLD, "The part was lost on the way.", "Put the part back on the table; unhold to look again.")
    GRIP_TIMEOUT = AlarmDefinition(2103, _C, Reaction.HOLD, "The gripper's sensor did not confirm in time.", "Check air, valve and sensor; 'resolve gripper empty|holding'.")
    GRIPPER_STATE_UNKNOWN = AlarmDefinition(2104, _C, Reaction.ABORT, "It is not known what the gripper holds.", "Look at the gripper and say 'resolve gripper empty' or 'resolve gripper holding'.")
    GRIPPER_OCCUPIED = AlarmDefinition(2105, _E, Reaction.STOP, "The gripper holds a part where none is expected.", "Take the part out of the gripper, then 'resolve gripper empty'.")
    GRIPPER_FAULT = AlarmDefinition(2106, _C, Reaction.ABORT, "The gripper reports a fault, or is not activated.", "The detail names the fault and what to do; then clear and reset.")

    CAMERA_UNAVAILABLE = AlarmDefinition(3001, _C, Reaction.ABORT, "The camera cannot be opened.", "Check cable and device path (use /dev/v4l/by-id); only one program may own the camera.")
    CAMERA_TIMEOUT = AlarmDefinition(3002, _E, Reaction.HOLD, "The camera delivered no frame in time.", "Check cable and USB power; unhold to try again.")
    CAMERA_STALE = AlarmDefinition(3003, _E, Reaction.HOLD, "The camera delivered only frames exposed before the arm stood still.", "Check the frame rate and the stream; a frozen stream needs the camera re-plugged.")
    CAMERA_SETTING = AlarmDefinition(3004, _C, Reaction.ABORT, "The camera did not take a setting.", "Choose a supported value; the detail names the control, the value asked for and the value read back.")
    IMAGE_INVALID = AlarmDefinition(3005, _E, Reaction.HOLD, "An image is missing, truncated or of the wrong size.", "Check the file or the camera's resolution against the calibration.")
    IMAGE_UNUSABLE = AlarmDefinition(3006, _E, Reaction.HOLD, "An image shows nothing: it is of one grey, overexposed or nothing but noise.", "Check lens cap, lamp, exposure and cable; unhold to look again.")
    PAIR_INCONSISTENT = AlarmDefinition(3007, _E, Reaction.HOLD, "The two images do not show one scene from the reported poses.", "Check that left and right are not exchanged, that both are of one move, and that poses, user frame and tool are those of the calibration.")
    CALIBRATION_INVALID = AlarmDefinition(3101, _C, Reaction.ABORT, "The calibration is missing, malformed or impossible.", "Run 'srvs-cell calibrate check' and calibrate again.")
    BASELINE_INVALID = AlarmDefinition(3102, _E, Reaction.HOLD, "The two poses do not make a usable stereo baseline.", "Check the lateral path: a sideways move of the camera without rotation.")
    NOTHING_SEEN = AlarmDefinition(3201, _W, Reaction.SUSPEND, "No workpiece is in view.", "Put parts on the table; the cell looks again by itself.")
    UNKNOWN_OBJECT = AlarmDefinition(3202, _W, Reaction.NONE, "A shape was seen that is in no library, or only in part.", "Add the kind to the object library, move the part into view, or take it away.")
    UNCERTAIN_POSITION = AlarmDefinition(3203, _E, Reaction.HOLD, "A position or a height is less certain than the job allows.", "Improve lighting or calibration, or widen the tolerance that the detail names in the config.")
    VERIFY_FAILED = AlarmDefinition(3204, _E, Reaction.HOLD, "Parts do not stand where they should after a move, also after new plans.", "The detail names them; look at the report's pictures. Unhold to look again and plan anew.")
    LOOKS_DISAGREE = AlarmDefinition(3205, _E, Reaction.HOLD, "Looks at the same table do not see the same parts.", "Improve lighting or contrast, or separate the parts; unhold to look again.")
    SCENE_CHANGED = AlarmDefinition(3206, _W, Reaction.NONE, "While the cell worked a part was moved, taken away, added or not put where it belongs.", "None needed: the cell has looked again and planned anew. Keep hands and parts out while it works.")
    PART_LEFT = AlarmDefinition(3207, _W, Reaction.NONE, "A part cannot be taken and is left where it stands; what was wanted of it is not done.", "The detail says why: take the part away, add its kind to the object library or turn it so that it can be gripped. cell.unmovable_parts says whether the cell goes on without it.")

    PLAN_INFEASIBLE = AlarmDefinition(4001, _E, Reaction.HOLD, "No sequence of moves reaches the goal.", "The detail names the reason for each workpiece: make room, free a buffer place or remove the part.")
    PLAN_NOT_PROVEN = AlarmDefinition(4002, _W, Reaction.NONE, "The plan is valid but not proven to be the shortest.", "None needed; the bound is in the detail.")
    PLAN_INVALID = AlarmDefinition(4003, _C, Reaction.ABORT, "The independent validator refused the plan.", "Report this: planner and validator disagree. Nothing was moved.")
    NO_BUFFER_PLACE = AlarmDefinition(4004, _E, Reaction.HOLD, "There is no free buffer place on the table.", "Clear some table, or configure a buffer place.")
    PROBLEM_INVALID = AlarmDefinition(4005, _E, Reaction.NONE, "The planning problem is malformed.", "The detail names the field and what it should be.")

    COMMAND_REFUSED = AlarmDefinition(5001, _W, Reaction.NONE, "The command is not valid in the present state.", "The answer names the commands that lead there.")
    MODE_REFUSED = AlarmDefinition(5002, _W, Reaction.NONE, "The mode cannot be changed in the present state.", "Change modes in Stopped, Idle or Aborted.")
    RESTART_UNRESOLVED = AlarmDefinition(5003, _C, Reaction.ABORT, "The last run ended while a move or a grip was under way.", "Look at the gripper and say 'resolve gripper empty' or 'resolve gripper holding'.")
    JOURNAL_FAILED = AlarmDefinition(5004, _C, Reaction.ABORT, "The journal cannot be written, so nothing may move.", "Check disk space and permissions of the state directory.")
    INTERNAL_ERROR = AlarmDefinition(5005, _C, Reaction.ABORT, "The software met a condition that it has no name for.", "Save a copy of the log and report it; clear to continue.")
    NO_DAEMON = AlarmDefinition(5006, _E, Reaction.NONE, "No daemon answers.", "Start it: 'systemctl start srvs-cell' or 'srvs-cell run --config CELL.yaml'; one that serves another socket is named by --socket or $SRVS_CELL_SOCKET.")
    NOT_AUTHORISED = AlarmDefinition(5007, _W, Reaction.NONE, "This connection may read but not command.", "Use the unix socket as a member of the operators' group.")
    SIMULATION_FAILED = AlarmDefinition(5008, _E, Reaction.NONE, "The simulated cell did not start or ended early.", "Install the extra 'sim'; the detail has the last lines of its log.")
    ALREADY_RUNNING = AlarmDefinition(5009, _E, Reaction.NONE, "Another daemon already serves this cell.", "Use the running one ('srvs-cell status'), or stop it before you start another; the detail names what it holds.")

    CONFIG_INVALID = AlarmDefinition(6001, _C, Reaction.ABORT, "The configuration is wrong.", "The detail names file, key, value and bound.")
    FILE_INVALID = AlarmDefinition(6002, _E, Reaction.NONE, "A file is missing or cannot be read.", "The detail names the file and the reason.")
    DRIVER_UNKNOWN = AlarmDefinition(6003, _C, Reaction.ABORT, "The config names a driver that is not installed.", "The detail lists the installed drivers.")
    # fmt: on

    @property
    def code(self) -> int:
        """The number that operators and documents use."""
        return self.value.code

    @property
    def reaction(self) -> Reaction:
        """The PackML reaction where no milder recovery is decided."""
        return self.value.reaction

    @classmethod
    def from_code(cls, code: int) -> Self:
        """Return the alarm of a code; raises `KeyError` for a code that is not in the registry."""
        for alarm in cls:
            if alarm.value.code == code:
                return alarm
        raise KeyError(code)


class AlarmError(Exception):
    """An error that a person can meet: it carries its row of the registry and what happened in this case.

    Attributes:
        alarm: the registry's row.
        detail: what happened in this case: names, values, bounds.
    """

    def __init__(self, alarm: Alarm, detail: str) -> None:
        self.alarm = alarm
        self.detail = detail
        super().__init__(alarm, detail)

    def __str__(self) -> str:
        row = self.alarm.value
        return f"[{row.code} {self.alarm.name}] {self.detail} Cause: {row.cause} Remedy: {row.remedy}"
