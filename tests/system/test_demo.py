"""The demo as its user runs it: real processes, real wires, judged by the simulator's truth."""

import json
from pathlib import Path

import pytest

from srvs_cell.alarms import AlarmError
from srvs_cell.cli.demo_run import DemoOptions, run_demo
from srvs_cell.cli.main import run
from srvs_cell.cli.simulated_cell import SimulationOptions

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


def test_three_parts_are_relocated_and_the_truth_agrees(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    lines: list[str] = []
    result = run_demo(DemoOptions(SimulationOptions(objects=3, seed=1), out), lines.append)
    assert result["success"], result["reasons"]
    assert result["state"] == "Complete"
    assert result["simulation"] is True
    assert result["position_error_mm"]["max"] < 8.9, "worse than the paper's mean"
    assert result["moves_done"] == result["moves_least"]
    assert any("pick" in line.lower() for line in lines)
    page = (out / "report.html").read_text(encoding="utf-8")
    for picture in ("planes.png", "locations.png", "plan.png", "before.png", "after.png"):
        assert (out / picture).stat().st_size > 1000
        assert f'src="{picture}"' in page
    assert json.loads((out / "demo.json").read_text(encoding="utf-8"))["success"] is True


def test_a_folder_with_other_things_is_not_emptied(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work", encoding="utf-8")
    with pytest.raises(AlarmError, match="holds no earlier demo"):
        run_demo(DemoOptions(SimulationOptions(objects=3), tmp_path), print)
    assert (tmp_path / "thesis.tex").exists()


def test_too_few_objects_are_a_usage_error() -> None:
    assert run(["demo", "--objects", "2"]) == 2
