"""The exact walk of the hole: as short as the search over arrangements, never below its bound."""

import dataclasses

import pytest

from srvs_cell.planning import Disc, Problem, SearchLimits, plan, validate
from srvs_cell.planning.clearance import conflict_table
from srvs_cell.planning.detours import cycles_between, nested_detours, steps_of_walk
from srvs_cell.planning.goals import goal_rule
from srvs_cell.planning.hole_walk import shortest_walk
from srvs_cell.planning.travel import distances, least_travel, travel_mm
from srvs_cell.planning.walk_bound import hole_costs
from srvs_cell.scene import PlanStatus
from tests.planning.test_detours import scattered


def _start_and_target(problem: Problem) -> tuple[tuple[int, ...], tuple[int, ...]]:
    target = goal_rule(problem).labelled
    assert target is not None
    return tuple(item.start for item in problem.objects), target


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("count", [4, 6, 7])
def test_the_walk_is_as_short_as_the_search_over_arrangements_finds(count: int, seed: int) -> None:
    problem = scattered(count, seed)
    start, target = _start_and_target(problem)
    cycles = cycles_between(start, target)
    if not cycles:
        return
    legs, rule = distances(problem), goal_rule(problem)
    costs = hole_costs(cycles, count, legs, start)
    walk = shortest_walk(costs, float("inf"), 100_000)
    assert walk.places is not None
    steps = steps_of_walk(walk.places, start)
    exact = least_travel(start, len(steps), conflict_table(problem), rule, legs, 1_000_000)
    assert exact.steps is not None
    assert walk.bound_mm == pytest.approx(exact.bound_mm, abs=1e-6)
    assert travel_mm(steps, legs) == pytest.approx(walk.bound_mm, abs=1e-6)
    assert costs.bound_mm <= walk.bound_mm + 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_the_bound_of_a_search_that_ends_early_is_below_the_shortest_walk(seed: int) -> None:
    problem = scattered(9, seed)
    start, target = _start_and_target(problem)
    costs = hole_costs(cycles_between(start, target), 9, distances(problem), start)
    whole = shortest_walk(costs, float("inf"), 1_000_000)
    for looks in (1, 30, 200):
        part = shortest_walk(costs, float("inf"), looks)
        assert part.bound_mm <= whole.bound_mm + 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_twelve_objects_in_random_order_are_proven(seed: int) -> None:
    problem = scattered(12, seed)
    answer = plan(problem)
    assert answer.status is PlanStatus.SOLVED
    assert validate(problem, answer.moves) == []
    start, target = _start_and_target(problem)
    nested_mm = travel_mm(nested_detours(start, target, [12], distances(problem)), distances(problem))
    assert answer.travel_mm <= nested_mm + 1e-6


def test_a_hundred_objects_get_the_fewest_moves_and_a_bound_at_once() -> None:
    crowded = scattered(100, 3)
    slim = tuple(dataclasses.replace(item, footprint=Disc(0.1)) for item in crowded.objects)
    problem = dataclasses.replace(crowded, objects=slim)
    answer = plan(problem, SearchLimits(max_travel_search=100))
    assert answer.status is PlanStatus.NOT_PROVEN
    assert answer.moves_proven
    assert validate(problem, answer.moves) == []
    assert 0.75 * answer.travel_mm < answer.bound_travel_mm < answer.travel_mm
