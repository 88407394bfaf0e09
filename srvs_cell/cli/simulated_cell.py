"""A simulated cell with a daemon of its own, as child processes: what the demo, the system tests and benchmarks use."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cli.client import DaemonClient
from srvs_cell.cli.simulator import start_simulator, stop_simulator
from srvs_cell.config.embedded import embedded_config

if TYPE_CHECKING:
    from collections.abc import Iterator

_DAEMON_START_S, _DAEMON_STOP_S, _CONTROL_TIMEOUT_S = 30.0, 15.0, 30.0
_POLL_S = 0.05
CALIBRATION_FILE = "calibration.yaml"
_LOG_LINES = 15


@dataclass(frozen=True)
class SimulationOptions:
    """What is simulated."""

    objects: int = 5
    seed: int = 0
    speed: float = 20.0
    imperfections: str = "real"
    wire: str = "modbus"


class SimulatorControl:
    """The simulator's control socket: its truth, and faults to inject. For demo, tests and benchmarks only."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=_CONTROL_TIMEOUT_S)
        self._lines = self._socket.makefile("rb")

    def ask(self, op: str, **arguments: Any) -> dict[str, Any]:
        """Send one request and return the answer."""
        self._socket.sendall(json.dumps({"op": op, **arguments}).encode() + b"\n")
        answer: dict[str, Any] = json.loads(self._lines.readline())
        return answer

    def close(self) -> None:
        """Let go of the socket."""
        self._lines.close()
        self._socket.close()


class DaemonProcess:
    """A daemon as a child process; can be ended, killed and started again on the same config.

    Args:
        config: the cell's YAML.
        socket_path: the unix socket that the config names.
        log_path: file that its log is appended to.
    """

    def __init__(self, config: Path, socket_path: Path, log_path: Path) -> None:
        self.config, self.socket_path, self.log_path = config, socket_path, log_path
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it and return when it answers; raises `AlarmError` NO_DAEMON with the end of its log."""
        command = [sys.executable, "-m", "srvs_cell.cli.main", "run", "--config", str(self.config)]
        with self.log_path.open("a", encoding="utf-8") as log:
            self.process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        deadline_s = time.monotonic() + _DAEMON_START_S
        while not self._answers():
            if self.process.poll() is not None or time.monotonic() > deadline_s:
                tail = "\n".join(self.log_path.read_text(encoding="utf-8").splitlines()[-_LOG_LINES:])
                raise AlarmError(Alarm.NO_DAEMON, f"The daemon did not start; {self.log_path} ends:\n{tail}\n")
            time.sleep(_POLL_S)

    def stop(self) -> int:
        """End it as systemd would and return its exit code; kill it where it does not end in time."""
        if self.process is None:
            return 0
        self.process.terminate()
        try:
            return self.process.wait(_DAEMON_STOP_S)
        except subprocess.TimeoutExpired:
            return self.kill()

    def kill(self) -> int:
        """End it without warning, as a power failure would."""
        if self.process is None:
            return 0
        self.process.kill()
        return self.process.wait()

    def _answers(self) -> bool:
        if not self.socket_path.exists():
            return False
        try:
            with DaemonClient(self.socket_path) as client:
                client.read("status")
        except AlarmError:
            return False
        return True


@dataclass(frozen=True)
class SimulatedCell:
    """A running simulated cell.

    Attributes:
        control: the simulator's control socket.
        daemon: the daemon's process.
        client: a client of the daemon.
        config: the config that the daemon runs with.
        simulator: the simulator's process.
    """

    control: SimulatorControl
    daemon: DaemonProcess
    client: DaemonClient
    config: Path
    simulator: subprocess.Popen[str]


@contextmanager
def simulated_cell(
    options: SimulationOptions, folder: Path, settings: Mapping[str, Any] | None = None
) -> Iterator[SimulatedCell]:
    """Start simulator and daemon; end both on the way out, whatever happens.

    Args:
        options: what is simulated.
        folder: existing folder for config, calibration, logs and the daemon's state.
        settings: keys of the config that differ from the embedded one, nested as there.

    Raises:
        AlarmError: SIMULATION_FAILED or NO_DAEMON with the end of the log.
    """
    with ExitStack() as stack:
        # A unix socket's path is limited to about 100 characters: not below a folder that the user chose.
        short = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="srvs-")))
        arguments = [
            "--objects", str(options.objects), "--seed", str(options.seed), "--speed", str(options.speed),
            "--imperfections", options.imperfections, "--wire", options.wire, "--clock-page", str(short / "clock"),
            "--calibration-out", str(folder / CALIBRATION_FILE),
        ]  # fmt: skip
        process, listening = start_simulator(arguments, folder / "simulator.log")
        stack.callback(stop_simulator, process)
        control = SimulatorControl(listening["control_port"])
        stack.callback(control.close)
        socket_path = short / "run" / "api.sock"
        config = folder / "cell.yaml"
        service = {"socket": str(socket_path), "tcp_port": None, "state_dir": "state"}
        write_config(config, listening, _merged({"service": service}, settings or {}))
        daemon = DaemonProcess(config, socket_path, folder / "daemon.log")
        stack.callback(daemon.stop)
        daemon.start()
        client = stack.enter_context(DaemonClient(socket_path))
        yield SimulatedCell(control, daemon, client, config, process)


def write_config(path: Path, listening: Mapping[str, Any], settings: Mapping[str, Any]) -> None:
    """Write the config of a daemon for a simulated cell: the embedded one with what this simulator listens on.

    Args:
        path: the file; the calibration is ``calibration.yaml`` beside it.
        listening: what the simulator has printed.
        settings: keys that differ from the embedded config's, nested as there.
    """
    config: dict[str, Any] = yaml.safe_load(embedded_config())
    x, y, z, w, p, r = listening["observe_pose"]
    config["cell"]["look"]["observe_pose"] = {"xyz_mm": [x, y, z], "wpr_deg": [w, p, r]}
    config["cell"]["look"]["baseline_mm"] = listening["baseline_mm"]
    config["cell"]["table_z_mm"] = listening["table_z_mm"]
    config["calibration"] = CALIBRATION_FILE
    config["devices"]["clock"]["path"] = listening["clock_page"]
    config["devices"]["camera"]["port"] = listening["camera_port"]
    config["devices"]["arm"] = {**listening["arm"], "timeout_s": config["devices"]["arm"]["timeout_s"]}
    if "robotiq" in listening:
        stroke = [[3, listening["gripper"]["max_opening_mm"]], [230, 0.0]]
        gripper = {"driver": "robotiq", "port": listening["robotiq"], "stroke": stroke, "answer_timeout_s": 5.0}
        config["devices"]["gripper"] = gripper
    path.write_text(yaml.safe_dump(_merged(config, settings), sort_keys=False), encoding="utf-8")


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``base`` with ``changes``, section by section."""
    changed = {
        key: _merged(base[key], value) if isinstance(value, Mapping) and key in base else value
        for key, value in changes.items()
    }
    return {**base, **changed}
