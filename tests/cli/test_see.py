"""``srvs-cell perceive`` from its arguments to its output."""

from __future__ import annotations

import json
import re
from pathlib import Path  # noqa: TC003 - pytest's fixtures
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cli.see import _correction, register
from srvs_cell.geometry import Transform, Xyzwpr
from srvs_cell.scene import TableCheck
from tests.vision.painted import TABLE_Z_MM, cuboid, paint, rig
from tests.vision.pictures import render, square

if TYPE_CHECKING:
    from typer.testing import Result

CALIBRATION = """\
schema_version: 1
camera: {width: 220, height: 160, fx: 400.0, fy: 400.0, cx: 110.0, cy: 80.0, distortion: [0.0, 0.0, 0.0, 0.0, 0.0]}
tcp_T_camera: {xyz_mm: [0.0, 0.0, 0.0], wpr_deg: [0.0, 0.0, 0.0]}
"""
OF_THE_PAINTER = "640, height: 480, fx: 800.0, fy: 800.0, cx: 321.0, cy: 238.0"
LEFT_POSE, RIGHT_POSE = "500,0,500,180,0,0", "530,0,500,180,0,0"


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    left, right = render([square(80.0, 60.0, 50.0, 160.0, 28.4), square(150.0, 110.0, 40.0, 120.0, 26.0)])
    paths = tmp_path / "left.png", tmp_path / "right.png"
    for path, image in zip(paths, (left, right), strict=True):
        cv2.imwrite(str(path), image)
    return paths


def run(*arguments: object) -> Result:
    app = typer.Typer()
    app.callback()(lambda: None)
    register(app)
    return CliRunner().invoke(app, ["perceive", *map(str, arguments)])


def alarm_of(result: Result) -> Alarm:
    assert isinstance(result.exception, AlarmError), result.output
    return result.exception.alarm


def test_without_calibration_it_works_in_pixels_and_prints_one_json_object(pair: tuple[Path, Path]) -> None:
    result = run(*pair, "--min-disparity", 15, "--max-disparity", 40, "--json")
    assert result.exit_code == 0
    report = json.loads(result.stdout)
    assert list(report) == ["planes_left", "planes_right", "matches", "ambiguous_planes", "timings_ms"]
    found = sorted(match["disparity_px"] for match in report["matches"])
    assert any(value == pytest.approx(28.4, abs=0.2) for value in found)
    assert any(value == pytest.approx(26.0, abs=0.2) for value in found)


def test_people_get_a_table(pair: tuple[Path, Path]) -> None:
    result = run(*pair, "--max-disparity", 40)
    assert result.exit_code == 0
    assert "matched" in result.stdout
    assert "disparity px" in result.stdout


def test_a_plane_that_equals_could_fool_is_told_and_not_matched(tmp_path: Path) -> None:
    one, other = square(120.0, 60.0, 40.0, 160.0, 20.0), square(120.0, 60.0, 40.0, 160.0, 75.0)
    paths = tmp_path / "left.png", tmp_path / "right.png"
    for path, image in zip(paths, (render([one])[0], render([one, other])[1]), strict=True):
        cv2.imwrite(str(path), image)
    result = run(*paths, "--max-disparity", 100)
    assert result.exit_code == 0, result.output
    assert "1 left unmatched because they are ambiguous, at x, y px: (119, 59)" in result.stdout
    report = json.loads(run(*paths, "--max-disparity", 100, "--json").stdout)
    assert report["matches"] == []
    assert report["ambiguous_planes"][0]["centre_px"] == pytest.approx([119.5, 59.5], abs=1.0)


def test_disparity_and_overlay_are_written(pair: tuple[Path, Path], tmp_path: Path) -> None:
    result = run(*pair, "--max-disparity", 40, "--disparity", tmp_path / "d.pfm", "--overlay", tmp_path / "o.png")
    assert result.exit_code == 0
    data = (tmp_path / "d.pfm").read_bytes()
    assert data.startswith(b"Pf\n220 160\n-1\n")
    values = np.frombuffer(data[len(b"Pf\n220 160\n-1\n") :], dtype="<f4").reshape(160, 220)[::-1]
    assert values[60, 80] == pytest.approx(28.4, abs=0.2)
    picture = cv2.imread(str(tmp_path / "o.png"))
    assert picture is not None
    assert picture.shape[1] >= 2 * 220


def test_with_calibration_there_are_workpieces(pair: tuple[Path, Path], tmp_path: Path) -> None:
    calibration = tmp_path / "cal.yaml"
    calibration.write_text(CALIBRATION, encoding="utf-8")
    result = run(
        *pair,
        "--calibration",
        calibration,
        "--left-pose",
        LEFT_POSE,
        "--right-pose",
        RIGHT_POSE,
        "--table-z",
        0,
        "--json",
    )
    assert result.exit_code == 0, result.exception
    report = json.loads(result.stdout)
    # d = f b / Z = 28.4 px is Z = 422.5 mm below a camera at 500 mm
    highest = max(report["workpieces"], key=lambda workpiece: workpiece["height_mm"])
    assert highest["height_mm"] == pytest.approx(500.0 - 400.0 * 30.0 / 28.4, abs=4.0)


def test_people_are_told_how_sure_each_place_is_how_it_is_taken_and_what_the_table_told(tmp_path: Path) -> None:
    cameras = rig()
    parts = [cuboid(470.0, 100.0, 60.0, 20.0, (50.0, 30.0), 200), cuboid(540.0, 10.0, 60.0, 20.0, (95.0, 90.0), 200)]
    paths = tmp_path / "left.png", tmp_path / "right.png"
    for path, image in zip(paths, paint(parts, cameras), strict=True):
        cv2.imwrite(str(path), image)
    calibration = tmp_path / "cal.yaml"
    calibration.write_text(
        CALIBRATION.replace("220, height: 160, fx: 400.0, fy: 400.0, cx: 110.0, cy: 80.0", OF_THE_PAINTER),
        encoding="utf-8",
    )
    left = cameras.base_T_camera
    to_right = Xyzwpr(cameras.baseline_mm, 0.0, 0.0, 0.0, 0.0, 0.0)
    right = left @ Transform.from_xyzwpr("camera_left", "camera_right", to_right)
    poses = [",".join(f"{value:.9g}" for value in pose.to_xyzwpr().as_tuple()) for pose in (left, right)]
    where = ["--calibration", calibration, "--left-pose", poses[0], "--right-pose", poses[1], "--table-z", TABLE_Z_MM]
    result = run(*paths, *where)
    assert result.exit_code == 0, result.exception
    # the painted table is blank
    assert re.search(r"^table: corrects nothing, the table shows too little: ", result.stdout, re.MULTILINE)
    sigmas = r"sigma \(0\.\d\d, 0\.\d\d, \d\.\d\d\) mm, random \(0\.0\d, 0\.0\d, 0\.\d\d\) mm, height"
    taken = r"grasp closes to (29|30)\.\d mm at (109|110)\.\d deg$"
    assert re.search(
        rf"cuboid at \(4(69|70)\.\d, (99|100)\.\d, 6\d\.\d\) mm, {sigmas}.*; {taken}", result.stdout, re.MULTILINE
    )
    assert re.search(rf"cuboid at \(5.* mm, {sigmas}.*; no grasp: too wide: ", result.stdout, re.MULTILINE)


def test_people_are_told_by_how_much_the_table_corrects() -> None:
    assert _correction(TableCheck(90, 0.2, 0.1, 0.01, (0.123, -4.0, 5.678))).endswith("by (0.12, -4.00, 5.68) mm")


@pytest.mark.parametrize("pose", ["1,2,3", "1,2,3,4,5,six", "1,2,3,4,5,nan", ""])
def test_a_bad_pose_is_a_usage_error_that_names_it(pair: tuple[Path, Path], tmp_path: Path, pose: str) -> None:
    result = run(*pair, "--calibration", tmp_path / "c.yaml", "--left-pose", pose, "--right-pose", RIGHT_POSE)
    assert result.exit_code == 2
    assert "--left-pose" in result.output


def test_calibration_and_poses_go_together(pair: tuple[Path, Path]) -> None:
    assert run(*pair, "--left-pose", LEFT_POSE).exit_code == 2


def test_an_empty_disparity_range_is_a_usage_error(pair: tuple[Path, Path]) -> None:
    assert run(*pair, "--min-disparity", 20, "--max-disparity", 20).exit_code == 2
    assert run(*pair, "--max-disparity", 1e9).exit_code == 2


def test_a_missing_a_truncated_and_an_odd_sized_image_are_named(pair: tuple[Path, Path], tmp_path: Path) -> None:
    left, _ = pair
    broken = tmp_path / "broken.png"
    broken.write_bytes(left.read_bytes()[:60])
    odd = tmp_path / "odd.png"
    cv2.imwrite(str(odd), np.zeros((100, 90), dtype=np.uint8))
    for path in (tmp_path / "nowhere.png", broken, odd):
        result = run(left, path)
        assert alarm_of(result) is Alarm.IMAGE_INVALID, path
        assert result.stdout == ""


def test_a_broken_calibration_is_named(pair: tuple[Path, Path], tmp_path: Path) -> None:
    calibration = tmp_path / "cal.yaml"
    for text in ("[1, 2", "just text", "schema_version: 1"):
        calibration.write_text(text, encoding="utf-8")
        result = run(*pair, "--calibration", calibration, "--left-pose", LEFT_POSE, "--right-pose", RIGHT_POSE)
        assert alarm_of(result) is Alarm.CALIBRATION_INVALID, text


def test_a_place_that_cannot_be_written_is_named(pair: tuple[Path, Path], tmp_path: Path) -> None:
    result = run(*pair, "--disparity", tmp_path / "nowhere" / "d.pfm")
    assert alarm_of(result) is Alarm.FILE_INVALID


def test_faithful_takes_the_papers_steps_alone(pair: tuple[Path, Path]) -> None:
    asked = (*pair, "--min-disparity", 15, "--max-disparity", 40, "--json")
    timings = [json.loads(run(*asked, *more).stdout)["timings_ms"] for more in ((), ("--faithful",))]
    assert {"refinement", "grouping"} <= set(timings[0])
    assert not {"refinement", "grouping"} & set(timings[1])
