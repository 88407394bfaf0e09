"""A FANUC controller with option R912, as a PC sees it over the Remote Motion Interface.

Built from the operator's manual B-84184EN/03 and field reports (references/fanuc.md 1a) alone; it shares no codec
with the driver. Where the manual does not say what happens, the double does the worse: motion goes on to its target
when the connection is cut, aborted instructions are never answered, HOLD outlives an abort.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeGuard

from drivers.sim.controlled_arm import MotionRefusedError
from drivers.sim.rmi_server import RmiServer
from srvs_cell.geometry import Xyzwpr

if TYPE_CHECKING:
    from drivers.sim.controlled_arm import ControlledArm, ControllerTime

_RMIT: Final = 2556928
(_TOOL, _FRAME) = (_RMIT + n for n in (2, 3))
(_NO_SERVO, _PENDANT, _NOT_RUNNING, _BAD_COMMAND, _FAILED, _BAD_STATE) = (_RMIT + n for n in (7, 8, 9, 13, 14, 15))
(_CANNOT_EXECUTE, _BAD_OVERRIDE, _BAD_INSTRUCTION, _BAD_VALUE, _BAD_TEXT) = (_RMIT + n for n in (6, 5, 20, 21, 22))
(_BAD_POSITION, _IN_HOLD, _COMMAND_OUT, _BUFFER_FULL, _SEQUENCE) = (_RMIT + n for n in (23, 24, 27, 28, 29))
(_SPEED_TYPE, _SPEED, _TERM_TYPE, _PORT, _SINGLE_STEP, _ASCII) = (_RMIT + n for n in (30, 31, 32, 38, 43, 49))

_BUFFER: Final = 8
_SCAN_S: Final = 0.05
_JOIN_S: Final = 2.0  # real seconds: simulated time may already stand still
_SIGNALS: Final = 512
_LAST_SEQUENCE: Final = 2**31 - 1
_RESET_ALONE: Final = 4
_RUNNING, _PAUSED, _ABORTED = 0, 1, 2
_POSTURE: Final = ("Front", "Up", "Left", "Flip", "Turn4", "Turn5", "Turn6")
_AXES: Final = "XYZWPR"
_FRAME_KEYS: Final = ("UToolNumber", "UFrameNumber")
_FRAMES: Final = range(10)
_TOOLS: Final = range(1, 11)
_FARTHEST: Final = 1e6
_SHORT: Final = 2**15 - 1
_MOVES: Final = {"FRC_LinearMotion", "FRC_LinearRelative", "FRC_JointMotion"}
_INSTRUCTIONS: Final = _MOVES | {"FRC_WaitTime", "FRC_SetUFrame", "FRC_SetUTool"}
_SPEED_TYPES: Final = {"FRC_LinearMotion": "mmSec", "FRC_LinearRelative": "mmSec", "FRC_JointMotion": "Percent"}
_WITHOUT_INITIALIZE: Final = {
    "FRC_Initialize",
    "FRC_GetStatus",
    "FRC_ReadError",
    "FRC_SetOverRide",
    "FRC_ReadCartesianPosition",
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
        self.posture: dict[str, int] = dict(zip(_POSTURE, (1, 1, 0, 0, 0, 0, 0), strict=True))
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
            kind, name = ("", "") if packet is None else next(iter(packet.items()))
            if packet is None or kind not in {"Command", "Communication", "Instruction"} or not isinstance(name, str):
                self.server.send({"Command": "Unknown", "ErrorID": _BAD_TEXT})
            elif kind == "Instruction":
                self._queue_up(name, packet)
            elif kind == "Communication":
                self._goodbye(name)
            elif self._lengthy is not None:
                self._answer(name, _COMMAND_OUT)
            elif name in {"FRC_Abort", "FRC_Reset"}:
                self._begin_lengthy(name)
            else:
                self._command(name, packet)
            self._scan()

    def _goodbye(self, name: str) -> None:
        self._end_program()
        self.server.send({"Communication": name, "ErrorID": 0})

    def _command(self, name: str, packet: dict[str, Any]) -> None:
        """Carry out a command and answer it at once."""
        handlers = {
            "FRC_Initialize": self._initialize,
            "FRC_GetStatus": self._status,
            "FRC_ReadError": self._errors,
            "FRC_SetOverRide": self._set_override,
            "FRC_ReadCartesianPosition": self._position,
            "FRC_GetUFrameUTool": self._frames,
            "FRC_SetUFrameUTool": self._set_frames,
            "FRC_ReadDIN": self._read_input,
            "FRC_WriteDOUT": self._write_output,
        }
        if self.has_io_port:
            handlers["FRC_ReadIOPort"] = self._read_port
        if self.has_variables:
            handlers["FRC_ReadVariable"] = self._read_variable
        if name not in handlers:
            self._answer(name, _BAD_COMMAND)
        elif name not in _WITHOUT_INITIALIZE and not self._running:
            self._answer(name, _NOT_RUNNING)
        else:
            try:
                self._answer(name, 0, **handlers[name](packet))
            except (KeyError, TypeError):
                self._answer(name, _BAD_TEXT)
            except ValueError as error:
                self._answer(name, int(str(error)))

    def _answer(self, name: str, error_id: int, **fields: Any) -> None:
        # Beside an ErrorID a real controller was seen to send junk, too.
        junk = {"ProgramStatus": -4} if error_id else {}
        self.server.send({"Command": name, "ErrorID": error_id, **fields, **junk})

    def _initialize(self, _: dict[str, Any]) -> dict[str, Any]:
        refusals = (
            (self.initialize_error, self.initialize_error),
            (self._arm.pendant_enabled, _PENDANT),
            (not self._arm.servo_on, _NO_SERVO),
            (self.single_step, _SINGLE_STEP),
            (str(self._arm.mode) != "AUTO", _BAD_STATE),
            (self._alarm() is not None, _CANNOT_EXECUTE),
            (self._running, _BAD_STATE),
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
        if not _is_whole(packet["Value"]) or packet["Value"] not in range(1, 101):
            raise ValueError(_BAD_OVERRIDE)
        self._arm.override_percent = packet["Value"]
        return {"Value": packet["Value"]}

    def _position(self, _: dict[str, Any]) -> dict[str, Any]:
        configuration = {"UToolNumber": self.user_tool, "UFrameNumber": self.user_frame, **self.posture}
        position = dict(zip(_AXES, (round(value, 4) for value in self._arm.pose.as_tuple()), strict=True))
        return {
            "TimeTag": round(self._time.now_s() * 1000),
            "Configuration": configuration,
            "Position": {**position, "Ext1": 0.0, "Ext2": 0.0, "Ext3": 0.0},
        }

    def _frames(self, _: dict[str, Any]) -> dict[str, Any]:
        return {"UFrameNumber": self.user_frame, "UToolNumber": self.user_tool}

    def _set_frames(self, packet: dict[str, Any]) -> dict[str, Any]:
        if self._arm.moving:
            raise ValueError(_BAD_STATE)
        if packet["UFrameNumber"] not in _FRAMES or not _is_whole(packet["UFrameNumber"]):
            raise ValueError(_FRAME)
        if packet["UToolNumber"] not in _TOOLS or not _is_whole(packet["UToolNumber"]):
            raise ValueError(_TOOL)
        self.user_frame, self.user_tool = packet["UFrameNumber"], packet["UToolNumber"]
        return self._frames(packet)

    def _read_input(self, packet: dict[str, Any]) -> dict[str, Any]:
        n = _signal(packet)
        return {"PortNumber": n, "PortValue": int(self._arm.input(n))}

    def _read_port(self, packet: dict[str, Any]) -> dict[str, Any]:
        n = _signal(packet)
        if packet["PortType"] != "DO":
            raise ValueError(_BAD_VALUE)
        return {"PortType": "DO", "PortNumber": n, "PortValue": int(self._arm.output(n))}

    def _read_variable(self, packet: dict[str, Any]) -> dict[str, Any]:
        name = packet["VariableName"]
        if name != "$RMI_CFG.$ASBN_ENB":
            raise ValueError(_BAD_VALUE)
        return {"VariableName": name, "VariableType": "Integer", "VariableValue": int(self.ascii_mode)}

    def _write_output(self, packet: dict[str, Any]) -> dict[str, Any]:
        if packet["PortValue"] not in {"ON", "OFF"}:
            raise ValueError(_BAD_VALUE)
        self._arm.set_output(_signal(packet), packet["PortValue"] == "ON")
        return {"PortNumber": packet["PortNumber"]}

    def _begin_lengthy(self, name: str) -> None:
        if name == "FRC_Abort":
            if not self._running:
                self._answer(name, _FAILED)
                return
            self._arm.stop()
            self._queue.clear()
            self._current = None
            takes_s = self.abort_takes_s
        else:
            if not self._running and self.major_version < _RESET_ALONE:
                self._answer(name, _NOT_RUNNING)
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
        self._current = None

    def _queue_up(self, name: str, packet: dict[str, Any]) -> None:
        sequence = packet.get("SequenceID")
        if not _is_whole(sequence):
            self.server.send({"Instruction": "Unknown", "SequenceID": 0, "ErrorID": _BAD_TEXT})
            return
        error_id = self._refuse(name, packet, sequence)
        if error_id:
            # Section 3.3: what was queued goes on, nothing new is taken until a reset.
            self._hold = self._hold or error_id not in {_NOT_RUNNING, _BUFFER_FULL}
            self.server.send({"Instruction": name, "ErrorID": error_id, "SequenceID": sequence})
            return
        self._next_sequence = sequence % _LAST_SEQUENCE + 1
        self._queue.append(packet)

    def _refuse(self, name: str, packet: dict[str, Any], sequence: int) -> int:
        """Return the ErrorID for which an instruction is not queued, 0 where it is."""
        checks = (
            (_ASCII, not self.ascii_mode),
            (_NOT_RUNNING, self._running),
            (_IN_HOLD, not self._hold),
            (_BUFFER_FULL, len(self._queue) + (self._current is not None) < _BUFFER),
            (_SEQUENCE, sequence == self._next_sequence),
            (_BAD_INSTRUCTION, name in _INSTRUCTIONS),
        )
        refused = next((error_id for error_id, passed in checks if not passed), 0)
        if refused:
            return refused
        if name in _MOVES:
            return self._refuse_move(name, packet)
        key, error_id, right = {
            "FRC_WaitTime": ("Time", _BAD_VALUE, _is_real),
            "FRC_SetUFrame": ("FrameNumber", _FRAME, _is_whole),
            "FRC_SetUTool": ("ToolNumber", _TOOL, _is_whole),
        }[name]
        return 0 if right(packet.get(key)) else error_id

    def _refuse_move(self, name: str, packet: dict[str, Any]) -> int:
        position, configuration = packet.get("Position"), packet.get("Configuration")
        if not isinstance(position, dict) or not isinstance(configuration, dict):
            return _BAD_TEXT
        # One after the other: a later check may rely on an earlier one.
        checks = (
            (_BAD_POSITION, all(_is_real(position.get(axis)) for axis in _AXES)),
            (_BAD_POSITION, all(_is_whole(configuration.get(key)) for key in (*_POSTURE, *_FRAME_KEYS))),
            (_BAD_POSITION, all(configuration[key] == value for key, value in self.posture.items())),
            (_SPEED_TYPE, packet.get("SpeedType") == _SPEED_TYPES[name]),
            (_SPEED, _is_whole(packet.get("Speed")) and 1 <= packet["Speed"] <= _SHORT),
            (_TERM_TYPE, packet.get("TermType") in ("FINE", "CNT")),
        )
        return next((error_id for error_id, passed in checks if not passed), 0)

    def _scan_for_ever(self) -> None:
        while not self._closing.is_set():
            with self._lock:
                self._scan()
            self._time.sleep(_SCAN_S)

    def _scan(self) -> None:
        """Let the program RMI_MOVE catch up with the present instant."""
        moving = self._arm.moving
        unfinished = self._current is not None and self._current["Instruction"] in _MOVES and self._arm.stopped_short
        halted = self._alarm() is not None or not self._arm.servo_on or (unfinished and not moving)
        if self._running and not self._paused and halted:
            self._fall_into_pause()
        if self._current is not None and not self._paused and not moving and self._time.now_s() >= self._wait_until_s:
            done, self._current = self._current, None
            name, sequence = done["Instruction"], done["SequenceID"]
            self.server.send({"Instruction": name, "ErrorID": 0, "SequenceID": sequence})
        while self._queue and self._current is None and not self._paused and self._may_begin(self._queue[0]):
            self._current = self._queue.popleft()
            self._begin(self._current)
        self._finish_lengthy()

    def _may_begin(self, packet: dict[str, Any]) -> bool:
        """A CNT move does not begin before another instruction follows."""
        return packet.get("TermType") != "CNT" or len(self._queue) > 1

    def _begin(self, packet: dict[str, Any]) -> None:
        name, self._wait_until_s = packet["Instruction"], self._time.now_s()
        if name == "FRC_WaitTime":
            self._wait_until_s += float(packet.get("Time", 0.0))
        elif name == "FRC_SetUFrame":
            self.user_frame = packet["FrameNumber"]
        elif name == "FRC_SetUTool":
            self.user_tool = packet["ToolNumber"]
        else:
            try:
                self._begin_move(name, packet)
            except MotionRefusedError as error:
                self.alarm = str(error)
                self._fall_into_pause()

    def _begin_move(self, name: str, packet: dict[str, Any]) -> None:
        configuration, position = packet["Configuration"], [packet["Position"][axis] for axis in _AXES]
        if configuration.get("UFrameNumber") != self.user_frame:
            raise MotionRefusedError("INTP-252 User frame number mismatch")
        if configuration.get("UToolNumber") != self.user_tool:
            raise MotionRefusedError("INTP-253 Tool frame number mismatch")
        if name == "FRC_LinearRelative":
            position = [a + b for a, b in zip(self._arm.pose.as_tuple(), position, strict=True)]
        target = Xyzwpr(*position)
        if name == "FRC_JointMotion":
            self._arm.start_joint(target, float(packet["Speed"]))
        else:
            self._arm.start_linear(target, float(packet["Speed"]))
        self.motions_started += 1

    def _fall_into_pause(self) -> None:
        self._paused = True
        sequence = 0 if self._current is None else self._current["SequenceID"]
        self.server.send({"Communication": "FRC_SystemFault", "SequenceID": sequence})

    def _alarm(self) -> str | None:
        return self._arm.fault or self.alarm

    def _servo_ready(self) -> bool:
        return self._arm.servo_on and not (self._arm.fault or "").startswith("SRVO")


def _is_whole(value: object) -> TypeGuard[int]:
    """Whether a value is an integer of 32 bits; JSON's true is none."""
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) <= _LAST_SEQUENCE


def _is_real(value: object) -> TypeGuard[float]:
    """Whether a value is a number that a coordinate or a time can be; NaN, which JSON libraries read, is none."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _FARTHEST


def _signal(packet: dict[str, Any]) -> int:
    n = packet["PortNumber"]
    if not _is_whole(n) or not 1 <= n <= _SIGNALS:
        raise ValueError(_PORT)
    return n
