"""Why there is no plan, for each object that would have to move.

The first reason that is certain without a search is named; where only the search knows, the reason says what was never
seen in any arrangement that can be reached.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from srvs_cell.planning.clearance import NEVER
from srvs_cell.scene import PlaceKind

if TYPE_CHECKING:
    from collections.abc import Iterable

    from srvs_cell.planning.clearance import ConflictTable
    from srvs_cell.planning.goals import GoalRule
    from srvs_cell.planning.moves import Arrangement
    from srvs_cell.planning.problem import Problem


def infeasible_reasons(
    problem: Problem, table: ConflictTable, rule: GoalRule, explored: dict[Arrangement, int] | None
) -> tuple[str, ...]:
    """Return one line per object that stands wrongly, and per place that stays empty.

    Args:
        problem: the problem.
        table: its conflicts.
        rule: its goal.
        explored: every arrangement that can be reached from the start; None: no arrangement at all is a goal.
    """
    start = tuple(item.start for item in problem.objects)
    lines = [
        f"{problem.objects[item].name}: {_object_reason(problem, table, rule, explored, item)}"
        for item in rule.misplaced(start)
    ]
    filled = set(start)
    lines += [
        f"{_place(problem, place.id)} must be filled, but no sequence of moves fills it"
        for place in problem.places
        if rule.must_fill >> place.id & 1 and place.id not in filled
    ]
    if not lines and explored is None:
        lines = ["there is no arrangement that keeps the order of height and in which all have room"]
    elif not lines and explored is not None:
        lines = [
            f"{item.name}: the order of height is not kept, and none of the {len(explored)} arrangements "
            "that can be reached keeps it"
            for item in problem.objects
        ]
    return tuple(lines)


def _object_reason(
    problem: Problem, table: ConflictTable, rule: GoalRule, explored: dict[Arrangement, int] | None, item: int
) -> str:
    origin = problem.objects[item].start
    here = _place(problem, origin)
    goals = [place.id for place in problem.places if rule.allowed[item] >> place.id & 1]
    goal_text = " or ".join(_place(problem, place) for place in goals)
    if problem.places[origin].kind is PlaceKind.BIN:
        return f"stands in a bin ({here}), which is never picked from"
    if not problem.places[origin].reachable:
        return f"stands on {here}, which is out of reach"
    blocked = dict(problem.objects[item].blocked)
    if origin in blocked:
        return f"cannot be gripped on {here}: {blocked[origin]}"
    if not any(problem.places[place].reachable for place in goals):
        return f"belongs on {goal_text}, which is out of reach"
    if all(place in blocked for place in goals):
        causes = dict.fromkeys(blocked[place] for place in goals)
        return f"cannot be put down on {goal_text}: {' or '.join(causes)}"
    if not any(table.standable[item][place] for place in goals):
        return f"belongs on {goal_text}, where an obstacle is in the way"
    if all(mask == NEVER for mask in table.grip_blocked_by[item][origin]):
        return f"cannot be gripped on {here}: an obstacle is in the way of the fingers"
    if all(all(mask == NEVER for mask in table.grip_blocked_by[item][place]) for place in goals):
        return f"cannot be put down on {goal_text}: an obstacle is in the way of the fingers"
    neighbour = _goal_neighbour(problem, table, rule, item, goals)
    if neighbour is not None:
        return f"belongs on {goal_text}, where it does not fit beside {neighbour} on its own place"
    if explored is None:
        return f"belongs on {goal_text}; there is no arrangement in which all have room where they belong"
    if not _free_places(problem, table):
        return f"belongs on {goal_text}, but every place is taken and there is no free buffer place to begin with"
    seen = {arrangement[item] for arrangement in explored}
    looked = f"all {len(explored)} arrangements that can be reached were looked at"
    if any(table.place_count in arrangement for arrangement in explored):
        looked += ", with a free place for whoever needs one"
    fixed = {other for other in range(len(problem.objects)) if _never_moves(problem, other, explored)}
    fingers = _in_the_way_of_fingers(problem, table, item, origin, fixed)
    if fingers:
        return f"cannot be gripped on {here}: a finger hits {' and '.join(fingers)}"
    holder = next((other.id for other in problem.objects if other.start in goals and other.id in fixed), None)
    if len(goals) == 1 and holder is not None and holder != item:
        why = _why_fixed(problem, table, holder, fixed)
        return f"belongs on {goal_text}, taken by {problem.objects[holder].name}, which cannot leave{why}"
    blockers = _blockers(problem, table, item, [origin])
    if seen == {origin}:
        return f"can never leave {here}{blockers}; {looked}"
    if not seen & set(goals):
        blockers = _blockers(problem, table, item, goals)
        return f"never gets to {goal_text}{blockers}; {looked}"
    blockers = _goal_blockers(problem, table, rule, item, goals)
    return f"can get to {goal_text}, but never while the others stand where they belong{blockers}; {looked}"


def _never_moves(problem: Problem, item: int, explored: dict[Arrangement, int]) -> bool:
    start = problem.objects[item].start
    return all(arrangement[item] == start for arrangement in explored)


def _in_the_way_of_fingers(problem: Problem, table: ConflictTable, item: int, place: int, fixed: set[int]) -> list[str]:
    """Name the objects that cannot leave and of which one at least is in the way of every grip at a place."""
    standing = {other: table.bit(other, problem.objects[other].start) for other in fixed - {item}}
    grips = table.grip_blocked_by[item][place]
    if not all(any(mask & bit for bit in standing.values()) for mask in grips):
        return []
    return [problem.objects[o].name for o, bit in sorted(standing.items()) if any(mask & bit for mask in grips)]


def _why_fixed(problem: Problem, table: ConflictTable, item: int, fixed: set[int]) -> str:
    start = problem.objects[item].start
    if not problem.places[start].reachable:
        return ": out of reach"
    if start in (blocked := dict(problem.objects[item].blocked)):
        return f": {blocked[start]}"
    if all(mask == NEVER for mask in table.grip_blocked_by[item][start]):
        return ": an obstacle is in the way of the fingers"
    fingers = _in_the_way_of_fingers(problem, table, item, start, fixed)
    return f": a finger hits {' and '.join(fingers)}" if fingers else ""


def _goal_neighbour(problem: Problem, table: ConflictTable, rule: GoalRule, item: int, goals: list[int]) -> str | None:
    """Return the name of an object with one allowed place only that excludes this object from all of its own."""
    for other in problem.objects:
        mask = rule.allowed[other.id]
        if other.id == item or mask.bit_count() != 1:
            continue
        bit = table.bit(other.id, mask.bit_length() - 1)
        if all(table.blocked_by[item][place] & bit for place in goals):
            return other.name
    return None


def _goal_blockers(problem: Problem, table: ConflictTable, rule: GoalRule, item: int, goals: list[int]) -> str:
    """Name the objects that hinder the hand, or have no room beside the object, where they have to end."""
    names = []
    for other in problem.objects:
        ends = [table.bit(other.id, place) for place in range(table.place_count) if rule.allowed[other.id] >> place & 1]
        if other.id != item and all(
            any(mask & bit for mask in (table.blocked_by[item][place], *table.grip_blocked_by[item][place]))
            for place in goals
            for bit in ends
        ):
            names.append(other.name)
    return f" (in the way there: {', '.join(names)})" if names else ""


def _free_places(problem: Problem, table: ConflictTable) -> list[int]:
    taken = {item.start for item in problem.objects}
    return [
        place.id
        for place in problem.places
        if place.reachable and (place.id not in taken or not table.single >> place.id & 1)
    ]


def _blockers(problem: Problem, table: ConflictTable, item: int, places: Iterable[int]) -> str:
    """Name the objects that are too near, or in the way of the fingers, on the places where they stand now."""
    names = [
        other.name
        for other in problem.objects
        if other.id != item
        and any(
            mask != NEVER and mask & table.bit(other.id, other.start)
            for place in places
            for mask in (table.blocked_by[item][place], *table.grip_blocked_by[item][place])
        )
    ]
    return f" (in the way: {', '.join(names)})" if names else ""


def _place(problem: Problem, place: int) -> str:
    point = problem.places[place]
    return f"place {place} ({point.x_mm:.1f}, {point.y_mm:.1f})"
