"""An infeasible problem names the reason for each object."""

import dataclasses

import pytest

from srvs_cell.planning import AssignGoal, Disc, FingerGrip, Obstacle, Problem, plan, what_would_help
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
    assert "where the obstacle at (0.0, -110.0) is in the way" in _reasons(moved)[0]


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
    assert (
        "taken by object 1, which cannot leave: the obstacle at (120.0, 0.0) is in the way of the hand"
        in _reasons(blocked)[0]
    )


def test_the_order_that_cannot_be_mended_names_every_object() -> None:
    # Everybody is within its window, the order is still wrong, and there is no room to change it.
    reasons = _reasons(line_problem([99.0, 98.0, 100.0, 99.0], tolerance_mm=1.5, buffers=0))
    assert len(reasons) == 4


def test_a_ring_that_the_fingers_close_blames_those_in_it_alone() -> None:
    # The fingers of the first two hit each other where both belong; the third only wants to go elsewhere.
    base = line_problem([10.0, 20.0, 30.0], spacing_mm=30.0)
    grip = FingerGrip("along x", (0.0, 0.0), 0.0, 15.0, 10.0, 16.0)
    far = [dataclasses.replace(base.places[-1], id=4 + i, x_mm=300.0 + 200.0 * i, y_mm=0.0) for i in range(3)]
    problem = dataclasses.replace(
        base,
        places=(*base.places, *far),
        objects=tuple(
            dataclasses.replace(item, grips=(grip,), start=start)
            for item, start in zip(base.objects, (4, 5, 6), strict=True)
        ),
        goal=AssignGoal((frozenset({0}), frozenset({1}), frozenset({3})), frozenset()),
    )
    reasons = _reasons(problem)
    assert "cannot end on place 0 (0.0, 0.0) with object 1 where it belongs, whatever else is moved" in reasons[0]
    assert "cannot end on place 1 (30.0, 0.0) with object 0 where it belongs, whatever else is moved" in reasons[1]
    assert reasons[2].endswith("has no reason of its own; see object 0 and object 1")
    assert reasons[3].startswith("all ")


def test_where_no_single_change_helps_pairs_are_named() -> None:
    # A ring of four with one spare place out of reach and nobody who could be left out of both rings.
    problem = line_problem([20.0, 10.0, 40.0, 30.0], spacing_mm=60.0, buffers=0)
    goal = AssignGoal(tuple(frozenset({place}) for place in (1, 0, 3, 2)), frozenset())
    blocked = tuple(
        dataclasses.replace(item, blocked=((place, "out of reach by 14 mm"),))
        for item, place in zip(problem.objects, (1, 0, 3, 2), strict=True)
    )
    stuck = dataclasses.replace(problem, goal=goal, objects=(*problem.objects[:2], *blocked[2:]))
    lines = what_would_help(stuck)
    assert lines
    assert all(" and " in line or line.startswith("two more") for line in lines)
