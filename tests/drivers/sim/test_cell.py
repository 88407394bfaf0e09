"""The simulated cell as a program."""

from __future__ import annotations

import base64
import json
import socket
import subprocess
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

import cv2
import numpy as np
import pytest
import yaml

from drivers.sim.cell import main
from drivers.sim.gripper_geometry import CameraMount
from drivers.sim.imperfections import LEVELS, make_camera, write_calibration
from srvs_cell.calibration import Calibration
from srvs_cell.geometry import pose_difference

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


class Ask(Protocol):
    """One request on the control socket, by keyword."""

    def __call__(self, **request: Any) -> dict[str, Any]: ...


@contextmanager
def running(*arguments: str) -> Iterator[tuple[dict[str, Any], Ask, subprocess.Popen[str]]]:
    command = [sys.executable, "-m", "drivers.sim.cell", *arguments]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        line = json.loads(process.stdout.readline())
        with (
            socket.create_connection(("127.0.0.1", line["control_port"])) as connection,
            connection.makefile("rw") as stream,
        ):

            def ask(**request: Any) -> dict[str, Any]:
                stream.write(json.dumps(request) + "\n")
                stream.flush()
                answer: dict[str, Any] = json.loads(stream.readline())
                return answer

            yield line, ask, process
    finally:
        process.kill()
        process.communicate()


def test_it_says_what_listens_where_answers_and_ends_when_it_is_asked_to(tmp_path: Path) -> None:
    calibration = tmp_path / "calibration.yaml"
    with running("--objects", "3", "--seed", "4", "--calibration-out", str(calibration)) as (line, ask, process):
        assert {"modbus_port", "camera_port", "control_port", "clock_page", "observe_pose", "baseline_mm"} <= set(line)
        assert line["calibration"] == str(calibration)
        assert Calibration.from_mapping(yaml.safe_load(calibration.read_text()), "file").camera.width == 640
        truth = ask(op="truth")
        assert len(truth["parts"]) == 3
        assert all(part["tilt_deg"] < 0.1 for part in truth["parts"])
        picture = cv2.imdecode(np.frombuffer(base64.b64decode(ask(op="render")["png"]), np.uint8), cv2.IMREAD_GRAYSCALE)
        assert picture is not None
        assert picture.shape == (480, 640)
        assert "part" in ask(op="inject", fault="drop_part")["error"]
        assert "fault must be one of" in ask(op="inject", fault="earthquake")["error"]
        assert "op must be" in ask(op="dance")["error"]
        ask(op="inject", fault="move_part", part=1, dx_mm=12.0)
        moved = ask(op="truth")["parts"][1]
        assert moved["position_mm"][0] - moved["start"]["position_mm"][0] == pytest.approx(12.0, abs=0.5)
        ask(op="inject", fault="e_stop")
        assert "SRVO-001" in ask(op="truth")["arm"]["fault"]
        assert ask(op="shutdown") == {"ok": True}
        assert process.wait(20) == 0


def test_it_ends_with_its_stdin() -> None:
    with running("--objects", "1", "--imperfections", "none") as (_, _, process):
        assert process.stdin is not None
        process.stdin.close()
        process.stdin = None
        assert process.wait(20) == 0


def test_an_impossible_cell_is_refused(capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture) -> None:
    assert main(["--objects", "12"]) == 1
    assert "1 to 10" in caplog.text
    assert capfd.readouterr().out == ""


def test_without_mujoco_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("drivers.sim.cell.find_spec", lambda _: None)
    assert main([]) == 1
    assert "srvs-cell[sim]" in caplog.text


def test_the_calibration_file_is_off_by_what_the_level_says(tmp_path: Path) -> None:
    level, nominal = LEVELS["real"], CameraMount().transform()
    focal, centre, shift_mm, turn_deg = [], [], [], []
    for seed in range(60):
        camera = make_camera(level, nominal, np.random.default_rng(seed))
        write_calibration(camera, tmp_path / "calibration.yaml")
        read = Calibration.from_mapping(yaml.safe_load((tmp_path / "calibration.yaml").read_text()), "file")
        focal.append(read.camera.fx / camera.lens.fx - 1.0)
        centre.append(read.camera.cx - camera.lens.cx)
        distance, angle = pose_difference(camera.mount, camera.calibrated_mount)
        shift_mm.append(distance / np.sqrt(3.0))
        turn_deg.append(angle / np.sqrt(3.0))
    for errors, sigma in ((focal, 0.001), (centre, 0.5), (shift_mm, 0.3), (turn_deg, 0.05)):
        assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(sigma, rel=0.3)


def test_a_perfect_cell_has_an_exact_calibration() -> None:
    camera = make_camera(LEVELS["none"], CameraMount().transform(), np.random.default_rng(0))
    assert camera.lens == camera.calibrated_lens
    assert pose_difference(camera.mount, camera.calibrated_mount) == (0.0, 0.0)
