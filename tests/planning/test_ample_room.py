"""Fewest moves with room enough, and refusals, against a brute force that knows only what the validator allows."""

from __future__ import annotations

import random
from collections import Counter, deque
from dataclasses import replace
from functools import cache

import pytest

from srvs_cell.planning import AssignGoal, FingerGrip, Polygon, Problem, ProblemObject, SearchLimits, plan, validate
from srvs_cell.planning.ample_room import clear_places, fewest_with_room
from srvs_cell.planning.clearance import conflict_table
from srvs_cell.planning.culprits import culprits, only
from srvs_cell.planning.explain import what_would_help
from srvs_cell.planning.goals import goal_rule
from srvs_cell.planning.moves import fewest_moves
from srvs_cell.planning.planner import lacks_room, moves_with_room
from srvs_cell.scene import Move, Place, PlaceKind, PlanStatus

SEEDS = range(40)
CAP = 100_000
CLEARANCE_MM = 2.0


def crowd(seed: int) -> Problem:
    """Return oblongs in a narrow place that change places, with fingers, and up to three free places far outside."""
    choose = random.Random(seed)  # noqa: S311 - reproducible, no secret
    count = choose.choice((3, 3, 4))
    sizes = [(choose.uniform(9.0, 16.0), choose.uniform(9.0, 16.0)) for _ in range(count)]
    points: list[tuple[float, float]] = []
    while len(points) < count:
        point, (x, y) = (choose.uniform(0.0, 75.0), choose.uniform(0.0, 75.0)), sizes[len(points)]
        gaps = [
            max(abs(point[0] - u) - x - other_x, abs(point[1] - v) - y - other_y)
            for (u, v), (other_x, other_y) in zip(points, sizes, strict=False)
        ]
        if min(gaps, default=CLEARANCE_MM) >= CLEARANCE_MM:
            points.append(point)
    objects = []
    for number, (x, y) in enumerate(sizes):
        yaws = choose.choice(((0.0,), (90.0,), (0.0, 90.0)))
        grips = tuple(FingerGrip(f"{yaw:g}", (0.0, 0.0), yaw, 16.0, 8.0, 14.0) for yaw in yaws)
        shape = Polygon(((-x, -y), (x, -y), (x, y), (-x, y)))
        objects.append(ProblemObject(number, 30.0, shape, number, grips, f"part {number}"))
    free = choose.choice((1, 2, 3)) if count == 3 else 1
    points += [(400.0 + 150.0 * number, 0.0) for number in range(free)]
    goal = choose.sample(range(count), count)
    return Problem(
        id=f"crowd {seed}",
        places=tuple(
            Place(i, *point, PlaceKind.SLOT if i < count else PlaceKind.BUFFER) for i, point in enumerate(points)
        ),
        objects=tuple(objects),
        obstacles=(),
        goal=AssignGoal(tuple(frozenset({place}) for place in goal), frozenset()),
        home_mm=(0.0, 0.0),
        clearance_mm=CLEARANCE_MM,
    )


@cache
def brute_force(problem: Problem) -> int | None:
    """Return the least number of moves by trying everything that the validator lets pass."""
    start = tuple(item.start for item in problem.objects)
    queue, seen = deque([(start, 0)]), {start}
    while queue:
        stands, moves = queue.popleft()
        here = replace(
            problem,
            objects=tuple(replace(item, start=place) for item, place in zip(problem.objects, stands, strict=True)),
        )
        if not validate(here, []):
            return moves
        for item, origin in enumerate(stands):
            for target in range(len(problem.places)):
                after = (*stands[:item], target, *stands[item + 1 :])
                if after in seen or target == origin:
                    continue
                if any(reason.startswith("move 1") for reason in validate(here, [Move(item, origin, target)])):
                    continue
                seen.add(after)
                queue.append((after, moves + 1))
    return None


@pytest.mark.parametrize("seed", SEEDS)
def test_plans_and_refusals_are_those_of_brute_force(seed: int) -> None:
    problem = crowd(seed)
    answer, truth = plan(problem), brute_force(problem)
    if truth is None:
        assert answer.status is PlanStatus.INFEASIBLE
        assert answer.reasons
        return
    assert validate(problem, answer.moves) == []
    assert len(answer.moves) == truth


def test_the_scenes_are_of_both_kinds() -> None:
    refused = [seed for seed in SEEDS if plan(crowd(seed)).status is PlanStatus.INFEASIBLE]
    assert 0.15 * len(SEEDS) < len(refused) < 0.85 * len(SEEDS)


@pytest.mark.parametrize("seed", range(0, 40, 3))
def test_what_would_help_helps(seed: int) -> None:
    problem = crowd(seed)
    if plan(problem).status is not PlanStatus.INFEASIBLE:
        return
    for number, item in enumerate(problem.objects):
        if f"{item.name} taken off the table" in what_would_help(problem):
            rest = [other for other in problem.objects if other is not item]
            assert isinstance(problem.goal, AssignGoal)
            without = replace(
                problem,
                objects=tuple(replace(other, id=i) for i, other in enumerate(rest)),
                goal=replace(problem.goal, allowed=tuple(a for i, a in enumerate(problem.goal.allowed) if i != number)),
            )
            assert brute_force(without) is not None


@pytest.mark.parametrize("seed", SEEDS)
def test_those_to_blame_are_alone_to_blame_and_each_of_them_is(seed: int) -> None:
    problem = crowd(seed)
    blamed = culprits(problem, range(len(problem.objects)))
    if plan(problem).status is not PlanStatus.INFEASIBLE:
        assert blamed == ()
        return
    assert blamed
    assert brute_force(only(problem, blamed)) is None
    assert all(brute_force(only(problem, set(blamed) - {one})) is not None for one in blamed)


@pytest.mark.parametrize("seed", SEEDS)
def test_moves_with_room_are_a_bound_and_with_enough_clear_places_the_truth(seed: int) -> None:
    problem = crowd(seed)
    table, rule = conflict_table(problem), goal_rule(problem)
    start = tuple(item.start for item in problem.objects)
    found = fewest_with_room(start, table, rule, len(start), CAP)
    assert found.proven
    clear = clear_places(start, table, rule)
    assert clear == tuple(place.id for place in problem.places if place.kind is PlaceKind.BUFFER)
    truth = brute_force(problem)
    if len(clear) >= len(start):
        assert (None if found.steps is None else len(found.steps)) == truth
    elif truth is not None:
        assert found.steps is not None
        assert found.bound <= truth


@pytest.mark.parametrize("seed", SEEDS)
def test_plans_in_which_each_object_waits_once_at_most_are_plans(seed: int) -> None:
    problem = crowd(seed)
    start, table, rule = tuple(item.start for item in problem.objects), conflict_table(problem), goal_rule(problem)
    found = fewest_moves(start, table, rule, CAP, at_most_twice=True)
    if found.steps is None:
        return
    truth = brute_force(problem)
    assert truth is not None
    assert len(found.steps) >= truth
    assert validate(problem, [Move(*step) for step in found.steps]) == []
    assert max(Counter(item for item, _, _ in found.steps).values(), default=0) <= 2


@pytest.mark.parametrize("seed", SEEDS)
def test_where_no_room_is_lacking_the_fewest_moves_are_those_with_room(seed: int) -> None:
    problem, limits = crowd(seed), SearchLimits()
    needed, truth = moves_with_room(problem, limits), brute_force(problem)
    if needed is None:
        assert truth is None
    elif lacks_room(problem, needed, limits):
        assert truth is None or truth >= needed
    else:
        assert truth == needed


@pytest.mark.parametrize("seed", range(0, 40, 5))
def test_the_table_of_some_objects_is_a_part_of_the_whole_one(seed: int) -> None:
    problem = crowd(seed)
    for items in ([0], [2, 0], [1, 2], [0, 1, 2]):
        assert conflict_table(problem).of(sorted(items)) == conflict_table(only(problem, items))
