"""A free buffer place on the table, where none is configured."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.planning.clearance import corners_mm, hand_solids, outer_radius_mm, too_close
from srvs_cell.planning.goals import goal_rule
from srvs_cell.planning.view import View, in_view
from srvs_cell.scene import Place, PlaceKind

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.planning.problem import Footprint, Obstacle, Polygon, Problem, ProblemObject
    from srvs_cell.scene import Move, Point2

Array = NDArray[np.float64]

_GAIN_MM = 1.0
"""A buffer place that saves less is not worth another plan."""

_CHUNK = 128
"""Candidates that are checked at once, best first: the first free one ends the search."""


@dataclass(frozen=True)
class Workspace:
    """Where on the table workpieces may be moved, base frame.

    Attributes:
        x_min_mm, x_max_mm, y_min_mm, y_max_mm: a box.
        view: what the cameras see; None: no matter.
    """

    x_min_mm: float
    x_max_mm: float
    y_min_mm: float
    y_max_mm: float
    view: View | None = None

    def contains(self, x_mm: float, y_mm: float) -> bool:
        """Tell whether a point lies inside."""
        return self.beyond_mm(x_mm, y_mm) == 0.0

    def holds(self, x_mm: Array, y_mm: Array) -> NDArray[np.bool_]:
        """Tell of points, each coordinate of shape (N,), whether they lie inside."""
        inside: NDArray[np.bool_] = (x_mm >= self.x_min_mm) & (x_mm <= self.x_max_mm)
        inside &= (y_mm >= self.y_min_mm) & (y_mm <= self.y_max_mm)
        return inside

    def beyond_mm(self, x_mm: float, y_mm: float) -> float:
        """Return the distance of a point from the box; 0 inside."""
        return math.hypot(
            max(self.x_min_mm - x_mm, 0.0, x_mm - self.x_max_mm), max(self.y_min_mm - y_mm, 0.0, y_mm - self.y_max_mm)
        )

    def __str__(self) -> str:
        return f"x {self.x_min_mm:g} to {self.x_max_mm:g} mm, y {self.y_min_mm:g} to {self.y_max_mm:g} mm"


def better_buffer(
    problem: Problem, moves: Sequence[Move], workspace: Workspace, grid_mm: float, allowed: Allowed | None = None
) -> Problem | None:
    """Return the problem with its last buffer place where a plan's ways to it and from it are shortest together.

    The place is clear for every object that stands wrongly or is brought there, whatever slot any other stands on by
    then. The plan stays valid; planned anew it may get shorter still.

    Args:
        problem: a problem whose last place is a buffer place that `find_buffer` found.
        moves: a plan of it.
        workspace: box that the whole footprint of a buffered object stays in.
        grid_mm: distance of the points that are looked at.
        allowed: where each object can be picked and put down; None: everywhere in the workspace.

    Returns:
        None where the plan does not use that place, or no other point of the grid is nearer.
    """
    last = problem.places[-1]
    points = {place.id: (place.x_mm, place.y_mm) for place in problem.places}
    hand: list[Point2] = [problem.home_mm]
    for move in moves:
        hand += [points[move.from_place], points[move.to_place]]
    hand.append(problem.home_mm)
    here = points[last.id]
    partners = [b for a, b in pairwise(hand) if a == here != b] + [a for a, b in pairwise(hand) if b == here != a]
    if not partners:
        return None
    wrong = goal_rule(problem).misplaced(tuple(item.start for item in problem.objects))
    moving = {*wrong, *(move.object for move in moves if move.to_place == last.id)}
    movers = [item for item in problem.objects if item.id in moving]
    candidates = _grid(workspace, grid_mm)
    ways_mm = np.linalg.norm(candidates[:, None, :] - np.array(partners)[None, :, :], axis=-1).sum(axis=1)
    nearer = ways_mm < sum(math.dist(here, partner) for partner in partners) - _GAIN_MM
    candidates, ways_mm = candidates[nearer], ways_mm[nearer]
    elsewhere = replace(problem, places=problem.places[:-1])
    everywhere = [place.id for place in elsewhere.places if place.kind is not PlaceKind.BIN]
    standings = [each for item in problem.objects for each in _standings(item, elsewhere, everywhere)]
    best = _first_clear(candidates[np.argsort(ways_mm)], movers, standings, problem, workspace, allowed)
    if best is None:
        return None
    return replace(problem, places=(*elsewhere.places, replace(last, x_mm=float(best[0]), y_mm=float(best[1]))))


@dataclass(frozen=True)
class _Standing:
    """An object, as it stands there, and the points (S, 2) where it may while something is in the buffer place."""

    item: ProblemObject
    points_mm: Array


def _standings(item: ProblemObject, problem: Problem, places: Sequence[int]) -> list[_Standing]:
    """Return an object in each orientation that it has on some places, with those places."""
    return [
        _Standing(shape, _points(problem, there))
        for shape, mask in item.orientations(len(problem.places))
        if (there := [place for place in places if mask >> place & 1])
    ]


Allowed = Callable[["ProblemObject", Array], NDArray[np.bool_]]
"""Tells, of an object and points (N, 2), where it can be picked and put down."""


def find_buffer(problem: Problem, workspace: Workspace, grid_mm: float, allowed: Allowed | None = None) -> Problem:
    """Return the problem with one more buffer place, found on the table.

    It is clear, footprints and fingers, for every object, since one that stands rightly may have to make room, whatever
    slot the others stand on by then. Where the table is too full for that, it is clear for those that stand wrongly, or
    for one object at least as the table stands now; the search then finds out whether that is enough. Among the clear
    points the one is taken that makes the shortest detour for one object; the others can go round through its slot
    (references/planning.md section 3). Every look sees what waits there.

    Args:
        problem: a rank problem that is not in order yet.
        workspace: box that the whole footprint of a buffered object stays in.
        grid_mm: distance of the points that are looked at.
        allowed: where each object can be picked and put down; None: everywhere in the workspace.

    Raises:
        AlarmError: NO_BUFFER_PLACE.
    """
    misplaced = goal_rule(problem).misplaced(tuple(item.start for item in problem.objects))
    wrong = [problem.objects[item] for item in misplaced] or list(problem.objects)
    everywhere = [place.id for place in problem.places]
    now = [_Standing(item, _points(problem, [item.start])) for item in problem.objects]
    anywhere = [each for item in problem.objects for each in _standings(item, problem, everywhere)]
    moving = {item.id for item in wrong}
    by_then = [each for each in anywhere if each.item.id in moving]
    by_then += [each for each in now if each.item.id not in moving]
    candidates = _by_detour(_grid(workspace, grid_mm), problem, wrong)
    choices = [(list(problem.objects), anywhere), (wrong, by_then), *(([mover], now) for mover in wrong)]
    point = None
    for movers, standings in choices:
        point = _first_clear(candidates, movers, standings, problem, workspace, allowed)
        if point is not None:
            break
    if point is None:
        names = ", ".join(item.name for item in wrong)
        raise AlarmError(
            Alarm.NO_BUFFER_PLACE,
            f"no point of the workspace ({workspace}) on a grid of {grid_mm:g} mm is clear"
            f"{'' if workspace.view is None else ' and in view of every look'} for any of: {names}.",
        )
    found = Place(len(problem.places), float(point[0]), float(point[1]), PlaceKind.BUFFER)
    return replace(problem, places=(*problem.places, found))


def _grid(workspace: Workspace, grid_mm: float) -> Array:
    """Return grid points of shape (C, 2), on multiples of the grid so that they do not depend on the workpieces."""
    axes = [
        np.arange(np.ceil(low / grid_mm), np.floor(high / grid_mm) + 1.0) * grid_mm
        for low, high in ((workspace.x_min_mm, workspace.x_max_mm), (workspace.y_min_mm, workspace.y_max_mm))
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)


def _by_detour(candidates: Array, problem: Problem, movers: Sequence[ProblemObject]) -> Array:
    """Sort candidates by the shortest way start -> candidate -> goal of any object, then by the sum of all ways."""
    rule = goal_rule(problem)
    ways = []
    for item in movers:
        goals = _points(problem, [p.id for p in problem.places if rule.allowed[item.id] >> p.id & 1])
        to_goal = np.linalg.norm(candidates[:, None, :] - goals[None, :, :], axis=-1).min(axis=1)
        ways.append(np.linalg.norm(candidates - _points(problem, [item.start]), axis=-1) + to_goal)
    all_ways = np.array(ways)
    ranking = np.lexsort((np.round(all_ways.sum(axis=0), 6), np.round(all_ways.min(axis=0), 6)))
    ordered: Array = candidates[ranking]
    return ordered


def _points(problem: Problem, places: Sequence[int]) -> Array:
    return np.array([[problem.places[p].x_mm, problem.places[p].y_mm] for p in places], dtype=np.float64)


def _first_clear(
    candidates: Array,
    movers: Sequence[ProblemObject],
    standings: Sequence[_Standing],
    problem: Problem,
    workspace: Workspace,
    allowed: Allowed | None,
) -> Array | None:
    """Return the first candidate that is clear for all movers, or None.

    A mover's own place counts as taken too: somebody else is to stand there.
    """
    for begin in range(0, len(candidates), _CHUNK):
        chunk = candidates[begin : begin + _CHUNK]
        for mover in movers:
            chunk = chunk[_inside(mover.footprint, chunk, workspace)]
            if workspace.view is not None and len(chunk):
                chunk = chunk[in_view(mover, chunk, workspace.view, from_aside=True)]
            for obstacle in problem.obstacles:
                at = np.array([[obstacle.x_mm, obstacle.y_mm]])
                chunk = _without_hits(chunk, mover, obstacle, at, problem.clearance_mm)
            for standing in standings:
                chunk = _without_hits(chunk, mover, standing.item, standing.points_mm, problem.clearance_mm)
                # The other's fingers come down beside what stands in the buffer place.
                for solid in _lower_than(standing.item, mover.top_mm):
                    chunk = chunk[~_hit(mover.footprint, solid, chunk, standing.points_mm, 0.0)]
            # The arm's joints last: they cost most.
            if allowed is not None and len(chunk):
                chunk = chunk[allowed(mover, chunk)]
            if not len(chunk):
                break
        if len(chunk):
            first: Array = chunk[0]
            return first
    return None


def _without_hits(
    chunk: Array, mover: ProblemObject, other: ProblemObject | Obstacle, at_mm: Array, clearance_mm: float
) -> Array:
    """Drop the candidates where the mover or its fingers would meet another at any of the points (S, 2)."""
    chunk = chunk[~_hit(mover.footprint, other.footprint, chunk, at_mm, clearance_mm)]
    for solid in _lower_than(mover, other.top_mm):
        chunk = chunk[~_hit(solid, other.footprint, chunk, at_mm, 0.0)]
    return chunk


def _hit(a: Footprint, b: Footprint, a_at_mm: Array, b_at_mm: Array, clearance_mm: float) -> NDArray[np.bool_]:
    """Return, per point of A (C, 2), whether A is too close to B at any point of B (S, 2)."""
    displacement_mm = b_at_mm[None, :, :] - a_at_mm[:, None, :]
    # Two oblongs are compared axis by axis, so that their corners may be farther apart than the clearance.
    reach_mm = outer_radius_mm(a) + outer_radius_mm(b) + math.sqrt(2.0) * clearance_mm
    close: NDArray[np.bool_] = np.sum(displacement_mm**2, axis=-1) <= reach_mm**2
    if close.any():
        close[close] = too_close(a, b, displacement_mm[close], clearance_mm)
    hit: NDArray[np.bool_] = np.any(close, axis=1)
    return hit


def _lower_than(item: ProblemObject, top_mm: float) -> list[Polygon]:
    """Return what comes down lower than a height when an object is gripped."""
    return [shape for grip in item.grips for shape, bottom_mm in hand_solids(grip) if bottom_mm < top_mm]


def _inside(shape: Footprint, points_mm: Array, workspace: Workspace) -> NDArray[np.bool_]:
    """Return where the whole of a shape lies in the workspace, per point (C, 2)."""
    corners = corners_mm(shape)
    low, high = corners.min(axis=0), corners.max(axis=0)
    fits: NDArray[np.bool_] = (
        (points_mm[:, 0] + low[0] >= workspace.x_min_mm)
        & (points_mm[:, 0] + high[0] <= workspace.x_max_mm)
        & (points_mm[:, 1] + low[1] >= workspace.y_min_mm)
        & (points_mm[:, 1] + high[1] <= workspace.y_max_mm)
    )
    return fits
