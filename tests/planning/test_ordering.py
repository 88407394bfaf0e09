"""Who must leave before whom: a true bound on the moves, reached through buffer places outside."""

import dataclasses
import math
import random
from collections.abc import Sequence

import pytest

from srvs_cell.planning import AssignGoal, Disc, FingerGrip, Problem, ProblemObject, plan, validate
from srvs_cell.planning.clearance import conflict_table
from srvs_cell.planning.goals import goal_rule
from srvs_cell.planning.moves import fewest_moves
from srvs_cell.planning.ordering import Ordering, order_moves
from srvs_cell.planning.travel import distances
from srvs_cell.scene import Move, Place, PlaceKind, PlanStatus
from tests.planning.problems import line_problem

RADIUS_MM = 20.0


def crowded(count: int, seed: int, *, density: float = 0.4, buffers: int | None = None) -> Problem:
    """Return discs on a table that they cover to some part, each with its own start and goal, and places beside it."""
    choose = random.Random(seed)  # noqa: S311 - a reproducible problem, no secret
    side_mm = math.sqrt(count * math.pi * RADIUS_MM**2 / density)

    def layout() -> list[tuple[float, float]]:
        points: list[tuple[float, float]] = []
        tries = 0
        while len(points) < count:
            point = choose.uniform(RADIUS_MM, side_mm - RADIUS_MM), choose.uniform(RADIUS_MM, side_mm - RADIUS_MM)
            tries += 1
            if all(math.dist(point, other) > 2 * RADIUS_MM for other in points):
                points.append(point)
            elif tries > 200 * count:
                points, tries = [], 0
        return points

    def places(points: Sequence[tuple[float, float]], first: int, kind: PlaceKind) -> list[Place]:
        return [Place(first + number, *point, kind) for number, point in enumerate(points)]

    beside = [(-200.0, 150.0 * number) for number in range(count if buffers is None else buffers)]
    return Problem(
        id=f"crowded {count} {seed}",
        places=(
            *places(layout(), 0, PlaceKind.LOOSE),
            *places(layout(), count, PlaceKind.SLOT),
            *places(beside, 2 * count, PlaceKind.BUFFER),
        ),
        objects=tuple(ProblemObject(i, 20.0, Disc(RADIUS_MM), i, (), f"object {i}") for i in range(count)),
        obstacles=(),
        goal=AssignGoal(tuple(frozenset({count + i}) for i in range(count)), frozenset()),
        home_mm=(0.0, -300.0),
        clearance_mm=0.0,
    )


def _ordering(problem: Problem) -> Ordering | None:
    target = goal_rule(problem).labelled
    assert target is not None
    return order_moves(problem, tuple(item.start for item in problem.objects), target, distances(problem))


@pytest.mark.parametrize("fingers", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_bound_and_plan_agree_with_the_search_over_arrangements(seed: int, *, fingers: bool) -> None:
    problem = crowded(4, seed, density=0.3, buffers=2)
    if fingers:
        grip = FingerGrip("along x", (0.0, 0.0), 30.0 * seed, RADIUS_MM, 8.0, 12.0)
        gripped = tuple(dataclasses.replace(item, grips=(grip,)) for item in problem.objects)
        problem = dataclasses.replace(problem, objects=gripped)
    start = tuple(item.start for item in problem.objects)
    exact = fewest_moves(start, conflict_table(problem), goal_rule(problem), 200_000)
    ordering = _ordering(problem)
    if ordering is None:
        assert exact.steps is None  # a ring that no detour opens
        return
    if exact.steps is not None:
        assert ordering.bound <= len(exact.steps)
    if ordering.steps is not None:
        assert exact.steps is not None
        assert len(ordering.steps) == ordering.bound == len(exact.steps)
        assert validate(problem, [Move(*step) for step in ordering.steps]) == []


@pytest.mark.parametrize("seed", range(3))
def test_fifty_crowded_objects_get_proven_moves(seed: int) -> None:
    problem = crowded(50, seed)
    answer = plan(problem)
    assert answer.status is PlanStatus.NOT_PROVEN
    assert answer.moves_proven
    assert answer.bound_moves == len(answer.moves) > 50
    assert answer.bound_travel_mm < answer.travel_mm
    assert validate(problem, answer.moves) == []


def test_three_that_change_places_need_one_detour() -> None:
    problem = line_problem([10.0, 20.0, 30.0])
    turned = dataclasses.replace(
        problem, goal=AssignGoal((frozenset({1}), frozenset({2}), frozenset({0})), frozenset())
    )
    ordering = _ordering(turned)
    assert ordering is not None
    assert ordering.bound == 4
    assert ordering.steps is not None
    assert len(ordering.steps) == 4


def test_too_few_buffer_places_leave_the_bound_alone() -> None:
    problem = crowded(50, 0, buffers=0)
    ordering = _ordering(problem)
    assert ordering is not None
    assert ordering.steps is None
    assert ordering.bound > 50


def test_where_the_orders_are_not_the_whole_truth_they_say_nothing() -> None:
    problem = crowded(5, 1)
    bin_places = (*problem.places[:5], dataclasses.replace(problem.places[5], kind=PlaceKind.BIN), *problem.places[6:])
    assert _ordering(dataclasses.replace(problem, places=bin_places)) is None
    hidden = (dataclasses.replace(problem.places[0], reachable=False), *problem.places[1:])
    assert _ordering(dataclasses.replace(problem, places=hidden)) is None
