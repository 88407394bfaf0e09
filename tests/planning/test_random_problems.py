"""Random small problems with every feature of the file format, against a brute force over what the validator allows."""

import copy
import json
import math
import random
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.planning import Problem, explain, has_plan, plan, plan_svg, plan_to_json, read_problems, validate
from srvs_cell.scene import Move, PlanStatus
from tests.planning.problems import wire_problem

BRUTE_SEEDS = range(45)
FEW_PLACES = 6


def _shape(choose: random.Random) -> dict[str, Any]:
    if choose.random() < 0.5:
        return {"shape": "disc", "r_mm": choose.uniform(5.0, 25.0)}
    return {"shape": "rect", "hx_mm": choose.uniform(4.0, 25.0), "hy_mm": choose.uniform(4.0, 25.0)}


def _gripper(choose: random.Random) -> dict[str, Any] | None:
    if choose.random() < 0.5:
        return None
    return {
        "axes": choose.choice([["x"], ["y"], ["x", "y"]]),
        "gap_mm": choose.uniform(0.0, 6.0),
        "thick_mm": choose.uniform(0.0, 14.0),
        "width_mm": choose.uniform(0.0, 26.0),
    }


def random_problem(seed: int) -> dict[str, Any]:
    """Return a problem of up to four objects; starts may overlap, goals may be anywhere."""
    choose = random.Random(seed)  # noqa: S311 - reproducible, no secret
    count = choose.randint(0, 4)
    places = max(1, min(count + choose.randint(0, 3), FEW_PLACES))
    side_mm = choose.choice([80.0, 150.0, 300.0])
    kinds = ["slot"] * count
    kinds += choose.choices(["buffer", "buffer", "bin", "stock", "loose", "slot"], k=places - count)
    choose.shuffle(kinds)
    solid = [place for place, kind in enumerate(kinds) if kind != "bin"]
    starts = choose.sample(solid, count)
    spread = choose.choice([1, 1, 2, places])
    allowed = [sorted(set(choose.choices(starts + list(range(places)), k=spread))) for _ in range(count)]
    goal: dict[str, Any] = {"type": "assign", "allowed": allowed, "must_fill": choose.sample(solid, min(1, count))}
    if choose.random() < 0.5:
        slots = choose.sample(starts, count)
        tolerance_mm = choose.choice([0.0, 2.0, 5.0])
        goal = {"type": "rank", "slots": slots, "tol_mm": tolerance_mm, "semantics": "pairwise"}
    far = choose.choice([0.0, 0.15])
    return {
        "id": f"random {seed}",
        "home_mm": [choose.uniform(-50.0, 200.0), -50.0],
        "clearance_mm": choose.choice([0.0, 5.0]),
        "places": [
            {
                "id": place,
                "x_mm": choose.uniform(0.0, side_mm) + (400.0 if kind == "buffer" else 0.0),
                "y_mm": choose.uniform(0.0, side_mm),
                "kind": kind,
                "reachable": choose.random() >= far,
            }
            for place, kind in enumerate(kinds)
        ],
        "objects": [
            {"id": item, "height_mm": choose.choice([30.0, 32.0, 36.0, 50.0]), "start": start, **_shape(choose)}
            for item, start in enumerate(starts)
        ],
        "gripper": _gripper(choose),
        "obstacles": [
            {"x_mm": choose.uniform(0.0, side_mm), "y_mm": choose.uniform(0.0, side_mm), **_shape(choose)}
            for _ in range(choose.choice([0, 0, 1, 2]))
        ],
        "goal": goal,
    }


def _moves(problem: Problem, stands: tuple[int, ...]) -> Iterator[tuple[tuple[int, ...], Move]]:
    """Yield every move that the validator lets pass, with what stands where after it."""
    moved = zip(problem.objects, stands, strict=True)
    here = replace(problem, objects=tuple(replace(item, start=place) for item, place in moved))
    for item, origin in enumerate(stands):
        for target in range(len(problem.places)):
            move = Move(item, origin, target)
            if not any(reason.startswith("move 1") for reason in validate(here, [move])):
                yield (*stands[:item], target, *stands[item + 1 :]), move


def _is_goal(problem: Problem, stands: tuple[int, ...]) -> bool:
    moved = zip(problem.objects, stands, strict=True)
    return not validate(replace(problem, objects=tuple(replace(item, start=place) for item, place in moved)), [])


def brute_force(problem: Problem) -> tuple[int, float] | None:
    """Return the fewest moves and the least travel of so many, layer by layer; None where there is no plan."""
    points = [(place.x_mm, place.y_mm) for place in problem.places]
    home = problem.home_mm
    start = tuple(item.start for item in problem.objects)
    if _is_goal(problem, start):
        return 0, 0.0
    # Per arrangement and place of the hand, the least way so far.
    layer = {start: {home: 0.0}}
    seen, depth = {start}, 0
    while layer:
        depth += 1
        following: dict[tuple[int, ...], dict[tuple[float, float], float]] = {}
        for stands, ways_mm in layer.items():
            for after, move in _moves(problem, stands):
                if after in seen:
                    continue
                pick, put = points[move.from_place], points[move.to_place]
                way_mm = min(so_far + math.dist(hand, pick) for hand, so_far in ways_mm.items()) + math.dist(pick, put)
                known = following.setdefault(after, {})
                known[put] = min(way_mm, known.get(put, math.inf))
        reached = [ways_mm for stands, ways_mm in following.items() if _is_goal(problem, stands)]
        if reached:
            return depth, min(way_mm + math.dist(hand, home) for ways in reached for hand, way_mm in ways.items())
        seen |= following.keys()
        layer = following
    return None


@pytest.mark.parametrize("seed", BRUTE_SEEDS)
def test_status_moves_and_travel_are_those_of_brute_force(seed: int) -> None:
    problem = Problem.from_mapping(random_problem(seed), "random")
    answer, truth = plan(problem), brute_force(problem)
    if truth is None:
        assert answer.status is PlanStatus.INFEASIBLE
        assert answer.reasons
        return
    moves, travel_mm = truth
    assert answer.status is PlanStatus.SOLVED
    assert len(answer.moves) == answer.bound_moves == moves
    assert answer.travel_mm == pytest.approx(travel_mm, abs=1e-6)
    assert validate(problem, answer.moves) == []


def test_what_stands_too_near_from_the_beginning_may_stay() -> None:
    data = wire_problem()
    data["places"][1]["x_mm"] = 105.0
    data["goal"] = {"type": "assign", "allowed": [[0], [1]], "must_fill": []}
    answer = plan(Problem.from_mapping(data, "overlap"))
    assert (answer.status, answer.moves) == (PlanStatus.SOLVED, ())


_VALUES: tuple[Any, ...] = (
    None,
    True,
    -1,
    0,
    10**30,
    float("nan"),
    float("inf"),
    "",
    "x",
    [],
    {},
    [[]],
    1e-320,
    1e6,
    3.7,
)


def _paths(data: object, before: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    keys = list(data) if isinstance(data, dict) else range(len(data)) if isinstance(data, list) else ()
    for key in keys:
        yield (*before, key)
        yield from _paths(data[key], (*before, key))  # type: ignore[index]


def _read(data: object) -> tuple[list[Problem], AlarmError | None]:
    try:
        return read_problems(data, "damaged.json"), None
    except AlarmError as error:
        return [], error


@pytest.mark.parametrize("seed", range(150))
def test_damaged_problems_are_planned_or_refused_with_the_field(seed: int) -> None:
    choose = random.Random(seed)  # noqa: S311 - reproducible, no secret
    data = copy.deepcopy(wire_problem() if seed % 2 else random_problem(seed))
    *way, key = choose.choice(list(_paths(data)))
    owner: Any = data
    for step in way:
        owner = owner[step]
    if choose.random() < 0.3:
        del owner[key]
    else:
        owner[key] = choose.choice(_VALUES)
    problems, refusal = _read(data)
    if refusal is not None:
        assert refusal.alarm is Alarm.PROBLEM_INVALID
        assert refusal.detail.startswith("damaged.json: ")
    for problem in problems:
        answer = plan(problem)
        assert answer.reasons or has_plan(answer)
        assert not has_plan(answer) or validate(problem, answer.moves) == []
        json.dumps([plan_to_json(problem, answer), explain(problem, answer), plan_svg(problem, answer.moves, "")])
