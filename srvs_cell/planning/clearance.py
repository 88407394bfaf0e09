"""Which standings exclude each other: a table of bit masks over (object, place) pairs.

The search only sees the table, so that discs, oblongs and the cell's polygons are the same to it. Two convex shapes
are compared through their Minkowski difference: B's reference point at displacement d from A's makes them touch where
d lies on the border of A + (-B), so that the signed distance of the point d to that polygon is the gap.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from srvs_cell.planning.problem import (
    Disc,
    FingerGrip,
    Footprint,
    Obstacle,
    Polygon,
    Problem,
    ProblemObject,
    Rectangle,
)
from srvs_cell.scene import PlaceKind

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.scene import Point2

Array = NDArray[np.float64]

CONTACT_TOLERANCE_MM = 1e-6
"""Gaps short of the clearance by less than this are none (references/planning.md section 5)."""

NEVER = -1
"""The mask that excludes every standing: all bits set."""


@dataclass(frozen=True)
class ConflictTable:
    """Who may stand where, and what excludes it.

    The bit of object o at place p is ``1 << (o * place_count + p)``; an arrangement's mask is the union of its bits.

    Attributes:
        place_count: number of places.
        standable: ``[object][place]``: place reachable and clear of obstacles for that object.
        blocked_by: ``[object][place]``: standings of other objects that are too close to the object at that place.
        grip_blocked_by: ``[object][place][grip]``: standings in the way of the hand; `NEVER` where an obstacle is, and
            where the object may not be gripped at all.
        pickable: ``[place]``: reachable and no bin.
        single: mask over places that hold one object only.
    """

    place_count: int
    standable: tuple[tuple[bool, ...], ...]
    blocked_by: tuple[tuple[int, ...], ...]
    grip_blocked_by: tuple[tuple[tuple[int, ...], ...], ...]
    pickable: tuple[bool, ...]
    single: int

    @property
    def nothing_in_the_way(self) -> bool:
        """Whether every object may go to every free place whatever the others do."""
        return (
            all(self.pickable)
            and all(map(all, self.standable))
            and not any(map(any, self.blocked_by))
            and not any(mask for places in self.grip_blocked_by for grips in places for mask in grips)
        )

    def bit(self, item: int, place: int) -> int:
        """Return the bit of an object at a place."""
        return 1 << (item * self.place_count + place)

    def standing(self, arrangement: tuple[int, ...]) -> int:
        """Return the mask of an arrangement (place per object)."""
        mask = 0
        for item, place in enumerate(arrangement):
            mask |= 1 << (item * self.place_count + place)
        return mask

    def of(self, items: Sequence[int]) -> ConflictTable:
        """Return the table of some objects alone, numbered anew in the order in which they are named."""
        places = (1 << self.place_count) - 1
        shifts = [(item * self.place_count, number * self.place_count) for number, item in enumerate(items)]

        def kept(mask: int) -> int:
            return mask if mask == NEVER else sum((mask >> was & places) << now for was, now in shifts)

        return replace(
            self,
            standable=tuple(self.standable[item] for item in items),
            blocked_by=tuple(tuple(map(kept, self.blocked_by[item])) for item in items),
            grip_blocked_by=tuple(
                tuple(tuple(map(kept, grips)) for grips in self.grip_blocked_by[item]) for item in items
            ),
        )


@lru_cache(maxsize=8)
def conflict_table(problem: Problem) -> ConflictTable:
    """Compute the conflict table of a problem; kept, because bounds, plan, grips and reasons ask for the same."""
    solid = [place.kind is not PlaceKind.BIN for place in problem.places]
    points = np.array([[place.x_mm, place.y_mm] for place in problem.places], dtype=np.float64).reshape(-1, 2)
    count = len(problem.places)
    hits = _Hits(points, np.array(solid, dtype=bool))
    orientations = [item.orientations(count) for item in problem.objects]
    standable, blocked_by, grip_blocked_by = [], [], []
    for item in problem.objects:
        clear = (1 << count) - 1
        for shape, at in orientations[item.id]:
            for obstacle in problem.obstacles:
                clear &= ~(at & _hits_obstacle(shape.footprint, points, obstacle, problem.clearance_mm))
        blocked = {place for place, _ in item.blocked}
        standable.append(
            tuple(
                place.reachable and place.id not in blocked and (bool(clear >> place.id & 1) or not solid[place.id])
                for place in problem.places
            )
        )
        others = [each for other in problem.objects if other.id != item.id for each in orientations[other.id]]
        masks = [0] * count
        grips = [[0] * count for _ in item.grips or (None,)]
        for shape, at in orientations[item.id]:
            for other, other_at in others:
                for place, places in hits.of(shape.footprint, other.footprint, problem.clearance_mm):
                    if at >> place & 1:
                        masks[place] |= (places & other_at) << (other.id * count)
            for grip, grip_masks in zip(shape.grips, grips, strict=False):
                _add_grip(grip_masks, grip, at, points, problem.obstacles, others, hits)
        blocked_by.append(tuple(masks))
        for number, grip_masks in enumerate(grips):
            for place in blocked.union(item.grips[number].blocked if item.grips else ()):
                grip_masks[place] = NEVER
        grip_blocked_by.append(tuple(zip(*grips, strict=True)))
    return ConflictTable(
        place_count=count,
        standable=tuple(standable),
        blocked_by=tuple(blocked_by),
        grip_blocked_by=tuple(grip_blocked_by),
        pickable=tuple(place.reachable and solid[place.id] for place in problem.places),
        single=hits.solid,
    )


def too_close(a: Footprint, b: Footprint, displacement_mm: Array, clearance_mm: float) -> NDArray[np.bool_]:
    """Return where B, displaced from A by each row of shape (..., 2), is nearer than the clearance.

    Two axis-aligned oblongs are compared axis by axis (both gaps below the clearance), as the problem format says.
    """
    if isinstance(a, Rectangle) and isinstance(b, Rectangle):
        reach = np.array([a.half_x_mm + b.half_x_mm, a.half_y_mm + b.half_y_mm]) + clearance_mm
        inside: NDArray[np.bool_] = np.all(np.abs(displacement_mm) < reach - CONTACT_TOLERANCE_MM, axis=-1)
        return inside
    reach_mm = _radius_mm(a) + _radius_mm(b) + clearance_mm
    near: NDArray[np.bool_] = signed_distance_mm(displacement_mm, _difference(a, b)) < reach_mm - CONTACT_TOLERANCE_MM
    return near


@lru_cache(maxsize=4096)
def _difference(a: Footprint, b: Footprint) -> Array:
    """Return the polygon A + (-B); kept, because the search for a buffer place asks for the same pairs many times."""
    return minkowski_sum(_core(a), -_core(b))


def minkowski_sum(a: Array, b: Array) -> Array:
    """Return the sum, shape (M, 2), of two convex polygons, both and the sum counter-clockwise.

    The sum's edges are those of both in the order of their directions, from the lowest point on (the leftmost of equal
    ones). Polygons of one or two vertices are points and segments.
    """
    edges, begin = np.zeros((0, 2)), np.zeros(2)
    for polygon in (a, b):
        edges = np.concatenate([edges, _following(polygon) - polygon])
        begin += polygon[np.lexsort((polygon[:, 0], polygon[:, 1]))[0]]
    edges = edges[np.any(edges != 0.0, axis=1)]
    direction = np.arctan2(edges[:, 1], edges[:, 0])
    order = np.argsort(np.where(direction < 0.0, direction + 2.0 * np.pi, direction), kind="stable")
    corners: Array = begin + np.concatenate([np.zeros((1, 2)), np.cumsum(edges[order], axis=0)])[: max(len(edges), 1)]
    return corners


def _following(polygon_mm: Array) -> Array:
    """Return the vertex behind each vertex."""
    return np.concatenate([polygon_mm[1:], polygon_mm[:1]])


def finger_polygons(grip: FingerGrip) -> tuple[Polygon, Polygon]:
    """Return the two finger rectangles of a grip, relative to the object's reference point."""
    yaw_rad = np.deg2rad(grip.yaw_deg)
    closing = np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
    across = np.array([-closing[1], closing[0]])
    near, far, half = grip.inner_mm, grip.inner_mm + grip.thick_mm, grip.width_mm / 2.0
    corners = [(near, -half), (far, -half), (far, half), (near, half)]
    sides = []
    for sign in (1.0, -1.0):
        vertices = np.array(grip.centre_mm) + sign * np.array([c * closing + w * across for c, w in corners])
        sides.append(Polygon(tuple((float(x), float(y)) for x, y in vertices)))
    return sides[0], sides[1]


@lru_cache(maxsize=1024)
def hand_solids(grip: FingerGrip) -> tuple[tuple[Polygon, float], ...]:
    """Return what comes down on a grip: fingers and palm, each with the height that it does not go below."""
    solids = [(finger, grip.bottom_mm) for finger in finger_polygons(grip)]
    if grip.palm is not None:
        half = grip.palm.half_along_mm
        # The palm is the "finger" that reaches from the middle to both sides.
        palm = replace(grip, inner_mm=-half, thick_mm=2.0 * half, width_mm=2.0 * grip.palm.half_across_mm)
        solids.append((finger_polygons(palm)[0], grip.palm.bottom_mm))
    return tuple(solids)


def convex_hull(points_mm: Array) -> Array:
    """Return the hull of shape (M, 2), counter-clockwise, of points of shape (N, 2); one or two points stay."""
    ordered = sorted({(float(x), float(y)) for x, y in np.round(points_mm, 9)})
    if len(ordered) <= 2:  # noqa: PLR2004 - a point or a segment is its own hull
        return np.array(ordered)
    halves: list[list[Point2]] = []
    for sweep in (ordered, ordered[::-1]):
        chain: list[Point2] = []
        for point in sweep:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], point) <= 0.0:
                chain.pop()
            chain.append(point)
        halves.append(chain[:-1])
    return np.array(halves[0] + halves[1])


def _turn(a: Point2, b: Point2, c: Point2) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def signed_distance_mm(points_mm: Array, polygon_mm: Array) -> Array:
    """Return the distance of points (..., 2) to a convex counter-clockwise polygon (M, 2), negative inside.

    A polygon of one or two vertices is a point or a segment and has no inside.
    """
    edge_x, edge_y = (_following(polygon_mm) - polygon_mm).T
    offset_x = points_mm[..., 0, None] - polygon_mm[:, 0]
    offset_y = points_mm[..., 1, None] - polygon_mm[:, 1]
    length2 = edge_x**2 + edge_y**2
    along = np.clip((offset_x * edge_x + offset_y * edge_y) / np.where(length2 > 0.0, length2, 1.0), 0.0, 1.0)
    distance2 = (offset_x - along * edge_x) ** 2 + (offset_y - along * edge_y) ** 2
    distance: Array = np.sqrt(distance2.min(axis=-1))
    if len(polygon_mm) <= 2:  # noqa: PLR2004 - a point or a segment
        return distance
    left_of_all = (edge_x * offset_y - edge_y * offset_x >= 0.0).all(axis=-1)
    return np.where(left_of_all, -distance, distance)


def _core(shape: Footprint) -> Array:
    """Return the vertices of a shape without its rounding: a disc is a point with a radius."""
    if isinstance(shape, Disc):
        return np.zeros((1, 2))
    if isinstance(shape, Rectangle):
        x, y = shape.half_x_mm, shape.half_y_mm
        return np.array([(-x, -y), (x, -y), (x, y), (-x, y)])
    return np.array(shape.vertices_mm)


def corners_mm(shape: Footprint) -> Array:
    """Return the corners, shape (N, 2), of a convex polygon that holds a shape; relative to its reference point."""
    if isinstance(shape, Disc):
        return _core(Rectangle(shape.radius_mm, shape.radius_mm))
    return _core(shape)


def _radius_mm(shape: Footprint) -> float:
    return shape.radius_mm if isinstance(shape, Disc) else 0.0


class _Hits:
    """Where two shapes are too close, over all pairs of places; kept per pair of shapes, because many are alike.

    Bins take no part, and two objects never stand on one place: the search looks at free places only.

    Attributes:
        solid: mask of the places that are no bins.
    """

    def __init__(self, points: Array, solid: NDArray[np.bool_]) -> None:
        self._displacement_mm = points[None, :, :] - points[:, None, :]
        apart = solid[:, None] & solid[None, :] & ~np.eye(len(points), dtype=bool)
        self._distance_mm = np.where(apart, np.linalg.norm(self._displacement_mm, axis=-1), np.inf)
        self._least_mm = float(self._distance_mm.min(initial=np.inf))
        self._known: dict[tuple[Footprint, Footprint, float], list[tuple[int, int]]] = {}
        self.solid = sum(1 << place for place in np.flatnonzero(solid).tolist())

    def of(self, a: Footprint, b: Footprint, clearance_mm: float) -> list[tuple[int, int]]:
        """Return (place of A, mask of the places where B is too close to it) wherever there is any."""
        # Two oblongs are compared axis by axis, so that their corners may be farther apart than the clearance.
        reach_mm = outer_radius_mm(a) + outer_radius_mm(b) + math.sqrt(2.0) * clearance_mm
        if reach_mm < self._least_mm:
            return []
        known = self._known.get((a, b, clearance_mm))
        if known is None:
            near = np.argwhere(self._distance_mm <= reach_mm)
            if len(near):
                near = near[too_close(a, b, self._displacement_mm[near[:, 0], near[:, 1]], clearance_mm)]
            masks: dict[int, int] = {}
            for place, other in near.tolist():
                masks[place] = masks.get(place, 0) | 1 << other
            known = self._known[a, b, clearance_mm] = list(masks.items())
        return known


@lru_cache(maxsize=1024)
def outer_radius_mm(shape: Footprint) -> float:
    """Return the radius of a circle round the reference point that holds the shape."""
    return float(np.linalg.norm(_core(shape), axis=-1).max()) + _radius_mm(shape)


def _hits_obstacle(shape: Footprint, points: Array, obstacle: Obstacle, clearance_mm: float) -> int:
    """Return the mask of the places where a shape is too close to an obstacle."""
    displacement = np.array([obstacle.x_mm, obstacle.y_mm]) - points
    hit = too_close(shape, obstacle.footprint, displacement, clearance_mm)
    return sum(1 << place for place in np.flatnonzero(hit).tolist())


def _add_grip(
    masks: list[int],
    grip: FingerGrip,
    at: int,
    points: Array,
    obstacles: tuple[Obstacle, ...],
    others: list[tuple[ProblemObject, int]],
    hits: _Hits,
) -> None:
    """Add to the masks of a grip, one a place, what is in its way on the places of the mask ``at``."""
    for shape, bottom_mm in hand_solids(grip):
        for other, other_at in others:
            if other.top_mm > bottom_mm:
                for place, places in hits.of(shape, other.footprint, 0.0):
                    if at >> place & 1:
                        masks[place] |= (places & other_at) << (other.id * len(points))
        for obstacle in obstacles:
            if obstacle.top_mm > bottom_mm:
                hit = at & hits.solid & _hits_obstacle(shape, points, obstacle, 0.0)
                for place in range(len(points)):
                    if hit >> place & 1:
                        masks[place] = NEVER
