"""The fault table: what strikes a cell on a wire, and what must come of it. docs/reference/faults.md is made of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

UNKNOWN: Final = "unknown"


@dataclass(frozen=True)
class Ending:
    """What a fault ends in.

    Attributes:
        alarm: the first alarm; None where the job goes on.
        state: the unit's PackML state.
        move: how the journal says that the move under way ended; ``unknown`` is an intent without an outcome, ``-``
            where none was under way.
        gripper: what the cell knows of the gripper.
    """

    alarm: str | None
    state: str
    move: str
    gripper: str


@dataclass(frozen=True)
class Fault:
    """One row.

    Attributes:
        strike: its function in `strikes`.
        title: for people.
        when: ``idle``, ``suspended``, or the job's step in whose move it strikes.
        modbus, rmi: what it ends in on each wire; None where the wire has no such thing.
        note: what else a person should know.
    """

    strike: str
    title: str
    when: str
    modbus: Ending | None
    rmi: Ending | None
    note: str = ""


_LOST = Ending("CONNECTION_LOST", "Aborted", "-", "empty")
_SILENT = Ending("CONNECTION_TIMEOUT", "Aborted", "-", "empty")
_NOT_KNOWN = Ending("MOTION_OUTCOME_UNKNOWN", "Aborted", UNKNOWN, UNKNOWN)
_FAULT = Ending("ROBOT_FAULT", "Aborted", "failed", "empty")
_COLLISION = Ending("COLLISION", "Aborted", "failed", "empty")
_TAKEN_OVER = Ending("MODE_NOT_AUTO", "Stopped", "stopped", "empty")
_STOPPED = Ending("MOTION_STOPPED", "Held", "stopped", "empty")
_GOES_ON = Ending(None, "Execute", "done", "empty")
_DROPPED = Ending("GRIP_LOST", "Held", "lost", "empty")
_FROZEN = Ending("HEARTBEAT_LOST", "Aborted", "stopped", "empty")

_MOVE: Final = "observe_left"
_CARRY: Final = "place"

TABLE: Final = (
    Fault("cut", "Cable cut before any move", "idle", _LOST, _LOST),
    Fault(
        "cut", "Cable cut during a move", _MOVE, _NOT_KNOWN, _NOT_KNOWN,
        "Modbus, KAREL: the robot ends the move within 3 s. RMI: taken to go on to its target.",
    ),
    Fault("cut", "Cable cut after the moves", "suspended", _LOST, _LOST),
    Fault("cut", "Cable cut while a part is carried", _CARRY, _NOT_KNOWN, _NOT_KNOWN, "The gripper's outputs stay."),
    Fault("silence", "No answer, before any move", "idle", _SILENT, _SILENT),
    Fault("silence", "No answer, during a move", _MOVE, _NOT_KNOWN, _NOT_KNOWN),
    Fault("half_a_packet", "Half a packet, then the connection ends", _MOVE, _NOT_KNOWN, _NOT_KNOWN),
    Fault("nonsense", "An answer that is not of the protocol", _MOVE, _NOT_KNOWN, _NOT_KNOWN),
    Fault(
        "reply_for_another", "A reply for another sequence", _MOVE, _NOT_KNOWN, _NOT_KNOWN,
        "Modbus: replies of another transaction are passed over, so it ends by the time-out.",
    ),
    Fault(
        "duplicate_reply", "A reply that comes twice", _MOVE, _GOES_ON, _NOT_KNOWN,
        "Modbus, KAREL: the second one's number has been answered, it is passed over. RMI: it may be anybody's.",
    ),
    Fault(
        "emergency_stop", "E-stop, standing", "idle", Ending("ROBOT_FAULT", "Aborted", "-", "empty"),
        Ending("ROBOT_FAULT", "Aborted", "-", "empty"), "Release it; `clear` resets the controller.",
    ),
    Fault("emergency_stop", "E-stop during a move", _MOVE, _FAULT, _FAULT, "The move is never continued."),
    Fault(
        "emergency_stop", "E-stop while a part is carried", _CARRY,
        Ending("ROBOT_FAULT", "Aborted", "failed", "holding"),
        Ending("ROBOT_FAULT", "Aborted", "failed", "holding"),
    ),
    Fault("collision", "Collision detected by the controller", _MOVE, _COLLISION, _COLLISION),
    Fault("override_lowered", "Override lowered during a move", _MOVE, _GOES_ON, _GOES_ON, "A move may take longer."),
    Fault(
        "switched_to_t1", "Mode switched to T1 during a move, pendant on", _MOVE, _TAKEN_OVER, _TAKEN_OVER,
        "RMI: told by the pendant alone; the mode switch cannot be read.",
    ),
    Fault(
        "paused_on_the_pendant", "HOLD pressed on the pendant during a move", _MOVE,
        Ending("MOTION_STOPPED", "Aborted", "stopped", "empty"), _STOPPED,
        "Modbus: the program SRVS stays paused, which is ROBOT_FAULT until `clear` starts it anew.",
    ),
    Fault("rebooted", "Controller rebooted during a move", _MOVE, _NOT_KNOWN, _NOT_KNOWN),
    Fault(
        "second_client", "A second client connects during a move", _MOVE, _GOES_ON, _GOES_ON,
        "It is refused: Modbus closes it, RMI and KAREL report SESSION_HELD to it.",
    ),
    Fault("another_writes_commands", "Another client writes a command during a move", _MOVE, _NOT_KNOWN, None),
    Fault(
        "part_lost", "The gripper loses the part on the way", _CARRY, _DROPPED, _DROPPED,
        "With `cell.retries.grip: 0`; else the cell looks and plans anew as often.",
    ),
    Fault(
        "robot_heartbeat_frozen", "The robot's heartbeat freezes during a move", _MOVE, _FROZEN, None,
        "KAREL: the program that would stop the arm stands still itself; the move goes on to its target.",
    ),
    Fault(
        "started_without_heartbeat", "The robot's heartbeat freezes just before a move", "idle",
        Ending("HEARTBEAT_LOST", "Aborted", "rejected", "empty"), None,
        "The robot's program refuses the command (fault 6): nothing has moved.",
    ),
    Fault(
        "started_after_a_pause", "The PC hangs for 2.5 s before a move", "idle", _FROZEN, None,
        "The robot's watchdog has forbidden motion: nothing has moved.",
    ),
    Fault(
        "pc_heartbeat_frozen", "The PC's heartbeat freezes during a move", _MOVE, _FROZEN, None,
        "The robot ends the move by itself. RMI has no heartbeat: a PC that hangs lets the move go on to its target.",
    ),
)  # fmt: skip

KAREL: Final = {
    **{(fault.strike, fault.when): fault.rmi for fault in TABLE},
    ("duplicate_reply", _MOVE): _GOES_ON,
    ("robot_heartbeat_frozen", _MOVE): _NOT_KNOWN,
    ("started_after_a_pause", "idle"): _FROZEN,
    ("pc_heartbeat_frozen", _MOVE): _FROZEN,
}
"""What the rows end in on the KAREL line protocol: as on RMI, but for its heartbeats and its memory for numbers."""

KAREL_SERIAL: Final = {
    **KAREL,
    ("cut", "idle"): _SILENT,
    ("cut", "suspended"): _SILENT,
}
"""Over RS-232: a line that is cut is silent, nobody says that it has gone."""
