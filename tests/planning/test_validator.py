"""The validator refuses what is wrong, by the name of the fault."""

import dataclasses

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from srvs_cell.planning import AssignGoal, Disc, FingerGrip, Obstacle, Problem, plan, validate
from srvs_cell.scene import Move, Place, PlaceKind
from tests.planning.problems import line_problem

SWAP = (Move(0, 0, 2), Move(1, 1, 0), Move(0, 2, 1))


def _with_place(problem: Problem, index: int, **changes: object) -> Problem:
    places = list(problem.places)
    places[index] = dataclasses.replace(places[index], **changes)  # type: ignore[arg-type]
    return dataclasses.replace(problem, places=tuple(places))


def test_a_right_plan_is_accepted() -> None:
    assert validate(line_problem([10.0, 20.0]), SWAP) == []


def test_nothing_to_do_is_accepted() -> None:
    assert validate(line_problem([20.0, 10.0]), ()) == []


@pytest.mark.parametrize(
    ("moves", "reason"),
    [
        ([Move(7, 0, 2)], "move 1: bad_object"),
        ([Move(-1, 0, 2)], "move 1: bad_object"),
        ([Move(0, 0, 9)], "move 1: bad_place"),
        ([Move(0, -1, 2)], "move 1: bad_place"),
        ([Move(0, 0, 0)], "move 1: same_place"),
        ([Move(0, 0, 2), Move(0, 0, 1)], "move 2: wrong_from"),
        ([Move(0, 0, 1)], "move 1: occupied"),
        (SWAP[:2], "goal_not_reached"),
        ((), "goal_not_reached"),
    ],
)
def test_the_fault_is_named(moves: list[Move], reason: str) -> None:
    assert validate(line_problem([10.0, 20.0]), moves)[0].startswith(reason)


def test_reach_and_bins() -> None:
    problem = line_problem([10.0, 20.0])
    assert validate(_with_place(problem, 0, reachable=False), SWAP)[0].startswith("move 1: unreachable_pick")
    assert validate(_with_place(problem, 2, reachable=False), SWAP)[0].startswith("move 1: unreachable_place")
    assert validate(_with_place(problem, 2, kind=PlaceKind.BIN), SWAP)[0].startswith("move 3: pick_from_bin")


def test_footprints_and_obstacles() -> None:
    problem = line_problem([10.0, 20.0])
    near = _with_place(problem, 2, x_mm=100.0, y_mm=-24.0)  # 24 mm from object 1: 10 + 10 + 5 are needed
    assert validate(near, SWAP)[0].startswith("move 1: footprint_conflict")
    blocked = dataclasses.replace(problem, obstacles=(Obstacle(Disc(5.0), 0.0, -80.5),))
    assert validate(blocked, SWAP)[0].startswith("move 1: obstacle_conflict")


def test_fingers() -> None:
    grip = FingerGrip("along x", (0.0, 0.0), 0.0, 12.0, 10.0, 16.0)
    problem = _with_place(line_problem([10.0, 20.0], spacing_mm=30.0), 2, y_mm=-100.0)
    gripped = tuple(dataclasses.replace(item, grips=(grip,)) for item in problem.objects)
    assert validate(dataclasses.replace(problem, objects=gripped), SWAP)[0].startswith("move 1: gripper_blocked")
    across = tuple(dataclasses.replace(item, grips=(dataclasses.replace(grip, yaw_deg=90.0),)) for item in gripped)
    assert validate(dataclasses.replace(problem, objects=across), SWAP) == []


def test_assigned_places_and_places_to_fill() -> None:
    problem = dataclasses.replace(
        line_problem([10.0, 20.0]), goal=AssignGoal((frozenset({0}), frozenset({2})), frozenset({0, 1}))
    )
    assert validate(problem, ()) == ["goal_not_reached (object 1 stands on place 1, allowed are [2])"]
    assert validate(problem, (Move(1, 1, 2),)) == ["goal_not_reached (place 1 is empty)"]


def test_an_object_without_a_rank_is_not_at_its_goal() -> None:
    assert "which has no rank" in validate(line_problem([20.0, 10.0]), (Move(1, 1, 2),))[0]


@given(st.permutations([10.0, 20.0, 30.0, 40.0]), st.data())
@settings(max_examples=60)
def test_a_plan_with_one_move_missing_or_bent_is_refused(heights_mm: list[float], data: st.DataObject) -> None:
    problem = line_problem(heights_mm)
    moves = list(plan(problem).moves)
    if not moves:
        return
    index = data.draw(st.integers(0, len(moves) - 1))
    assert validate(problem, moves[:index] + moves[index + 1 :])
    bent = data.draw(st.integers(0, len(problem.places) - 1))
    if bent != moves[index].to_place:
        assert validate(
            problem, [*moves[:index], dataclasses.replace(moves[index], to_place=bent), *moves[index + 1 :]]
        )
    swapped = dataclasses.replace(moves[index], object=(moves[index].object + 1) % 4)
    assert validate(problem, [*moves[:index], swapped, *moves[index + 1 :]])


def test_bins_hold_many() -> None:
    base = line_problem([10.0, 20.0])
    problem = dataclasses.replace(
        base,
        places=(*base.places, Place(3, 0.0, 400.0, PlaceKind.BIN)),
        goal=AssignGoal((frozenset({3}), frozenset({3})), frozenset({3})),
    )
    assert validate(problem, (Move(0, 0, 3), Move(1, 1, 3))) == []
