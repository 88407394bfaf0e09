"""``srvs-cell perceive --method lines`` from its arguments to its output."""

from __future__ import annotations

import json
from pathlib import Path  # noqa: TC003 - pytest's fixtures
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from srvs_cell.cli.see import register
from tests.vision.pictures import render, square

if TYPE_CHECKING:
    from typer.testing import Result


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    left, right = render([square(80.0, 60.0, 50.0, 160.0, 28.4, 30.0), square(150.0, 110.0, 40.0, 120.0, 26.0, 30.0)])
    paths = tmp_path / "left.png", tmp_path / "right.png"
    for path, image in zip(paths, (left, right), strict=True):
        cv2.imwrite(str(path), image)
    return paths


def run(*arguments: object) -> Result:
    app = typer.Typer()
    app.callback()(lambda: None)
    register(app)
    return CliRunner().invoke(app, ["perceive", *map(str, arguments), "--method", "lines"])


def test_it_prints_one_json_object_without_workpieces(pair: tuple[Path, Path]) -> None:
    result = run(*pair, "--min-disparity", 15, "--max-disparity", 40, "--json")
    assert result.exit_code == 0
    report = json.loads(result.stdout)
    assert report["method"] == "lines"
    assert "workpieces" not in report
    found = [match["disparity_px"] for match in report["matches"]]
    assert sum(value == pytest.approx(28.4, abs=0.3) for value in found) >= 3
    assert list(report["timings_ms"]) == ["edges", "line_parameters", "matching"]


def test_with_calibration_the_lines_have_places(pair: tuple[Path, Path], tmp_path: Path) -> None:
    calibration = tmp_path / "calibration.yaml"
    calibration.write_text(
        "schema_version: 1\n"
        "camera: {width: 220, height: 160, fx: 400.0, fy: 400.0, cx: 110.0, cy: 80.0, distortion: [0, 0, 0, 0, 0]}\n"
        "tcp_T_camera: {xyz_mm: [0.0, 0.0, 0.0], wpr_deg: [0.0, 0.0, 0.0]}\n",
        encoding="utf-8",
    )
    poses = ("--left-pose", "500,0,500,180,0,0", "--right-pose", "530,0,500,180,0,0")
    result = run(*pair, "--calibration", calibration, *poses, "--json")
    assert result.exit_code == 0
    report = json.loads(result.stdout)
    assert list(report["timings_ms"]) == ["rectification", "edges", "line_parameters", "matching", "depth"]
    heights = [end[2] for match in report["matches"] for end in match["ends_mm"]]
    assert np.median(heights) == pytest.approx(70.0, abs=15.0)


def test_people_get_a_table(pair: tuple[Path, Path]) -> None:
    result = run(*pair, "--max-disparity", 40)
    assert result.exit_code == 0
    assert "lines left" in result.stdout
    assert "length px" in result.stdout


def test_disparity_and_overlay_are_written(pair: tuple[Path, Path], tmp_path: Path) -> None:
    result = run(*pair, "--max-disparity", 40, "--disparity", tmp_path / "d.pfm", "--overlay", tmp_path / "o.png")
    assert result.exit_code == 0
    assert (tmp_path / "d.pfm").read_bytes().startswith(b"Pf\n220 160\n-1")
    picture = cv2.imread(str(tmp_path / "o.png"))
    assert picture is not None
    assert picture.shape[1] > 2 * 900


def test_an_unknown_method_is_a_usage_error(pair: tuple[Path, Path]) -> None:
    app = typer.Typer()
    app.callback()(lambda: None)
    register(app)
    result = CliRunner().invoke(app, ["perceive", *map(str, pair), "--method", "points"])
    assert result.exit_code == 2
