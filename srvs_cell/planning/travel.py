"""Least travel among the plans with the fewest moves: A* over (arrangement, hand position).

Only moves are followed after which the goal is still within reach of the moves that remain, so that every plan found
has the fewest moves; among those, the estimate (travel so far + lower bound of the rest) leads to the least travel.
The lower bound: each misplaced object is carried at least to its nearest goal, and each pick needs an empty leg to it
from some other place. When the cap is hit, the least estimate in the queue is a proven bound.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count
from typing import TYPE_CHECKING, NamedTuple

from srvs_cell.planning.moves import Arrangement, Step, after, possible_moves

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srvs_cell.planning.clearance import ConflictTable
    from srvs_cell.planning.goals import GoalRule
    from srvs_cell.planning.problem import Problem

HOME = -1


@dataclass(frozen=True)
class Distances:
    """What legs cost: straight distances, or times as the lengths that are gone in them at travel speed.

    Attributes:
        between_mm: from place to place.
        home_mm: from home (`HOME`) to each place.
        handling_mm: per object, what each of its moves costs besides its legs; empty: nothing.
        round_trips_mm: per object, from place to place, what a move costs from home and back to home, where the hand
            goes there after every move; empty: it goes from place to place.
    """

    between_mm: tuple[tuple[float, ...], ...]
    home_mm: tuple[float, ...]
    handling_mm: tuple[float, ...] = ()
    round_trips_mm: tuple[tuple[tuple[float, ...], ...], ...] = ()

    def handling_of_mm(self, item: int) -> float:
        """Return what each move of an object costs besides its legs."""
        return self.handling_mm[item] if self.handling_mm else 0.0

    def leg_mm(self, origin: int, target: int) -> float:
        """Return the length of the empty leg from a place or `HOME` to a place; round trips hold it already."""
        if self.round_trips_mm:
            return 0.0
        return self.home_mm[target] if origin == HOME else self.between_mm[origin][target]

    def move_mm(self, item: int, origin: int, target: int) -> float:
        """Return what a move costs without the empty leg to it."""
        loaded_mm = self.round_trips_mm[item] if self.round_trips_mm else self.between_mm
        return loaded_mm[origin][target] + self.handling_of_mm(item)

    def nearest_mm(self, place: int) -> float:
        """Return the shortest empty leg to a place from any other, or from home."""
        others = range(len(self.home_mm))
        return min(self.leg_mm(origin, place) for origin in (HOME, *others) if origin != place)

    def way_home_mm(self, hand: int) -> float:
        """Return the length of the last leg."""
        return 0.0 if hand == HOME or self.round_trips_mm else self.home_mm[hand]

    @property
    def shortest_home_mm(self) -> float:
        """The shortest last leg from any place."""
        return min(self.way_home_mm(place) for place in range(len(self.home_mm)))


def distances(problem: Problem) -> Distances:
    """Compute the distances of a problem."""
    points = [(place.x_mm, place.y_mm) for place in problem.places]
    return Distances(
        tuple(tuple(math.dist(a, b) for b in points) for a in points),
        tuple(math.dist(problem.home_mm, point) for point in points),
    )


def travel_mm(steps: tuple[Step, ...], legs: Distances) -> float:
    """Return home -> pick -> place ... -> home of a plan; 0 without moves."""
    hand, total_mm = HOME, 0.0
    for item, origin, target in steps:
        total_mm += legs.leg_mm(hand, origin) + legs.move_mm(item, origin, target)
        hand = target
    return total_mm + legs.way_home_mm(hand)


@dataclass(frozen=True)
class TravelSearch:
    """What the search for the least travel found.

    Attributes:
        steps: the plan with the least travel, or None where the cap was hit first.
        bound_mm: proven lower bound on the travel of any plan with the fewest moves.
    """

    steps: tuple[Step, ...] | None
    bound_mm: float


def least_travel(
    start: Arrangement,
    moves: int,
    table: ConflictTable,
    rule: GoalRule,
    legs: Distances,
    max_looks: int,
    weight: float = 1.0,
) -> TravelSearch:
    """Search for the plan of exactly ``moves`` moves with the least travel.

    Args:
        start: place per object.
        moves: the fewest moves that reach the goal.
        table: conflicts.
        rule: goal.
        legs: distances.
        max_looks: cap on the number of moves that are looked at.
        weight: 1 proves the least travel; above 1 the search is greedier and its bound means nothing.
    """
    if moves == 0:
        return TravelSearch((), 0.0)
    successors = _Successors(moves, table, rule, legs)
    first = _Node(start, HOME, 0)
    cost_mm: dict[_Node, float] = {first: 0.0}
    came_from: dict[_Node, tuple[_Node, Step]] = {}
    closed: set[_Node] = set()
    order = count()
    bound_mm = successors.rest_mm(start, HOME)
    queue = [(weight * bound_mm, -next(order), first)]
    while queue:
        estimate_mm, _, node = heappop(queue)
        if node in closed:
            continue
        bound_mm = estimate_mm
        if node.depth == moves:
            return TravelSearch(_way_to(node, came_from), estimate_mm)
        if successors.looks > max_looks:
            break
        closed.add(node)
        so_far_mm = cost_mm[node]
        for step, successor in successors.of(node.arrangement, node.depth):
            item, pick, target = step
            hand = HOME if legs.round_trips_mm else target
            following = _Node(successor, hand, node.depth + 1)
            total_mm = so_far_mm + legs.leg_mm(node.hand, pick) + legs.move_mm(item, pick, target)
            if total_mm < cost_mm.get(following, math.inf):
                cost_mm[following] = total_mm
                came_from[following] = (node, step)
                rest_mm = successors.rest_mm(successor, hand)
                heappush(queue, (total_mm + weight * rest_mm, -next(order), following))
    return TravelSearch(None, bound_mm)


class _Node(NamedTuple):
    arrangement: Arrangement
    hand: int
    depth: int


def _way_to(node: _Node, came_from: dict[_Node, tuple[_Node, Step]]) -> tuple[Step, ...]:
    steps: list[Step] = []
    while node in came_from:
        node, step = came_from[node]
        steps.append(step)
    return tuple(reversed(steps))


class _Successors:
    """Moves that least-move plans may hold, and the lower bound of the travel that remains.

    Both are asked for once per hand position of an arrangement, and computed once; ``looks`` counts the moves tried.
    """

    def __init__(self, moves: int, table: ConflictTable, rule: GoalRule, legs: Distances) -> None:
        self._moves = moves
        self._table = table
        self._rule = rule
        places = range(table.place_count)
        self._nearest_mm = [legs.nearest_mm(place) for place in places]
        self._to_goal_mm = [
            [min((legs.move_mm(item, p, q) for q in places if mask >> q & 1), default=0.0) for p in places]
            for item, mask in enumerate(rule.allowed)
        ]
        self._legs = legs
        self._shortest_home_mm = legs.shortest_home_mm
        self.looks = 0
        self._known: dict[tuple[Arrangement, int], list[tuple[Step, Arrangement]]] = {}
        self._moves_left: dict[Arrangement, int] = {}
        self._rest_mm: dict[Arrangement, float] = {}

    def of(self, arrangement: Arrangement, depth: int) -> list[tuple[Step, Arrangement]]:
        """Return the moves from an arrangement after which the goal may still be reached in time."""
        key = (arrangement, depth)
        known = self._known.get(key)
        if known is None:
            known = self._known[key] = list(self._in_time(arrangement, depth))
        return known

    def _in_time(self, arrangement: Arrangement, depth: int) -> Iterator[tuple[Step, Arrangement]]:
        allowed = self._rule.allowed
        left = self._moves - depth - 1
        wrong = len(self._rule.misplaced(arrangement))
        for step in possible_moves(arrangement, self._table):
            self.looks += 1
            item, origin, target = step
            mask = allowed[item]
            # The number of misplaced objects alone rules most moves out; the closed form costs more.
            if wrong + (mask >> origin & 1) - (mask >> target & 1) > left:
                continue
            successor = after(arrangement, step)
            bound = self._moves_left.get(successor)
            if bound is None:
                bound = self._moves_left[successor] = self._rule.lower_bound(successor)
            if bound <= left:
                yield step, successor

    def rest_mm(self, arrangement: Arrangement, hand: int) -> float:
        """Return a lower bound on the travel from an arrangement with the hand at a place (or `HOME`).

        An object that was just put down may be picked up again without an empty leg.
        """
        known_mm = self._rest_mm.get(arrangement)
        if known_mm is None:
            known_mm = self._rest_mm[arrangement] = sum(
                self._nearest_mm[arrangement[item]] + self._to_goal_mm[item][arrangement[item]]
                for item in self._rule.misplaced(arrangement)
            )
        if hand == HOME:
            return known_mm + self._shortest_home_mm
        if self._rule.is_reached(arrangement):
            return self._legs.way_home_mm(hand)
        in_hand_place = any(
            place == hand and not self._rule.allowed[item] >> hand & 1 for item, place in enumerate(arrangement)
        )
        return known_mm + self._shortest_home_mm - (self._nearest_mm[hand] if in_hand_place else 0.0)
