"""A FANUC controller with option R553 and the program SRVS, as a PC sees it over Modbus TCP.

Built from docs/reference/modbus-map.md alone and packed with `struct`: it shares no codec with the driver. Like the
robot's program it copies parameters before it acts, checks them itself, counts a heartbeat in a second task, stops
on the hold output and when the PC's heartbeat freezes, and takes no command that was sent before it started.
"""

from __future__ import annotations

import re
import struct
import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Protocol

from drivers.sim.modbus_server import HoldableTime, ModbusServer
from srvs_cell.geometry import Xyzwpr

if TYPE_CHECKING:
    from srvs_cell.ports import RobotMode

_PROTO: Final = 4201
_FIRST: Final = 12001 - 1  # wire addresses count from 0
_PC_FIRST: Final = 12031 - 1
_LAST: Final = 12049 - 1
_WORDS: Final = _LAST - _FIRST + 1
_PC_WORDS: Final = _LAST - _PC_FIRST + 1

_MOVE_L, _MOVE_J = 1, 2
_IDLE, _BUSY, _DONE, _FAULT = 0, 1, 2, 3
_BAD_COMMAND, _BAD_SUM, _BAD_POSITION, _BAD_SPEED, _BAD_FRAME, _NO_PC, _HELD = 1, 2, 3, 4, 5, 6, 7
_STOPPED, _STOPPED_BY_WATCHDOG = 20, 21

_COUNT_TO: Final = 30_000
_BEAT_S: Final = 0.1
_SCAN_S: Final = 0.05
_TAKE_S: Final = 0.15  # register write to motion, measured on a controller (references/fanuc.md 1b)
_PC_SILENT_S: Final = 2.0
_REACH_UM: Final = 3_000_000
_ANGLE_MDEG: Final = 360_000
_SPEED_L_UM: Final = (1_000, 2_000_000)
_SPEED_J_MILLI: Final = (1_000, 100_000)
_HOLD_DO: Final = 3
_RESET_DO: Final = 4
_OUTPUTS: Final = 512
_JOIN_S: Final = 2.0  # real seconds: simulated time may already stand still

_FACILITY: Final = {"MEMO": 7, "TPIF": 9, "SRVO": 11, "INTP": 12, "PRIO": 13, "MOTN": 15, "SYST": 24}
_NAMED_ALARM: Final = re.compile(r"\b([A-Z]{4})-(\d{3})\b")
_UNREACHABLE: Final = (15, 18)  # MOTN-018 Position not reachable
_UNNAMED: Final = (24, 999)


class MotionRefusedError(Exception):
    """The arm cannot begin a motion; the text says why."""


class ControlledArm(Protocol):
    """What the controller needs of the arm that it drives."""

    mode: RobotMode
    pendant_enabled: bool
    servo_on: bool
    override_percent: int

    @property
    def moving(self) -> bool:
        """Whether a motion is under way."""
        ...

    @property
    def stopped_short(self) -> bool:
        """Whether the last motion ended before its target."""
        ...

    @property
    def pose(self) -> Xyzwpr:
        """The reported base_T_tcp."""
        ...

    @property
    def fault(self) -> str | None:
        """The controller's alarm, spelt as on the pendant ("SRVO-050 ..."), or None."""
        ...

    def start_linear(self, target: Xyzwpr, speed_mm_s: float) -> None:
        """Begin a straight motion."""
        ...

    def start_joint(self, target: Xyzwpr, speed_percent: float) -> None:
        """Begin a joint motion."""
        ...

    def stop(self) -> None:
        """Decelerate to a stand."""
        ...

    def reset_fault(self) -> None:
        """Clear the fault."""
        ...

    def set_output(self, n: int, on: bool) -> None:
        """Switch DO[n]."""
        ...

    def output(self, n: int) -> bool:
        """Read DO[n]."""
        ...

    def input(self, n: int) -> bool:
        """Read DI[n]."""
        ...


class ControllerTime(HoldableTime, Protocol):
    """Simulated time for threads."""

    def now_s(self) -> float:
        """Return simulated seconds."""
        ...

    def sleep(self, seconds: float) -> None:
        """Return after ``seconds`` of simulated time."""
        ...


@dataclass
class _Motion:
    """The motion task's private copy of a command, and how far it has come."""

    sequence: int
    command: int
    micro: tuple[int, ...]
    total: int
    taken_at_s: float
    started: bool = False
    stop_code: int = 0


@dataclass
class _Registers:
    """R registers that the program writes."""

    acknowledged: int = 0
    state: int = _IDLE
    fault: int = 0
    alarm: tuple[int, int] = (0, 0)
    pc: list[int] = field(default_factory=lambda: [0] * _PC_WORDS)
    """What the PC has written, from %R12031 on."""


class ModbusController:
    """The controller double.

    Attributes:
        motions_started: how many motions the arm was told to begin; a repeated command would show here.
        heartbeat_frozen: set it to let the heartbeat task die.
        user_frame, user_tool: active frame numbers.
        server: the wire, with its faults.
    """

    def __init__(self, arm: ControlledArm, time: ControllerTime, port: int = 0, unit_id: int = 1) -> None:
        self.motions_started = 0
        self.heartbeat_frozen = False
        self.user_frame = 1
        self.user_tool = 1
        self.server = ModbusServer(self, time, port, unit_id)
        self._arm, self._time = arm, time
        self._r = _Registers()
        self._motion: _Motion | None = None
        self._paused = False
        self._beat = 1
        self._beat_at_s = time.now_s()
        self._pc_beat = 0
        self._pc_beat_at_s = time.now_s()
        self._pc_frozen = True
        self._own_outputs = {_HOLD_DO: False, _RESET_DO: False}
        self._lock = threading.RLock()
        self._closing = threading.Event()
        self._scanner = threading.Thread(target=self._scan_for_ever, name="controller double", daemon=True)

    def start(self) -> int:
        """Serve and run the robot's tasks; return the bound port."""
        self._scanner.start()
        return self.server.start()

    def close(self) -> None:
        """End server and tasks."""
        self._closing.set()
        self.server.close()
        self._scanner.join(_JOIN_S)

    def reboot(self) -> None:
        """Power off and on: connection cut, motion ended, registers cleared, outputs off, program started anew."""
        with self._lock:
            self._arm.stop()
            self._r = _Registers()
            self._own_outputs = dict.fromkeys(self._own_outputs, False)
            self._pc_frozen = True
            self._start_program()
        self.server.cut()

    def read_words(self, address: int, count: int) -> list[int]:
        """Return words of the $SNPX_ASG table; what is not assigned reads 0."""
        with self._lock:
            self._scan()
            table = self._table()
        return [table[a - _FIRST] if _FIRST <= a <= _LAST else 0 for a in range(address, address + count)]

    def write_words(self, address: int, values: list[int]) -> None:
        """Set the PC's words; others are not assigned for writing and keep their values."""
        with self._lock:
            self._scan()
            for a, value in enumerate(values, start=address):
                if _PC_FIRST <= a <= _LAST:
                    self._r.pc[a - _PC_FIRST] = value
            self._scan()

    def read_coils(self, address: int, count: int) -> list[bool]:
        """Return DO[address + 1] and up."""
        with self._lock:
            self._scan()
            return [self._output(n) for n in _numbers(address, count)]

    def write_coils(self, address: int, values: list[bool]) -> None:
        """Set DO[address + 1] and up."""
        with self._lock:
            self._scan()
            for n, on in zip(_numbers(address, len(values)), values, strict=True):
                if n == _RESET_DO and on and not self._own_outputs[n]:
                    self._reset()
                if n in self._own_outputs:
                    self._own_outputs[n] = on
                else:
                    self._arm.set_output(n, on)
            self._scan()

    def read_inputs(self, address: int, count: int) -> list[bool]:
        """Return DI[address + 1] and up."""
        with self._lock:
            return [self._arm.input(n) for n in _numbers(address, count)]

    def _output(self, n: int) -> bool:
        return self._own_outputs[n] if n in self._own_outputs else self._arm.output(n)

    def _scan_for_ever(self) -> None:
        while not self._closing.is_set():
            with self._lock:
                self._scan()
            self._time.sleep(_SCAN_S)

    def _scan(self) -> None:
        """Let both tasks of the robot catch up with the present instant."""
        now_s = self._time.now_s()
        self._heartbeat_task(now_s)
        self._motion_task(now_s)

    def _heartbeat_task(self, now_s: float) -> None:
        """SRVS_HB: count R[114]; raise the hold output when R[115] stands still."""
        if not self.heartbeat_frozen:
            beats = int((now_s - self._beat_at_s) / _BEAT_S)
            self._beat = (self._beat - 1 + beats) % _COUNT_TO + 1
            self._beat_at_s += beats * _BEAT_S
        pc_beat = self._r.pc[1]
        if pc_beat != self._pc_beat:
            self._pc_beat, self._pc_beat_at_s, self._pc_frozen = pc_beat, now_s, False
        elif not self._pc_frozen and now_s - self._pc_beat_at_s > _PC_SILENT_S:
            self._pc_frozen = True
            self._own_outputs[_HOLD_DO] = True

    def _motion_task(self, now_s: float) -> None:
        """SRVS: wait for a sequence number, copy, check, move, report."""
        if self._arm.fault is not None:
            self._alarm(_alarm_words(self._arm.fault))
        if self._paused:
            return
        if self._motion is None:
            if self._r.pc[0] != self._r.acknowledged:
                self._motion = self._copy_command(now_s)
                self._r.state, self._r.fault = _BUSY, 0
            return
        motion = self._motion
        if not motion.started:
            if now_s - motion.taken_at_s >= _TAKE_S:
                self._begin(motion)
        elif self._arm.moving:
            if self._own_outputs[_HOLD_DO] and not motion.stop_code:
                motion.stop_code = _STOPPED_BY_WATCHDOG if self._pc_frozen else _STOPPED
                self._arm.stop()
        elif self._arm.stopped_short:
            self._finish(motion.stop_code or _STOPPED)
        else:
            self._finish(0)

    def _copy_command(self, now_s: float) -> _Motion:
        words = self._r.pc
        values = struct.unpack("<8i", struct.pack("<16H", *words[3:19]))
        return _Motion(words[0], words[2], values[:7], values[7], now_s)

    def _begin(self, motion: _Motion) -> None:
        code = self._check(motion)
        if code:
            self._finish(code)
            return
        x, y, z, w, p, r, speed = (value / 1000 for value in motion.micro)
        target = Xyzwpr(x, y, z, w, p, r)
        try:
            if motion.command == _MOVE_L:
                self._arm.start_linear(target, speed)
            else:
                self._arm.start_joint(target, speed)
        except MotionRefusedError as error:
            self._alarm(_alarm_words(str(error), _UNREACHABLE))
            return
        motion.started = True
        self.motions_started += 1

    def _check(self, motion: _Motion) -> int:
        """SRVS_CHK: return the fault code, 0 where the command may be carried out."""
        x, y, z, w, p, r, speed = motion.micro
        low, high = _SPEED_L_UM if motion.command == _MOVE_L else _SPEED_J_MILLI
        total = (
            _PROTO + motion.sequence + 2 * motion.command + 3 * x + 4 * y + 5 * z + 6 * w + 7 * p + 8 * r + 9 * speed
        )
        checks = (
            (_BAD_COMMAND, motion.command in {_MOVE_L, _MOVE_J}),
            (_BAD_POSITION, max(abs(x), abs(y), abs(z)) <= _REACH_UM and max(abs(w), abs(p), abs(r)) <= _ANGLE_MDEG),
            (_BAD_SPEED, low <= speed <= high),
            (_BAD_SUM, total == motion.total and 1 <= motion.sequence <= _COUNT_TO),
            (_BAD_FRAME, (self.user_frame, self.user_tool) == (1, 1)),
            (_NO_PC, not self._pc_frozen),
            (_HELD, not self._own_outputs[_HOLD_DO]),
        )
        return next((code for code, passed in checks if not passed), 0)

    def _finish(self, code: int) -> None:
        """Write the result, and the acknowledgement last."""
        if self._motion is not None:
            self._r.fault, self._r.state = code, _FAULT if code else _DONE
            self._r.acknowledged = self._motion.sequence
            self._motion = None

    def _alarm(self, alarm: tuple[int, int]) -> None:
        """A controller alarm pauses the program where it is; state and acknowledgement stay as they are."""
        self._r.alarm = alarm
        self._paused = True

    def _reset(self) -> None:
        """DO[4]: fault reset, abort of what is paused, start of SRVS from its first line."""
        if self._arm.moving:
            return
        self._arm.reset_fault()
        if self._arm.fault is None:
            self._start_program()

    def _start_program(self) -> None:
        self._motion, self._paused = None, False
        self._r.alarm = (0, 0)
        self._r.acknowledged, self._r.state, self._r.fault = self._r.pc[0], _IDLE, 0

    def _table(self) -> list[int]:
        arm = self._arm
        faulty = self._r.alarm != (0, 0)
        remote = str(arm.mode) == "AUTO" and not arm.pendant_enabled
        uo = (
            (remote and arm.servo_on and not faulty)
            | arm.servo_on << 1
            | (not self._paused) << 2
            | self._paused << 3
            | faulty << 5
            | arm.pendant_enabled << 7
        )
        mode = {"AUTO": 1, "T1": 2, "T2": 3}.get(str(arm.mode), 0)
        head = (_PROTO, self._r.acknowledged, self._r.state, self._r.fault, self._beat, mode, uo, *self._r.alarm)
        pose = (round(value * 1000) for value in arm.pose.as_tuple())
        tail = (*pose, arm.override_percent, self.user_frame, self.user_tool)
        robot = struct.unpack("<27H", struct.pack("<9H9i", *head, *tail))
        return [*robot, 0, 0, 0, *self._r.pc]


def _numbers(address: int, count: int) -> range:
    """Return the 1-based signal numbers; raises ValueError beyond what the controller has."""
    if address + count > _OUTPUTS:
        raise ValueError(address)
    return range(address + 1, address + count + 1)


def _alarm_words(text: str, otherwise: tuple[int, int] = _UNNAMED) -> tuple[int, int]:
    """Return facility and number of an alarm spelt as on the pendant."""
    found = _NAMED_ALARM.search(text)
    if found is None or found[1] not in _FACILITY:
        return otherwise
    return _FACILITY[found[1]], int(found[2])
