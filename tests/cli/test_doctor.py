"""``srvs-cell doctor`` on doubles behind real wires: one line a check, the exit code, and nothing touched."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import socket
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
import yaml

from drivers.sim.modbus_controller import ModbusController
from drivers.sim.robotiq_double import RobotiqDouble
from drivers.sim.robotiq_fingers import ScriptedFingers
from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cli.main import run
from srvs_cell.ports import RobotMode
from tests.cli.test_operate import Daemon
from tests.drivers.stepped import PointArm

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager

CALIBRATION = {
    "schema_version": 1,
    "camera": {
        "width": 640, "height": 480, "fx": 800.0, "fy": 800.0, "cx": 319.5, "cy": 239.5,
        "distortion": [0.0, 0.0, 0.0, 0.0, 0.0],
    },
    "tcp_T_camera": {"xyz_mm": [0.0, -60.0, 40.0], "wpr_deg": [0.0, 0.0, 0.0]},
    "robot": {"user_frame": 1, "user_tool": 1},
}  # fmt: skip


class LifeTime:
    """The time of life, for a controller double whose client is another process's loop; some of it can be skipped."""

    def __init__(self) -> None:
        self._skipped_s = 0.0

    def now_s(self) -> float:
        return time.monotonic() + self._skipped_s

    def skip(self, seconds: float) -> None:
        self._skipped_s += seconds

    @staticmethod
    def sleep(seconds: float) -> None:
        time.sleep(seconds)

    @staticmethod
    def hold() -> AbstractContextManager[None]:
        return contextlib.nullcontext()

    @staticmethod
    def hold_while(_unread: Callable[[], bool]) -> None:
        pass


class Site:
    """A folder with a config of a cell whose arm, camera and gripper are there."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.time = LifeTime()
        self.point = PointArm(self.time)  # type: ignore[arg-type]  # only the time of day is asked for
        self.controller = ModbusController(self.point, self.time)
        self.gripper = RobotiqDouble(ScriptedFingers(time.monotonic), time.monotonic)
        self.gripper.make_ready()
        self.devices: dict[str, dict[str, Any]] = {
            "clock": {"driver": "system"},
            "camera": {"driver": "image_folder", "folder": str(folder / "images"), "width": 640, "height": 480},
            "arm": {"driver": "fanuc_modbus", "port": self.controller.start(), "timeout_s": 5.0},
            "gripper": {"driver": "robotiq", "port": self.gripper.start(), "answer_timeout_s": 5.0},
        }
        (folder / "images").mkdir()
        cv2.imwrite(str(folder / "images" / "0.png"), np.zeros((480, 640), np.uint8))
        self.calibration: dict[str, Any] = dict(CALIBRATION)
        self.state = folder / "state"
        self.state.mkdir()

    def close(self) -> None:
        self.controller.close()
        self.gripper.close()

    def doctor(self, *options: str) -> int:
        text = (Path(__file__).parent.parent.parent / "configs" / "cell.robotiq.yaml").read_text(encoding="utf-8")
        content = yaml.safe_load(text)
        content["devices"] = self.devices
        content["service"] = {"socket": str(self.folder / "api.sock"), "state_dir": str(self.state)}
        (self.folder / "cell.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
        (self.folder / "calibration.yaml").write_text(yaml.safe_dump(self.calibration), encoding="utf-8")
        return run(["doctor", "--config", str(self.folder / "cell.yaml"), *options])


@pytest.fixture
def site() -> Iterator[Site]:
    with tempfile.TemporaryDirectory() as folder:
        made = Site(Path(folder))
        yield made
        made.close()


class Answer:
    """What a run has printed with ``--json``."""

    def __init__(self, text: str) -> None:
        self.content = json.loads(text)

    def wrong(self) -> dict[str, tuple[str, str]]:
        return {
            f"{one['part']}, {one['check']}": (one["level"], one["alarm"]["name"])
            for one in self.content["findings"]
            if one["level"] != "ok"
        }


def _asked(site: Site, capsys: pytest.CaptureFixture[str], code: int) -> Answer:
    assert site.doctor("--json") == code, capsys.readouterr().out
    return Answer(capsys.readouterr().out)


def test_a_cell_that_is_ready(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    answer = _asked(site, capsys, 0)
    assert answer.wrong() == {}
    assert answer.content["verdict"] == "ok"
    assert answer.content["daemon"] is False
    parts = {one["part"] for one in answer.content["findings"]}
    assert parts == {"calibration", "state folder", "daemon", "camera", "arm", "gripper"}
    assert {"part", "check", "level", "detail", "alarm", "cause", "remedy", "facts"} == set(
        answer.content["findings"][0]
    )
    assert untouched(site)


def untouched(site: Site) -> bool:
    return site.controller.motions_started == 0 and not site.point.outputs and not site.gripper.commands


def test_one_line_a_check_with_code_cause_and_remedy(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    site.point.mode = RobotMode.T1
    site.time.skip(1.0)  # the robot's program tells the mode ten times a second, not at once
    site.point.override_percent = 10
    assert site.doctor() == 1
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    assert lines[-1] == "verdict: failed"
    assert all(line.split()[0] in {"ok", "warning", "failed"} for line in lines[:-1])
    (mode,) = [line for line in lines if "mode switch" in line]
    assert mode.startswith("failed   arm, mode switch: The mode switch is at T1. [2010 MODE_NOT_AUTO] Cause: ")
    assert "Remedy: Turn the key to AUTO" in mode
    (override,) = [line for line in lines if "speed override" in line]
    assert override.startswith("warning")
    assert printed.err.startswith("srvs-cell: 1 of ")
    assert "2010 MODE_NOT_AUTO" in printed.err
    assert untouched(site)


def test_a_warning_alone_is_no_failure(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    site.point.override_percent = 10
    answer = _asked(site, capsys, 0)
    assert answer.content["verdict"] == "warning"
    assert answer.wrong() == {"arm, speed override": ("warning", "ROBOT_NOT_READY")}


def test_every_device_that_is_not_there_is_named(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        site.devices["arm"]["port"] = listener.getsockname()[1]
    site.devices["gripper"]["port"] = str(site.folder / "ttyUSB0")
    site.devices["camera"] = {"driver": "v4l2", "device": "/dev/v4l/by-id/none"}
    assert _asked(site, capsys, 1).wrong() == {
        "camera, device": ("failed", "CAMERA_UNAVAILABLE"),
        "arm, connection": ("failed", "CONNECTION_REFUSED"),
        "gripper, connection": ("failed", "DEVICE_UNAVAILABLE"),
    }


def test_a_gripper_behind_the_arm(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    site.devices["gripper"] = {"driver": "robot_io"}
    assert _asked(site, capsys, 0).wrong() == {"gripper, sensors": ("warning", "GRIPPER_STATE_UNKNOWN")}
    site.point.inputs[2] = True
    assert _asked(site, capsys, 0).wrong() == {}


def test_a_calibration_of_other_frames(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    site.calibration["robot"] = {"user_frame": 5, "user_tool": 1}
    answer = _asked(site, capsys, 1)
    assert answer.wrong() == {"calibration, fits the robot's frames": ("failed", "FRAME_CHANGED")}
    assert "user_frame is 1, calibrated with 5" in answer.content["findings"][-1]["detail"]


def test_a_calibration_that_is_missing_or_impossible(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    site.calibration["camera"] = {**CALIBRATION["camera"], "fx": -1.0}  # type: ignore[dict-item]
    assert _asked(site, capsys, 1).wrong() == {"calibration, file": ("failed", "CALIBRATION_INVALID")}
    site.calibration["camera"] = {**CALIBRATION["camera"], "fx": 8.0}  # type: ignore[dict-item]
    assert _asked(site, capsys, 1).wrong()["calibration, numbers"] == ("failed", "CALIBRATION_INVALID")


def test_a_config_that_is_wrong_is_a_usage_error(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    site.devices["gripper"]["force_n"] = 10_000.0
    assert site.doctor("--json") == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "6001 CONFIG_INVALID" in printed.err
    assert "devices.gripper.force_n" in printed.err


def test_without_a_config_it_is_the_services(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Path] = []

    def load(path: Path) -> None:
        asked.append(path)
        raise AlarmError(Alarm.CONFIG_INVALID, f"{path}: none here.")

    monkeypatch.setattr("srvs_cell.config.load_config", load)
    assert run(["doctor"]) == 2
    assert "none here" in capsys.readouterr().err
    unit = (Path(__file__).parent.parent.parent / "systemd" / "srvs-cell.service").read_text(encoding="utf-8")
    assert f"--config {asked[0]}" in unit


def test_a_state_folder_that_cannot_be_written(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    (site.folder / "file").touch()
    site.state = site.folder / "file" / "state"
    assert _asked(site, capsys, 1).wrong() == {"state folder, access": ("failed", "JOURNAL_FAILED")}


def test_a_daemon_that_runs_is_asked_and_its_devices_are_left_alone(capsys: pytest.CaptureFixture[str]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        site, daemon = Site(Path(folder)), Daemon(Path(folder) / "api.sock")
        daemon.start()
        try:
            answer = _asked(site, capsys, 1)
        finally:
            daemon.end()
            site.close()
    assert answer.content["daemon"] is True
    assert answer.wrong() == {"daemon, alarm": ("failed", "GRIP_EMPTY")}
    (arm,) = [one for one in answer.content["findings"] if one["part"] == "arm"]
    assert "a fake: active; not looked at" in arm["detail"]
    assert site.controller.server.requests == 0
    assert site.gripper.line.received == []


def test_a_daemon_that_does_not_answer_keeps_its_devices(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    lock = os.open(site.state / "daemon.lock", os.O_RDWR | os.O_CREAT)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert _asked(site, capsys, 1).wrong() == {"daemon, answer": ("failed", "ALREADY_RUNNING")}
        assert site.controller.server.requests == 0
        fcntl.flock(lock, fcntl.LOCK_UN)
        assert _asked(site, capsys, 0).wrong() == {}
    finally:
        os.close(lock)


def test_a_simulated_cell_that_does_not_run(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    site.devices["clock"] = {"driver": "sim", "path": str(site.folder / "clock")}
    assert _asked(site, capsys, 1).wrong() == {"clock, time": ("failed", "CLOCK_LOST")}
