"""``srvs-cell plan``: the JSON contract, the table for people, malformed files."""

import json
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cli.main import run
from srvs_cell.cli.plan import register
from tests.planning.problems import instances, problem_file, wire_problem

KEYS = {
    "id",
    "status",
    "moves",
    "travel_mm",
    "moves_proven",
    "travel_proven",
    "bound_moves",
    "bound_travel_mm",
    "plan",
    "reasons",
}


@pytest.fixture
def app() -> typer.Typer:
    made = typer.Typer()
    made.callback()(lambda: None)
    register(made)
    return made


def _write(tmp_path: Path, data: object) -> str:
    path = tmp_path / "problem.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    return str(path)


def _lines(app: typer.Typer, path: str) -> list[dict[str, Any]]:
    result = CliRunner().invoke(app, ["plan", path, "--json"], catch_exceptions=False)
    assert result.exit_code == 0
    return [json.loads(line) for line in result.stdout.splitlines()]


def test_one_problem_is_one_line_of_json(app: typer.Typer, tmp_path: Path) -> None:
    (line,) = _lines(app, _write(tmp_path, wire_problem()))
    assert set(line) == KEYS
    assert (line["id"], line["status"], line["moves"]) == ("swap", "solved", 3)
    assert line["moves_proven"]
    assert line["travel_proven"]
    assert line["bound_moves"] == 3
    assert line["bound_travel_mm"] == line["travel_mm"]
    assert sorted(line["plan"]) in ([[0, 0, 2], [0, 2, 1], [1, 1, 0]], [[0, 0, 1], [1, 1, 2], [1, 2, 0]])


def test_infeasible_is_an_answer(app: typer.Typer, tmp_path: Path) -> None:
    full = wire_problem() | {"k": 0}
    full["places"] = full["places"][:2]
    (line,) = _lines(app, _write(tmp_path, full))
    assert (line["status"], line["moves"], line["travel_mm"], line["plan"]) == ("infeasible", None, None, [])
    assert len(line["reasons"]) == 2
    shown = CliRunner().invoke(app, ["plan", _write(tmp_path, full)], catch_exceptions=False)
    assert shown.exit_code == 0
    assert "infeasible" in shown.stdout
    assert "no free buffer place" in shown.stdout


def test_a_file_of_instances_gives_one_line_each_in_order(app: typer.Typer, tmp_path: Path) -> None:
    data = {"schema": "planning-problem/1", "instances": [wire_problem() | {"id": name} for name in "cab"]}
    assert [line["id"] for line in _lines(app, _write(tmp_path, data))] == ["c", "a", "b"]


def test_people_see_moves_with_coordinates(app: typer.Typer, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["plan", _write(tmp_path, wire_problem())], catch_exceptions=False)
    assert "swap: solved, 3 moves" in result.stdout
    assert "buffer 2 (150.0, 100.0)" in result.stdout


@pytest.mark.parametrize(
    ("text", "alarm", "words"),
    [
        ("{", Alarm.PROBLEM_INVALID, "not JSON"),
        ("[]", Alarm.PROBLEM_INVALID, "JSON object"),
        ('{"id": "x"}', Alarm.PROBLEM_INVALID, "home_mm"),
        (None, Alarm.FILE_INVALID, "No such file"),
    ],
)
def test_a_bad_file_is_an_alarm(app: typer.Typer, tmp_path: Path, text: str | None, alarm: Alarm, words: str) -> None:
    path = tmp_path / "bad.json"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(AlarmError) as caught:
        CliRunner().invoke(app, ["plan", str(path), "--json"], catch_exceptions=False)
    assert caught.value.alarm is alarm
    assert words in caught.value.detail
    assert "bad.json" in caught.value.detail


def test_a_malformed_problem_is_a_misuse(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["plan", _write(tmp_path, wire_problem() | {"clearance_mm": -1.0})]) == 2
    assert "clearance_mm" in capsys.readouterr().err


def test_the_shared_file_gives_the_proven_optima(app: typer.Typer) -> None:
    lines = _lines(app, str(problem_file()))
    assert [line["id"] for line in lines] == [instance["id"] for instance in instances()]
    for line, instance in zip(lines, instances(), strict=True):
        assert line["status"] == instance["optimal"]["status"]
        assert line["moves"] == instance["optimal"]["moves"]


def test_a_plan_is_explained_and_drawn(app: typer.Typer, tmp_path: Path) -> None:
    problem, picture = _write(tmp_path, wire_problem()), tmp_path / "plan.svg"
    arguments = ["plan", problem, "--explain", "--picture", str(picture)]
    shown = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert "3 moves, proven least: 2 stand wrongly" in shown.stdout
    assert picture.read_text(encoding="utf-8").startswith("<svg")
    told = json.loads(CliRunner().invoke(app, ["plan", problem, "--explain", "--json"]).stdout)
    assert len(told["explanation"]) == 3
    with pytest.raises(AlarmError) as caught:
        CliRunner().invoke(app, [*arguments[:-1], str(tmp_path / "none" / "plan.svg")], catch_exceptions=False)
    assert caught.value.alarm is Alarm.FILE_INVALID
