"""The arm's time as what is least: the profile, the searches that must agree, and what changes against the length."""

import dataclasses
import math
import random

import pytest

from srvs_cell.planning import AssignGoal, Disc, PlanningParameters, Problem, ProblemObject, Workspace, plan
from srvs_cell.planning import plan_relocation as plan_cell
from srvs_cell.planning.clearance import conflict_table
from srvs_cell.planning.goals import goal_rule
from srvs_cell.planning.timing import Timing, Turns, straight_s
from srvs_cell.planning.travel import least_travel, travel_mm
from srvs_cell.scene import Place, PlaceKind, PlanStatus
from tests.planning.problems import workpiece
from tests.planning.test_heights import HAND

SPEED_MM_S, ACCELERATION_MM_S2 = 250.0, 2000.0


def _permutation(count: int, seed: int, order: list[int] | None = None) -> tuple[Problem, Timing]:
    choose = random.Random(seed)  # noqa: S311 - reproducible, no secret
    order = order or choose.sample(range(count), count)
    points = [(choose.uniform(0, 500), choose.uniform(0, 500)) for _ in range(count + 1)]
    problem = Problem(
        id=f"{count} {seed}",
        places=tuple(
            Place(i, *point, PlaceKind.SLOT if i < count else PlaceKind.BUFFER) for i, point in enumerate(points)
        ),
        objects=tuple(ProblemObject(i, 20.0, Disc(1e-3), i, (), f"object {i}") for i in range(count)),
        obstacles=(),
        goal=AssignGoal(tuple(frozenset({place}) for place in order), frozenset()),
        home_mm=(250.0, -100.0),
        clearance_mm=0.0,
    )
    return problem, Timing(SPEED_MM_S, ACCELERATION_MM_S2, tuple(choose.uniform(2.0, 6.0) for _ in range(count)))


def test_a_short_move_never_reaches_its_speed() -> None:
    assert straight_s(1000.0, 250.0, 2000.0) == pytest.approx(4.0 + 0.125)
    assert straight_s(20.0, 250.0, 2000.0) == pytest.approx(2.0 * math.sqrt(20.0 / 2000.0))
    ramps_mm = 250.0**2 / 2000.0
    assert straight_s(ramps_mm, 250.0, 2000.0) == pytest.approx(straight_s(ramps_mm - 1e-9, 250.0, 2000.0))


@pytest.mark.parametrize("seed", range(12))
def test_the_walk_of_the_hole_and_the_search_agree_on_the_least_time(seed: int) -> None:
    problem, timing = _permutation(5, seed)
    answer = plan(problem, timing=timing)
    assert answer.status is PlanStatus.SOLVED
    legs, start = timing.distances(problem), tuple(range(5))
    other = least_travel(start, len(answer.moves), conflict_table(problem), goal_rule(problem), legs, 10**7)
    assert other.steps is not None
    assert answer.time_s is not None
    assert answer.time_s == pytest.approx(travel_mm(other.steps, legs) / SPEED_MM_S)
    assert answer.bound_time_s == pytest.approx(answer.time_s)
    assert answer.time_s > sum(timing.handling_s[move.object] for move in answer.moves)


def test_what_is_quick_to_handle_is_moved_twice() -> None:
    problem, timing = _permutation(2, 3, [1, 0])
    for slow in (0, 1):
        handling = tuple(30.0 if item == slow else 1.0 for item in (0, 1))
        answer = plan(problem, timing=dataclasses.replace(timing, handling_s=handling))
        assert [move.object for move in answer.moves] == [1 - slow, slow, 1 - slow]


@pytest.mark.parametrize("seed", range(4))
def test_detours_that_are_not_proven_count_handling_too(seed: int) -> None:
    problem, timing = _permutation(6, seed, [1, 0, 3, 2, 5, 4])
    quick = (1.0, 30.0, 30.0, 1.0, 1.0, 30.0)
    least = plan(problem, timing=dataclasses.replace(timing, handling_s=quick))
    assert sorted(item for item in range(6) if sum(m.object == item for m in least.moves) == 2) == [0, 3, 4]


def test_the_cell_plans_for_time_unless_told_otherwise() -> None:
    parts = [workpiece(0, (450, -100), 60), workpiece(1, (450, 100), 20)]
    workspace = Workspace(300.0, 700.0, -250.0, 250.0)
    quick = plan_cell(parts, PlanningParameters(home_mm=(450.0, 0.0)), workspace, hand=HAND).relocation
    assert quick.time_s is not None
    assert quick.status is PlanStatus.SOLVED
    # Three moves of at least 250 mm/s, two grips of half a second and four slow ways of 60 mm at 80 mm/s each.
    assert quick.time_s > quick.travel_mm / 250.0 + 3 * (2 * 0.5 + 4 * 60.0 / 80.0)
    short = PlanningParameters(home_mm=(450.0, 0.0), objective="length")
    assert plan_cell(parts, short, workspace, hand=HAND).relocation.time_s is None


def _round_trip_s(problem: Problem, timing: Timing, item: int, origin: int, target: int) -> float:
    """Return the time of a move from home to home, leg by leg."""

    def leg_s(*gap_mm: float) -> float:
        return straight_s(math.hypot(*gap_mm), SPEED_MM_S, ACCELERATION_MM_S2)

    (x, y), p, q = problem.home_mm, problem.places[origin], problem.places[target]
    to_s, with_s, back_s = timing.turns_s[item][origin][target]
    down_s = max(leg_s(p.x_mm - x, p.y_mm - y, timing.rise_mm), to_s)
    home_s = max(leg_s(q.x_mm - x, q.y_mm - y), back_s)
    level_s = max(leg_s(p.x_mm - q.x_mm, p.y_mm - q.y_mm), with_s)
    return down_s + level_s + leg_s(timing.rise_mm) + home_s + timing.handling_s[item]


def _turns(problem: Problem, *turns_s: Turns) -> tuple[tuple[tuple[Turns, ...], ...], ...]:
    """Return the same turns of an object from everywhere to everywhere."""
    count = len(problem.places)
    return tuple(((each,) * count,) * count for each in turns_s)


@pytest.mark.parametrize("seed", range(8))
def test_with_a_look_after_every_move_the_least_time_is_that_of_the_best_of_all_first_movers(seed: int) -> None:
    problem, timing = _permutation(4, seed, [1, 2, 3, 0])
    turns_s = _turns(problem, (0.2, 0.0, 4.0), (5.0, 3.0, 5.0), (1.0, 6.0, 1.0), (3.0, 0.0, 3.0))
    timing = dataclasses.replace(timing, looks_between=True, rise_mm=200.0, turns_s=turns_s)
    answer = plan(problem, timing=timing)
    assert answer.status is PlanStatus.SOLVED
    direct_s = [_round_trip_s(problem, timing, item, item, (item + 1) % 4) for item in range(4)]
    twice_s = [
        _round_trip_s(problem, timing, item, item, 4) + _round_trip_s(problem, timing, item, 4, (item + 1) % 4)
        for item in range(4)
    ]
    least_s = min(sum(direct_s) - direct_s[item] + twice_s[item] for item in range(4))
    assert answer.time_s == pytest.approx(least_s)
    assert answer.bound_time_s == pytest.approx(least_s)


def test_a_part_for_which_the_wrist_turns_long_is_not_moved_twice() -> None:
    problem, timing = _permutation(2, 3, [1, 0])
    for slow in (0, 1):
        turns_s = _turns(problem, *((20.0, 0.0, 20.0) if item == slow else (0.0, 0.0, 0.0) for item in (0, 1)))
        answer = plan(problem, timing=dataclasses.replace(timing, looks_between=True, turns_s=turns_s))
        assert [move.object for move in answer.moves] == [1 - slow, slow, 1 - slow]
