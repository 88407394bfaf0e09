"""A plan in words: why so many moves, what happens to each object and why, what would make the impossible possible."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING

from srvs_cell.planning.clearance import conflict_table, outer_radius_mm
from srvs_cell.planning.culprits import is_possible
from srvs_cell.planning.goals import goal_rule
from srvs_cell.planning.moves import after
from srvs_cell.planning.problem import RankGoal
from srvs_cell.scene import Move, Place, PlaceKind, PlanStatus

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srvs_cell.planning.clearance import ConflictTable
    from srvs_cell.planning.problem import Problem
    from srvs_cell.scene import Point2, RelocationPlan

_MOST_PAIRS = 60
"""Pairs of changes that are tried where no single one helps; help should be cheap."""
_MOST_HELPFUL_PAIRS = 3

_A_PAIR = 2


def explain(problem: Problem, answer: RelocationPlan) -> tuple[str, ...]:
    """Explain an answer.

    Args:
        problem: the problem.
        answer: the planner's answer to it.

    Returns:
        lines: the number of moves; one for each object; for an infeasible problem its reasons, and single changes that
        make it solvable.
    """
    if answer.status is PlanStatus.INFEASIBLE:
        helpful = what_would_help(problem)
        lines = [f"it would help: {change}" for change in helpful]
        return tuple(lines or ["no change that was tried, and no two of them, make it solvable"])
    if not answer.moves and not answer.moves_proven and answer.status is PlanStatus.NOT_PROVEN:
        return ()
    return (_count(problem, answer), *_objects(problem, answer))


def _count(problem: Problem, answer: RelocationPlan) -> str:
    rule = goal_rule(problem)
    start = tuple(item.start for item in problem.objects)
    wrong = len(rule.misplaced(start))
    bound = rule.lower_bound(start)
    proof = "proven least" if answer.moves_proven else f"at least {answer.bound_moves} are needed"
    text = f"{len(answer.moves)} moves, {proof}: {wrong} stand wrongly"
    if bound > wrong:
        text += f", {bound - wrong} more where places are exchanged in a ring and somebody has to step out of it first"
    fills = _fills(problem, answer)
    if fills:
        text += f", {fills} more from a place where they might stay to one that must be filled"
    if len(answer.moves) > bound + fills:
        text += f", {len(answer.moves) - bound - fills} more because objects are in each other's way"
    return text


def _fills(problem: Problem, answer: RelocationPlan) -> int:
    """Return how many objects that stand where they may end go to a place that must be filled."""
    rule = goal_rule(problem)
    ends = {move.object: move.to_place for move in answer.moves}
    return sum(
        bool(rule.allowed[item] >> problem.objects[item].start & 1 and rule.must_fill >> end & 1)
        for item, end in ends.items()
        if end != problem.objects[item].start
    )


def _objects(problem: Problem, answer: RelocationPlan) -> Iterator[str]:
    """Yield a line for each object."""
    table, rule = conflict_table(problem), goal_rule(problem)
    arrangement = tuple(item.start for item in problem.objects)
    ways: dict[int, list[str]] = {item.id: [] for item in problem.objects}
    for number, move in enumerate(answer.moves, start=1):
        final = rule.allowed[move.object] >> move.to_place & 1
        why = "" if final else _why_not_at_once(problem, table, arrangement, move, rule.allowed[move.object])
        item = problem.objects[move.object]
        turn_deg = item.turn_deg(move.to_place) - item.turn_deg(move.from_place)
        turned = f", turned by {turn_deg:.0f} deg" if turn_deg else ""
        ways[move.object].append(f"move {number} to {_place(problem, move.to_place)}{turned}{why}")
        arrangement = after(arrangement, (move.object, move.from_place, move.to_place))
    for item in problem.objects:
        right = rule.allowed[item.id] >> item.start & 1
        steps = "; ".join(ways[item.id])
        if not steps:
            yield f"{item.name}: stays, it stands where it may end"
        elif right:
            ends = next(move.to_place for move in reversed(answer.moves) if move.object == item.id)
            filled = ends != item.start and rule.must_fill >> ends & 1
            why = "goes where a place must be filled" if filled else "makes room"
            yield f"{item.name}: stands where it may end, but {why}: {steps}"
        else:
            yield f"{item.name}: {steps}"


def _why_not_at_once(
    problem: Problem, table: ConflictTable, arrangement: tuple[int, ...], move: Move, allowed: int
) -> str:
    """Say who is in the way at an object's goals while it goes elsewhere."""
    names = []
    for other, place in enumerate(arrangement):
        if other == move.object:
            continue
        bit = table.bit(other, place)
        for goal in range(table.place_count):
            if not allowed >> goal & 1:
                continue
            grips = table.grip_blocked_by[move.object][goal]
            if place == goal or table.blocked_by[move.object][goal] & bit or any(mask & bit for mask in grips):
                names.append(problem.objects[other].name)
                break
    return f" for the time being: {', '.join(names)} in the way at its goal" if names else " to make room"


def what_would_help(problem: Problem) -> tuple[str, ...]:
    """Return single changes, each of which makes an infeasible problem solvable; a few pairs where none does.

    Tried are one more buffer place; each place that is out of reach, for all objects or for some, brought within it;
    each obstacle and each object taken away. Changes whose search ends at its cap are not named.
    """
    single = tuple(text for text, changed in _changes(problem) if is_possible(changed))
    return single or tuple(islice(_pairs(problem), _MOST_HELPFUL_PAIRS))


def _pairs(problem: Problem) -> Iterator[str]:
    """Yield pairs of changes that make a problem solvable."""
    tried: set[frozenset[str]] = set()
    for first, changed in _changes(problem):
        for second, changed_again in _changes(changed):
            pair = frozenset({first, second})
            if pair in tried or len(tried) >= _MOST_PAIRS:
                continue
            tried.add(pair)
            if is_possible(changed_again):
                yield "two more free buffer places" if first == second else f"{first} and {second}"


def _changes(problem: Problem) -> Iterator[tuple[str, Problem]]:
    reach = max((outer_radius_mm(item.footprint) for item in problem.objects), default=0.0)
    farthest = max((place.x_mm for place in problem.places), default=0.0)
    farthest = max([farthest, *(o.x_mm + outer_radius_mm(o.footprint) for o in problem.obstacles)])
    grips = [abs(grip.inner_mm) + grip.thick_mm + grip.width_mm for item in problem.objects for grip in item.grips]
    beside_mm = farthest + 4.0 * (reach + max(grips, default=0.0) + problem.clearance_mm)
    spare = Place(len(problem.places), beside_mm, 0.0, PlaceKind.BUFFER)
    yield "one more free buffer place", replace(problem, places=(*problem.places, spare))
    for place in problem.places:
        if not place.reachable:
            within = tuple(replace(p, reachable=True) if p.id == place.id else p for p in problem.places)
            yield f"{_place(problem, place.id)} within reach", replace(problem, places=within)
    for number, obstacle in enumerate(problem.obstacles):
        rest = (*problem.obstacles[:number], *problem.obstacles[number + 1 :])
        text = f"the obstacle at ({obstacle.x_mm:.1f}, {obstacle.y_mm:.1f}) taken away"
        yield text, replace(problem, obstacles=rest)
    limits = {number: reason for item in problem.objects for number, reason in item.blocked}
    for number, reason in sorted(limits.items()):
        freed = tuple(
            replace(item, blocked=tuple(entry for entry in item.blocked if entry[0] != number))
            for item in problem.objects
        )
        yield f"{_place(problem, number)} free of what blocks it ({reason})", replace(problem, objects=freed)
    # Of two, one that is left alone is always in order.
    if len(problem.objects) > _A_PAIR:
        for item in problem.objects:
            yield f"{item.name} taken off the table", _without(problem, item.id)


def _without(problem: Problem, gone: int) -> Problem:
    """Return the problem without an object; in an order of height its place, or else the last one, is given up."""
    rest = tuple(item for item in problem.objects if item.id != gone)
    goal = problem.goal
    if isinstance(goal, RankGoal):
        point = _point(problem, problem.objects[gone].start)
        given_up = next((slot for slot in goal.slots if _point(problem, slot) == point), goal.slots[-1])
        goal = replace(goal, slots=tuple(slot for slot in goal.slots if slot != given_up))
    else:
        goal = replace(goal, allowed=tuple(goal.allowed[item.id] for item in rest))
    return replace(problem, objects=tuple(replace(item, id=i) for i, item in enumerate(rest)), goal=goal)


def _point(problem: Problem, place: int) -> Point2:
    return problem.places[place].x_mm, problem.places[place].y_mm


def _place(problem: Problem, place: int) -> str:
    spot = problem.places[place]
    return f"{spot.kind.value} {place} ({spot.x_mm:.1f}, {spot.y_mm:.1f})"
