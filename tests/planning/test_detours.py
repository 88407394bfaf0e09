"""Nested detours: as many moves as needed and no more, valid, and never longer than one cycle after another."""

import dataclasses
import random

import pytest

from srvs_cell.planning import Problem, SearchLimits, plan, validate
from srvs_cell.planning.detours import nested_detours
from srvs_cell.planning.travel import distances, travel_mm
from srvs_cell.scene import Move, Place, PlaceKind, PlanStatus
from tests.planning.problems import line_problem


def scattered(count: int, seed: int, buffers: int = 1) -> Problem:
    """Return objects in random order on random places."""
    choose = random.Random(seed)  # noqa: S311 - a reproducible problem, no secret
    heights_mm = [10.0 * number for number in range(count)]
    choose.shuffle(heights_mm)
    problem = line_problem(heights_mm, buffers=buffers)
    places = [Place(place.id, choose.uniform(0, 3000), choose.uniform(0, 3000), place.kind) for place in problem.places]
    return dataclasses.replace(problem, places=tuple(places), clearance_mm=0.0)


def _target(problem: Problem) -> tuple[int, ...]:
    order = sorted(problem.objects, key=lambda item: -item.height_mm)
    rank = {item.id: position for position, item in enumerate(order)}
    return tuple(rank[item.id] for item in problem.objects)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("buffers", [1, 2])
def test_a_walk_is_a_valid_plan_with_the_fewest_moves_near_the_least_travel(seed: int, buffers: int) -> None:
    problem = scattered(6, seed, buffers)
    exact = plan(problem)
    assert exact.status is PlanStatus.SOLVED
    start = tuple(item.start for item in problem.objects)
    steps = nested_detours(start, _target(problem), range(6, 6 + buffers), distances(problem))
    assert validate(problem, [Move(*step) for step in steps]) == []
    assert len(steps) == len(exact.moves)
    assert exact.travel_mm - 1e-6 <= travel_mm(steps, distances(problem)) <= 1.15 * exact.travel_mm


def test_nothing_to_do_is_no_walk() -> None:
    problem = scattered(3, 1)
    assert nested_detours((0, 1, 2), (0, 1, 2), [3], distances(problem)) == ()


def test_many_objects_get_a_valid_plan_whose_moves_are_proven() -> None:
    problem = scattered(30, 5)
    answer = plan(problem, SearchLimits(max_travel_search=20))
    assert answer.status is PlanStatus.NOT_PROVEN
    assert answer.moves_proven
    assert validate(problem, answer.moves) == []
    assert answer.bound_travel_mm < answer.travel_mm < 1.6 * answer.bound_travel_mm


def test_where_something_is_in_the_way_a_capped_search_still_gives_a_valid_plan() -> None:
    base = scattered(6, 3, buffers=2)
    # Two slots so near to each other that only one of them can be taken by an object at a time in passing.
    places = list(base.places)
    places[6] = Place(6, places[0].x_mm + 15.0, places[0].y_mm, PlaceKind.BUFFER)
    problem = dataclasses.replace(base, places=tuple(places))
    answer = plan(problem, SearchLimits(max_travel_search=20))
    assert answer.status is PlanStatus.NOT_PROVEN
    assert validate(problem, answer.moves) == []
