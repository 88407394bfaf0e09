"""Why there is no plan, for each object that would have to move.

The first reason that is certain without a search is named; where only the search knows, those are named that alone make
the problem impossible.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.planning.clearance import NEVER, hand_solids, too_close
from srvs_cell.planning.culprits import culprits
from srvs_cell.scene import PlaceKind

if TYPE_CHECKING:
    from collections.abc import Sequence

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
    wrong = rule.misplaced(start)
    own = {item: _own_reason(problem, table, rule, explored, item) for item in wrong}
    at_a_loss = [item for item in wrong if not own[item]]
    if at_a_loss:
        to_blame = {item for item in wrong if own[item]}
        together = culprits(problem, {item.id for item in problem.objects} - to_blame)
        for item in at_a_loss:
            own[item] = _common_reason(problem, table, rule, item, together, to_blame.union(together))
    lines = [f"{problem.objects[item].name}: {reason}" for item, reason in own.items()]
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
    elif at_a_loss and explored is not None:
        with_room = any(table.place_count in arrangement for arrangement in explored)
        room = ", with a free place for whoever needs one" if with_room else ""
        lines.append(f"all {len(explored)} arrangements that can be reached were looked at{room}")
    return tuple(lines)


def _own_reason(
    problem: Problem, table: ConflictTable, rule: GoalRule, explored: dict[Arrangement, int] | None, item: int
) -> str:
    """Return why an object cannot get where it belongs whoever else is to blame, or an empty string."""
    origin = problem.objects[item].start
    here = _place(problem, origin)
    goals = _goals(problem, rule, item)
    goal_text = _places(problem, goals)
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
        return f"belongs on {goal_text}, where {_obstacles(problem, item, goals)} is in the way"
    if all(mask == NEVER for mask in table.grip_blocked_by[item][origin]):
        obstacles = _obstacles(problem, item, [origin], of_hand=True)
        return f"cannot be gripped on {here}: {obstacles} is in the way of the hand"
    if all(all(mask == NEVER for mask in table.grip_blocked_by[item][place]) for place in goals):
        obstacles = _obstacles(problem, item, goals, of_hand=True)
        return f"cannot be put down on {goal_text}: {obstacles} is in the way of the hand"
    neighbour = _goal_neighbour(problem, table, rule, item, goals)
    if neighbour is not None:
        return f"belongs on {goal_text}, where it does not fit beside {neighbour} on its own place"
    if explored is None:
        return ""
    if not _free_places(problem, table):
        return f"belongs on {goal_text}, but every place is taken and there is no free buffer place to begin with"
    fixed = {other for other in range(len(problem.objects)) if _never_moves(problem, other, explored)}
    fingers = _in_the_way_of_fingers(problem, table, item, origin, fixed)
    if fingers:
        return f"cannot be gripped on {here}: a finger hits {' and '.join(fingers)}"
    holder = next((other.id for other in problem.objects if other.start in goals and other.id in fixed), None)
    if len(goals) == 1 and holder is not None and holder != item:
        why = _why_fixed(problem, table, holder, fixed)
        return f"belongs on {goal_text}, taken by {problem.objects[holder].name}, which cannot leave{why}"
    return ""


def _common_reason(
    problem: Problem, table: ConflictTable, rule: GoalRule, item: int, together: tuple[int, ...], to_blame: set[int]
) -> str:
    """Return why an object cannot get where it belongs though nothing is in its own way.

    Args:
        problem: the problem.
        table: its conflicts.
        rule: its goal.
        item: the object.
        together: objects that alone make the problem impossible.
        to_blame: these, and the objects that have a reason of their own.
    """
    goals = _goals(problem, rule, item)
    goal_text = _places(problem, goals)
    if item not in together:
        who = f"see {_names(problem, sorted(to_blame))}" if to_blame else "the objects hinder each other"
        return f"belongs on {goal_text} and has no reason of its own; {who}"
    others = [other for other in together if other != item]
    if not others:
        return f"never gets to {goal_text}, even with all others taken away"
    hinder = _hinder(problem, table, rule, item, goals, others)
    detail = f" (in the way there: {_names(problem, hinder)})" if hinder and hinder != others else ""
    they = "they belong" if len(others) > 1 else "it belongs"
    return f"cannot end on {goal_text} with {_names(problem, others)} where {they}, whatever else is moved{detail}"


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
        return f": {_obstacles(problem, item, [start], of_hand=True)} is in the way of the hand"
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


def _hinder(
    problem: Problem, table: ConflictTable, rule: GoalRule, item: int, goals: list[int], others: list[int]
) -> list[int]:
    """Return who of some objects hinders the hand, or has no room beside an object, wherever both may end."""
    return [
        other
        for other in others
        if all(
            any(mask & bit for mask in (table.blocked_by[item][place], *table.grip_blocked_by[item][place]))
            for place in goals
            for bit in (table.bit(other, end) for end in _goals(problem, rule, other))
        )
    ]


def _obstacles(problem: Problem, item: int, places: list[int], *, of_hand: bool = False) -> str:
    """Name the obstacles that keep an object, or the hand on it, out of some places."""
    found = []
    for place in places:
        standing, point = problem.objects[item].at(place), problem.places[place]
        solids = [(standing.footprint, 0.0)]
        if of_hand:
            solids = [solid for grip in standing.grips if place not in grip.blocked for solid in hand_solids(grip)]
        for number, obstacle in enumerate(problem.obstacles):
            apart = np.array([[obstacle.x_mm - point.x_mm, obstacle.y_mm - point.y_mm]])
            clearance_mm = 0.0 if of_hand else problem.clearance_mm
            if any(
                obstacle.top_mm > bottom_mm and too_close(shape, obstacle.footprint, apart, clearance_mm)[0]
                for shape, bottom_mm in solids
            ):
                found.append(number)
    names = [f"({problem.obstacles[n].x_mm:.1f}, {problem.obstacles[n].y_mm:.1f})" for n in dict.fromkeys(found)]
    return f"the obstacle at {' or '.join(names)}" if names else "the limit of the arm's reach"


def _free_places(problem: Problem, table: ConflictTable) -> list[int]:
    taken = {item.start for item in problem.objects}
    return [
        place.id
        for place in problem.places
        if place.reachable and (place.id not in taken or not table.single >> place.id & 1)
    ]


def _goals(problem: Problem, rule: GoalRule, item: int) -> list[int]:
    return [place.id for place in problem.places if rule.allowed[item] >> place.id & 1]


def _names(problem: Problem, items: Sequence[int]) -> str:
    *first, last = [problem.objects[item].name for item in items]
    return f"{', '.join(first)} and {last}" if first else last


def _places(problem: Problem, places: Sequence[int]) -> str:
    return " or ".join(_place(problem, place) for place in places)


def _place(problem: Problem, place: int) -> str:
    point = problem.places[place]
    return f"place {place} ({point.x_mm:.1f}, {point.y_mm:.1f})"
