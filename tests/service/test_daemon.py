"""The daemon as a process of its own: devices that cannot be reached, signals, a kill and a second start."""

from __future__ import annotations

import json
import os
import signal
import socket
import stat
import subprocess
import sys
import tempfile
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from srvs_cell.cli.client import DaemonClient
from srvs_cell.cli.main import run
from tests.service.fakes import FakeUnit

if TYPE_CHECKING:
    from collections.abc import Iterator

CALIBRATION = {
    "schema_version": 1,
    "camera": {
        "width": 640, "height": 480, "fx": 800.0, "fy": 800.0, "cx": 319.5, "cy": 239.5,
        "distortion": [0.0, 0.0, 0.0, 0.0, 0.0],
    },
    "tcp_T_camera": {"xyz_mm": [0.0, -60.0, 40.0], "wpr_deg": [0.0, 0.0, 0.0]},
}  # fmt: skip


@dataclass
class Site:
    """A folder with a config whose arm listens nowhere."""

    folder: Path
    config: Path
    api: Path
    manager: socket.socket

    def notifications(self, until: str) -> list[str]:
        """What the service manager hears, up to the message that contains ``until``."""
        heard: list[str] = []
        while not heard or until not in heard[-1]:
            heard.append(self.manager.recv(4096).decode())
        return heard

    @contextmanager
    def daemon(self, *options: str) -> Iterator[subprocess.Popen[str]]:
        """A daemon that serves; ended and reaped afterwards."""
        environment = {**os.environ, "NOTIFY_SOCKET": str(self.folder / "notify"), "WATCHDOG_USEC": "600000"}
        process = subprocess.Popen(
            [sys.executable, "-m", "srvs_cell.cli.main", "run", "--config", str(self.config), *options],
            env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            self.notifications("READY=1")
            yield process
        finally:
            with suppress(ProcessLookupError):
                process.kill()
            process.communicate()


@pytest.fixture
def site() -> Iterator[Site]:
    with (
        tempfile.TemporaryDirectory() as name,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager,
        socket.socket() as closed,
    ):
        folder = Path(name)
        manager.bind(str(folder / "notify"))
        manager.settimeout(60)
        closed.bind(("127.0.0.1", 0))  # bound, not listening: a connection is refused
        (folder / "images").mkdir()
        config = {
            "schema_version": 1,
            "calibration": "calibration.yaml",
            "cell": {
                "look": {
                    "observe_pose": {"xyz_mm": [700.0, 0.0, 500.0], "wpr_deg": [180.0, 0.0, 0.0]},
                    "baseline_mm": 30.0,
                },
                "workspace": {"x_mm": [400.0, 1000.0], "y_mm": [-300.0, 300.0], "z_mm": [-10.0, 700.0]},
                "table_z_mm": 0.0,
            },
            "devices": {
                "camera": {"driver": "image_folder", "folder": str(folder / "images")},
                "arm": {"driver": "fanuc_modbus", "host": "127.0.0.1", "port": closed.getsockname()[1]},
                "gripper": {"driver": "robot_io"},
            },
            "service": {"socket": "run/api.sock", "state_dir": "state"},
        }
        (folder / "cell.yaml").write_text(yaml.safe_dump(config))
        (folder / "calibration.yaml").write_text(yaml.safe_dump(CALIBRATION))
        yield Site(folder, folder / "cell.yaml", folder / "run" / "api.sock", manager)


def status(site: Site) -> dict[str, Any]:
    with DaemonClient(site.api) as daemon:
        return daemon.read("status")


def test_daemon_serves_aborted_when_devices_cannot_be_reached_and_ends_tidily(site: Site) -> None:
    with site.daemon("--tcp-port", "0") as process:
        with DaemonClient(site.api) as daemon:
            seen = next(s for s in daemon.changes() if any(a["name"] == "CONNECTION_REFUSED" for a in s["alarms"]))
            refused = daemon.command("command/start")
        assert set(seen) == {*FakeUnit().snapshot(), "service"}, "the fake unit of the other tests tells the truth"
        assert (seen["state"], seen["mode"], seen["simulation"]) == ("Aborted", "Production", False)
        assert seen["service"]["page"].startswith("http://127.0.0.1:")
        assert refused["leads_there"] == ["clear", "reset", "start"]
        assert stat.S_IMODE(site.api.stat().st_mode) == 0o660
        assert stat.S_IMODE(site.api.parent.stat().st_mode) == 0o750
        assert site.notifications("WATCHDOG=1"), "the watchdog is fed while the unit lives"

        for number in (signal.SIGHUP, signal.SIGTERM):  # a terminal that is closed, and somebody in a hurry
            process.send_signal(number)
        _, log = process.communicate(timeout=30)
    assert process.returncode == 0
    assert not site.api.exists()
    assert "STOPPING=1" in site.notifications("STOPPING=1")[-1]
    lines = [json.loads(line) for line in log.splitlines()]
    assert lines[0]["event"] == "starting"
    assert lines[0]["effective"]["cell"]["look"]["baseline_mm"] == 30.0
    assert {"version", "python", "packages"} <= set(lines[0])
    assert lines[-1]["event"] == "stopped"


def test_second_daemon_is_refused_by_socket_and_by_state_folder(site: Site) -> None:
    with site.daemon():
        for options in ([], ["--socket", str(site.folder / "run" / "other.sock")]):
            second = subprocess.run(
                [sys.executable, "-m", "srvs_cell.cli.main", "run", "--config", str(site.config), *options],
                capture_output=True, text=True, check=False,
            )  # fmt: skip
            assert second.returncode == 1
            assert "5009 ALREADY_RUNNING" in second.stderr
        assert status(site)["state"] == "Aborted"


def test_killed_daemon_leaves_nothing_in_the_way_of_the_next(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    with site.daemon() as process:
        process.kill()
        process.wait()
        assert site.api.is_socket(), "the killed daemon left its socket"
        assert run(["status", "--socket", str(site.api)]) == 1
        assert "5006 NO_DAEMON" in capsys.readouterr().err
    with site.daemon():
        assert status(site)["state"] == "Aborted"


def test_wrong_config_is_two_and_names_the_key(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    site.config.write_text(site.config.read_text().replace("baseline_mm: 30.0", "baseline_mm: -30.0"))
    assert run(["run", "--config", str(site.config)]) == 2
    message = capsys.readouterr().err
    assert "6001 CONFIG_INVALID" in message
    assert "cell.look.baseline_mm" in message


def test_a_wrong_calibration_ends_with_the_status_that_systemd_does_not_try_again(site: Site) -> None:
    wrong = {**CALIBRATION, "camera": {**CALIBRATION["camera"], "fx": -800.0}}  # type: ignore[dict-item]
    (site.folder / "calibration.yaml").write_text(yaml.safe_dump(wrong))
    ended = subprocess.run(
        [sys.executable, "-m", "srvs_cell.cli.main", "run", "--config", str(site.config)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 2
    assert "3101 CALIBRATION_INVALID" in ended.stderr
