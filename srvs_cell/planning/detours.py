"""Short travel for many objects: nested detours of the hole (references/planning.md section 3).

With nothing in the way and one free place, a plan is a closed walk of the *hole*: each move brings the object from the
next place of the walk to the place where the hole stands. A plan with the fewest moves is a set of nested detours:
wherever the hole stands, it may run once round a whole unfinished cycle and come back. Opening one cycle in the hole of
another saves the way to the free place, which is then visited once. The walk is built by cheapest insertion and
improved by taking one or two cycles out and inserting them again. The result is good, not proven.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from srvs_cell.planning.travel import HOME

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from srvs_cell.planning.moves import Arrangement, Step
    from srvs_cell.planning.travel import Distances

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_GAIN_MM = 1e-9

_MOST_CYCLES_IN_PAIRS = 12
"""With more cycles only one is taken out at a time: pairs cost the square."""

_MOST_FIRST_MOVERS = 16
"""With more displaced objects the walk is built once only."""

_UNWINDING = HOME
"""Cycle number of the walk's own tokens: home, free place, home."""


@dataclass(frozen=True)
class _Walk:
    """The places of the hole's walk, from `HOME` to `HOME`, and per place the cycle whose detour leads there."""

    places: Indices
    cycles: Indices


@dataclass(frozen=True)
class _Entries:
    """Every way to run round every cycle: one row for each place at which a cycle may be entered.

    Attributes:
        cycle: number of the cycle.
        first, second, last_but_one, last: places in the order of the round.
        inner_mm: what the round costs wherever it is inserted.
    """

    cycle: Indices
    first: Indices
    second: Indices
    last_but_one: Indices
    last: Indices
    inner_mm: Array

    def of(self, numbers: Iterable[int]) -> _Entries:
        """Return the rows of some cycles only."""
        rows = np.isin(self.cycle, list(numbers))
        return _Entries(*(column[rows] for column in vars(self).values()))


def nested_detours(start: Arrangement, target: Arrangement, free: Iterable[int], legs: Distances) -> tuple[Step, ...]:
    """Return a plan with the fewest moves from start to target, with short travel.

    Args:
        start: place per object; nothing may be in the way of any move to a free place.
        target: place per object, the same places in another order.
        free: places that are empty; each is tried as the hole's home.
        legs: distances.
    """
    rounds = cycles_between(start, target)
    if not rounds:
        return ()
    builder = _Builder(rounds, legs, start)
    walks = [builder.improved(walk) for place in free for walk in builder.built(place)]
    best = min(walks, key=builder.length_mm)
    return steps_of_walk(best.places[1:-1].tolist(), start)


def cycles_between(start: Arrangement, target: Arrangement) -> list[tuple[int, ...]]:
    """Return the cycles of the places: behind each place the place from which its object comes."""
    comes_from = {end: begin for begin, end in zip(start, target, strict=True) if begin != end}
    cycles = []
    while comes_from:
        first = min(comes_from)
        places = [first]
        following = comes_from.pop(first)
        while following != first:
            places.append(following)
            following = comes_from.pop(following)
        cycles.append(tuple(places))
    return cycles


def steps_of_walk(places: Sequence[int], start: Arrangement) -> tuple[Step, ...]:
    """Return the moves of a hole's walk: each brings the object of the next place to where the hole stands."""
    holds = {place: item for item, place in enumerate(start)}
    steps: list[Step] = []
    for hole, origin in pairwise(places):
        item = holds.pop(origin)
        holds[hole] = item
        steps.append((item, origin, hole))
    return tuple(steps)


class _Builder:
    """Builds and improves walks over given cycles."""

    def __init__(self, cycles: list[tuple[int, ...]], legs: Distances, start: Arrangement) -> None:
        self._cycles = [np.array(places) for places in cycles]
        # One more row and column for home, which `HOME` = -1 indexes.
        count = len(legs.home_mm)
        self._mm = np.zeros((count + 1, count + 1))
        self._mm[:count, :count] = legs.between_mm
        self._mm[:count, count] = self._mm[count, :count] = legs.home_mm
        # A cycle's first mover is the only one of its objects that is moved twice.
        self._again_mm = np.zeros(count + 1)
        for item, place in enumerate(start):
            self._again_mm[place] = legs.handling_of_mm(item)
        columns = [[np.roll(places, -shift) for places in self._cycles] for shift in (0, 1, -2, -1)]
        first, second, last_but_one, last = (np.concatenate(parts) for parts in columns)
        number = np.repeat(np.arange(len(cycles)), [len(places) for places in cycles])
        step_mm = self._mm[first, second]
        skip_mm = self._mm[first, np.concatenate([np.roll(places, -2) for places in self._cycles])]
        round_mm = (np.bincount(number, step_mm) + np.bincount(number, skip_mm))[number]
        closing_mm = self._mm[last, first] + self._mm[last_but_one, first] + self._mm[last, second]
        self._entries = _Entries(
            number, first, second, last_but_one, last, round_mm - closing_mm + self._again_mm[first]
        )

    def length_mm(self, walk: _Walk) -> float:
        """Return the travel of a walk: loaded legs between neighbours, empty legs between next neighbours.

        What every object's only or last move costs besides its legs is the same for every walk and left out.
        """
        places = walk.places
        numbers, entered = np.unique(walk.cycles, return_index=True)
        again_mm = self._again_mm[places[entered[numbers != _UNWINDING]]].sum()
        return float(self._mm[places[1:-2], places[2:-1]].sum() + self._mm[places[:-2], places[2:]].sum() + again_mm)

    def built(self, free_place: int) -> list[_Walk]:
        """Return walks by cheapest insertion: one, and while objects are few one for each that could move first."""
        bare = _Walk(np.array([HOME, free_place, HOME]), np.full(3, _UNWINDING))
        numbers = range(len(self._cycles))
        walks = [self._with_cheapest(bare, numbers)]
        if len(self._entries.cycle) > _MOST_FIRST_MOVERS:
            return walks
        for row, number in enumerate(self._entries.cycle.tolist()):
            opened = self._with_detour(bare, 1, self._entries, row)
            walks.append(self._with_cheapest(opened, [other for other in numbers if other != number]))
        return walks

    def improved(self, walk: _Walk) -> _Walk:
        """Take cycles out, with all that is nested in them, and insert them again, as long as that helps."""
        numbers = range(len(self._cycles))
        groups: list[tuple[int, ...]] = [(number,) for number in numbers]
        if len(numbers) <= _MOST_CYCLES_IN_PAIRS:
            groups += combinations(numbers, 2)
        length_mm = self.length_mm(walk)
        tried_in_vain = 0
        while tried_in_vain < len(groups):
            group = groups[0]
            groups = [*groups[1:], group]
            rest = walk
            for number in group:
                rest = _without(rest, number)
            again = self._with_cheapest(rest, set(numbers).difference(rest.cycles.tolist()))
            again_mm = self.length_mm(again)
            tried_in_vain += 1
            if again_mm < length_mm - _GAIN_MM:
                walk, length_mm, tried_in_vain = again, again_mm, 0
        return walk

    def _insertion_mm(self, places: Indices, indices: Indices, entries: _Entries) -> Array:
        """Return [entry, index] = what a detour costs where the hole stands at ``places[index]``."""
        mm = self._mm
        hole, before, behind = places[indices], places[indices - 1], places[indices + 1]
        column = (entries.first[:, None], entries.second[:, None], entries.last_but_one[:, None], entries.last[:, None])
        first, second, last_but_one, last = column
        hole_mm = mm[first, hole] + mm[last, hole] + mm[second, hole] + mm[last_but_one, hole]
        outer_mm = mm[first, before] + mm[last, behind] - mm[before, behind]
        cost_mm: Array = hole_mm + outer_mm + entries.inner_mm[:, None]
        return cost_mm

    def _with_cheapest(self, walk: _Walk, numbers: Iterable[int]) -> _Walk:
        """Insert cycles, the cheapest insertion first; only the costs that an insertion changes are computed again."""
        entries = self._entries.of(numbers)
        cost_mm = self._insertion_mm(walk.places, np.arange(1, len(walk.places) - 1), entries)
        while len(entries.cycle):
            row, column = divmod(int(cost_mm.argmin()), cost_mm.shape[1])
            number, index = int(entries.cycle[row]), column + 1
            walk = self._with_detour(walk, index, entries, row)
            kept = entries.cycle != number
            entries = _Entries(*(values[kept] for values in vars(entries).values()))
            fresh = np.arange(index, index + len(self._cycles[number]) + 2)
            fresh_mm = self._insertion_mm(walk.places, fresh, entries)
            cost_mm = np.concatenate([cost_mm[kept, :column], fresh_mm, cost_mm[kept, column + 1 :]], axis=1)
        return walk

    def _with_detour(self, walk: _Walk, index: int, entries: _Entries, row: int) -> _Walk:
        """Insert the detour of an entry where the hole stands at ``places[index]``."""
        number = int(entries.cycle[row])
        cycle = self._cycles[number]
        turn = int(np.flatnonzero(cycle == entries.first[row])[0])
        around = np.concatenate([cycle[turn:], cycle[:turn], walk.places[index : index + 1]])
        return _Walk(
            np.concatenate([walk.places[: index + 1], around, walk.places[index + 1 :]]),
            np.concatenate([walk.cycles[: index + 1], np.full(len(around), number), walk.cycles[index + 1 :]]),
        )


def _without(walk: _Walk, number: int) -> _Walk:
    """Take out the detour of a cycle, with all that is nested in it."""
    inside = np.flatnonzero(walk.cycles == number)
    if not len(inside):
        return walk
    rest = np.r_[: inside[0], inside[-1] + 1 : len(walk.cycles)]
    return _Walk(walk.places[rest], walk.cycles[rest])
