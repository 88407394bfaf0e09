"""The cell as the integrator configures it: the shipped config for Modbus, with this robot's and this camera's data."""

from __future__ import annotations

import json
import shutil
import socket
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from srvs_cell.cli.client import DaemonClient
from tests.vm.checks import usb
from tests.vm.checks.commands import wait_until

if TYPE_CHECKING:
    from collections.abc import Collection

CONFIG = Path("/etc/srvs-cell/cell.yaml")
SOCKET = Path("/run/srvs-cell/api.sock")
STATE_DIR = Path("/var/lib/srvs-cell")
UNIT = "srvs-cell.service"
_HOST = "10.0.2.2"
"""The host's loopback, as QEMU's user network shows it: there the simulated controller listens."""
_SHIPPED = "cell.fanuc-modbus.yaml"
_STATE_S = 300.0


def write_cell(folder: Path) -> Cell:
    """Write config and calibration as docs/how-to/install-service.md has it; return how to reach the cell.

    Args:
        folder: what ``srvs-cell sim --folder`` has made, and ``listens.json``, what it has printed.
    """
    listens = json.loads((folder / "listens.json").read_text(encoding="utf-8"))
    shipped = resources.files("srvs_cell") / "_data" / "configs" / _SHIPPED
    config: dict[str, Any] = yaml.safe_load(shipped.read_text(encoding="utf-8"))
    x, y, z, w, p, r = listens["observe_pose"]
    cell = config["cell"]
    cell["look"] |= {"observe_pose": {"xyz_mm": [x, y, z], "wpr_deg": [w, p, r]}, "baseline_mm": listens["baseline_mm"]}
    cell |= {"workspace": listens["workspace"], "table_z_mm": listens["table_z_mm"]}
    # Slow enough for a stop in the middle of the lateral path.
    cell["motion"] |= {"jaw_axis": listens["gripper"]["jaw_axis"], "approach_speed_mm_s": 10.0}
    config["planning"] |= {"home_mm": [x, y], "arm": None}  # the simulated one is another
    devices = config["devices"]
    devices["camera"] |= {"device": str(usb.DEVICE), **usb.SETTINGS}
    devices["arm"] |= {"host": _HOST, "port": listens["modbus_port"], "timeout_s": 5.0}
    devices["arm"] |= {"heartbeat_timeout_s": 10.0}  # the robot's, which shares two processors with an emulated machine
    CONFIG.write_text(yaml.safe_dump(config, sort_keys=False), encoding="utf-8")
    calibration = yaml.safe_load((folder / "calibration.yaml").read_text(encoding="utf-8"))
    shrink = usb.SETTINGS["width"] / calibration["camera"]["width"]  # less to compute, for an emulated processor
    for name in ("width", "height", "fx", "fy", "cx", "cy"):
        value = calibration["camera"][name] * shrink
        calibration["camera"][name] = round(value) if name in {"width", "height"} else value
    (CONFIG.parent / "calibration.yaml").write_text(yaml.safe_dump(calibration), encoding="utf-8")
    for path in (CONFIG, CONFIG.parent / "calibration.yaml"):
        path.chmod(0o640)
        shutil.chown(path, group="srvs-cell")
    return Cell(listens["control_port"])


class Cell:
    """The running service, over its unix socket, as the operator's commands use it; and what its robot truly does.

    Args:
        control_port: of the simulated controller.
    """

    def __init__(self, control_port: int) -> None:
        self._robot = socket.create_connection((_HOST, control_port), 30.0)
        self._answers = self._robot.makefile("rb")

    def arm_moves(self) -> bool:
        """Return whether the arm moves, by the simulator's truth."""
        self._robot.sendall(b'{"op": "truth"}\n')
        return bool(json.loads(self._answers.readline())["arm"]["moving"])

    def status(self) -> dict[str, Any]:
        """Return what ``srvs-cell status --json`` prints."""
        with DaemonClient(SOCKET, 30.0) as client:
            return client.read("status")

    def command(self, name: str) -> None:
        """Give a command; raises `AssertionError` with the reason where it is refused."""
        with DaemonClient(SOCKET, 30.0) as client:
            answer = client.command(f"command/{name}")
        assert answer["accepted"], f"{name}: {answer['reason']}"

    def resolve(self) -> None:
        """Say that the gripper is empty."""
        with DaemonClient(SOCKET, 30.0) as client:
            answer = client.command("resolve", {"gripper": "empty"})
        assert answer["accepted"], answer["reason"]

    def reaches(self, states: Collection[str]) -> float:
        """Wait until the cell is in one of ``states``; return after how many seconds."""
        seen: list[str] = []

        def reached() -> bool:
            status = self.status()
            seen[:] = [status["state"], *(f"{alarm['name']}: {alarm['detail']}" for alarm in status["alarms"])]
            return status["state"] in states

        try:
            return wait_until("the state", reached, _STATE_S)
        except TimeoutError as error:
            raise TimeoutError(f"{error} {' or '.join(states)}; the cell is {'; '.join(seen)}") from error

    def alarms(self) -> set[str]:
        """Return the names of the active alarms."""
        return {alarm["name"] for alarm in self.status()["alarms"]}

    def make_idle(self) -> None:
        """Clear, resolve where that is asked for, and reset, as an operator does."""
        if self.status()["gripper"]["knowledge"] == "unknown":
            self.resolve()
        if self.status()["state"] == "Aborted":
            self.command("clear")
            self.reaches({"Stopped"})
        self.command("reset")
        self.reaches({"Idle", "Aborted"})
        assert self.status()["state"] == "Idle", self.alarms()
