"""The simulated cell as a program."""

from __future__ import annotations

import base64
import json
import socket
import struct
import subprocess
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

import cv2
import numpy as np
import pytest
import serial
import yaml

from drivers.sim.cell import _parser, _wires, main
from drivers.sim.gripper_geometry import CameraMount
from drivers.sim.imperfections import LEVELS, make_camera, write_calibration
from srvs_cell.calibration import Calibration
from srvs_cell.geometry import pose_difference

if TYPE_CHECKING:
    from collections.abc import Iterator
    from io import BufferedRWPair
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


def test_all_wires_lead_to_one_arm_and_it_ends_with_its_stdin(tmp_path: Path) -> None:
    link = tmp_path / "gripper"
    wires = ("--rmi-port", "0", "--modbus-port", "0", "--karel-port", "0", "--robotiq", str(link))
    with running("--objects", "1", "--imperfections", "none", *wires) as (line, ask, process):
        assert line["arm"]["driver"] == "fanuc_modbus", "the first of several that are asked for"
        assert line["robotiq"] == str(link)
        with serial.Serial(str(link), 115200, timeout=10.0) as port:
            port.write(bytes.fromhex("09 04 07 D0 00 03 B1 CE"))
            assert port.read(3) == bytes.fromhex("09 04 06")
        with socket.create_connection(("127.0.0.1", line["rmi_port"]), 10.0) as first, first.makefile("rwb") as stream:
            assert _say(stream, Communication="FRC_Connect")["PortNumber"] == line["rmi_session_port"]
        with (
            socket.create_connection(("127.0.0.1", line["rmi_session_port"]), 10.0) as session,
            session.makefile("rwb") as stream,
        ):
            assert _say(stream, Command="FRC_Initialize")["ErrorID"] == 0
            before = _say(stream, Command="FRC_ReadJointAngles")["JointAngle"]
            turn = {**dict.fromkeys(before, 0.0), "J1": 5.0}
            move = {"SequenceID": 1, "JointAngle": turn, "SpeedType": "Percent", "Speed": 50, "TermType": "FINE"}
            assert _say(stream, Instruction="FRC_JointRelativeJRep", **move)["ErrorID"] == 0
            after = _say(stream, Command="FRC_ReadJointAngles")["JointAngle"]
            assert after == {**before, "J1": pytest.approx(before["J1"] + 5.0, abs=0.01)}
            beyond = {**move, "SequenceID": 2, "JointAngle": {**before, "J2": 161.0}}
            stream.write(json.dumps({"Instruction": "FRC_JointMotionJRep", **beyond}).encode() + b"\r\n")
            assert _say(stream, Command="FRC_GetStatus")["Communication"] == "FRC_SystemFault", "a limit, no answer"
        assert ask(op="truth")["motions_started"] == 1
        with socket.create_connection(("127.0.0.1", line["modbus_port"]), 10.0) as modbus:
            modbus.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 12009, 4))
            x_um, y_um = struct.unpack("<2i", struct.pack("<4H", *struct.unpack(">4H", modbus.recv(100)[9:])))
        reported = ask(op="truth")["arm"]["true_pose"]
        assert (x_um / 1000, y_um / 1000) == pytest.approx(reported[:2], abs=0.01)
        with socket.create_connection(("127.0.0.1", line["karel_port"]), 10.0) as karel:
            karel.sendall(b">1,HELO,4301*16825\r\n")
            assert karel.recv(100).startswith(b"<1,OK,4301")
        assert process.stdin is not None
        process.stdin.close()
        process.stdin = None
        assert process.wait(20) == 0
    assert not link.is_symlink()


@pytest.mark.parametrize(
    ("arguments", "wires"),
    [
        ([], {"modbus": 0}),
        (["--rmi-port", "16001"], {"rmi": 16001}),
        (["--wire", "karel-serial"], {"karel-serial": 0}),
        (["--wire", "rmi", "--modbus-port", "502", "--rmi-port", "7"], {"rmi": 7, "modbus": 502}),
        (["--wire", "karel-serial", "--karel-port", "0"], {"karel-serial": 0, "karel": 0}),
    ],
)
def test_a_port_asks_for_its_wire_and_the_daemons_wire_comes_first(arguments: list[str], wires: dict[str, int]) -> None:
    assert list(_wires(_parser().parse_args(arguments)).items()) == list(wires.items())


def _say(stream: BufferedRWPair, **packet: object) -> dict[str, Any]:
    """Send one packet of RMI and return the next one that comes."""
    stream.write(json.dumps(packet).encode() + b"\r\n")
    stream.flush()
    answer: dict[str, Any] = json.loads(stream.readline())
    return answer


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
