"""Least travel with one free place and nothing in the way: A* over the walks of the hole.

The plans with the fewest moves are exactly the nested detours (references/planning.md section 3), so that the search
needs no arrangements: its state is which cycles were entered, which are still open and from where, and where hole and
hand are. The bound of `walk_bound` goes down move by move with what the move has used up.
"""

from __future__ import annotations

import math
from heapq import heappop, heappush
from itertools import count
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from srvs_cell.planning.walk_bound import HoleCosts


class _State(NamedTuple):
    """Where a walk stands.

    Attributes:
        entered: mask of the cycles that were entered.
        open_detours: per open cycle, the hole in which its first mover waits, and the place that this one came from.
        hole: the free place.
        hand: where the hand put the last object; home at first and last.
    """

    entered: int
    open_detours: tuple[tuple[int, int], ...]
    hole: int
    hand: int


class HoleWalk(NamedTuple):
    """The walk with the least travel, or None where the cap was hit, and a proven lower bound on the travel."""

    places: tuple[int, ...] | None
    bound_mm: float


def shortest_walk(costs: HoleCosts, most_mm: float, max_looks: int) -> HoleWalk:
    """Search for the hole's shortest walk.

    Args:
        costs: the cycles, distances and prices.
        most_mm: length of a walk that is known; longer ones are not followed.
        max_looks: cap on the number of moves that are looked at.

    Returns:
        the place ids from the free place through all cycles and back.
    """
    moves = _Moves(costs)
    first = _State(0, (), len(costs.places) - 1, len(costs.places))
    length_mm = {first: costs.once_mm}
    came_from: dict[_State, _State] = {}
    closed: set[_State] = set()
    order = count()
    queue = [(costs.bound_mm, 0, first, costs.bound_mm - costs.once_mm)]
    bound_mm, looks = costs.bound_mm, 0
    most_mm *= 1.0 + 1e-12
    while queue:
        estimate_mm, _, state, rest_mm = heappop(queue)
        if state in closed:
            continue
        bound_mm = max(bound_mm, estimate_mm)
        if moves.is_last(state):
            return HoleWalk(_holes(state, came_from, costs), length_mm[state])
        if looks >= max_looks:
            return HoleWalk(None, bound_mm)
        closed.add(state)
        so_far_mm = length_mm[state]
        for successor, move_mm, used_mm in moves.of(state):
            looks += 1
            total_mm = so_far_mm + move_mm
            left_mm = rest_mm - used_mm
            if total_mm + left_mm <= most_mm and total_mm < length_mm.get(successor, math.inf):
                length_mm[successor] = total_mm
                came_from[successor] = state
                # Later ones first among equals: the way to the end is then followed at once.
                heappush(queue, (total_mm + left_mm, -next(order), successor, left_mm))
    return HoleWalk(None, bound_mm)


class _Moves:
    """The moves that lead on from a state, with their travel and with what of the bound they use up."""

    def __init__(self, costs: HoleCosts) -> None:
        self._between = costs.between_mm.tolist()
        self._pick: list[float] = costs.pick_mm.tolist()
        self._put: list[float] = costs.put_mm.tolist()
        self._opening: list[float] = costs.opening_mm.tolist()
        self._again: list[float] = costs.again_mm.tolist()
        self._least_again: list[float] = costs.least_again_mm.tolist()
        self._along_mm = costs.along_mm
        self._cycles = costs.cycles
        self._comes_from, self._goes_to = costs.comes_from, costs.goes_to
        self._home = len(costs.places)
        self._all = (1 << len(costs.cycles)) - 1

    def is_last(self, state: _State) -> bool:
        """Tell whether everything stands right and the hand is home."""
        return state.entered == self._all and not state.open_detours and state.hand == self._home

    def of(self, state: _State) -> list[tuple[_State, float, float]]:
        """Return (successor, travel, what it uses up of the bound) of each move."""
        entered, open_detours, hole, hand = state
        between, pick, put = self._between, self._pick, self._put
        if entered == self._all and not open_detours:
            # What the bound holds besides, for legs along a cycle, is at most nothing here.
            home = _State(entered, (), hole, self._home)
            return [
                (home, between[hand][self._home], put[hand] + pick[self._home] - self._along_mm * self._turn(state))
            ]
        found = []
        to_pick, to_hole = between[hand], between[hole]
        if open_detours:
            waiting, entry = open_detours[-1]
            origin = self._comes_from[hole]
            still_open = open_detours
            if origin == entry:
                origin, still_open = waiting, open_detours[:-1]
            successor = _State(entered, still_open, origin, hole)
            used_mm = to_hole[origin] + put[hand] + pick[origin] + self._along(state, successor)
            found.append((successor, to_pick[origin] + to_hole[origin], used_mm))
        for number, cycle in enumerate(self._cycles):
            if entered >> number & 1:
                continue
            for entry in cycle:
                successor = _State(entered | 1 << number, (*open_detours, (hole, entry)), entry, hole)
                goal = self._goes_to[entry]
                used_mm = between[entry][goal] + self._opening[number] - to_hole[goal] - pick[hole] - put[hole]
                used_mm += put[hand] + pick[entry] + self._along(state, successor) + self._least_again[number]
                found.append((successor, to_pick[entry] + to_hole[entry] + self._again[entry], used_mm))
        return found

    def _along(self, state: _State, successor: _State) -> float:
        """Return what a move uses up of the price on legs along cycles.

        The legs that are certain to lead along a cycle: all that remain, less four for each cycle not yet entered,
        two for each one open, and one where the next leg is a detour's second or the one that leads out of it.
        """
        if self._along_mm == 0.0:
            return 0.0
        opened = successor.entered != state.entered
        closed = len(successor.open_detours) < len(state.open_detours)
        fewer = 1 - 2 * opened - 2 * closed + self._turn(successor) - self._turn(state)
        return self._along_mm * fewer

    def _turn(self, state: _State) -> int:
        """Return 1 where the next leg cannot lead along a cycle: the hole did not just move along one."""
        hand = state.hand
        on_cycle = hand < len(self._comes_from) and self._comes_from[hand] == state.hole
        return 0 if on_cycle or hand == self._home else 1


def _holes(state: _State, came_from: dict[_State, _State], costs: HoleCosts) -> tuple[int, ...]:
    # The last state differs from the one before by the way home only.
    state = came_from[state]
    places = [costs.places[state.hole]]
    while state in came_from:
        state = came_from[state]
        places.append(costs.places[state.hole])
    return tuple(reversed(places))
