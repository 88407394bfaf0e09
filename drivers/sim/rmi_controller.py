"""A FANUC controller with option R912, as a PC sees it over the Remote Motion Interface.

Built from the operator's manual B-84184EN/03 and field reports (references/fanuc.md 1a) alone; it shares no codec
with the driver. Where the manual does not say what happens, the double does the worse: motion goes on to its target
when the connection is cut, aborted instructions are never answered, HOLD outlives an abort.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from drivers.sim.controlled_arm import JointedArm, MotionRefusedError
from drivers.sim.rmi_instructions import (
    ASCII,
    AXES,
    BAD_COMMAND,
    BAD_OVERRIDE,
    BAD_STATE,
    BAD_TEXT,
    BAD_VALUE,
    BUFFER_FULL,
    CANNOT_EXECUTE,
    COMMAND_OUT,
    FAILED,
    FRAME,
    IN_HOLD,
    JOINT_MOVES,
    JOINTS,
    LAST_SEQUENCE,
    MOVES,
    NO_SERVO,
    NOT_PAUSED,
    NOT_RUNNING,
    PENDANT,
    POSTURE,
    SEQUENCE,
    SINGLE_STEP,
    TOOL,
    is_whole,
    refusal,
    signal_number,
    spelled_out,
)
from drivers.sim.rmi_server import RmiServer
from srvs_cell.geometry import Xyzwpr

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.sim.controlled_arm import ControlledArm, ControllerTime

_BUFFER: Final = 8
_SCAN_S: Final = 0.05
_JOIN_S: Final = 2.0  # real seconds: simulated time may already stand still
_RESET_ALONE: Final = 4
_RUNNING, _PAUSED, _ABORTED = 0, 1, 2
_FRAMES: Final = range(10)
_TOOLS: Final = range(1, 11)
_WITHOUT_INITIALIZE: Final = {
    "FRC_Initialize",
    "FRC_GetStatus",
    "FRC_ReadError",
    "FRC_SetOverRide",
    "FRC_ReadCartesianPosition",
    "FRC_ReadJointAngles",
    "FRC_GetUFrameUTool",
    "FRC_SetUFrameUTool",
    "FRC_Abort",
    "FRC_ReadVariable",
}


@dataclass
class _Lengthy:
    """A command that has not been answered yet."""

    name: str
    until_s: float


class RmiController:
    """The controller double.

    Attributes:
        motions_started: how many motions the arm was told to begin; a repeated instruction would show here.
        abort_takes_s, reset_takes_s: how long the controller lets a client wait for the reply.
        user_frame, user_tool: active frame numbers.
        posture: the arm's configuration; an instruction for another one is refused.
        major_version: of the interface.
        single_step, ascii_mode: states of the controller that forbid motion.
        initialize_error: an ErrorID that ``FRC_Initialize`` ends in, 0 for none.
        has_io_port, has_variables: whether it knows FRC_ReadIOPort and FRC_ReadVariable, which the manual does not
            have.
        alarm: an alarm of the interface itself, besides the arm's.
        server: the wire, with its faults.
    """

    def __init__(self, arm: ControlledArm, time: ControllerTime, port: int = 0, session_port: int = 0) -> None:
        self.motions_started = 0
        self.abort_takes_s = self.reset_takes_s = 0.0
        self.user_frame, self.user_tool = 0, 1
        self.posture: dict[str, int] = dict(zip(POSTURE, (1, 1, 0, 0, 0, 0, 0), strict=True))
        self.major_version = 9
        self.single_step = self.ascii_mode = False
        self.initialize_error = 0
        self.has_io_port = self.has_variables = True
        self.alarm: str | None = None
        self.server = RmiServer(self, time, port, session_port)
        self._arm, self._time = arm, time
        self._running = self._paused = self._hold = False
        self._next_sequence = 1
        self._queue: deque[dict[str, Any]] = deque()
        self._current: dict[str, Any] | None = None
        self._settled: list[float] | None = None
        self._wait_until_s = 0.0
        self._lengthy: _Lengthy | None = None
        self._lock = threading.RLock()
        self._closing = threading.Event()
        self._scanner = threading.Thread(target=self._scan_for_ever, name="RMI controller double", daemon=True)

    @property
    def working(self) -> bool:
        """Whether a command takes simulated time to be answered."""
        return self._lengthy is not None

    def start(self) -> int:
        """Serve and run; return the port for ``FRC_Connect``."""
        self._scanner.start()
        return self.server.start()

    def close(self) -> None:
        """End server and tasks."""
        self._closing.set()
        self.server.close()
        self._scanner.join(_JOIN_S)

    def reboot(self) -> None:
        """Power off and on: motion ended, programs gone, connection cut."""
        with self._lock:
            self._arm.stop()
            self._end_program()
            self._hold, self._lengthy, self.alarm = False, None, None
        self.server.cut()

    def pause(self) -> None:
        """Somebody presses HOLD on the pendant: the arm stops, the program is paused and could be continued."""
        with self._lock:
            self._arm.stop()
            self._paused = True

    def version(self) -> tuple[int, int]:
        """Return major and minor version of the interface."""
        return self.major_version, 0

    def take(self, packet: dict[str, Any] | None) -> None:
        """Carry out a packet."""
        with self._lock:
            self._scan()
            packet = None if packet is None else spelled_out(packet)
            kind, name = ("", "") if packet is None else next(iter(packet.items()))
            if packet is None or kind not in {"Command", "Communication", "Instruction"} or not isinstance(name, str):
                self.server.send({"Command": "Unknown", "ErrorID": BAD_TEXT})
            elif kind == "Instruction":
                self._queue_up(name, packet)
            elif kind == "Communication":
                self._goodbye(name)
            elif self._lengthy is not None:
                self._answer(name, COMMAND_OUT)
            elif name in {"FRC_Abort", "FRC_Reset"}:
                self._begin_lengthy(name)
            else:
                self._command(name, packet)
            self._scan()

    def _goodbye(self, name: str) -> None:
        known = name == "FRC_Disconnect"
        if known:
            self._end_program()
        self.server.send({"Communication": name, "ErrorID": 0 if known else BAD_COMMAND})

    def _command(self, name: str, packet: dict[str, Any]) -> None:
        """Carry out a command and answer it at once."""
        handlers = {
            "FRC_Initialize": self._initialize,
            "FRC_GetStatus": self._status,
            "FRC_ReadError": self._errors,
            "FRC_SetOverRide": self._set_override,
            "FRC_ReadCartesianPosition": self._position,
            "FRC_Pause": self._pause,
            "FRC_Continue": self._continue,
            "FRC_GetUFrameUTool": self._frames,
            "FRC_SetUFrameUTool": self._set_frames,
            "FRC_ReadDIN": self._read_input,
            "FRC_WriteDOUT": self._write_output,
        }
        if self.has_io_port:
            handlers["FRC_ReadIOPort"] = self._read_port
        if isinstance(self._arm, JointedArm):
            handlers["FRC_ReadJointAngles"] = self._joints
        if self.has_variables:
            handlers["FRC_ReadVariable"] = self._read_variable
        if name not in handlers:
            self._answer(name, BAD_COMMAND)
        elif name not in _WITHOUT_INITIALIZE and not self._running:
            self._answer(name, NOT_RUNNING)
        else:
            try:
                self._answer(name, 0, **handlers[name](packet))
            except (KeyError, TypeError):
                self._answer(name, BAD_TEXT)
            except ValueError as error:
                self._answer(name, int(str(error)))

    def _answer(self, name: str, error_id: int, **fields: Any) -> None:
        # Beside an ErrorID a real controller was seen to send junk, too.
        junk = {"ProgramStatus": -4} if error_id else {}
        self.server.send({"Command": name, "ErrorID": error_id, **fields, **junk})

    def _initialize(self, _: dict[str, Any]) -> dict[str, Any]:
        refusals = (
            (self.initialize_error, self.initialize_error),
            (self._arm.pendant_enabled, PENDANT),
            (not self._arm.servo_on, NO_SERVO),
            (self.single_step, SINGLE_STEP),
            (str(self._arm.mode) != "AUTO", BAD_STATE),
            (self._alarm() is not None, CANNOT_EXECUTE),
            (self._running, BAD_STATE),
        )
        for applies, error_id in refusals:
            if applies:
                raise ValueError(error_id)
        self._running, self._paused, self._next_sequence = True, False, 1
        return {"GroupMask": 1}

    def _status(self, _: dict[str, Any]) -> dict[str, Any]:
        return {
            "ServoReady": int(self._servo_ready()),
            "TPMode": int(self._arm.pendant_enabled),
            "RMIMotionStatus": int(self._running),
            "ProgramStatus": _PAUSED if self._paused else _RUNNING if self._running else _ABORTED,
            "SingleStepMode": int(self.single_step),
            "NumberUTool": 10,
            "NumberUFrame": 9,
            "NextSequenceID": self._next_sequence,
            "Override": self._arm.override_percent,
        }

    def _errors(self, _: dict[str, Any]) -> dict[str, Any]:
        alarm = self._alarm()
        return {"Count": 1, "ErrorData": "No Error" if alarm is None else alarm.split()[0]}

    def _set_override(self, packet: dict[str, Any]) -> dict[str, Any]:
        if not is_whole(packet["Value"]) or packet["Value"] not in range(1, 101):
            raise ValueError(BAD_OVERRIDE)
        self._arm.override_percent = packet["Value"]
        return {"Value": packet["Value"]}

    def _position(self, _: dict[str, Any]) -> dict[str, Any]:
        configuration = {"UToolNumber": self.user_tool, "UFrameNumber": self.user_frame, **self.posture}
        position = dict(zip(AXES, (round(value, 4) for value in self._arm.pose.as_tuple()), strict=True))
        return {
            "TimeTag": round(self._time.now_s() * 1000),
            "Configuration": configuration,
            "Position": {**position, "Ext1": 0.0, "Ext2": 0.0, "Ext3": 0.0},
        }

    def _joints(self, _: dict[str, Any]) -> dict[str, Any]:
        angles = dict(zip(JOINTS, (round(angle, 3) for angle in self._jointed().joints_deg), strict=True))
        return {
            "TimeTag": round(self._time.now_s() * 1000),
            "JointAngle": {**angles, "J7": 0.0, "J8": 0.0, "J9": 0.0},
        }

    def _pause(self, _: dict[str, Any]) -> dict[str, Any]:
        self.pause()
        return {}

    def _continue(self, _: dict[str, Any]) -> dict[str, Any]:
        if not self._paused:
            raise ValueError(NOT_PAUSED)
        if self._alarm() is not None or self._arm.moving:
            raise ValueError(BAD_STATE)
        self._paused = False
        if self._current is not None and self._current["Instruction"] in MOVES and self._arm.stopped_short:
            self._start(self._current["Instruction"], self._current)
        return {}

    def _frames(self, _: dict[str, Any]) -> dict[str, Any]:
        return {"UFrameNumber": self.user_frame, "UToolNumber": self.user_tool}

    def _set_frames(self, packet: dict[str, Any]) -> dict[str, Any]:
        if self._arm.moving:
            raise ValueError(BAD_STATE)
        if packet["UFrameNumber"] not in _FRAMES or not is_whole(packet["UFrameNumber"]):
            raise ValueError(FRAME)
        if packet["UToolNumber"] not in _TOOLS or not is_whole(packet["UToolNumber"]):
            raise ValueError(TOOL)
        self.user_frame, self.user_tool = packet["UFrameNumber"], packet["UToolNumber"]
        return self._frames(packet)

    def _read_input(self, packet: dict[str, Any]) -> dict[str, Any]:
        n = signal_number(packet)
        return {"PortNumber": n, "PortValue": int(self._arm.input(n))}

    def _read_port(self, packet: dict[str, Any]) -> dict[str, Any]:
        n = signal_number(packet)
        if packet["PortType"] != "DO":
            raise ValueError(BAD_VALUE)
        return {"PortType": "DO", "PortNumber": n, "PortValue": int(self._arm.output(n))}

    def _read_variable(self, packet: dict[str, Any]) -> dict[str, Any]:
        name = packet["VariableName"]
        if name != "$RMI_CFG.$ASBN_ENB":
            raise ValueError(BAD_VALUE)
        return {"VariableName": name, "VariableType": "Integer", "VariableValue": int(self.ascii_mode)}

    def _write_output(self, packet: dict[str, Any]) -> dict[str, Any]:
        if packet["PortValue"] not in {"ON", "OFF"}:
            raise ValueError(BAD_VALUE)
        self._arm.set_output(signal_number(packet), packet["PortValue"] == "ON")
        return {"PortNumber": packet["PortNumber"]}

    def _begin_lengthy(self, name: str) -> None:
        if name == "FRC_Abort":
            if not self._running:
                self._answer(name, FAILED)
                return
            self._arm.stop()
            self._queue.clear()
            self._current = self._settled = None
            takes_s = self.abort_takes_s
        else:
            if not self._running and self.major_version < _RESET_ALONE:
                self._answer(name, NOT_RUNNING)
                return
            takes_s = self.reset_takes_s
        self._lengthy = _Lengthy(name, self._time.now_s() + takes_s)

    def _finish_lengthy(self) -> None:
        lengthy = self._lengthy
        if lengthy is None or self._arm.moving or self._time.now_s() < lengthy.until_s:
            return
        if lengthy.name == "FRC_Abort":
            self._end_program()
        else:
            self._arm.reset_fault()
            self.alarm, self._hold = None, False
        self._answer(lengthy.name, 0)
        self._lengthy = None

    def _end_program(self) -> None:
        self._running = self._paused = False
        self._queue.clear()
        self._current = self._settled = None

    def _queue_up(self, name: str, packet: dict[str, Any]) -> None:
        sequence = packet.get("SequenceID")
        if not is_whole(sequence):
            self.server.send({"Instruction": "Unknown", "SequenceID": 0, "ErrorID": BAD_TEXT})
            return
        error_id = self._refuse(name, packet, sequence)
        if error_id:
            # Section 3.3: what was queued goes on, nothing new is taken until a reset.
            self._hold = self._hold or error_id not in {NOT_RUNNING, BUFFER_FULL}
            self.server.send({"Instruction": name, "ErrorID": error_id, "SequenceID": sequence})
            return
        self._next_sequence = sequence % LAST_SEQUENCE + 1
        self._queue.append(packet)

    def _refuse(self, name: str, packet: dict[str, Any], sequence: int) -> int:
        """Return the ErrorID for which an instruction is not queued, 0 where it is."""
        checks = (
            (ASCII, not self.ascii_mode),
            (NOT_RUNNING, self._running),
            (IN_HOLD, not self._hold),
            (BUFFER_FULL, len(self._queue) + (self._current is not None) < _BUFFER),
            (SEQUENCE, sequence == self._next_sequence),
        )
        refused = next((error_id for error_id, passed in checks if not passed), 0)
        return refused or refusal(name, packet, self.posture, jointed=isinstance(self._arm, JointedArm))

    def _scan_for_ever(self) -> None:
        while not self._closing.is_set():
            with self._lock:
                self._scan()
            self._time.sleep(_SCAN_S)

    def _scan(self) -> None:
        """Let the program RMI_MOVE catch up with the present instant."""
        moving = self._arm.moving
        unfinished = self._current is not None and self._current["Instruction"] in MOVES and self._arm.stopped_short
        halted = self._alarm() is not None or not self._arm.servo_on or (unfinished and not moving)
        if self._running and not self._paused and halted:
            self._fall_into_pause()
        if self._current is not None and not self._paused and not moving and self._has_waited(self._current):
            done, self._current, self._settled = self._current, None, None
            name, sequence = done["Instruction"], done["SequenceID"]
            self.server.send({"Instruction": name, "ErrorID": 0, "SequenceID": sequence})
        while self._queue and self._current is None and not self._paused and self._may_begin(self._queue[0]):
            self._current = self._queue.popleft()
            self._begin(self._current)
        self._finish_lengthy()

    def _has_waited(self, packet: dict[str, Any]) -> bool:
        if packet["Instruction"] == "FRC_WaitDIN":
            return self._arm.input(packet["PortNumber"]) is (packet["PortValue"] == "ON")
        return self._time.now_s() >= self._wait_until_s

    def _may_begin(self, packet: dict[str, Any]) -> bool:
        """A CNT move does not begin before another instruction follows."""
        return packet.get("TermType") != "CNT" or len(self._queue) > 1

    def _begin(self, packet: dict[str, Any]) -> None:
        name, self._wait_until_s = packet["Instruction"], self._time.now_s()
        if name == "FRC_WaitTime":
            self._wait_until_s += float(packet["Time"])
        elif name == "FRC_SetUFrame":
            self.user_frame = packet["FrameNumber"]
        elif name == "FRC_SetUTool":
            self.user_tool = packet["ToolNumber"]
        elif name in MOVES:
            self._start(name, packet)

    def _start(self, name: str, packet: dict[str, Any]) -> None:
        """Let the arm begin a move, or go on with one that was paused."""
        try:
            if name in JOINT_MOVES:
                self._jointed().start_joints(self._target(name, packet["JointAngle"], JOINTS), float(packet["Speed"]))
            else:
                self._begin_move(name, packet)
        except MotionRefusedError as error:
            self.alarm = str(error)
            self._fall_into_pause()
        else:
            self.motions_started += 1

    def _begin_move(self, name: str, packet: dict[str, Any]) -> None:
        configuration = packet["Configuration"]
        if configuration["UFrameNumber"] != self.user_frame:
            raise MotionRefusedError("INTP-252 User frame number mismatch")
        if configuration["UToolNumber"] != self.user_tool:
            raise MotionRefusedError("INTP-253 Tool frame number mismatch")
        target, speed = Xyzwpr(*self._target(name, packet["Position"], AXES)), float(packet["Speed"])
        if name.startswith("FRC_Joint"):
            self._arm.start_joint(target, speed)
        else:
            self._arm.start_linear(target, speed)

    def _target(self, name: str, values: dict[str, Any], keys: Sequence[str]) -> list[float]:
        """Return where a move ends; that of a relative one is settled when it begins, and holds after a pause."""
        target = [float(values[key]) for key in keys]
        if "Relative" in name:
            here = self._arm.pose.as_tuple() if keys == AXES else self._jointed().joints_deg
            if self._settled is None:
                self._settled = [a + b for a, b in zip(here, target, strict=True)]
            return self._settled
        return target

    def _jointed(self) -> JointedArm:
        if not isinstance(self._arm, JointedArm):
            raise TypeError(self._arm)
        return self._arm

    def _fall_into_pause(self) -> None:
        self._paused = True
        sequence = 0 if self._current is None else self._current["SequenceID"]
        self.server.send({"Communication": "FRC_SystemFault", "SequenceID": sequence})

    def _alarm(self) -> str | None:
        return self._arm.fault or self.alarm

    def _servo_ready(self) -> bool:
        return self._arm.servo_on and not (self._arm.fault or "").startswith("SRVO")
