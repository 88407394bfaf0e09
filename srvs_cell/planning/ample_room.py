"""Fewest moves where free places are clear of everything: a small exact search, and what it proves for any other table.

A place that is clear never hinders anybody, whoever stands there. With one for everybody each object needs two moves at
most: from its start to a clear place, and from there to its goal. (Take any plan: whatever an object does between its
first pick and its last placement, waiting in a clear place instead is in nobody's way.) So it is at its start, waiting,
or where it ends, which is far less to look at than all arrangements, and clear places need not be told apart.

What holds with a clear place for everybody holds on every table: the number of moves is a lower bound, and where even
then there is no plan there is none at all. With as many waiting at once as there are clear places a plan of that length
is a plan with the fewest moves.
"""

from __future__ import annotations

import heapq
from dataclasses import replace
from typing import TYPE_CHECKING

from srvs_cell.planning.goals import OUTSIDE
from srvs_cell.planning.moves import MoveSearch, after, way_to

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srvs_cell.planning.clearance import ConflictTable
    from srvs_cell.planning.goals import GoalRule
    from srvs_cell.planning.moves import Arrangement, Step
    from srvs_cell.planning.travel import Distances

MOST_WITH_ROOM = 14
"""With more objects there is too much to look at even so."""


def clear_places(start: Arrangement, table: ConflictTable, rule: GoalRule) -> tuple[int, ...]:
    """Return the places where any object can wait, pick and put it who may, without being in anybody's way."""
    wanted = 0
    for mask in rule.allowed:
        wanted |= mask
    items = range(len(start))
    in_the_way = 0
    for item in items:
        for place in range(table.place_count):
            in_the_way |= table.blocked_by[item][place]
            for mask in table.grip_blocked_by[item][place]:
                if mask >= 0:
                    in_the_way |= mask
    return tuple(
        place
        for place in range(table.place_count)
        if table.pickable[place]
        and place not in start
        and not wanted >> place & 1
        and all(table.standable[item][place] and not table.blocked_by[item][place] for item in items)
        and not any(mask for item in items for mask in table.grip_blocked_by[item][place])
        and not any(in_the_way & table.bit(item, place) for item in items)
    )


def fewest_with_room(
    start: Arrangement, table: ConflictTable, rule: GoalRule, room: int, max_moves_search: int
) -> MoveSearch:
    """Search for the fewest moves with clear places for some objects at a time.

    Args:
        start: place per object.
        table: conflicts.
        rule: goal.
        room: how many may wait at once.
        max_moves_search: give up after this many moves were tried.

    Returns:
        the plan, in which the place ``table.place_count`` stands for any clear place; or that there is none; or neither
        where the cap was hit.
    """
    waiting = table.place_count
    rule = replace(rule, class_of_place=(*rule.class_of_place, OUTSIDE))
    first_bound = rule.lower_bound(start)
    least = {start: 0}
    came_from: dict[Arrangement, tuple[Arrangement, Step]] = {}
    queue: list[tuple[int, int, Arrangement]] = [(first_bound, 0, start)]
    closed: set[Arrangement] = set()
    bound, tried = first_bound, 0
    while queue:
        estimate, minus_moves, arrangement = heapq.heappop(queue)
        if arrangement in closed:
            continue
        bound = max(bound, estimate)
        if rule.is_reached(arrangement):
            return MoveSearch(way_to(arrangement, came_from), True, bound, least)
        if tried >= max_moves_search:
            return MoveSearch(None, proven=False, bound=bound, explored=least)
        closed.add(arrangement)
        moves = 1 - minus_moves
        for step in _moves(arrangement, start, table, rule, waiting, room):
            tried += 1
            successor = after(arrangement, step)
            if moves < least.get(successor, moves + 1):
                least[successor] = moves
                came_from[successor] = (arrangement, step)
                heapq.heappush(queue, (moves + rule.lower_bound(successor), -moves, successor))
    return MoveSearch(None, proven=True, bound=bound, explored=least)


def _moves(
    arrangement: Arrangement, start: Arrangement, table: ConflictTable, rule: GoalRule, waiting: int, room: int
) -> Iterator[Step]:
    """Yield the moves of objects that have not ended yet: to a place where they may end, or to wait."""
    # A bit that is nobody's: `NEVER` excludes a standing also where nobody stands.
    standing = 1 << len(arrangement) * table.place_count
    filled = held = 0
    for item, place in enumerate(arrangement):
        if place == waiting:
            held += 1
        else:
            standing |= table.bit(item, place)
            filled |= 1 << place
    filled &= table.single
    for item, origin in enumerate(arrangement):
        grip_masks = table.grip_blocked_by[item]
        if origin != waiting and (origin != start[item] or not table.pickable[origin]):
            continue
        at_origin = (0,) * len(grip_masks[0]) if origin == waiting else grip_masks[origin]
        grips = [grip for grip, mask in enumerate(at_origin) if not mask & standing]
        if not grips:
            continue
        if origin != waiting and held < room:
            yield item, origin, waiting
        standable, blocked_by = table.standable[item], table.blocked_by[item]
        targets = rule.allowed[item] & ~filled
        while targets:
            lowest = targets & -targets
            targets ^= lowest
            target = lowest.bit_length() - 1
            if target == origin or not standable[target] or blocked_by[target] & standing:
                continue
            if any(not grip_masks[target][grip] & standing for grip in grips):
                yield item, origin, target


def with_places(
    steps: tuple[Step, ...], start: Arrangement, clear: tuple[int, ...], table: ConflictTable, legs: Distances
) -> tuple[Step, ...]:
    """Return a plan of `fewest_with_room` with a clear place for each object that waits, the one that costs least."""
    waiting = table.place_count
    ends = {item: target for item, _, target in steps if target != waiting}
    free = set(clear)
    waits_at: dict[int, int] = {}
    placed: list[Step] = []
    for item, origin, target in steps:
        if target == waiting:
            to_place, to_end = legs.between_mm[start[item]], legs.between_mm[ends[item]]
            _, place = min((to_place[free_place] + to_end[free_place], free_place) for free_place in free)
            free.remove(place)
            waits_at[item] = place
            placed.append((item, origin, place))
        elif origin == waiting:
            place = waits_at.pop(item)
            free.add(place)
            placed.append((item, place, target))
        else:
            placed.append((item, origin, target))
    return tuple(placed)
