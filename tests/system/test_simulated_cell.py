"""The tutorial's last step: ``srvs-cell sim --folder`` makes all that ``srvs-cell run`` needs."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from srvs_cell.cli.client import DaemonClient
from srvs_cell.cli.main import run
from srvs_cell.cli.simulated_cell import DaemonProcess

pytestmark = [pytest.mark.slow, pytest.mark.timeout(120)]


def test_a_daemon_runs_on_the_folder_of_a_simulated_cell(capsys: pytest.CaptureFixture[str]) -> None:
    with tempfile.TemporaryDirectory(prefix="srvs-") as name:
        folder = Path(name) / "my-cell"
        simulator = subprocess.Popen(
            [sys.executable, "-m", "srvs_cell.cli.main", "sim", "--objects", "3", "--folder", str(folder)],
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        daemon = DaemonProcess(folder / "cell.yaml", folder / "run" / "api.sock", Path(name) / "daemon.log")
        try:
            assert simulator.stdout is not None
            assert "modbus_port" in json.loads(simulator.stdout.readline())
            assert run(["config", "check", str(folder / "cell.yaml"), "--json"]) == 0
            checked = json.loads(capsys.readouterr().out)
            assert checked["simulation"]
            assert "640 x 480" in checked["calibration"]
            daemon.start()
            with DaemonClient(daemon.socket_path) as client:
                assert client.command("command/clear")["accepted"]
                cleared = next(status for status in client.changes() if status["state"] != "Clearing")
                assert (cleared["state"], cleared["alarms"]) == ("Stopped", [])
                assert {device["lifecycle"] for device in cleared["devices"].values()} != {"disconnected"}
        finally:
            daemon.stop()
            simulator.terminate()
            simulator.communicate(timeout=30)
