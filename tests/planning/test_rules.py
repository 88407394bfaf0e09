"""Goal rules: order of height along any direction, position correction, element change, installed ones."""

import dataclasses
import json

import pytest

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.config import parse_config
from srvs_cell.config.embedded import embedded_config
from srvs_cell.planning import (
    ElementChange,
    HeightOrder,
    NominalPlace,
    PlanningParameters,
    PositionCorrection,
    Workspace,
    make_rule,
    plan_relocation,
    validate,
)
from srvs_cell.scene import PlanStatus
from tests.planning.problems import workpiece

WORKSPACE = Workspace(300.0, 700.0, -250.0, 250.0)
PARAMETERS = PlanningParameters(home_mm=(450.0, 0.0))


def test_height_order_along_x_and_ascending() -> None:
    parts = [workpiece(0, (400, 0), 60), workpiece(1, (550, 0), 20)]
    along_x = plan_relocation(parts, PARAMETERS, WORKSPACE, HeightOrder(direction_deg=0.0))
    assert {goal.workpiece: goal.point_mm[0] for goal in along_x.goals} == pytest.approx({0: 550, 1: 400})
    assert not plan_relocation(parts, PARAMETERS, WORKSPACE, HeightOrder(direction_deg=180.0)).moves
    assert not plan_relocation(parts, PARAMETERS, WORKSPACE, HeightOrder(direction_deg=0.0, ascending=True)).moves


def test_position_correction_moves_only_what_is_off() -> None:
    rule = PositionCorrection(
        places=(
            NominalPlace(kind="cuboid", x_mm=450.0, y_mm=-100.0),
            NominalPlace(kind="cuboid", x_mm=450.0, y_mm=100.0),
        ),
        tolerance_mm=3.0,
    )
    parts = [workpiece(0, (452, -100), 60), workpiece(1, (520, 150), 20)]
    answer = plan_relocation(parts, PARAMETERS, WORKSPACE, rule)
    assert answer.relocation.status is PlanStatus.SOLVED
    assert [(move.workpiece, move.to_mm) for move in answer.moves] == [(1, (450.0, 100.0))]
    assert validate(answer.table.problem, answer.relocation.moves) == []


def test_position_correction_gets_round_a_neighbour_at_the_goal() -> None:
    rule = PositionCorrection(
        places=(
            NominalPlace(kind="cuboid", x_mm=450.0, y_mm=-100.0),
            NominalPlace(kind="cylinder", x_mm=450.0, y_mm=100.0),
        )
    )
    parts = [workpiece(0, (450, 100), 60), workpiece(1, (450, -100), 20, kind="cylinder")]
    answer = plan_relocation(parts, PARAMETERS, WORKSPACE, rule)
    assert answer.relocation.status is PlanStatus.SOLVED
    assert len(answer.moves) == 3


def test_position_correction_refuses_what_it_cannot_mend() -> None:
    rule = PositionCorrection(places=(NominalPlace(kind="cuboid", x_mm=450.0, y_mm=0.0, yaw_deg=0.0),))
    with pytest.raises(AlarmError) as caught:
        plan_relocation([workpiece(4, (450, 10), 60), workpiece(5, (450, 200), 20)], PARAMETERS, WORKSPACE, rule)
    assert caught.value.alarm is Alarm.PLAN_INFEASIBLE
    assert "workpiece 5: no taught place of kind cuboid is left" in caught.value.detail


def test_element_change_puts_a_substitute_where_the_rejected_one_stood() -> None:
    rule = ElementChange(
        height_mm=(30.0, 100.0), bin_mm=(320.0, 0.0), stock_mm=((650.0, 0.0), (650.0, 100.0)), substitute_kind="cuboid"
    )
    parts = [
        workpiece(0, (450, -100), 60),
        workpiece(1, (450, 100), 20),
        workpiece(2, (650, 0), 60, kind="cylinder"),
        workpiece(3, (652, 101), 60),
    ]
    answer = plan_relocation(parts, PARAMETERS, WORKSPACE, rule)
    assert [move.workpiece for move in answer.moves] == [1, 3]
    assert answer.moves[0].to_mm == (320.0, 0.0)
    assert answer.moves[1].to_mm == pytest.approx((450.0, 100.0))
    assert "workpiece 1 is rejected: its height 20.0 mm is outside 30 to 100 mm" in answer.relocation.reasons
    with pytest.raises(AlarmError) as caught:
        plan_relocation(parts[:3], PARAMETERS, WORKSPACE, rule)
    assert "1 workpieces are rejected and 0 places are vacant, but 0 of kind cuboid are in stock" in caught.value.detail


def test_element_change_rejects_what_is_too_dark_and_says_of_what_the_brightness_is_unknown() -> None:
    rule = ElementChange(
        brightness=(100.0, 200.0), bin_mm=(320.0, 0.0), stock_mm=((650.0, 0.0),), substitute_kind="cuboid"
    )
    greys = (100.0, 99.5, None, None)
    places = ((450, -200), (450, 0), (450, 200), (650, 0))
    parts = [
        dataclasses.replace(workpiece(i, place, 60), brightness=grey)
        for i, (place, grey) in enumerate(zip(places, greys, strict=True))
    ]
    answer = plan_relocation(parts, PARAMETERS, WORKSPACE, rule)
    assert [(move.workpiece, move.to_mm) for move in answer.moves] == [
        (1, (320.0, 0.0)),
        (3, pytest.approx((450.0, 0.0))),
    ]
    assert [reason for reason in answer.relocation.reasons if "brightness" in reason] == [
        "workpiece 1 is rejected: its brightness 99.5 is outside 100 to 200",
        "workpiece 2 is not judged by its brightness: that was not measured",
    ]
    glaring = [dataclasses.replace(part, brightness=None if part.id == 3 else 200.5) for part in parts[2:]]
    assert len(plan_relocation(glaring, PARAMETERS, WORKSPACE, rule).moves) == 2
    unlimited = dataclasses.replace(rule, brightness=(0.0, 255.0))
    answer = plan_relocation(parts, PARAMETERS, WORKSPACE, unlimited)
    assert not answer.moves
    assert not any("brightness" in reason for reason in answer.relocation.reasons)


def test_the_config_names_the_rule() -> None:
    parts = [workpiece(0, (450, -100), 60)]
    settings = {"places": [{"kind": "cuboid", "x_mm": 450.0, "y_mm": 100.0}]}
    named = dataclasses.replace(PARAMETERS, rule="position_correction", rule_settings=settings)
    assert len(plan_relocation(parts, named, WORKSPACE).moves) == 1


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        (
            "by_colour",
            {},
            "no such goal rule is installed; there are: element_change, height_order, position_correction",
        ),
        (
            "height_order",
            {"direction_deg": 999.0},
            "planning.rule_settings.direction_deg = 999.0: should be less than or equal to 360",
        ),
        ("height_order", {"colour": "red"}, "planning.rule_settings.colour: unexpected keyword argument"),
        ("element_change", {"bin_mm": [0.0, 0.0]}, "planning.rule_settings.substitute_kind: field required"),
        (
            "element_change",
            {"bin_mm": [0.0, 0.0], "substitute_kind": "cuboid", "brightness": [0.0, 256.0]},
            "planning.rule_settings.brightness.1 = 256.0: should be less than or equal to 255",
        ),
        (
            "element_change",
            {"bin_mm": [0.0, 0.0], "substitute_kind": "cuboid", "brightness": [200.0, 100.0]},
            "the least value 200 is greater than the greatest 100",
        ),
    ],
)
def test_a_wrong_rule_is_a_config_alarm(name: str, settings: dict[str, object], words: str) -> None:
    with pytest.raises(AlarmError) as caught:
        make_rule(name, settings)
    assert caught.value.alarm is Alarm.CONFIG_INVALID
    assert words in caught.value.detail
    text = embedded_config().replace(
        "planning:\n", f"planning:\n  rule: {name}\n  rule_settings: {json.dumps(settings)}\n"
    )
    with pytest.raises(AlarmError) as caught:
        parse_config(text, "cell.yaml")
    assert caught.value.detail.startswith("cell.yaml: planning.rule")


def test_what_lies_in_the_bin_was_rejected_before() -> None:
    rule = ElementChange(height_mm=(30.0, 100.0), bin_mm=(320.0, 0.0), substitute_kind="cuboid")
    parts = [workpiece(0, (450, -100), 60), workpiece(1, (322, 3), 20)]
    assert not plan_relocation(parts, PARAMETERS, WORKSPACE, rule).moves
