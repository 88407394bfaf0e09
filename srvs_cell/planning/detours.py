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

from srvs_cell.planning.travel import HOME

if TYPE_CHECKING:
    from collections.abc import Iterable

    from srvs_cell.planning.moves import Arrangement, Step
    from srvs_cell.planning.travel import Distances

_WALK = -1
"""Cycle number of the tokens that belong to no detour: home, free place, home."""

_GAIN_MM = 1e-9

_MOST_CYCLES_IN_PAIRS = 12
"""With more cycles only one is taken out at a time: pairs cost the square."""

_MOST_FIRST_MOVERS = 16
"""With more displaced objects the walk is built once only."""


@dataclass(frozen=True)
class _Token:
    """A place on the hole's walk and the cycle whose detour leads there."""

    place: int
    cycle: int


Walk = list[_Token]


@dataclass(frozen=True)
class _Cycle:
    """Places in the order in which the hole runs through them, and the lengths of the closed round."""

    places: tuple[int, ...]
    loaded_mm: float
    empty_mm: float


def nested_detours(start: Arrangement, target: Arrangement, free: Iterable[int], legs: Distances) -> tuple[Step, ...]:
    """Return a plan with the fewest moves from start to target, with short travel.

    Args:
        start: place per object; nothing may be in the way of any move to a free place.
        target: place per object, the same places in another order.
        free: places that are empty; each is tried as the hole's home.
        legs: distances.
    """
    cycles = [_cycle(places, legs) for places in _cycles(start, target)]
    if not cycles:
        return ()
    walks = [_improved(walk, cycles, legs) for place in free for walk in _built(place, cycles, legs)]
    best = min(walks, key=lambda walk: _length_mm(walk, legs))
    return _steps(best, start)


def _cycles(start: Arrangement, target: Arrangement) -> list[tuple[int, ...]]:
    """Return the cycles: behind each place the place from which its object comes."""
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


def _leg_mm(a: int, b: int, legs: Distances) -> float:
    if b == HOME:
        a, b = b, a
    return 0.0 if b == HOME else legs.leg_mm(a, b)


def _cycle(places: tuple[int, ...], legs: Distances) -> _Cycle:
    count = len(places)
    return _Cycle(
        places,
        sum(legs.between_mm[places[i]][places[(i + 1) % count]] for i in range(count)),
        sum(legs.between_mm[places[i]][places[(i + 2) % count]] for i in range(count)),
    )


def _insertion_mm(walk: Walk, index: int, cycle: _Cycle, entry: int, legs: Distances) -> float:
    """Return what a detour round a cycle costs where the hole stands at ``walk[index]``."""
    places, count = cycle.places, len(cycle.places)
    first, second = places[entry], places[(entry + 1) % count]
    last, last_but_one = places[entry - 1], places[entry - 2]
    hole, before, behind = walk[index].place, walk[index - 1].place, walk[index + 1].place
    between = legs.between_mm
    loaded_mm = cycle.loaded_mm - between[last][first] + between[hole][first] + between[last][hole]
    inner_mm = cycle.empty_mm - between[last_but_one][first] - between[last][second]
    joints_mm = between[hole][second] + between[last_but_one][hole]
    outer_mm = _leg_mm(before, first, legs) + _leg_mm(last, behind, legs) - _leg_mm(before, behind, legs)
    return loaded_mm + inner_mm + joints_mm + outer_mm


def _with_cheapest(walk: Walk, numbers: Iterable[int], cycles: list[_Cycle], legs: Distances) -> Walk:
    """Insert cycles, the cheapest insertion first."""
    waiting = set(numbers)
    while waiting:
        _, number, index, entry = min(
            (_insertion_mm(walk, index, cycles[number], entry, legs), number, index, entry)
            for number in waiting
            for index in range(1, len(walk) - 1)
            for entry in range(len(cycles[number].places))
        )
        walk = _with_detour(walk, index, number, cycles[number], entry)
        waiting.remove(number)
    return walk


def _with_detour(walk: Walk, index: int, number: int, cycle: _Cycle, entry: int) -> Walk:
    """Insert the detour round a cycle where the hole stands at ``walk[index]``."""
    around = (*cycle.places[entry:], *cycle.places[:entry], walk[index].place)
    return walk[: index + 1] + [_Token(place, number) for place in around] + walk[index + 1 :]


def _built(free_place: int, cycles: list[_Cycle], legs: Distances) -> list[Walk]:
    """Return walks by cheapest insertion: one, and while they are few one for each object that could be moved first."""
    bare = [_Token(HOME, _WALK), _Token(free_place, _WALK), _Token(HOME, _WALK)]
    numbers = range(len(cycles))
    walks = [_with_cheapest(bare, numbers, cycles, legs)]
    if sum(len(cycle.places) for cycle in cycles) > _MOST_FIRST_MOVERS:
        return walks
    for number in numbers:
        others = [other for other in numbers if other != number]
        for entry in range(len(cycles[number].places)):
            opened = _with_detour(bare, 1, number, cycles[number], entry)
            walks.append(_with_cheapest(opened, others, cycles, legs))
    return walks


def _without(walk: Walk, number: int) -> Walk:
    """Take out the detour of a cycle, with all that is nested in it."""
    inside = [index for index, token in enumerate(walk) if token.cycle == number]
    return walk[: inside[0]] + walk[inside[-1] + 1 :] if inside else walk


def _improved(walk: Walk, cycles: list[_Cycle], legs: Distances) -> Walk:
    numbers = range(len(cycles))
    groups: list[tuple[int, ...]] = [(number,) for number in numbers]
    if len(cycles) <= _MOST_CYCLES_IN_PAIRS:
        groups += combinations(numbers, 2)
    length_mm = _length_mm(walk, legs)
    improving = True
    while improving:
        improving = False
        for group in groups:
            rest = walk
            for number in group:
                rest = _without(rest, number)
            kept = {token.cycle for token in rest}
            again = _with_cheapest(rest, [number for number in numbers if number not in kept], cycles, legs)
            again_mm = _length_mm(again, legs)
            if again_mm < length_mm - _GAIN_MM:
                walk, length_mm, improving = again, again_mm, True
    return walk


def _length_mm(walk: Walk, legs: Distances) -> float:
    """Return the travel of a walk: loaded legs between neighbours, empty legs between next neighbours."""
    places = [token.place for token in walk]
    loaded_mm = sum(legs.between_mm[a][b] for a, b in pairwise(places[1:-1]))
    return loaded_mm + sum(_leg_mm(a, b, legs) for a, b in zip(places[:-2], places[2:], strict=True))


def _steps(walk: Walk, start: Arrangement) -> tuple[Step, ...]:
    holds = {place: item for item, place in enumerate(start)}
    steps: list[Step] = []
    places = [token.place for token in walk[1:-1]]
    for hole, origin in pairwise(places):
        item = holds.pop(origin)
        holds[hole] = item
        steps.append((item, origin, hole))
    return tuple(steps)
