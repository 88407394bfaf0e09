"""An infeasible problem names the reason for each object."""

import dataclasses

import pytest

from srvs_cell.planning import AssignGoal, Disc, FingerGrip, Obstacle, Problem, plan
from srvs_cell.scene import PlanStatus
from tests.planning.problems import line_problem


def _reasons(problem: Problem) -> tuple[str, ...]:
    answer = plan(problem)
    assert answer.status is PlanStatus.INFEASIBLE
    assert answer.moves == ()
    return answer.reasons


def _unreachable(problem: Problem, place: int) -> Problem:
    places = list(problem.places)
    places[place] = dataclasses.replace(places[place], reachable=False)
    return dataclasses.replace(problem, places=tuple(places))


def test_no_free_place() -> None:
    reasons = _reasons(line_problem([10.0, 20.0], buffers=0))
    assert [reason.split(":")[0] for reason in reasons] == ["object 0", "object 1"]
    assert all("no free buffer place" in reason for reason in reasons)


def test_out_of_reach() -> None:
    reasons = _reasons(_unreachable(line_problem([10.0, 20.0]), 0))
    assert "object 0: stands on place 0 (0.0, 0.0), which is out of reach" in reasons
    assert "object 1: belongs on place 0 (0.0, 0.0), which is out of reach" in reasons


def test_obstacle_at_the_goal() -> None:
    problem = line_problem([10.0])
    moved = dataclasses.replace(
        problem, goal=AssignGoal((frozenset({1}),), frozenset()), obstacles=(Obstacle(Disc(5.0), 0.0, -110.0),)
    )
    assert "an obstacle is in the way" in _reasons(moved)[0]


@pytest.mark.parametrize(("obstacle_y_mm", "words"), [(0.0, "cannot be gripped"), (-100.0, "cannot be put down")])
def test_obstacle_in_the_way_of_the_fingers(obstacle_y_mm: float, words: str) -> None:
    problem = line_problem([10.0])
    grip = FingerGrip("along x", (0.0, 0.0), 0.0, 15.0, 10.0, 16.0)
    moved = dataclasses.replace(
        problem,
        objects=(dataclasses.replace(problem.objects[0], grips=(grip,)),),
        goal=AssignGoal((frozenset({1}),), frozenset()),
        obstacles=(Obstacle(Disc(4.0), 20.0, obstacle_y_mm),),
    )
    assert words in _reasons(moved)[0]


def test_goals_that_exclude_each_other() -> None:
    reasons = _reasons(line_problem([10.0, 20.0], spacing_mm=22.0))
    assert "does not fit beside object 1" in reasons[0]


def test_a_place_that_nobody_can_fill() -> None:
    problem = line_problem([10.0])
    reasons = _reasons(dataclasses.replace(problem, goal=AssignGoal((frozenset({0, 1}),), frozenset({0, 1}))))
    assert reasons == ("place 1 (0.0, -100.0) must be filled, but no sequence of moves fills it",)


def test_a_neighbour_out_of_reach_keeps_the_fingers_out() -> None:
    base = line_problem([10.0, 20.0], spacing_mm=30.0)
    grip = FingerGrip("along x", (0.0, 0.0), 0.0, 15.0, 10.0, 16.0)
    problem = _unreachable(
        dataclasses.replace(
            base,
            objects=(dataclasses.replace(base.objects[0], grips=(grip,)), base.objects[1]),
            goal=AssignGoal((frozenset({2}), frozenset({1})), frozenset()),
        ),
        1,
    )
    assert "cannot be gripped on place 0 (0.0, 0.0): a finger hits object 1" in _reasons(problem)[0]


def test_a_goal_that_is_taken_names_who_cannot_leave_and_why() -> None:
    base = line_problem([10.0, 20.0])
    goal = AssignGoal((frozenset({1}), frozenset({1, 2})), frozenset())
    reasons = _reasons(_unreachable(dataclasses.replace(base, goal=goal), 1))
    assert reasons[0] == "object 0: belongs on place 1 (100.0, 0.0), which is out of reach"
    grip = FingerGrip("along x", (0.0, 0.0), 0.0, 15.0, 10.0, 16.0)
    gripped = (base.objects[0], dataclasses.replace(base.objects[1], grips=(grip,)))
    blocked = dataclasses.replace(base, goal=goal, objects=gripped, obstacles=(Obstacle(Disc(4.0), 120.0, 0.0),))
    assert "taken by object 1, which cannot leave: an obstacle is in the way of the fingers" in _reasons(blocked)[0]


def test_the_order_that_cannot_be_mended_names_every_object() -> None:
    # Everybody is within its window, the order is still wrong, and there is no room to change it.
    reasons = _reasons(line_problem([99.0, 98.0, 100.0, 99.0], tolerance_mm=1.5, buffers=0))
    assert len(reasons) == 4
