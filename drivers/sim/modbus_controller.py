"""A FANUC controller with option R553, as a PC sees it over Modbus TCP: it executes the robot's own programs.

What the programs of drivers/fanuc/controller/ say is what happens: an interpreter (drivers/sim/tp) runs them against
the simulated arm, and their command file SRVS.CF lays out the words. Only what the controller itself does is written
here: operating mode, alarms, UOP signals, power, and the wiring of the reset output.
"""

from __future__ import annotations

import re
import threading
from typing import TYPE_CHECKING, Final

from drivers.sim.modbus_server import ModbusServer
from drivers.sim.snpx import WordTable, split
from drivers.sim.tp import TpMachine, load, shipped_sources
from drivers.sim.tp_arm import MODE_SIGNALS, TpArm

if TYPE_CHECKING:
    from collections.abc import Mapping

    from drivers.sim.controlled_arm import ControlledArm, ControllerTime

_MAIN: Final = "SRVS"
_HEARTBEAT: Final = "SRVS_HB"
_COMMAND_FILE: Final = "SRVS.CF"

_SCAN_S: Final = 0.05
_SWITCHED_ON_S: Final = 1.0
"""How long the controller has been on, and its programs have run, when it begins to serve."""

_HOLD_DO: Final = 3
_RESET_DO: Final = 4
_OUTPUTS: Final = 512
_WORDS: Final = 16384
_JOIN_S: Final = 2.0  # real seconds: simulated time may already stand still
_MICRO: Final = 1000
_UO_BITS: Final = 16

_FACILITY: Final = {"MEMO": 7, "TPIF": 9, "SRVO": 11, "INTP": 12, "PRIO": 13, "MOTN": 15, "SYST": 24}
_NAMED_ALARM: Final = re.compile(r"\b([A-Z]{4})-(\d{3})\b")
_UNNAMED: Final = (24, 999)


class _Robot(TpArm):
    """The controller's devices and data, as its programs and its word table see them.

    Attributes:
        outputs: DO that lead to no device of the arm.
        alarm: facility and number of the active alarm, zeros without.
        machine: runs the programs.
    """

    def __init__(self, arm: ControlledArm, sources: Mapping[str, str]) -> None:
        super().__init__(arm)
        self.outputs = {_HOLD_DO: False, _RESET_DO: False}
        self.alarm = (0, 0)
        self.machine = TpMachine(load(sources), self)
        self._robot_outputs: dict[int, bool] = {}
        self._flags: dict[int, bool] = {}

    # -- what programs see --------------------------------------------------------------------------------------------

    def signal(self, kind: str, number: int) -> bool:
        """Return a signal; inputs of the end effector (RI) and all of UI are not wired."""
        if kind == "DO":
            return self.outputs[number] if number in self.outputs else self._arm.output(number)
        if kind == "DI":
            return self._arm.input(number)
        if kind == "SI":
            return number in MODE_SIGNALS.get(str(self._arm.mode), set())
        if kind == "UO":
            return bool(self._uop() >> (number - 1) & 1)
        return {"RO": self._robot_outputs, "F": self._flags}.get(kind, {}).get(number, False)

    def set_signal(self, kind: str, number: int, on: bool) -> None:
        """Switch DO, RO or a flag."""
        if kind == "RO":
            self._robot_outputs[number] = on
        elif kind == "F":
            self._flags[number] = on
        elif number in self.outputs:
            self.outputs[number] = on
        else:
            self._arm.set_output(number, on)

    # -- what the word table sees -------------------------------------------------------------------------------------

    def register(self, index: int) -> float:
        """Return R[index]."""
        return self.machine.memory.registers.get(index, 0)

    def set_register(self, index: int, value: int) -> None:
        """Write R[index]."""
        self.machine.memory.registers[index] = value

    def element(self, name: str, index: int, multiply: int) -> list[int]:
        """Return the words of POS, ALM, UO or a system variable."""
        if name == "UO":
            return [self._uop() & ((1 << _UO_BITS) - 1)]
        if name == "ALM":
            return list(self.alarm)
        if name == "POS":
            return [word for value in self._arm.pose.as_tuple() for word in split(round(value * multiply))]
        return split(self.variable(f"{name}[{index}]" if index else name) * multiply)

    # -- what the controller does by itself ---------------------------------------------------------------------------

    def catch_up(self, now_s: float) -> None:
        """Let the programs come up to ``now_s``; an alarm of the arm or of a program pauses them."""
        if self._arm.fault is not None:
            self._raise(self._arm.fault)
        alarm = self.machine.catch_up(now_s)
        if alarm is not None:  # of a program that waits for an arm which has just come to fault, the cause is named
            self._raise(self._arm.fault or alarm)

    def reset(self, now_s: float) -> None:
        """DO[4]: fault reset, abort, start of SRVS from its first line."""
        if self._arm.moving:
            return
        self._arm.reset_fault()
        if self._arm.fault is None:
            self.machine.abort()
            self._begin(now_s)

    def power_off(self) -> None:
        """End motion and programs, switch the controller's own outputs off; registers keep their values."""
        self._arm.stop()
        self.machine.power_off()
        self.outputs = dict.fromkeys(self.outputs, False)

    def power_on(self, now_s: float) -> None:
        """Start SRVS, and let it run for the time that the controller has been on."""
        self._begin(now_s - _SWITCHED_ON_S)

    def _begin(self, at_s: float) -> None:
        self.alarm = (0, 0)
        self.machine.run(_MAIN, at_s)

    def _raise(self, text: str) -> None:
        self.alarm = _alarm_words(text)
        self.machine.paused = True

    def _uop(self) -> int:
        """Return UO[1] to UO[8]."""
        arm, paused, faulty = self._arm, self.machine.paused, self.alarm != (0, 0)
        remote = str(arm.mode) == "AUTO" and not arm.pendant_enabled
        running = self.machine.running(_MAIN) and not paused
        return (
            (remote and arm.servo_on and not faulty)
            | arm.servo_on << 1
            | running << 2
            | paused << 3
            | faulty << 5
            | arm.pendant_enabled << 7
        )


class ModbusController:
    """The controller double.

    Args:
        arm: what it drives.
        time: simulated time.
        port: where it serves; 0 takes a free one.
        unit_id: ``$SNPX_PARAM.$MODBUS_ADR``.
        sources: the robot's files by name; the shipped ones without.

    Raises:
        TpError: a program is refused; the message says file, line and reason.

    Attributes:
        server: the wire, with its faults.
    """

    def __init__(
        self,
        arm: ControlledArm,
        time: ControllerTime,
        port: int = 0,
        unit_id: int = 1,
        sources: Mapping[str, str] | None = None,
    ) -> None:
        sources = shipped_sources() if sources is None else sources
        self.server = ModbusServer(self, time, port, unit_id)
        self._time = time
        self._robot = _Robot(arm, sources)
        self._words = WordTable(sources[_COMMAND_FILE])
        self._robot.power_on(time.now_s())
        self._lock = threading.RLock()
        self._closing = threading.Event()
        self._scanner = threading.Thread(target=self._scan_for_ever, name="controller double", daemon=True)

    @property
    def motions_started(self) -> int:
        """How many motions the arm was told to begin; a repeated command would show here."""
        return self._robot.motions_started

    @property
    def user_frame(self) -> int:
        """The active user frame."""
        return self._robot.user_frame

    @user_frame.setter
    def user_frame(self, number: int) -> None:
        self._robot.user_frame = number

    @property
    def user_tool(self) -> int:
        """The active tool."""
        return self._robot.user_tool

    @user_tool.setter
    def user_tool(self, number: int) -> None:
        self._robot.user_tool = number

    @property
    def heartbeat_frozen(self) -> bool:
        """Whether the heartbeat task stands still, as after a defect."""
        return _HEARTBEAT in self._robot.machine.frozen

    @heartbeat_frozen.setter
    def heartbeat_frozen(self, frozen: bool) -> None:
        with self._lock:
            self._scan()
            self._robot.machine.frozen = {_HEARTBEAT} if frozen else set()

    def start(self) -> int:
        """Serve and run the robot's programs; return the bound port."""
        self._scanner.start()
        return self.server.start()

    def close(self) -> None:
        """End server and programs."""
        self._closing.set()
        self.server.close()
        self._scanner.join(_JOIN_S)

    def reboot(self) -> None:
        """Power off and on: connection cut, motion ended, outputs off, programs started anew; registers stay."""
        with self._lock:
            self._robot.power_off()
            self._robot.power_on(self._time.now_s())
        self.server.cut()

    def run_program(self, name: str) -> None:
        """Start a program from the pendant, beside what runs."""
        with self._lock:
            self._robot.machine.run(name, self._time.now_s())

    @property
    def messages(self) -> list[str]:
        """What programs have shown on the pendant."""
        return list(self._robot.machine.messages)

    def read_words(self, address: int, count: int) -> list[int]:
        """Return words of the $SNPX_ASG table; what is not assigned reads 0."""
        with self._lock:
            self._scan()
            return self._words.read(_first_word(address, count), count, self._robot)

    def write_words(self, address: int, values: list[int]) -> None:
        """Set registers through the $SNPX_ASG table; what is not assigned is ignored."""
        with self._lock:
            self._scan()
            self._words.write(_first_word(address, len(values)), values, self._robot)

    def read_coils(self, address: int, count: int) -> list[bool]:
        """Return DO[address + 1] and up."""
        with self._lock:
            self._scan()
            return [self._robot.signal("DO", n) for n in _numbers(address, count)]

    def write_coils(self, address: int, values: list[bool]) -> None:
        """Set DO[address + 1] and up; DO[4] resets when it comes on."""
        with self._lock:
            self._scan()
            for n, on in zip(_numbers(address, len(values)), values, strict=True):
                rises = on and not self._robot.signal("DO", n)
                self._robot.set_signal("DO", n, on)
                if n == _RESET_DO and rises:
                    self._robot.reset(self._time.now_s())

    def read_inputs(self, address: int, count: int) -> list[bool]:
        """Return DI[address + 1] and up."""
        with self._lock:
            return [self._robot.signal("DI", n) for n in _numbers(address, count)]

    def _scan_for_ever(self) -> None:
        while not self._closing.is_set():
            with self._lock:
                self._scan()
            self._time.sleep(_SCAN_S)

    def _scan(self) -> None:
        """Let the robot's programs catch up with the present instant."""
        self._robot.catch_up(self._time.now_s())


def _first_word(address: int, count: int) -> int:
    """Return the 1-based number of a word; raises IndexError beyond what $SNPX_ASG can assign."""
    if address + count > _WORDS:
        raise IndexError(address)
    return address + 1


def _numbers(address: int, count: int) -> range:
    """Return the 1-based signal numbers; raises IndexError beyond what the controller has."""
    if address + count > _OUTPUTS:
        raise IndexError(address)
    return range(address + 1, address + count + 1)


def _alarm_words(text: str) -> tuple[int, int]:
    """Return facility and number of an alarm spelt as on the pendant."""
    found = _NAMED_ALARM.search(text)
    if found is None or found[1] not in _FACILITY:
        return _UNNAMED
    return _FACILITY[found[1]], int(found[2])
