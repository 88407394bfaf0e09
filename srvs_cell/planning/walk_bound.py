"""A proven lower bound on the travel of every walk of the hole (references/planning.md section 3).

Each empty leg leads from a place where an object was put down to a place where one is picked up. With a price on every
such end, chosen so that no leg's two prices exceed its length, the prices of all ends together are a lower bound: the
dual of the assignment problem, a small linear programme. Two more things are known of nested detours. A cycle's first
mover is carried to a hole of another cycle and back from there; and of the empty legs at most four for each cycle do
not lead on within the same cycle. The prices then serve the search too, which subtracts them one by one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array

if TYPE_CHECKING:
    from srvs_cell.planning.moves import Arrangement
    from srvs_cell.planning.travel import Distances

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_LEGS_PER_DETOUR = 4
"""Empty legs that a detour has besides those along its own cycle: into it, its second, its last but one, out of it."""

_NEAREST = 12
"""Neighbours of each place that the linear programme looks at; prices are then made right for all of them."""


@dataclass(frozen=True)
class HoleCosts:
    """The places that a walk of the hole meets, numbered anew, and what is known of every plan's travel.

    Places are those of the cycles, one cycle after another, then the free place; one more index is home.

    Attributes:
        places: id of each place.
        cycles: per cycle, its places; behind each place the place from which its object comes.
        between_mm: distances of shape (M + 1, M + 1), home last.
        comes_from, goes_to: per place of the cycles, where its object comes from, and where the one on it belongs.
        pick_mm, put_mm: prices of an empty leg's end and beginning at a place, or at home.
        along_mm: price on a leg that leads on within a cycle.
        opening_mm: per cycle, price of carrying its first mover to another cycle's hole instead of to its goal.
        again_mm: per place of the cycles, what it costs besides the legs to move the object there a second time.
        least_again_mm: per cycle, the least of them.
        once_mm: what it costs besides the legs to move every object once.
        bound_mm: lower bound on the travel of every plan with the fewest moves.
    """

    places: tuple[int, ...]
    cycles: tuple[tuple[int, ...], ...]
    between_mm: Array
    comes_from: tuple[int, ...]
    goes_to: tuple[int, ...]
    pick_mm: Array
    put_mm: Array
    along_mm: float
    opening_mm: Array
    again_mm: Array
    least_again_mm: Array
    once_mm: float
    bound_mm: float


def hole_costs(cycles: list[tuple[int, ...]], free_place: int, legs: Distances, start: Arrangement) -> HoleCosts:
    """Compute prices and bound.

    Args:
        cycles: places of the cycles; behind each place the place from which its object comes.
        free_place: the one place that is free.
        legs: distances.
        start: place per object.
    """
    places = [place for cycle in cycles for place in cycle] + [free_place]
    count = len(places) - 1
    numbers = np.repeat(np.arange(len(cycles) + 1), [*(len(cycle) for cycle in cycles), 1])
    between = np.zeros((count + 2, count + 2))
    between[:-1, :-1] = np.array(legs.between_mm)[np.ix_(places, places)]
    between[-1, :-1] = between[:-1, -1] = np.array(legs.home_mm)[places]
    comes_from = np.empty(count, dtype=np.intp)
    begin = 0
    for cycle in cycles:
        comes_from[begin : begin + len(cycle)] = begin + np.roll(np.arange(len(cycle)), -1)
        begin += len(cycle)
    goes_to = np.empty_like(comes_from)
    goes_to[comes_from] = np.arange(count)
    empty_mm, along = _empty_legs(between, numbers, comes_from)
    detour_mm = _detours(between, numbers, goes_to, len(cycles))
    least_along = count - (_LEGS_PER_DETOUR - 1) * len(cycles)
    put_mm, along_mm = _prices(empty_mm, along, detour_mm, least_along)
    # The programme saw the nearest places only: these prices hold for every leg.
    pick_mm = np.min(empty_mm - along_mm * along - put_mm[:, None], axis=0)
    opening_mm = np.min(detour_mm + pick_mm[:-1] + put_mm[:-1], axis=1)
    stands_on = {place: item for item, place in enumerate(start)}
    again_mm = np.array([legs.handling_of_mm(stands_on[place]) for place in places[:-1]])
    least_again_mm = np.array([again_mm[numbers[:-1] == number].min() for number in range(len(cycles))])
    known = np.arange(count + 2) != count
    bound_mm = (
        pick_mm[known].sum()
        + put_mm[known].sum()
        + opening_mm.sum()
        + along_mm * least_along
        + between[np.arange(count), goes_to].sum()
        + again_mm.sum()
        + least_again_mm.sum()
    )
    return HoleCosts(
        tuple(places),
        tuple(tuple(np.flatnonzero(numbers == number).tolist()) for number in range(len(cycles))),
        between,
        tuple(comes_from.tolist()),
        tuple(goes_to.tolist()),
        pick_mm,
        put_mm,
        along_mm,
        opening_mm,
        again_mm,
        least_again_mm,
        float(again_mm.sum()),
        float(bound_mm),
    )


def _empty_legs(between: Array, numbers: Indices, comes_from: Indices) -> tuple[Array, NDArray[np.bool_]]:
    """Return [put, pick] = length of an empty leg, infinite where there is none, and which lead on within a cycle."""
    empty_mm = between.copy()
    same = numbers[:, None] == numbers[None, :]
    empty_mm[:-1, :-1][same] = np.inf
    empty_mm[-1, -1] = np.inf
    along = np.zeros(empty_mm.shape, dtype=bool)
    put = np.arange(len(comes_from))
    pick = comes_from[comes_from]
    put, pick = put[pick != put], pick[pick != put]
    along[put, pick] = True
    empty_mm[put, pick] = between[put, pick]
    return empty_mm, along


def _detours(between: Array, numbers: Indices, goes_to: Indices, cycles: int) -> Array:
    """Return [cycle, hole] = the least that carrying an object of the cycle by way of the hole adds."""
    origin = np.arange(len(goes_to))
    added = between[origin, :-1] + between[:-1, goes_to].T - between[origin, goes_to][:, None]
    detour_mm = np.array([added[numbers[:-1] == number].min(axis=0) for number in range(cycles)])
    detour_mm[np.arange(cycles)[:, None] == numbers[None, :]] = np.inf
    return detour_mm


def _prices(empty_mm: Array, along: NDArray[np.bool_], detour_mm: Array, least_along: int) -> tuple[Array, float]:
    """Solve the linear programme; return the prices of putting down, and of going on within a cycle."""
    size, cycles = len(empty_mm), len(detour_mm)
    put, pick = np.nonzero(_near(empty_mm) | along)
    number, hole = np.nonzero(_near(detour_mm))
    legs, detours = np.arange(len(put)), len(put) + np.arange(len(number))
    on = np.flatnonzero(along[put, pick])
    along_column = 2 * size + cycles
    rows = np.concatenate([legs, legs, on, detours, detours, detours])
    columns = np.concatenate([pick, size + put, np.full(len(on), along_column), 2 * size + number, hole, size + hole])
    signs = np.repeat([1.0, -1.0], [2 * len(legs) + len(on) + len(detours), 2 * len(detours)])
    # Nobody has to go to the free place or to come from there.
    gain = np.concatenate([np.ones(2 * size + cycles), [max(float(least_along), 0.0)]])
    gain[[size - 2, 2 * size - 2]] = 0.0
    farthest_mm = 2.0 * float(empty_mm[np.isfinite(empty_mm)].max())
    highest = np.full(along_column + 1, farthest_mm)
    lowest = -highest
    lowest[-1] = 0.0
    if least_along <= 0:
        highest[-1] = 0.0
    matrix = csr_array((signs, (rows, columns)), shape=(len(legs) + len(detours), along_column + 1))
    limit = np.concatenate([empty_mm[put, pick], detour_mm[number, hole]])
    prices = milp(-gain, bounds=Bounds(lowest, highest), constraints=LinearConstraint(matrix, ub=limit)).x
    # Any prices give a right bound; without any the bound is the loaded legs and the nearest empty ones.
    if prices is None:
        return np.zeros(size), 0.0
    return prices[size : 2 * size], float(prices[along_column])


def _near(lengths_mm: Array) -> NDArray[np.bool_]:
    """Return which entries are among the smallest of their row or column, and finite."""
    near = np.zeros(lengths_mm.shape, dtype=bool)
    for axis in (0, 1):
        kth = min(_NEAREST, lengths_mm.shape[axis]) - 1
        near |= lengths_mm <= np.partition(lengths_mm, kth, axis=axis).take([kth], axis=axis)
    return near & np.isfinite(lengths_mm)
