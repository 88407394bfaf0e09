"""Least travel among the plans with the fewest moves: a layered dynamic programme over (arrangement, hand position).

Layer t holds the arrangements that are t moves from the start and can still reach the goal in the moves that remain.
Every prefix of a least-move plan is a shortest way, so that an arrangement belongs to one layer only. Going backwards,
the cost to go from (arrangement, hand) is the least of: empty leg to the object, loaded leg, cost to go from there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from srvs_cell.planning.moves import Arrangement, Step, after, possible_moves

if TYPE_CHECKING:
    from srvs_cell.planning.clearance import ConflictTable
    from srvs_cell.planning.goals import GoalRule
    from srvs_cell.planning.problem import Problem

HOME = -1


@dataclass(frozen=True)
class Distances:
    """Straight distances between places, and from home (`HOME`)."""

    between_mm: tuple[tuple[float, ...], ...]
    home_mm: tuple[float, ...]

    def leg_mm(self, origin: int, target: int) -> float:
        """Return the length of the leg from a place or `HOME` to a place."""
        return self.home_mm[target] if origin == HOME else self.between_mm[origin][target]


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
    for _, origin, target in steps:
        total_mm += legs.leg_mm(hand, origin) + legs.between_mm[origin][target]
        hand = target
    return total_mm + (0.0 if hand == HOME else legs.home_mm[hand])


@dataclass(frozen=True)
class _Edge:
    """A move of some plan with the fewest moves."""

    step: Step
    successor: Arrangement


Layer = dict[Arrangement, list[_Edge]]


def least_travel(
    start: Arrangement,
    moves: int,
    table: ConflictTable,
    rule: GoalRule,
    legs: Distances,
    max_edges: int,
) -> tuple[Step, ...] | None:
    """Return the plan of exactly ``moves`` moves with the least travel, or None where ``max_edges`` is exceeded.

    Args:
        start: place per object.
        moves: the fewest moves that reach the goal.
        table: conflicts.
        rule: goal.
        legs: distances.
        max_edges: cap on the number of moves between layers that are looked at.
    """
    layers = _layers(start, moves, table, rule, max_edges)
    if layers is None:
        return None
    to_go = _CostToGo(legs, layers)
    steps: list[Step] = []
    arrangement, hand = start, HOME
    for depth in range(moves):
        _, edge = to_go.best(depth, arrangement, hand)
        steps.append(edge.step)
        arrangement, hand = edge.successor, edge.step[2]
    return tuple(steps)


def _layers(start: Arrangement, moves: int, table: ConflictTable, rule: GoalRule, max_edges: int) -> list[Layer] | None:
    """Return per layer the arrangements of least-move plans with the moves that lead on; None above the cap."""
    layers: list[Layer] = [{start: []}]
    seen = {start}
    edges = 0
    for depth in range(moves):
        following: Layer = {}
        for arrangement, leads_on in layers[depth].items():
            for step in possible_moves(arrangement, table):
                edges += 1
                if edges > max_edges:
                    return None
                successor = after(arrangement, step)
                if successor not in following:
                    if successor in seen or depth + 1 + rule.lower_bound(successor) > moves:
                        continue
                    following[successor] = []
                leads_on.append(_Edge(step, successor))
        seen.update(following)
        layers.append(following)
    alive = {arrangement for arrangement in layers[moves] if rule.is_reached(arrangement)}
    for depth in range(moves - 1, -1, -1):
        kept: Layer = {}
        for arrangement, leads_on in layers[depth].items():
            useful = [edge for edge in leads_on if edge.successor in alive]
            if useful:
                kept[arrangement] = useful
        layers[depth] = kept
        alive = set(kept)
    return layers


class _CostToGo:
    """Cost to go with the hand at a place, computed once per (arrangement, hand)."""

    def __init__(self, legs: Distances, layers: list[Layer]) -> None:
        self._legs = legs
        self._layers = layers
        self._memo: dict[tuple[Arrangement, int], float] = {}
        self._pick_memo: dict[Arrangement, list[tuple[int, float, _Edge]]] = {}
        # Backwards, so that every value that a layer asks for is already there: no recursion over the depth.
        for depth in range(len(layers) - 2, 0, -1):
            for arrangement in layers[depth]:
                self._picks(depth, arrangement)

    def best(self, depth: int, arrangement: Arrangement, hand: int) -> tuple[float, _Edge]:
        """Return the least cost to go and the move that it begins with."""
        return min(
            (
                (self._legs.leg_mm(hand, pick) + rest_mm, edge)
                for pick, rest_mm, edge in self._picks(depth, arrangement)
            ),
            key=lambda choice: choice[0],
        )

    def _picks(self, depth: int, arrangement: Arrangement) -> list[tuple[int, float, _Edge]]:
        """Return per place to pick from: the least cost from the pick on, and its move."""
        known = self._pick_memo.get(arrangement)
        if known is not None:
            return known
        best: dict[int, tuple[float, _Edge]] = {}
        for edge in self._layers[depth][arrangement]:
            _, pick, target = edge.step
            cost_mm = self._legs.between_mm[pick][target] + self._cost(depth + 1, edge.successor, target)
            if pick not in best or cost_mm < best[pick][0]:
                best[pick] = (cost_mm, edge)
        picks = [(pick, cost_mm, edge) for pick, (cost_mm, edge) in best.items()]
        self._pick_memo[arrangement] = picks
        return picks

    def _cost(self, depth: int, arrangement: Arrangement, hand: int) -> float:
        if depth == len(self._layers) - 1:
            return self._legs.home_mm[hand]
        key = (arrangement, hand)
        cost_mm = self._memo.get(key)
        if cost_mm is None:
            cost_mm, _ = self.best(depth, arrangement, hand)
            self._memo[key] = cost_mm
        return cost_mm
