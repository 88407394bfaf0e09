"""Fewest moves: A* over arrangements with unit cost.

An arrangement is a tuple: the place of each object. The heuristic is the goal rule's closed-form lower bound, which is
the exact distance of the same problem without conflicts and with room enough, hence consistent: an arrangement is
expanded once, with its least number of moves.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import TYPE_CHECKING

from srvs_cell.planning.goals import OUTSIDE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srvs_cell.planning.clearance import ConflictTable
    from srvs_cell.planning.goals import GoalRule

Arrangement = tuple[int, ...]
Step = tuple[int, int, int]
"""(object, from place, to place)."""


def possible_moves(arrangement: Arrangement, table: ConflictTable) -> Iterator[Step]:
    """Yield every move that an arrangement allows: pick and place free, and one grip free at both."""
    standing = table.standing(arrangement)
    filled = 0
    for place in arrangement:
        filled |= 1 << place
    filled &= table.single
    for item, origin in enumerate(arrangement):
        if not table.pickable[origin]:
            continue
        grip_masks = table.grip_blocked_by[item]
        grips = [grip for grip, mask in enumerate(grip_masks[origin]) if not mask & standing]
        if not grips:
            continue
        standable = table.standable[item]
        blocked_by = table.blocked_by[item]
        for target in range(table.place_count):
            if target == origin or filled >> target & 1 or not standable[target] or blocked_by[target] & standing:
                continue
            masks = grip_masks[target]
            if any(not masks[grip] & standing for grip in grips):
                yield item, origin, target


def free_grips(arrangement: Arrangement, step: Step, table: ConflictTable) -> list[int]:
    """Return the grips that are free where a move takes its object and where it leaves it."""
    item, origin, target = step
    standing = table.standing(arrangement)
    at_origin, at_target = table.grip_blocked_by[item][origin], table.grip_blocked_by[item][target]
    return [
        grip
        for grip, masks in enumerate(zip(at_origin, at_target, strict=True))
        if not (masks[0] | masks[1]) & standing
    ]


def after(arrangement: Arrangement, step: Step) -> Arrangement:
    """Return the arrangement after a move."""
    item, _, target = step
    return (*arrangement[:item], target, *arrangement[item + 1 :])


@dataclass(frozen=True)
class MoveSearch:
    """What the search for the fewest moves found.

    Attributes:
        steps: a plan, or None.
        proven: the plan has the fewest moves, or (without a plan) there is none.
        bound: proven lower bound on the number of moves.
        explored: least number of moves found to every arrangement seen.
    """

    steps: tuple[Step, ...] | None
    proven: bool
    bound: int
    explored: dict[Arrangement, int]


def fewest_moves(
    start: Arrangement,
    table: ConflictTable,
    rule: GoalRule,
    max_moves_search: int,
    weight: float = 1.0,
    *,
    at_most_twice: bool = False,
) -> MoveSearch:
    """Search for a plan with the fewest moves.

    Args:
        start: place per object.
        table: conflicts.
        rule: goal.
        max_moves_search: give up after this many moves were tried.
        weight: 1 proves the fewest moves; above 1 the search is greedier and proves nothing but that there is no plan.
        at_most_twice: look only at plans in which each object goes where it ends at once, or waits in one other place:
            few arrangements, and mostly the fewest moves; what is found proves nothing of other plans.

    Returns:
        the plan, or that there is none (every reachable arrangement was seen), or neither where the cap was hit.
    """
    first_bound = rule.lower_bound(start)
    least = {start: 0}
    came_from: dict[Arrangement, tuple[Arrangement, Step]] = {}
    # Deeper arrangements first among equals: the way to the goal is then followed at once.
    queue: list[tuple[float, int, Arrangement]] = [(weight * first_bound, 0, start)]
    closed: set[Arrangement] = set()
    bound = first_bound
    tried = 0
    while queue:
        estimate, minus_moves, arrangement = heapq.heappop(queue)
        if arrangement in closed:
            continue
        if weight == 1.0:
            bound = max(bound, int(estimate))
        if rule.is_reached(arrangement):
            return MoveSearch(way_to(arrangement, came_from), weight == 1.0, bound, least)
        if tried >= max_moves_search:
            return MoveSearch(None, proven=False, bound=bound, explored=least)
        closed.add(arrangement)
        moves = 1 - minus_moves
        for step in possible_moves(arrangement, table):
            if at_most_twice and not _leads_on(step, start, rule):
                continue
            tried += 1
            successor = after(arrangement, step)
            if moves < least.get(successor, moves + 1):
                least[successor] = moves
                came_from[successor] = (arrangement, step)
                heapq.heappush(queue, (moves + weight * rule.lower_bound(successor), -moves, successor))
    return MoveSearch(None, proven=True, bound=bound, explored=least)


def _leads_on(step: Step, start: Arrangement, rule: GoalRule) -> bool:
    """Tell whether a move is its object's first one, or its second to where it ends."""
    item, origin, target = step
    allowed = rule.allowed[item]
    if allowed >> target & 1:
        return origin == start[item] or not allowed >> origin & 1
    return origin == start[item] and rule.class_of_place[target] == OUTSIDE


def way_to(arrangement: Arrangement, came_from: dict[Arrangement, tuple[Arrangement, Step]]) -> tuple[Step, ...]:
    """Return the moves that led to an arrangement."""
    steps: list[Step] = []
    while arrangement in came_from:
        arrangement, step = came_from[arrangement]
        steps.append(step)
    return tuple(reversed(steps))
