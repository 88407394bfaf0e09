"""A FANUC controller with KAREL, as a PC sees it over the line protocol: it executes the robot's own programs.

What drivers/fanuc/controller/karel/ says is what happens: an interpreter (drivers/sim/karel) runs the server's source,
another one (drivers/sim/tp) its TP program SRVS_KMV against the simulated arm. Only what the controller itself does is
written here: operating mode, alarms, UOP signals, tasks, registers, the file and port layer. Where the manual does not
say what happens the double does the worse: a cancelled task counts as ended while the arm still slows down, an aborted
server leaves the arm on its way.
"""

from __future__ import annotations

import re
import threading
from importlib.resources import files
from typing import TYPE_CHECKING, Final

from drivers.sim.controlled_arm import JointedArm
from drivers.sim.karel import ABORTED, PAUSED, RUNNING, KarelTask, Pose, shipped_sources
from drivers.sim.karel_server import KarelWire, TcpCarrier
from drivers.sim.tp import TpAlarm, TpMachine, load
from drivers.sim.tp_arm import MODE_SIGNALS, TpArm

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from drivers.sim.controlled_arm import ControlledArm, ControllerTime
    from drivers.sim.karel import FileVariable
    from drivers.sim.karel_server import Carrier

_MOVER: Final = "SRVS_KMV"
_AXES: Final = "XYZWPR"
_SCAN_S: Final = 0.05
_JOIN_S: Final = 2.0  # real seconds: simulated time may already stand still
_SIGNALS: Final = 512
_READ_ALL: Final = 200
"""How often the server may look for bytes until all are read."""

_DI, _DO, _SI, _UO = 1, 2, 11, 21
_FACILITY: Final = {"MEMO": 7, "TPIF": 9, "SRVO": 11, "INTP": 12, "PRIO": 13, "MOTN": 15, "SYST": 24}
_NAMED_ALARM: Final = re.compile(r"\b([A-Z]{4})-(\d{3})\b")
_UNNAMED: Final = 24_999
_FACILITY_STEP: Final = 1000


class _Robot(TpArm):
    """The controller's devices and data, as both interpreters see them.

    Attributes:
        program_frames: what the KAREL program has chosen for itself.
        port_settings: attributes of serial ports.
        screen: what was shown to the user.
        files: devices that are open.
        inbox: bytes that have come and were not read.
        frozen: whether the server's task stands still, as after a defect.
        machine: runs the TP program.
    """

    def __init__(self, arm: ControlledArm, tp_sources: Mapping[str, str], wire: KarelWire) -> None:
        super().__init__(arm)
        self.program_frames: dict[str, str] = {}
        self.port_settings: dict[tuple[int, int], int] = {}
        self.screen: list[str] = []
        self.inbox = b""
        self.now_s = 0.0
        self.alarm_text: str | None = None
        self.machine = TpMachine(load(tp_sources), self)
        self._hosts: dict[str, int] = {}
        self._wire = wire

    # -- what the TP program sees -------------------------------------------------------------------------------------

    def signal(self, kind: str, number: int) -> bool:
        """Return a signal."""
        return bool(self.port_value({"DI": _DI, "DO": _DO, "SI": _SI, "UO": _UO}[kind], number))

    def set_signal(self, kind: str, number: int, on: bool) -> None:
        """Switch an output."""
        if kind != "DO":
            raise TpAlarm(f"PRIO-001 {kind}[{number}] is not assigned")
        self._arm.set_output(number, on)

    # -- what the KAREL program sees ----------------------------------------------------------------------------------

    def connected(self, _tag: str) -> bool:
        """Let in a client that waits; whether there is one."""
        return self._wire.let_in()

    def disconnect(self, _tag: str) -> int:
        """Let go of the client, but not of one that has come and was never let in."""
        return 0

    def open_file(self, file: FileVariable, device: str) -> int:
        """Open a tag or a port."""
        file.device, self.inbox = device, b""
        return 0

    def close_file(self, file: FileVariable) -> None:
        """Close it, and with it the client's connection."""
        if file.device is not None:
            file.device = None
            self._wire.hang_up()

    def bytes_ahead(self, file: FileVariable) -> int | None:
        """Return how many bytes have come."""
        if self.inbox:
            return len(self.inbox)
        return 0 if file.device is not None and self._wire.connected else None

    def read(self, file: FileVariable, count: int) -> str | None:
        """Take bytes that have come."""
        if file.device is None or len(self.inbox) < count:
            return None
        taken, self.inbox = self.inbox[:count], self.inbox[count:]
        return taken.decode("latin-1")

    def write(self, file: FileVariable | None, text: str) -> int:
        """Send text, or show it."""
        if file is None:
            self.screen.append(text)
            return 0
        if file.device is None:
            return 1
        self._wire.send(text.encode("latin-1"))
        return 0

    def set_port(self, port: int, attribute: int, value: int) -> int:
        """Set an attribute of a serial port."""
        self.port_settings[port, attribute] = value
        return 0

    def system_variable(self, name: str) -> int | None:
        """Return a system variable."""
        try:
            return self.variable(name)
        except KeyError:
            return self._hosts.get(name)

    def set_system_variable(self, name: str, value: int) -> int:
        """Write a system variable."""
        if name == "$MNUFRAMENUM[1]":
            self.user_frame = value
        elif name == "$MNUTOOLNUM[1]":
            self.user_tool = value
        elif name.startswith("$HOSTS_CFG"):
            self._hosts[name] = value
        else:
            return 1
        return 0

    def select_program_frame(self, target: str, source: str) -> None:
        """Make a frame the one that the program's positions are told in."""
        self.program_frames[target] = source

    def port_value(self, kind: int, number: int) -> int | None:
        """Return a signal."""
        if not 1 <= number <= _SIGNALS:
            return None
        if kind == _DO:
            return int(self._arm.output(number))
        if kind == _DI:
            return int(self._arm.input(number))
        if kind == _SI:
            return int(number in MODE_SIGNALS.get(str(self._arm.mode), set()))
        return self._uop() >> (number - 1) & 1 if kind == _UO else None

    def set_port_value(self, kind: int, number: int, value: int) -> int:
        """Switch an output."""
        if kind != _DO or not 1 <= number <= _SIGNALS:
            return 1
        self._arm.set_output(number, bool(value))
        return 0

    def pose(self) -> Pose | None:
        """Return the TCP's pose; without frames of its own a program does not know where it is."""
        if len(self.program_frames) < 2:  # noqa: PLR2004 - user frame and tool
            return None
        return Pose(dict(zip(_AXES, self._arm.pose.as_tuple(), strict=True)), "N U T, 0, 0, 0")

    def joints(self) -> Sequence[float] | None:
        """Return joint angles; a point-like arm has none."""
        return self._arm.joints_deg if isinstance(self._arm, JointedArm) else None

    def set_pose_register(self, number: int, pose: Pose) -> int:
        """Write PR[number]."""
        self.machine.memory.positions[number] = [pose.elements[axis] for axis in _AXES]
        return 0

    def register(self, number: int) -> float:
        """Return R[number]."""
        return self.machine.memory.registers.get(number, 0)

    def set_register(self, number: int, value: float) -> int:
        """Write R[number]."""
        self.machine.memory.registers[number] = value
        return 0

    def run_task(self, program: str) -> int:
        """Begin a task where the controller lets programs run."""
        ready = self._uop() & 1 and program in self.machine.programs and not self.machine.running(program)
        if not ready:
            return 1
        self.machine.run(program, self.now_s)
        return 0

    def abort_task(self, program: str, *, cancel_motion: bool) -> int:
        """End a task; without ``cancel_motion`` the motion goes on."""
        if self.machine.running(program):
            self.machine.abort()
            if cancel_motion:
                self._arm.stop()
        return 0

    def task_state(self, program: str) -> int | None:
        """Return what a task does."""
        if not self.machine.running(program):
            return ABORTED if self.motions_started else None
        return PAUSED if self.machine.paused else RUNNING

    def alarm(self) -> tuple[int, str] | None:
        """Return the newest alarm."""
        if self.alarm_text is None:
            return None
        found = _NAMED_ALARM.search(self.alarm_text)
        if found is None or found[1] not in _FACILITY:
            return _UNNAMED, self.alarm_text
        return _FACILITY[found[1]] * _FACILITY_STEP + int(found[2]), self.alarm_text

    def reset(self) -> bool:
        """Reset the controller's fault."""
        if not self._arm.moving:
            self._arm.reset_fault()
        if self._arm.fault is None:
            self.alarm_text = None
        return self._arm.fault is None

    # -- what the controller does by itself ---------------------------------------------------------------------------

    def catch_up(self, now_s: float) -> None:
        """Let the TP program come up to ``now_s``; an alarm pauses it."""
        self.now_s = now_s
        alarm = self._arm.fault or self.machine.catch_up(now_s)
        if alarm is not None:
            self.alarm_text = alarm
            self.machine.paused = self.machine.running(_MOVER)

    def power_off(self) -> None:
        """End motion and tasks; registers keep their values."""
        self._arm.stop()
        self.machine.power_off()
        self.program_frames.clear()
        self.inbox, self.alarm_text = b"", None

    def _uop(self) -> int:
        """Return UO[1] to UO[8]."""
        arm, paused, faulty = self._arm, self.machine.paused, self.alarm_text is not None
        remote = str(arm.mode) == "AUTO" and not arm.pendant_enabled
        return (
            (remote and arm.servo_on and not faulty)
            | arm.servo_on << 1
            | (self.machine.running(_MOVER) and not paused) << 2
            | paused << 3
            | faulty << 5
            | arm.pendant_enabled << 7
        )


class KarelController:
    """The controller double.

    Args:
        arm: what it drives.
        time: simulated time.
        carrier: the wire; an Ethernet one runs srvstcp, any other one srvsser.
        sources: the robot's files by name; the shipped ones without.

    Raises:
        KarelError, TpError: a program is refused; the message says file, line and reason.

    Attributes:
        wire: the wire, with its faults.
    """

    def __init__(
        self,
        arm: ControlledArm,
        time: ControllerTime,
        carrier: Carrier | None = None,
        sources: Mapping[str, str] | None = None,
    ) -> None:
        sources = controller_sources() if sources is None else sources
        carrier = TcpCarrier() if carrier is None else carrier
        self.wire = KarelWire(carrier, self, time)
        self._time = time
        self._robot = _Robot(arm, {f: text for f, text in sources.items() if f.endswith(".LS")}, self.wire)
        main = "srvstcp.kl" if isinstance(carrier, TcpCarrier) else "srvsser.kl"
        self.task = KarelTask(sources, main, self._robot)
        self.frozen = False
        self._lock = threading.RLock()
        self._closing = threading.Event()
        self._scanner = threading.Thread(target=self._scan_for_ever, name="KAREL controller double", daemon=True)

    @property
    def motions_started(self) -> int:
        """How many motions the arm was told to begin; a repeated command would show here."""
        return self._robot.motions_started

    @property
    def robot(self) -> _Robot:
        """The controller's data."""
        return self._robot

    def start(self) -> str:
        """Serve and run the server; return what a client connects to."""
        self.task.start(self._time.now_s())
        self._scan()
        self._scanner.start()
        return self.wire.start()

    def close(self) -> None:
        """End wire and programs."""
        self._closing.set()
        self.wire.close()
        self._scanner.join(_JOIN_S)

    def reboot(self) -> None:
        """Power off and on: connection cut, motion ended, programs started anew."""
        with self._lock:
            self._robot.power_off()
            self.task.start(self._time.now_s())
            self._scan()
        self.wire.cut()

    def hold(self) -> None:
        """Somebody presses HOLD on the pendant: the arm stops, the program is paused."""
        with self._lock:
            self._robot.stop()
            self._robot.machine.paused = self._robot.machine.running(_MOVER)

    def take(self, data: bytes) -> None:
        """Take bytes; the server reads all of them at once."""
        with self._lock:
            self._robot.inbox += data
            self._scan()
            for _ in range(_READ_ALL):
                if not self._robot.inbox or self.frozen:
                    break
                self.task.resume(self._time.now_s(), early=True)

    def connection_changed(self) -> None:
        """Let the server notice that a client has come or gone."""
        with self._lock:
            self._scan()
            if not self.frozen:
                self.task.resume(self._time.now_s(), early=True)

    def _scan_for_ever(self) -> None:
        while not self._closing.is_set():
            with self._lock:
                self._scan()
            self._time.sleep(_SCAN_S)

    def _scan(self) -> None:
        """Let the robot's programs catch up with the present instant."""
        now_s = self._time.now_s()
        self._robot.catch_up(now_s)
        if not self.frozen:
            self.task.resume(now_s)


def controller_sources() -> dict[str, str]:
    """Return the robot's files as they are shipped, by name."""
    folder = files("drivers").joinpath("fanuc", "controller", "karel")
    programs = {f.name: f.read_text(encoding="ascii") for f in folder.iterdir() if f.name.endswith(".LS")}
    return {**shipped_sources(), **programs}
