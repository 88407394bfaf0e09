"""planning-problem/1: what is read, and that a malformed problem is refused by the name of its field."""

import copy
from typing import Any

import pytest

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.planning import AssignGoal, Disc, Problem, RankGoal, Rectangle, read_problems
from srvs_cell.scene import PlaceKind
from tests.planning.problems import wire_problem


def test_a_problem_is_read_with_its_gripper_as_grips_of_each_object() -> None:
    problem = Problem.from_mapping(wire_problem(), "a.json")
    assert [item.footprint for item in problem.objects] == [Disc(10.0), Rectangle(12.0, 8.0)]
    assert problem.places[2].kind is PlaceKind.BUFFER
    assert problem.goal == RankGoal((0, 1), 0.0)
    assert [(grip.yaw_deg, grip.inner_mm) for grip in problem.objects[1].grips] == [(0.0, 17.0), (90.0, 13.0)]


def test_an_assign_goal_is_read() -> None:
    data = wire_problem() | {"goal": {"type": "assign", "allowed": [[1], [0, 2]], "must_fill": [1]}, "gripper": None}
    problem = Problem.from_mapping(data, "a.json")
    assert problem.goal == AssignGoal((frozenset({1}), frozenset({0, 2})), frozenset({1}))
    assert problem.objects[0].grips == ()


def _changed(path: tuple[str | int, ...], value: Any) -> dict[str, Any]:
    data = copy.deepcopy(wire_problem())
    target: Any = data
    for part in path[:-1]:
        target = target[part]
    if value is KeyError:
        del target[path[-1]]
    else:
        target[path[-1]] = value
    return data


@pytest.mark.parametrize(
    ("path", "value", "named"),
    [
        (("schema",), "planning-problem/2", "schema"),
        (("objects", 1, "hx_mm"), -1.0, "objects[1].hx_mm"),
        (("objects", 0, "r_mm"), KeyError, "objects[0].r_mm"),
        (("objects", 0, "shape"), "star", "objects[0]"),
        (("objects", 0, "start"), 3, "objects[0].start"),
        (("objects", 1, "start"), 0, "objects[1].start"),
        (("objects", 1, "id"), 5, "objects[1].id"),
        (("objects", 0, "height_mm"), float("nan"), "objects[0].height_mm"),
        (("places", 0, "x_mm"), "far", "places[0].x_mm"),
        (("places", 0, "x_mm"), 1e300, "places[0].x_mm"),
        (("places", 0, "x_mm"), 10**400, "places[0].x_mm"),
        (("places", 1, "kind"), "shelf", "places[1].kind"),
        (("places", 1, "reachable"), KeyError, "places[1].reachable"),
        (("home_mm",), [1.0], "home_mm"),
        (("clearance_mm",), -1.0, "clearance_mm"),
        (("n",), 3, "n"),
        (("k",), 0, "k"),
        (("gripper", "axes"), ["z"], "gripper.axes[0]"),
        (("gripper", "axes"), [], "gripper.axes"),
        (("obstacles", 0, "r_mm"), 0.0, "obstacles[0].r_mm"),
        (("goal", "slots"), [0], "goal.slots"),
        (("goal", "slots"), [0, 0], "goal.slots"),
        (("goal", "slots"), [0, 9], "goal.slots[1]"),
        (("goal", "semantics"), "cluster", "goal.semantics"),
        (("goal",), {"type": "assign", "allowed": [[0]], "must_fill": []}, "goal.allowed"),
        (("goal",), {"type": "assign", "allowed": [[0], []], "must_fill": []}, "goal.allowed[1]"),
        (("goal",), {"type": "assign", "allowed": [[0], [7]], "must_fill": []}, "goal.allowed[1][0]"),
        (("goal",), {"type": "assign", "allowed": [[0], [1]], "must_fill": [4]}, "goal.must_fill[0]"),
    ],
)
def test_a_malformed_problem_names_the_field(path: tuple[str | int, ...], value: Any, named: str) -> None:
    with pytest.raises(AlarmError) as caught:
        Problem.from_mapping(_changed(path, value), "bad.json")
    assert caught.value.alarm is Alarm.PROBLEM_INVALID
    assert caught.value.detail.startswith(f"bad.json: {named}: ")


def test_a_rank_in_a_bin_is_refused() -> None:
    with pytest.raises(AlarmError, match="bin"):
        Problem.from_mapping(_changed(("places", 0, "kind"), "bin"), "bad.json")


def test_a_file_of_instances_is_read_in_order() -> None:
    data = {"schema": "planning-problem/1 (lengths in mm)", "instances": [wire_problem() | {"id": i} for i in "ab"]}
    assert [problem.id for problem in read_problems(data, "many.json")] == ["a", "b"]


@pytest.mark.parametrize(
    ("data", "named"),
    [
        ([], "problem"),
        ({"instances": 3}, "instances"),
        ({"instances": [wire_problem(), 3]}, "instances[1]"),
        ({"instances": [wire_problem(), {}]}, "instances[1]: id"),
        ({"schema": "other", "instances": []}, "schema"),
    ],
)
def test_a_malformed_file_names_the_instance(data: object, named: str) -> None:
    with pytest.raises(AlarmError) as caught:
        read_problems(data, "many.json")
    assert caught.value.detail.startswith(f"many.json: {named}")
