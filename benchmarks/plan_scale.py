"""Planning at scale: the figures of the planner's aims, beside one cycle after another through the buffer.

    python -m benchmarks.plan_scale

Problems are random with fixed seeds; all times are the processor time of one process on one thread.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import random
import statistics
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from srvs_cell.planning import AssignGoal, Disc, Problem, ProblemObject, SearchLimits, plan, validate
from srvs_cell.planning.clearance import conflict_table
from srvs_cell.planning.detours import cycles_between, nested_detours, steps_of_walk
from srvs_cell.planning.goals import goal_rule
from srvs_cell.planning.moves import fewest_moves
from srvs_cell.planning.travel import HOME, distances, travel_mm
from srvs_cell.planning.walk_bound import hole_costs
from srvs_cell.scene import Move, Place, PlaceKind

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from srvs_cell.planning.moves import Step
    from srvs_cell.planning.travel import Distances

SEEDS = range(5)
TABLE_MM = 1000.0
RADIUS_MM = 20.0
_MOST_CYCLES_IN_EVERY_ORDER = 8


def main() -> None:
    """Print the tables."""
    fewest()
    exact_travel()
    detours()
    footprints()
    validation()


def permutation(count: int, seed: int, *, pairs: bool = False) -> Problem:
    """Return objects that change places: at random, or in pairs; one buffer place, nothing in the way."""
    choose = random.Random(seed)  # noqa: S311 - reproducible, no secret
    order = [item ^ 1 for item in range(count)] if pairs else choose.sample(range(count), count)
    points = [(choose.uniform(0, TABLE_MM), choose.uniform(0, TABLE_MM)) for _ in range(count + 1)]
    kinds = [PlaceKind.SLOT] * count + [PlaceKind.BUFFER]
    return Problem(
        id=f"{'pairs' if pairs else 'random'} {count} {seed}",
        places=tuple(Place(i, *point, kind) for i, (point, kind) in enumerate(zip(points, kinds, strict=True))),
        objects=tuple(ProblemObject(i, 20.0, Disc(1e-3), i, (), f"object {i}") for i in range(count)),
        obstacles=(),
        goal=AssignGoal(tuple(frozenset({place}) for place in order), frozenset()),
        home_mm=(TABLE_MM / 2, -200.0),
        clearance_mm=0.0,
    )


def crowded(count: int, seed: int, density: float = 0.4) -> Problem:
    """Return discs that cover a part of their table, own start and goal each, as many buffer places beside it."""
    choose = random.Random(seed)  # noqa: S311 - reproducible, no secret
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

    beside = [(-100.0 - 60.0 * (i // 20), 60.0 * (i % 20)) for i in range(count)]
    kinds = [PlaceKind.LOOSE] * count + [PlaceKind.SLOT] * count + [PlaceKind.BUFFER] * count
    points = [*layout(), *layout(), *beside]
    return Problem(
        id=f"crowded {count} {seed}",
        places=tuple(Place(i, *point, kind) for i, (point, kind) in enumerate(zip(points, kinds, strict=True))),
        objects=tuple(ProblemObject(i, 20.0, Disc(RADIUS_MM), i, (), f"object {i}") for i in range(count)),
        obstacles=(),
        goal=AssignGoal(tuple(frozenset({count + i}) for i in range(count)), frozenset()),
        home_mm=(side_mm / 2, -200.0),
        clearance_mm=0.0,
    )


def start_and_target(problem: Problem) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return place and goal per object."""
    target = goal_rule(problem).labelled
    if target is None:
        raise ValueError(problem.id)
    return tuple(item.start for item in problem.objects), target


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """Return what work gives, and its seconds."""
    began = time.process_time()
    result = work()
    return result, time.process_time() - began


def fewest() -> None:
    """Moves of every problem of the file, n up to 8, and of random permutations of 9."""
    print("fewest moves, ms (reading, conflicts, search)      problems   proven   median    worst")
    data = os.environ.get("SRVS_DATA")
    shared = Path(data).parent if data else Path(__file__).resolve().parents[2] / "shared"
    path = shared / "planning" / "problems.json"
    families: dict[str, list[Problem]] = {"perm n=9": [permutation(9, seed) for seed in range(20)]}
    if path.is_file():
        for instance in json.loads(path.read_text(encoding="utf-8"))["instances"]:
            families.setdefault(instance["family"], []).append(Problem.from_mapping(instance, instance["id"]))
    else:
        print(f"  left out, {path} is not there: the families of the problem file")
    for family, problems in families.items():
        found = [timed(lambda problem=problem: moves_only(problem)) for problem in problems]
        times_ms = [1e3 * seconds for _, seconds in found]
        print(
            f"  {family:48} {len(problems):8} {sum(proven for proven, _ in found):8} "
            f"{statistics.median(times_ms):8.1f} {max(times_ms):8.1f}",
            flush=True,
        )


def moves_only(problem: Problem) -> bool:
    """Search for the fewest moves; tell whether they, or that there is no plan, are proven."""
    start = tuple(item.start for item in problem.objects)
    return fewest_moves(start, conflict_table(problem), goal_rule(problem), 1_000_000).proven


def exact_travel() -> None:
    """Proven least travel of random permutations."""
    print("\nleast travel, random permutations, one buffer   proven   median s   worst s")
    for count in (9, 12, 15, 20):
        found = [timed(partial(plan, permutation(count, seed))) for seed in range(10)]
        times_s = [seconds for _, seconds in found]
        proven = sum(answer.travel_proven for answer, _ in found)
        print(f"  n = {count:3} {proven:36} / 10 {statistics.median(times_s):9.3f} {max(times_s):9.3f}", flush=True)


def detours() -> None:
    """Nested detours against one cycle after another, and against the bound."""
    print(
        "\nnested detours        median s   worst s   bound s   less travel than one-at-a-time   worse   gap to bound"
    )
    for count, pairs in itertools.product((50, 100, 200), (False, True)):
        times_s, bound_s, saved, gaps, worse = [], [], [], [], 0
        for seed in SEEDS:
            problem = permutation(count, seed, pairs=pairs)
            (start, target), legs = start_and_target(problem), distances(problem)
            steps, seconds = timed(lambda s=start, t=target, g=legs, n=count: nested_detours(s, t, [n], g))
            if validate(problem, [Move(*step) for step in steps]):
                raise ValueError(problem.id)
            cycles = cycles_between(start, target)
            costs, for_bound = timed(lambda c=cycles, n=count, g=legs, s=start: hole_costs(c, n, g, s))
            nested_mm = travel_mm(steps, legs)
            baseline_mm = travel_mm(one_after_another(cycles, count, start, legs), legs)
            times_s.append(seconds)
            bound_s.append(for_bound)
            saved.append(1.0 - nested_mm / baseline_mm)
            worse += nested_mm > baseline_mm + 1e-6
            gaps.append(nested_mm / costs.bound_mm - 1.0)
        print(
            f"  n = {count:3} {'2-cycles' if pairs else 'random':9} {statistics.median(times_s):10.3f} "
            f"{max(times_s):9.3f} {max(bound_s):9.3f} {statistics.mean(saved):30.1%} {worse:9} / {len(SEEDS)} "
            f"{statistics.mean(gaps):10.1%}",
            flush=True,
        )


def one_after_another(
    cycles: list[tuple[int, ...]], buffer: int, start: tuple[int, ...], legs: Distances
) -> tuple[Step, ...]:
    """Return the usual plan: each cycle through the buffer; best order and first movers where cycles are few.

    With many cycles: the nearest next cycle, entered where it is shortest.
    """

    def walk(order: Sequence[tuple[int, ...]]) -> list[int]:
        places = [buffer]
        for cycle in order:
            ways = [[*places, *cycle[i:], *cycle[:i], buffer] for i in range(len(cycle))]
            places = min(ways, key=length)
        return places

    def length(places: list[int]) -> float:
        return travel_mm(steps_of_walk(places, start), legs)

    if len(cycles) <= _MOST_CYCLES_IN_EVERY_ORDER // 2:
        return steps_of_walk(min((walk(order) for order in itertools.permutations(cycles)), key=length), start)
    waiting, order, hand = list(cycles), [], HOME
    while waiting:
        following = min(waiting, key=lambda cycle: min(legs.leg_mm(hand, place) for place in cycle))
        waiting.remove(following)
        order.append(following)
        hand = following[-1]
    return steps_of_walk(walk(order), start)


def footprints() -> None:
    """Fewest moves of crowded discs with buffer places outside."""
    print("\nfootprints, density 0.4, buffers outside   moves proven   median s   worst s   moves beyond n")
    for count in (20, 50, 100):
        found = [timed(partial(plan, crowded(count, seed))) for seed in SEEDS]
        for seed, (answer, _) in zip(SEEDS, found, strict=True):
            if validate(crowded(count, seed), answer.moves):
                raise ValueError(seed)
        times_s = [seconds for _, seconds in found]
        beyond = [len(answer.moves) - count for answer, _ in found]
        print(
            f"  n = {count:3} {sum(answer.moves_proven for answer, _ in found):40} / {len(SEEDS)} "
            f"{statistics.median(times_s):10.3f} {max(times_s):9.3f}   {beyond}",
            flush=True,
        )


def validation() -> None:
    """Time of a long plan, and damaged plans that are refused."""
    problem = permutation(667, 0, pairs=False)
    start, target = start_and_target(problem)
    walk = [667, *itertools.chain(*([*cycle, 667] for cycle in cycles_between(start, target)))]
    moves = [Move(*step) for step in steps_of_walk(walk, start)]
    shuttle = [Move(0, moves[-1].to_place, 667), Move(0, 667, moves[-1].to_place)]
    shuttle = [replace(move, object=moves[-1].object) for move in shuttle]
    moves += shuttle * ((1001 - len(moves)) // 2)
    refusal, seconds = timed(lambda: validate(problem, moves))
    print(f"\nvalidator: {len(moves)} moves of {len(start)} objects: {1e3 * seconds:.1f} ms, refused: {bool(refusal)}")
    choose = random.Random(1)  # noqa: S311 - reproducible, no secret
    refused = unharmed = 0
    problems = [permutation(8, seed) for seed in range(10)] + [crowded(12, seed) for seed in range(10)]
    plans = [list(plan(each, SearchLimits(max_travel_search=2000)).moves) for each in problems]
    for _ in range(1000):
        number = choose.randrange(len(problems))
        if damaged(problems[number], plans[number], choose) is None:
            unharmed += 1
            continue
        refused += 1
    print(f"validator: {refused} of 1000 damaged plans refused, {unharmed} accepted")


def damaged(problem: Problem, moves: list[Move], choose: random.Random) -> str | None:
    """Damage a plan in one of five ways; return the refusal, or None where it was accepted."""
    index = choose.randrange(len(moves))
    broken = list(moves)
    move = moves[index]
    kind = choose.randrange(5)
    if kind == 0:
        del broken[index]
    elif kind == 1:
        broken[index] = replace(move, object=(move.object + 1) % len(problem.objects))
    elif kind == 2:
        taken = {move.from_place, move.to_place}
        broken[index] = replace(move, from_place=choose.choice([p.id for p in problem.places if p.id not in taken]))
    elif kind == 3:
        broken.insert(index, move)
    else:
        # An object's last move ends somewhere else.
        last = max(i for i, other in enumerate(moves) if other.object == move.object)
        elsewhere = [p.id for p in problem.places if p.id != moves[last].to_place]
        broken[last] = replace(moves[last], to_place=choose.choice(elsewhere))
    reasons = validate(problem, broken)
    return reasons[0] if reasons else None


if __name__ == "__main__":
    main()
