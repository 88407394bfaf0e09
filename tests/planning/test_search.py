"""Fewest moves and least travel against plain exhaustive search on small random problems."""

import dataclasses
from collections import deque

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from srvs_cell.planning import AssignGoal, FingerGrip, Problem, SearchLimits, plan, validate
from srvs_cell.planning.clearance import conflict_table
from srvs_cell.planning.goals import GoalRule, goal_rule
from srvs_cell.planning.moves import Arrangement, after, fewest_moves, possible_moves
from srvs_cell.planning.travel import distances, travel_mm
from srvs_cell.scene import Place, PlaceKind, PlanStatus
from tests.planning.problems import line_problem

heights = st.lists(st.sampled_from([40.0, 41.0, 42.0, 43.0, 50.0, 60.0]), min_size=2, max_size=5)


def breadth_first(problem: Problem) -> int | None:
    """Return the fewest moves by looking at every arrangement in order of distance."""
    table, rule = conflict_table(problem), goal_rule(problem)
    start = tuple(item.start for item in problem.objects)
    distance = {start: 0}
    queue = deque([start])
    while queue:
        arrangement = queue.popleft()
        if rule.is_reached(arrangement):
            return distance[arrangement]
        for step in possible_moves(arrangement, table):
            successor = after(arrangement, step)
            if successor not in distance:
                distance[successor] = distance[arrangement] + 1
                queue.append(successor)
    return None


def least_travel_by_trying_all(problem: Problem, moves: int) -> float:
    """Return the least travel of all plans with so many moves."""
    table, rule, legs = conflict_table(problem), goal_rule(problem), distances(problem)

    def deepen(arrangement: Arrangement, steps: tuple[tuple[int, int, int], ...]) -> float:
        if len(steps) == moves:
            return travel_mm(steps, legs) if rule.is_reached(arrangement) else float("inf")
        return min(
            (deepen(after(arrangement, step), (*steps, step)) for step in possible_moves(arrangement, table)),
            default=float("inf"),
        )

    return deepen(tuple(item.start for item in problem.objects), ())


@given(heights, st.sampled_from([0.0, 1.0, 2.0]), st.integers(0, 2))
@settings(max_examples=40)
def test_the_fewest_moves_are_found(heights_mm: list[float], tolerance_mm: float, buffers: int) -> None:
    problem = line_problem(heights_mm, tolerance_mm=tolerance_mm, buffers=buffers)
    answer = plan(problem)
    fewest = breadth_first(problem)
    assert (None if answer.status is PlanStatus.INFEASIBLE else len(answer.moves)) == fewest
    if fewest is not None:
        assert validate(problem, answer.moves) == []


@given(heights, st.integers(1, 2))
@settings(max_examples=40)
def test_the_closed_form_is_exact_where_nothing_is_in_the_way(heights_mm: list[float], buffers: int) -> None:
    # Different heights, or equal ones: no chain of ties, so the closed form is the answer and not just a bound.
    problem = line_problem(heights_mm, buffers=buffers)
    start = tuple(range(len(heights_mm)))
    assert goal_rule(problem).lower_bound(start) == breadth_first(problem)


@given(heights, st.sampled_from([0.0, 1.0, 2.0]), st.sampled_from([15.0, 22.0, 100.0]))
@settings(max_examples=25)
def test_the_lower_bound_never_drops_by_more_than_a_move(
    heights_mm: list[float], tolerance_mm: float, spacing_mm: float
) -> None:
    problem = line_problem(heights_mm, tolerance_mm=tolerance_mm, spacing_mm=spacing_mm)
    table, rule = conflict_table(problem), goal_rule(problem)
    start = tuple(range(len(heights_mm)))
    for arrangement in fewest_moves(start, table, rule, 500).explored:
        bound = rule.lower_bound(arrangement)
        assert (bound == 0) == rule.is_reached(arrangement)
        for step in possible_moves(arrangement, table):
            assert rule.lower_bound(after(arrangement, step)) >= bound - 1


@pytest.mark.parametrize(
    ("heights_mm", "tolerance_mm", "buffers"),
    [
        ([10.0, 20.0], 0.0, 1),
        ([10.0, 20.0, 30.0], 0.0, 1),
        ([30.0, 10.0, 20.0], 0.0, 2),
        ([41.0, 40.0, 43.0], 1.0, 1),
        ([20.0, 40.0, 10.0, 30.0], 0.0, 1),
        ([41.0, 50.0, 40.5, 49.5], 1.0, 1),
    ],
)
def test_the_travel_is_the_least_of_all_least_move_plans(
    heights_mm: list[float], tolerance_mm: float, buffers: int
) -> None:
    problem = line_problem(heights_mm, tolerance_mm=tolerance_mm, buffers=buffers)
    answer = plan(problem)
    expected_mm = least_travel_by_trying_all(problem, len(answer.moves))
    assert answer.travel_mm == pytest.approx(expected_mm, abs=1e-6)
    assert answer.bound_travel_mm == answer.travel_mm


def test_two_cycles_are_nested_where_that_is_shorter() -> None:
    # Two swaps far from the buffer place: one is done while the hole stands in the other.
    problem = line_problem([30.0, 40.0, 10.0, 20.0])
    far = dataclasses.replace(problem, places=(*problem.places[:4], Place(4, 0.0, -900.0, PlaceKind.BUFFER)))
    answer = plan(far)
    assert len(answer.moves) == 6
    assert sum(4 in {move.from_place, move.to_place} for move in answer.moves) == 2


def test_ties_need_pairwise_order_and_not_windows_alone() -> None:
    # 98 before 100 although both keep their windows (references/planning.md section 1).
    problem = line_problem([99.0, 98.0, 100.0, 99.0], tolerance_mm=1.5)
    rule: GoalRule = goal_rule(problem)
    start = (0, 1, 2, 3)
    assert rule.misplaced(start) == []
    assert not rule.is_reached(start)
    assert plan(problem).moves


def test_the_same_grip_must_be_free_at_pick_and_place() -> None:
    along_x = FingerGrip("along x", (0.0, 0.0), 0.0, 15.0, 10.0, 16.0)
    along_y = dataclasses.replace(along_x, name="along y", yaw_deg=90.0)
    base = line_problem([10.0, 20.0], buffers=0, spacing_mm=30.0)
    away = [Place(2, 0.0, 300.0, PlaceKind.BUFFER), Place(3, 0.0, 600.0, PlaceKind.BUFFER)]
    problem = dataclasses.replace(
        base,
        places=(*base.places, *away),
        objects=(dataclasses.replace(base.objects[0], grips=(along_x,)), base.objects[1]),
        goal=AssignGoal((frozenset({2}), frozenset({1})), frozenset()),
    )
    assert plan(problem).status is PlanStatus.SOLVED
    assert plan(problem).moves[0].object == 1  # the neighbour must make room for the fingers first
    free = dataclasses.replace(
        problem, objects=(dataclasses.replace(base.objects[0], grips=(along_x, along_y)), base.objects[1])
    )
    assert len(plan(free).moves) == 1


def test_a_bin_takes_any_number_and_gives_nothing_back() -> None:
    base = line_problem([10.0, 20.0], buffers=0)
    problem = dataclasses.replace(
        base,
        places=(*base.places, Place(2, 50.0, 100.0, PlaceKind.BIN)),
        goal=AssignGoal((frozenset({2}), frozenset({2})), frozenset()),
    )
    answer = plan(problem)
    assert [move.to_place for move in answer.moves] == [2, 2]
    back = dataclasses.replace(problem, goal=AssignGoal((frozenset({0}), frozenset({1})), frozenset()))
    in_bin = dataclasses.replace(back, objects=(dataclasses.replace(base.objects[0], start=2), base.objects[1]))
    refused = plan(in_bin)
    assert refused.status is PlanStatus.INFEASIBLE
    assert "never picked from" in refused.reasons[0]


def test_caps_give_an_honest_answer() -> None:
    problem = line_problem([10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
    proven = plan(problem)
    few_looks = plan(problem, SearchLimits(max_travel_search=3))
    assert few_looks.status is PlanStatus.NOT_PROVEN
    assert few_looks.moves_proven
    assert not few_looks.travel_proven
    assert len(few_looks.moves) == len(proven.moves)
    assert few_looks.bound_travel_mm <= proven.travel_mm <= few_looks.travel_mm
    assert validate(problem, few_looks.moves) == []
    tied = line_problem([10.0, 20.0, 30.0, 40.0, 50.0, 50.0])
    nothing = plan(tied, SearchLimits(max_moves_search=1))
    assert nothing.status is PlanStatus.NOT_PROVEN
    assert nothing.bound_moves <= len(plan(tied).moves)
    assert nothing.reasons


def test_the_same_problem_gives_the_same_plan() -> None:
    problem = line_problem([41.0, 40.0, 43.0, 60.0, 42.0], tolerance_mm=1.0)
    assert plan(problem) == plan(problem)
