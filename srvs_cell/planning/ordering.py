"""Fewest moves of many objects with buffer places outside: who must leave before whom (references/planning.md 2).

Each object has one goal. Its first departure from its start and its last arrival at its goal are two events, and every
conflict between standings, or between fingers and standings, puts two events into an order that any plan keeps. An
object that moves once does both in one go. Objects that move once must therefore form no ring of orders: those that
move twice are a feedback vertex set, and displaced objects plus the smallest such set are a lower bound, whatever
places are used in passing. With enough buffer places that are clear of everything it is reached. The set is found as an
integer programme to which the rings that it leaves open are added until none is left.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp

from srvs_cell.planning.clearance import hand_solids, outer_radius_mm, too_close
from srvs_cell.planning.travel import HOME
from srvs_cell.scene import PlaceKind

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from srvs_cell.planning.moves import Arrangement, Step
    from srvs_cell.planning.problem import Footprint, Problem, ProblemObject
    from srvs_cell.planning.travel import Distances

Array = NDArray[np.float64]
Hits = NDArray[np.bool_]

_MOST_ROUNDS = 200
_MOST_ORDERS = 20_000
"""Sets of buffered objects that the search for an order may look at."""

_CORNER = 2.0**0.5
"""Two oblongs are compared axis by axis: their corners may be farther apart than the clearance by this factor."""


@dataclass(frozen=True)
class _Events:
    """Orders between events: object i leaves its start (event 2 i), and stands at its goal (event 2 i + 1).

    Attributes:
        before: per event, mask of the events that come before it.
        displaced: the objects that have to move.
    """

    before: tuple[int, ...]
    displaced: tuple[int, ...]


@dataclass(frozen=True)
class Ordering:
    """What the orders tell: the proven least number of moves, and a plan that has it, where one was found."""

    bound: int
    steps: tuple[Step, ...] | None


def order_moves(problem: Problem, start: Arrangement, target: Arrangement, legs: Distances) -> Ordering | None:
    """Plan with the fewest moves through buffer places that are clear of everything.

    Args:
        problem: the problem.
        start: place per object.
        target: goal per object.
        legs: distances; they decide between moves that are free to go.

    Returns:
        the bound and a plan; None where the orders say nothing, because of bins, several grips, obstacles, places out
        of reach, or objects that stand right but are in the way.
    """
    events = _events(problem, start, target)
    if events is None:
        return None
    twice = _fewest_twice(events)
    if twice is None:
        return None
    bound = len(events.displaced) + len(twice)
    buffers = _clear_places(problem, start, target)
    order = _order_within(events, twice, len(buffers))
    if order is None:
        return Ordering(bound, None)
    return Ordering(bound, _schedule(events, order, buffers, start, target, legs))


def _events(problem: Problem, start: Arrangement, target: Arrangement) -> _Events | None:
    """Return the orders that every plan keeps, or None where they are not the whole truth."""
    places = problem.places
    used = {*start, *target}
    plain = all(places[place].reachable and places[place].kind is not PlaceKind.BIN for place in used)
    if not plain or len(set(start)) < len(start) or any(len(item.grips) > 1 for item in problem.objects):
        return None
    if any(place in used for item in problem.objects for place, _ in item.blocked):
        return None
    points = [np.array([(places[place].x_mm, places[place].y_mm) for place in ends]) for ends in (start, target)]
    items = [[item.at(ends[item.id]) for item in problem.objects] for ends in (start, target)]
    if _obstructed(problem, items, points):
        return None
    shapes = [[item.footprint for item in standing] for standing in items]
    hands = [[hand_solids(grip) for item in standing for grip in item.grips] for standing in items]
    tops_mm = np.array([item.top_mm for item in problem.objects])
    before = [0] * (2 * len(start))
    moves = np.array(start) != np.array(target)
    clearance_mm = problem.clearance_mm
    hits = [(1, 0, _hits(shapes[1], shapes[0], points[0][None, :] - points[1][:, None], clearance_mm))]
    if (hands[0] and len(hands[0]) < len(start)) or len({len(hand) for hand in hands[0]}) > 1:
        return None
    for mine in (0, 1):
        for solids in zip(*hands[mine], strict=True):
            side = [shape for shape, _ in solids]
            reaches_down = tops_mm[None, :] > np.array([bottom_mm for _, bottom_mm in solids])[:, None]
            for yours in (0, 1):
                apart_mm = points[yours][None, :] - points[mine][:, None]
                hits.append((mine, yours, _hits(side, shapes[yours], apart_mm, 0.0) & reaches_down))
    both_at_goal = _hits(shapes[1], shapes[1], points[1][None, :] - points[1][:, None], clearance_mm)
    if both_at_goal.any():
        return None
    for mine, yours, hit in hits:
        if (hit & moves[:, None] & ~moves[None, :]).any():
            return None  # something that stands right is in the way and may have to make room
        for i, j in np.argwhere(hit & moves[:, None] & moves[None, :]).tolist():
            if yours == 0:  # i comes where j is in the way at its start: j leaves first
                before[2 * i + mine] |= 1 << (2 * j)
            else:  # j's goal is in the way of i: i comes or goes first
                before[2 * j + 1] |= 1 << (2 * i + mine)
    return _Events(tuple(before), tuple(np.flatnonzero(moves).tolist()))


def _obstructed(problem: Problem, items: Sequence[Sequence[ProblemObject]], points: Sequence[Array]) -> bool:
    """Tell whether an obstacle is too near to any goal, for the footprint, or to any start or goal, for the fingers.

    Args:
        problem: the problem.
        items: the objects as they stand at their starts, and at their goals.
        points: where those are.
    """
    for obstacle in problem.obstacles:
        at = np.array([obstacle.x_mm, obstacle.y_mm])
        for at_goal, standing in enumerate(items):
            for item in standing:
                apart_mm = (at - points[at_goal][item.id])[None]
                if at_goal and too_close(item.footprint, obstacle.footprint, apart_mm, problem.clearance_mm)[0]:
                    return True
                for grip in item.grips:
                    if any(
                        obstacle.top_mm > bottom_mm and too_close(side, obstacle.footprint, apart_mm, 0.0)[0]
                        for side, bottom_mm in hand_solids(grip)
                    ):
                        return True
    return False


def _hits(mine: Sequence[Footprint], yours: Sequence[Footprint], displacement_mm: Array, clearance_mm: float) -> Hits:
    """Return [i, j] = whether shape i is too close to shape j, i != j; equal pairs of shapes are compared at once."""
    kinds = {shape: number for number, shape in enumerate(dict.fromkeys([*mine, *yours]))}
    rows, columns = np.array([kinds[shape] for shape in mine]), np.array([kinds[shape] for shape in yours])
    reach = np.array([outer_radius_mm(shape) for shape in kinds])
    distance_mm = np.linalg.norm(displacement_mm, axis=-1)
    near: Hits = distance_mm <= reach[rows][:, None] + reach[columns] + _CORNER * clearance_mm
    np.fill_diagonal(near, val=False)
    hit: Hits = np.zeros(near.shape, dtype=np.bool_)
    shapes = list(kinds)
    pairs = rows[:, None] * len(shapes) + columns[None, :]
    for pair in np.unique(pairs[near]).tolist():
        these = near & (pairs == pair)
        hit[these] = too_close(
            shapes[pair // len(shapes)], shapes[pair % len(shapes)], displacement_mm[these], clearance_mm
        )
    return hit


def _clear_places(problem: Problem, start: Arrangement, target: Arrangement) -> list[int]:
    """Return the places, clear of each other and of every start, goal and obstacle, for any object and its fingers."""
    reach_mm = max(
        outer_radius_mm(shape)
        for item in problem.objects
        for shape in (item.footprint, *(side for grip in item.grips for side, _ in hand_solids(grip)))
    )
    room_mm = 2.0 * reach_mm + _CORNER * problem.clearance_mm
    used = {*start, *target}
    taken = [(problem.places[place].x_mm, problem.places[place].y_mm, room_mm) for place in used]
    taken += [(o.x_mm, o.y_mm, room_mm - reach_mm + outer_radius_mm(o.footprint)) for o in problem.obstacles]
    used |= {place for item in problem.objects for place, _ in item.blocked}
    clear = []
    for place in problem.places:
        if place.id in used or not place.reachable or place.kind is PlaceKind.BIN:
            continue
        if all((place.x_mm - x) ** 2 + (place.y_mm - y) ** 2 > room**2 for x, y, room in taken):
            clear.append(place.id)
            taken.append((place.x_mm, place.y_mm, room_mm))
    return clear


def _fewest_twice(events: _Events) -> frozenset[int] | None:
    """Return the smallest set of objects that move twice; None where no such set opens all rings, or in vain."""
    if not events.displaced:
        return frozenset()
    column = {item: number for number, item in enumerate(events.displaced)}
    cuts: set[frozenset[int]] = set()
    twice: frozenset[int] = frozenset()
    for _ in range(_MOST_ROUNDS):
        rings = _rings(events, twice)
        if not rings:
            return twice
        if any(not ring for ring in rings):
            return None
        cuts |= rings
        matrix = np.zeros((len(cuts), len(column)))
        for row, ring in enumerate(cuts):
            matrix[row, [column[item] for item in ring]] = 1.0
        chosen = milp(
            np.ones(len(column)),
            integrality=np.ones(len(column), dtype=np.intp),
            bounds=Bounds(0, 1),
            constraints=LinearConstraint(matrix, lb=1.0),
        ).x
        if chosen is None:
            return None
        twice = frozenset(item for item, number in column.items() if chosen[number] > 0.5)  # noqa: PLR2004 - 0 or 1
    return None


def _rings(events: _Events, twice: frozenset[int]) -> set[frozenset[int]]:
    """Return, for rings of orders that remain, the objects of which one has to move twice to open the ring.

    One shortest ring through each object, as far as there is one.
    """
    follows: dict[int, list[int]] = {}
    for event, mask in enumerate(events.before):
        for earlier in _bits(mask):
            follows.setdefault(earlier, []).append(event)
    rings = set()
    for item in events.displaced:
        for roots in ([2 * item], [2 * item + 1]) if item in twice else ([2 * item, 2 * item + 1],):
            ring = _ring_through(roots, follows, twice)
            if ring is not None:
                rings.add(ring)
    return rings


def _ring_through(roots: list[int], follows: dict[int, list[int]], twice: frozenset[int]) -> frozenset[int] | None:
    """Return the objects that could open the shortest ring through one of an object's events, or None."""
    # `came[event]` is the event that comes before it, and that by which the ring came to the same object.
    item = roots[0] // 2
    came: dict[int, tuple[int, int]] = {}
    queue = deque(roots)
    seen: set[int] = set()
    while queue:
        entered = queue.popleft()
        for left in _exits(entered, twice):
            for event in follows.get(left, ()):
                if event in roots:
                    return _openers(event, left, entered, came, item, twice)
                if event not in seen:
                    seen.add(event)
                    came[event] = (left, entered)
                    queue.append(event)
    return None


def _exits(event: int, twice: frozenset[int]) -> tuple[int, ...]:
    """Return the events of the same object that are not before this one."""
    item = event // 2
    if item in twice and event % 2:
        return (event,)
    return (2 * item, 2 * item + 1)


def _openers(
    last: int, left: int, entered: int, came: dict[int, tuple[int, int]], item: int, twice: frozenset[int]
) -> frozenset[int]:
    """Return the objects of a ring that are entered by their arrival and left by their departure."""
    found = set()
    while entered // 2 != item:
        if entered % 2 and not left % 2 and entered // 2 not in twice:
            found.add(entered // 2)
        left, entered = came[entered]
    if last % 2 and not left % 2 and item not in twice:
        found.add(item)
    return frozenset(found)


def _bits(mask: int) -> Iterable[int]:
    while mask:
        lowest = mask & -mask
        yield lowest.bit_length() - 1
        mask ^= lowest


class _Progress:
    """Which events have happened, and which objects may go on."""

    def __init__(self, events: _Events, twice: frozenset[int]) -> None:
        self._before = events.before
        self._twice = twice
        self.once = [item for item in events.displaced if item not in twice]

    def may_go(self, item: int, done: int) -> bool:
        """Tell whether an object may go to its goal, from its start or from its buffer place."""
        own = 3 << (2 * item)
        needed = self._before[2 * item + 1]
        if item not in self._twice:
            needed |= self._before[2 * item]
        return not needed & ~(done | own)

    def may_leave(self, item: int, done: int) -> bool:
        """Tell whether an object may go to a buffer place."""
        return not self._before[2 * item] & ~done


def _order_within(events: _Events, twice: frozenset[int], buffers: int) -> tuple[int, ...] | None:
    """Return an order in which objects go to buffer places so that never more are there than places; or None.

    What may go to its goal goes at once, which never hurts; what has happened then depends on who left only.
    """
    progress = _Progress(events, twice)
    all_left = frozenset(twice)
    failed: set[frozenset[int]] = set()
    stack: list[tuple[tuple[int, ...], int]] = [((), 0)]
    while stack and len(failed) < _MOST_ORDERS:
        order, done = stack.pop()
        left = frozenset(order)
        if left in failed:
            continue
        failed.add(left)
        done = _settled(progress, left, done)
        if left == all_left:
            return order
        held = sum(not done >> (2 * item + 1) & 1 for item in left)
        if held >= buffers:
            continue
        waiting = [item for item in sorted(twice - left) if progress.may_leave(item, done)]
        stack += [((*order, item), done | 1 << (2 * item)) for item in waiting]
    return None


def _settled(progress: _Progress, left: frozenset[int], done: int) -> int:
    """Let everything that may go to its goal go there."""
    waiting = [item for item in (*progress.once, *left) if not done >> (2 * item + 1) & 1]
    while True:
        going = [item for item in waiting if progress.may_go(item, done)]
        if not going:
            return done
        # One after another: each was free to go, and an order, once kept, stays kept.
        for item in going:
            done |= 3 << (2 * item)
        waiting = [item for item in waiting if not done >> (2 * item + 1) & 1]


def _schedule(
    events: _Events,
    order: tuple[int, ...],
    buffers: list[int],
    start: Arrangement,
    target: Arrangement,
    legs: Distances,
) -> tuple[Step, ...] | None:
    """Return the moves: always the nearest object that may go to its goal, else the next one to a buffer place."""
    progress = _Progress(events, frozenset(order))
    stands, free, done, hand = list(start), list(buffers), 0, HOME
    waiting = set(progress.once)
    to_leave = deque(order)
    steps: list[Step] = []
    while waiting or to_leave:
        going = [item for item in waiting if progress.may_go(item, done)]
        if going:
            item = min(going, key=lambda i: (legs.leg_mm(hand, stands[i]), i))
            waiting.remove(item)
            place = target[item]
            done |= 3 << (2 * item)
        else:
            item = to_leave.popleft()
            place = min(free, key=lambda p: legs.between_mm[stands[item]][p] + legs.between_mm[p][target[item]])
            free.remove(place)
            waiting.add(item)
            done |= 1 << (2 * item)
        if stands[item] in buffers:
            free.append(stands[item])
        steps.append((item, stands[item], place))
        stands[item] = hand = place
    return tuple(steps)
