import copy
import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.calibration import Calibration, CalibrationVerdict, Level, check_calibration, verdict
from srvs_cell.cli.main import run

GOOD: dict[str, Any] = {
    "schema_version": 1,
    "camera": {
        "width": 640,
        "height": 480,
        "fx": 800.1,
        "fy": 801,
        "cx": 314.4,
        "cy": 248.2,
        "distortion": [0.03, 0.1, -0.0001, -0.0007, -0.01],
    },
    "tcp_T_camera": {"xyz_mm": [39.2, -28.0, 12.0], "wpr_deg": [1.7, -0.2, -1.0]},
}


def changed(path: str, value: Any) -> dict[str, Any]:
    data = copy.deepcopy(GOOD)
    *sections, key = path.split(".")
    place = data
    for section in sections:
        place = place.setdefault(section, {})
    place[key] = value
    return data


def test_round_trip() -> None:
    calibration = Calibration.from_mapping(changed("robot.user_tool", 2), "cal.yaml")
    again = Calibration.from_mapping(yaml.safe_load(yaml.safe_dump(calibration.to_mapping())), "again")
    assert again == calibration
    assert again.robot.user_tool == 2
    assert again.uncertainty.hand_eye_mm == 0.3


def test_matrices() -> None:
    calibration = Calibration.from_mapping(GOOD, "cal.yaml")
    assert calibration.camera_matrix.tolist() == [[800.1, 0.0, 314.4], [0.0, 801.0, 248.2], [0.0, 0.0, 1.0]]
    assert calibration.distortion.shape == (5,)
    transform = calibration.tcp_T_camera
    assert (transform.target, transform.source) == ("tcp", "camera")
    assert transform.translation_mm.tolist() == [39.2, -28.0, 12.0]


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        ("schema_version", 2, "schema_version = 2: must be 1"),
        ("schema_version", True, "schema_version = True"),
        ("camera.fx", -3.0, "camera.fx = -3.0: Input should be greater than 0"),
        ("camera.fx", "800", "camera.fx = '800'"),
        ("camera.width", 640.5, "camera.width = 640.5"),
        ("camera.cx", float("nan"), "camera.cx = nan"),
        ("camera.distortion", [0.1, 0.2], "camera.distortion"),
        ("camera.focal", 3.0, "camera.focal = 3.0: Unexpected keyword argument"),
        ("tcp_T_camera.wpr_deg", [0.0, 500.0, 0.0], "tcp_T_camera.wpr_deg.1 = 500.0: Input should be less than"),
        ("hand_eye", {}, "hand_eye: unknown key"),
        ("camera", 3, "camera = 3: a mapping is expected"),
        ("uncertainty.hand_eye_mm", -1.0, "uncertainty.hand_eye_mm = -1.0"),
    ],
)
def test_mistakes_are_named_with_source_key_value_and_bound(path: str, value: Any, says: str) -> None:
    with pytest.raises(AlarmError) as caught:
        Calibration.from_mapping(changed(path, value), "cal.yaml")
    assert caught.value.alarm is Alarm.CALIBRATION_INVALID
    assert caught.value.detail.startswith("cal.yaml: ")
    assert says in caught.value.detail


@pytest.mark.parametrize("missing", ["camera", "tcp_T_camera"])
def test_missing_section(missing: str) -> None:
    data = {key: value for key, value in GOOD.items() if key != missing}
    with pytest.raises(AlarmError, match=f"{missing}: missing"):
        Calibration.from_mapping(data, "cal.yaml")


def test_a_good_calibration_is_usable() -> None:
    findings = check_calibration(Calibration.from_mapping(GOOD, "cal.yaml"))
    assert verdict(findings) is CalibrationVerdict.USABLE
    assert {finding.level for finding in findings} == {Level.OK}


@pytest.mark.parametrize(
    ("path", "value", "check", "expected"),
    [
        ("camera.fx", 850.0, "ratio fx/fy", CalibrationVerdict.DOUBTFUL),
        ("camera.fx", 8.0, "horizontal field of view", CalibrationVerdict.UNUSABLE),
        ("camera.cx", 150.0, "principal point off the image centre", CalibrationVerdict.DOUBTFUL),
        ("camera.distortion", [-2.5, 0.0, 0.0, 0.0, 0.0], "distortion grows", CalibrationVerdict.UNUSABLE),
        ("camera.distortion", [0.0, 0.0, 0.1, 0.0, 0.0], "tangential", CalibrationVerdict.DOUBTFUL),
        ("tcp_T_camera.xyz_mm", [0.039, -0.028, 0.012], "camera to TCP", CalibrationVerdict.DOUBTFUL),
        ("tcp_T_camera.wpr_deg", [175.0, 0.0, 0.0], "optical axis", CalibrationVerdict.UNUSABLE),
        ("uncertainty.hand_eye_mm", 5.0, "stated uncertainty", CalibrationVerdict.DOUBTFUL),
    ],
)
def test_implausible_numbers_are_found(path: str, value: Any, check: str, expected: CalibrationVerdict) -> None:
    findings = check_calibration(Calibration.from_mapping(changed(path, value), "cal.yaml"))
    assert verdict(findings) is expected
    bad = [finding for finding in findings if finding.level is not Level.OK]
    assert any(finding.check.startswith(check) or check in finding.check for finding in bad)
    assert all(finding.advice for finding in bad)


def test_command_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "cal.yaml"
    file.write_text(yaml.safe_dump(GOOD), encoding="utf-8")
    assert run(["calibrate", "check", str(file), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["verdict"] == "usable"
    assert run(["calibrate", "check", str(file)]) == 0
    assert "verdict: usable" in capsys.readouterr().out


@pytest.mark.parametrize("content", ["camera: [", "- 1\n", yaml.safe_dump(changed("camera.fx", 8.0))])
def test_command_check_fails_with_the_alarm(tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str) -> None:
    file = tmp_path / "cal.yaml"
    file.write_text(content, encoding="utf-8")
    assert run(["calibrate", "check", str(file)]) == 1
    assert "3101 CALIBRATION_INVALID" in capsys.readouterr().err


def test_command_check_without_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["calibrate", "check", str(tmp_path / "none.yaml")]) == 1
    assert "6002 FILE_INVALID" in capsys.readouterr().err
