"""``srvs-cell config``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import yaml
from typer.testing import CliRunner

from srvs_cell.cli.main import application, run

if TYPE_CHECKING:
    import pytest

CONFIGS = Path(__file__).parents[2] / "configs"
SIM = CONFIGS / "cell.sim.yaml"


def output(*arguments: str) -> str:
    result = CliRunner().invoke(application(list(arguments)), list(arguments))
    assert result.exit_code == 0, result.output
    return result.stdout


def test_check_says_what_it_is() -> None:
    text = output("config", "check", str(SIM))
    assert "valid, SIMULATION" in text
    assert "arm fanuc_modbus" in text


def test_check_as_json_is_one_object() -> None:
    answer = json.loads(output("config", "check", "--json", str(SIM)))
    assert answer["valid"] is True
    assert answer["drivers"]["camera"] == "sim"


def test_check_of_a_wrong_config_exits_2_with_the_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(SIM.read_text(encoding="utf-8").replace("baseline_mm: 30.0", "baseline_mm: 3000"))
    assert run(["config", "check", str(wrong)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "wrong.yaml: cell.look.baseline_mm = 3000: should be less than or equal to 500" in captured.err


def test_check_of_a_real_cell_without_calibration_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = tmp_path / "cell.yaml"
    copy.write_bytes((CONFIGS / "cell.fanuc-modbus.yaml").read_bytes())
    assert run(["config", "check", str(copy)]) == 2
    assert "3101 CALIBRATION_INVALID" in capsys.readouterr().err


def test_show_prints_every_default_and_can_be_read_again(tmp_path: Path) -> None:
    shown = output("config", "show")
    assert yaml.safe_load(shown)["cell"]["motion"]["clearance_mm"] == 30.0
    again = tmp_path / "again.yaml"
    again.write_text(shown, encoding="utf-8")
    assert json.loads(output("config", "show", "--json", str(again)))["cell"] == yaml.safe_load(shown)["cell"]


def test_schema_is_json() -> None:
    assert json.loads(output("config", "schema"))["title"] == "srvs_cell configuration"
