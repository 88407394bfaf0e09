"""Who alone makes a problem impossible: objects that cannot all end where they belong, whatever becomes of the others.

An object that is left out hinders nobody, so that what is impossible without some objects is so with them. Mostly two
are to blame. Otherwise objects are added one by one until it is impossible: the last one is to blame. So it goes on
with those before it, beside those to blame already, until the latter alone make it impossible.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import chain, combinations
from typing import TYPE_CHECKING

from srvs_cell.planning.ample_room import MOST_WITH_ROOM, clear_places, fewest_with_room
from srvs_cell.planning.clearance import conflict_table
from srvs_cell.planning.goals import goal_is_possible, goal_rule
from srvs_cell.planning.moves import fewest_moves
from srvs_cell.planning.problem import AssignGoal

if TYPE_CHECKING:
    from collections.abc import Collection

    from srvs_cell.planning.clearance import ConflictTable
    from srvs_cell.planning.problem import Problem

MOST_MOVES_TRIED = 20_000
_MOST_FOR_CULPRITS = 5_000
"""Reasons should be cheap."""

_GREEDY_WEIGHT = 2.0
"""That there is a plan is all that is asked; that there is none, a greedy search proves as well."""


def is_possible(
    problem: Problem, max_moves_search: int = MOST_MOVES_TRIED, table: ConflictTable | None = None
) -> bool | None:
    """Tell whether a problem has a plan; None where the search ends at its cap."""
    start = tuple(item.start for item in problem.objects)
    table, rule = table or conflict_table(problem), goal_rule(problem)
    if not goal_is_possible(start, table, rule):
        return False
    if len(start) <= MOST_WITH_ROOM:
        anywhere = fewest_with_room(start, table, rule, len(start), max_moves_search)
        if anywhere.proven and anywhere.steps is None:
            return False
        room = len(clear_places(start, table, rule))
        if fewest_with_room(start, table, rule, room, max_moves_search).steps is not None:
            return True
    found = fewest_moves(start, table, rule, max_moves_search, weight=_GREEDY_WEIGHT)
    if found.steps is not None:
        return True
    return False if found.proven else None


def only(problem: Problem, items: Collection[int]) -> Problem:
    """Return the problem with some of its objects; each of them may end where it might before."""
    allowed = goal_rule(problem).allowed
    kept = [item for item in problem.objects if item.id in items]
    goals = tuple(frozenset(place.id for place in problem.places if allowed[item.id] >> place.id & 1) for item in kept)
    return replace(
        problem,
        objects=tuple(replace(item, id=number) for number, item in enumerate(kept)),
        goal=AssignGoal(goals, frozenset()),
    )


def culprits(problem: Problem, suspects: Collection[int]) -> tuple[int, ...]:
    """Return objects among some that alone make the problem impossible; none where no search within its cap says so."""
    table = conflict_table(problem)

    def possible(items: Collection[int]) -> bool | None:
        return is_possible(only(problem, items), _MOST_FOR_CULPRITS, table.of(sorted(items)))

    def impossible(items: Collection[int]) -> bool:
        return possible(items) is False

    for group in chain(combinations(sorted(suspects), 1), combinations(sorted(suspects), 2)):
        if impossible(group):
            return group
    everybody = set(suspects)
    needed = {item for item in everybody if possible(everybody - {item})}
    # Without whom it is possible is certainly to blame.
    left = sorted(everybody, key=lambda item: (item not in needed, item))
    blamed: list[int] = []
    while not blamed or not impossible(blamed):
        count = next((n for n in range(1, len(left) + 1) if impossible({*blamed, *left[:n]})), 0)
        if not count:
            return ()
        # Without the last one it may be possible: that one is to blame, and besides only some of those before it.
        left, last = left[: count - 1], left[count - 1]
        blamed.append(last)
    return tuple(sorted(blamed))
