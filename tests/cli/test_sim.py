from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING

import pytest

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cli import simulator
from srvs_cell.cli.main import run
from srvs_cell.cli.simulated_cell import write_config
from srvs_cell.cli.simulator import simulator_failure, start_simulator, stop_simulator
from srvs_cell.config import load_config

if TYPE_CHECKING:
    from pathlib import Path

WELL = "import sys, signal; print('{\"modbus_port\": 5020}', flush=True); signal.pause()"
REPORTS = "import sys, json; print(json.dumps({'arguments': sys.argv[1:]}), flush=True)"
FAILS = "import sys; print('no such mesh', file=sys.stderr); sys.exit(3)"
TALKS = "import signal; print('hello', flush=True); signal.pause()"


@pytest.fixture
def child(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Lets a test say what the child process is: `child.setenv("CHILD", program)`."""

    def instead(command: list[str], **options: object) -> subprocess.Popen[str]:
        assert command[:3] == [sys.executable, "-m", "srvs_cell.cli.simulator"]
        return popen([sys.executable, "-c", os.environ["CHILD"], *command[4:]], **options)  # type: ignore[call-overload,no-any-return]

    popen = subprocess.Popen
    monkeypatch.setattr(subprocess, "Popen", instead)
    return monkeypatch


def test_first_line_says_what_listens_where(child: pytest.MonkeyPatch, tmp_path: Path) -> None:
    child.setenv("CHILD", WELL)
    process, listens = start_simulator(["--seed", "1"], tmp_path / "log")
    assert listens == {"modbus_port": 5020}
    assert stop_simulator(process) == -signal.SIGTERM


@pytest.mark.parametrize(("program", "said"), [(FAILS, "no such mesh"), (TALKS, "code -15")])
def test_failure_is_named_with_the_end_of_the_log(
    child: pytest.MonkeyPatch, tmp_path: Path, program: str, said: str
) -> None:
    child.setenv("CHILD", program)
    with pytest.raises(AlarmError, match=said) as failure:
        start_simulator([], tmp_path / "log")
    assert failure.value.alarm is Alarm.SIMULATION_FAILED


def test_silence_is_bounded_and_leaves_no_process(child: pytest.MonkeyPatch, tmp_path: Path) -> None:
    child.setenv("CHILD", "import signal; signal.pause()")
    with pytest.raises(AlarmError, match="ended with code -15"):
        start_simulator([], tmp_path / "log", timeout_s=0.3)


def test_sim_passes_options_and_line_through(child: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    child.setenv("CHILD", REPORTS)
    assert (
        run(["sim", "--objects", "3", "--seed", "7", "--modbus-port", "5020", "--wire", "rmi", "--robotiq", "pty"]) == 0
    )
    arguments = json.loads(capsys.readouterr().out)["arguments"]
    given = dict(zip(arguments[::2], arguments[1::2], strict=True))
    assert (given["--objects"], given["--seed"], given["--modbus-port"]) == ("3", "7", "5020")
    assert (given["--robotiq"], given["--wire"]) == ("pty", "rmi")


def test_the_config_beside_a_simulated_cell_takes_the_wire_and_the_gripper_that_listen(tmp_path: Path) -> None:
    listening: dict[str, object] = {
        "observe_pose": [675.0, 15.0, 410.0, 180.0, 0.0, 0.0],
        "baseline_mm": 30.0,
        "table_z_mm": -50.0,
        "clock_page": str(tmp_path / "clock"),
        "camera_port": 9101,
        "arm": {"driver": "fanuc_karel", "serial": {"device": "/dev/pts/9"}},
        "gripper": {"max_opening_mm": 84.0},
    }
    write_config(tmp_path / "cell.yaml", listening, {})
    assert load_config(tmp_path / "cell.yaml").devices.gripper.driver == "robot_io"
    arm = load_config(tmp_path / "cell.yaml").devices.arm
    assert (arm.driver, arm.settings.model_dump()["serial"]["device"]) == ("fanuc_karel", "/dev/pts/9")
    write_config(tmp_path / "cell.yaml", {**listening, "robotiq": str(tmp_path / "gripper")}, {})
    gripper = load_config(tmp_path / "cell.yaml").devices.gripper
    assert gripper.driver == "robotiq"
    assert gripper.settings.model_dump()["stroke"] == ((3, 84.0), (230, 0.0))


def test_sim_that_dies_is_an_alarm(child: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    child.setenv("CHILD", REPORTS + "; sys.exit(4)")
    assert run(["sim"]) == 1
    assert "5008 SIMULATION_FAILED" in capsys.readouterr().err


def test_failure_of_a_running_simulator_says_that_it_runs(child: pytest.MonkeyPatch, tmp_path: Path) -> None:
    child.setenv("CHILD", WELL)
    process, _ = start_simulator([], tmp_path / "log")
    assert "still running" in simulator_failure(process, tmp_path / "log").detail
    stop_simulator(process)


def test_simulator_ends_with_the_process_that_started_it(tmp_path: Path) -> None:
    """The child module itself, with a simulator that would wait for ever."""
    module = tmp_path / "waits_for_ever.py"
    module.write_text("import signal\n\ndef main(arguments):\n    print('{}', flush=True)\n    signal.pause()\n")
    entry = EntryPoint("x", "waits_for_ever:main", simulator.ENTRY_POINT_GROUP)
    program = (
        "import sys; from importlib.metadata import EntryPoint; from srvs_cell.cli import simulator;"
        f"simulator.entry_points = lambda **_: [EntryPoint({entry.name!r}, {entry.value!r}, {entry.group!r})];"
        "simulator._run_child('x', [])"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stdout.readline() == "{}\n"
    process.stdin.close()
    assert process.wait(10) == -signal.SIGTERM
    process.stdout.close()
