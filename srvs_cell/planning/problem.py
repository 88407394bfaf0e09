"""The planning problem: places, objects, what the gripper needs, obstacles, goal.

One set of types for the problems of a file (discs and axis-aligned oblongs) and for the cell's own (polygons with
their yaw, fingers along the grasp). Lengths in millimetres; x and y on the table in the robot's base frame. Every id
is a position in its tuple.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Self

from srvs_cell.planning.problem_format import (
    WireDisc,
    WireGripper,
    WireObstacleDisc,
    WireObstacleRect,
    WireProblem,
    WireRankGoal,
    WireRect,
    check_schema,
    problem_invalid,
    read_wire,
)
from srvs_cell.scene import Place, PlaceKind, Point2

if TYPE_CHECKING:
    from collections.abc import Mapping

_AXIS_YAW_DEG = {"x": 0.0, "y": 90.0}


@dataclass(frozen=True)
class Disc:
    """A round footprint."""

    radius_mm: float


@dataclass(frozen=True)
class Rectangle:
    """An oblong footprint along the base frame's axes: half sizes."""

    half_x_mm: float
    half_y_mm: float


@dataclass(frozen=True)
class Polygon:
    """A convex footprint: vertices counter-clockwise, relative to the object's reference point."""

    vertices_mm: tuple[Point2, ...]

    def turned(self, turn_deg: float) -> Polygon:
        """Return the polygon turned about the reference point."""
        return Polygon(tuple(_turned(vertex, turn_deg) for vertex in self.vertices_mm))


Footprint = Disc | Rectangle | Polygon


@dataclass(frozen=True)
class Palm:
    """What carries the fingers, as a rectangle round the middle between them.

    Attributes:
        half_along_mm: half its extent along the closing motion.
        half_across_mm: half its extent across the closing motion.
        bottom_mm: height of its underside above the table while the fingers grip; what is lower may stand below it.
    """

    half_along_mm: float
    half_across_mm: float
    bottom_mm: float


@dataclass(frozen=True)
class FingerGrip:
    """One way to take an object: the two rectangles on the table that the fingers need, at pick and at place.

    Attributes:
        name: what reasons call it.
        centre_mm: middle between the fingers, relative to the object's reference point.
        yaw_deg: direction of the closing motion, from base x towards base y.
        inner_mm: distance from the middle to the inner side of each rectangle.
        thick_mm: extent of each rectangle along the closing motion.
        width_mm: extent of each rectangle across the closing motion.
        bottom_mm: height above the table that the fingers do not go below; what is lower may stand under them.
        palm: what comes down behind the fingers, where that matters.
        blocked: places where the arm cannot take or leave the object this way.
    """

    name: str
    centre_mm: Point2
    yaw_deg: float
    inner_mm: float
    thick_mm: float
    width_mm: float
    bottom_mm: float = 0.0
    palm: Palm | None = None
    blocked: tuple[int, ...] = ()

    def turned(self, turn_deg: float) -> FingerGrip:
        """Return the grip turned about the object's reference point."""
        return replace(self, centre_mm=_turned(self.centre_mm, turn_deg), yaw_deg=self.yaw_deg + turn_deg)


@dataclass(frozen=True)
class ProblemObject:
    """An object that may be moved.

    Attributes:
        id: position in the problem's objects.
        height_mm: height above the table.
        footprint: as it stands at its start; its reference point stands on the place's point.
        start: id of the place where it stands.
        grips: ways to take it; the same one at pick and at place. Empty: the fingers need no room.
        name: what reasons call it.
        top_mm: height above the table that it certainly does not exceed; what is higher passes over it.
        blocked: places where it can be neither picked nor put down in any way, each with the reason.
        turns_deg: places where it stands turned about its reference point, against its start, and by how much.
    """

    id: int
    height_mm: float
    footprint: Footprint
    start: int
    grips: tuple[FingerGrip, ...]
    name: str
    top_mm: float = math.inf
    blocked: tuple[tuple[int, str], ...] = ()
    turns_deg: tuple[tuple[int, float], ...] = ()

    def turn_deg(self, place: int) -> float:
        """Return by how much it is turned where it stands on a place."""
        return next((turn_deg for turned_at, turn_deg in self.turns_deg if turned_at == place), 0.0)

    def at(self, place: int) -> ProblemObject:
        """Return it with footprint and grips as it stands on a place."""
        return _object_turned(self, self.turn_deg(place))

    def orientations(self, place_count: int) -> list[tuple[ProblemObject, int]]:
        """Return it in each of its orientations, with the mask of the places where it stands so."""
        masks = {0.0: (1 << place_count) - 1}
        for place, turn_deg in self.turns_deg:
            masks[0.0] &= ~(1 << place)
            masks[turn_deg] = masks.get(turn_deg, 0) | 1 << place
        return [(_object_turned(self, turn_deg), mask) for turn_deg, mask in masks.items()]


@lru_cache(maxsize=1024)
def _object_turned(item: ProblemObject, turn_deg: float) -> ProblemObject:
    """Return an object turned about its reference point; kept, because many ask for the same."""
    if turn_deg == 0.0:
        return item
    footprint = item.footprint
    if isinstance(footprint, Rectangle):
        x_mm, y_mm = footprint.half_x_mm, footprint.half_y_mm
        footprint = Polygon(((-x_mm, -y_mm), (x_mm, -y_mm), (x_mm, y_mm), (-x_mm, y_mm)))
    if isinstance(footprint, Polygon):
        footprint = footprint.turned(turn_deg)
    return replace(item, footprint=footprint, grips=tuple(grip.turned(turn_deg) for grip in item.grips))


def _turned(point_mm: Point2, turn_deg: float) -> Point2:
    turned = complex(*point_mm) * cmath.rect(1.0, math.radians(turn_deg))
    return turned.real, turned.imag


@dataclass(frozen=True)
class Obstacle:
    """Something that stays where it is.

    Attributes:
        footprint: relative to its point.
        x_mm, y_mm: its point.
        top_mm: height above the table that it certainly does not exceed.
    """

    footprint: Footprint
    x_mm: float
    y_mm: float
    top_mm: float = math.inf


@dataclass(frozen=True)
class RankGoal:
    """The objects stand in the order of height on the slots, one on each.

    Attributes:
        slots: place ids, the first for the tallest.
        tolerance_mm: no later slot holds an object taller than an earlier one by more than this.
    """

    slots: tuple[int, ...]
    tolerance_mm: float


@dataclass(frozen=True)
class AssignGoal:
    """Each object stands on one of its allowed places, and no place of ``must_fill`` is empty."""

    allowed: tuple[frozenset[int], ...]
    must_fill: frozenset[int]


@dataclass(frozen=True)
class Problem:
    """A relocation problem.

    Attributes:
        id: the problem's name.
        places: places; all but a bin hold one object and may be used in passing. A bin takes any number, is never
            picked from and never collides.
        objects: the objects that may be moved.
        obstacles: what never moves.
        goal: what has to hold at the end.
        home_mm: where the hand starts and ends.
        clearance_mm: least distance between footprints; fingers need none.
    """

    id: str
    places: tuple[Place, ...]
    objects: tuple[ProblemObject, ...]
    obstacles: tuple[Obstacle, ...]
    goal: RankGoal | AssignGoal
    home_mm: Point2
    clearance_mm: float

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any], source: str) -> Self:
        """Read a planning-problem/1 object (references/planning.md section 5).

        Args:
            data: the decoded JSON object.
            source: what errors call it, usually the file's name.

        Raises:
            AlarmError: PROBLEM_INVALID, naming the field and what it should be.
        """
        wire = read_wire(data, source)
        return cls(
            id=wire.id,
            places=tuple(Place(p.id, p.x_mm, p.y_mm, PlaceKind(p.kind), p.reachable) for p in wire.places),
            objects=tuple(_object(item, wire.gripper) for item in wire.objects),
            obstacles=tuple(Obstacle(_footprint(o), o.x_mm, o.y_mm) for o in wire.obstacles),
            goal=_goal(wire),
            home_mm=(wire.home_mm[0], wire.home_mm[1]),
            clearance_mm=wire.clearance_mm,
        )


def _footprint(item: WireDisc | WireRect | WireObstacleDisc | WireObstacleRect) -> Disc | Rectangle:
    if isinstance(item, WireDisc | WireObstacleDisc):
        return Disc(item.r_mm)
    return Rectangle(item.hx_mm, item.hy_mm)


def _object(item: WireDisc | WireRect, gripper: WireGripper | None) -> ProblemObject:
    footprint = _footprint(item)
    if gripper is None:
        return ProblemObject(item.id, item.height_mm, footprint, item.start, (), f"object {item.id}")
    if isinstance(footprint, Disc):
        half_mm = {"x": footprint.radius_mm, "y": footprint.radius_mm}
    else:
        half_mm = {"x": footprint.half_x_mm, "y": footprint.half_y_mm}
    grips = tuple(
        FingerGrip(
            name=f"along {axis}",
            centre_mm=(0.0, 0.0),
            yaw_deg=_AXIS_YAW_DEG[axis],
            inner_mm=half_mm[axis] + gripper.gap_mm,
            thick_mm=gripper.thick_mm,
            width_mm=gripper.width_mm,
        )
        for axis in gripper.axes
    )
    return ProblemObject(item.id, item.height_mm, footprint, item.start, grips, f"object {item.id}")


def _goal(wire: WireProblem) -> RankGoal | AssignGoal:
    if isinstance(wire.goal, WireRankGoal):
        return RankGoal(tuple(wire.goal.slots), wire.goal.tol_mm)
    return AssignGoal(
        tuple(frozenset(places) for places in wire.goal.allowed),
        frozenset(wire.goal.must_fill),
    )


def read_problems(data: object, source: str) -> list[Problem]:
    """Read the decoded JSON of a problem file: one problem, or an object with ``instances``.

    Args:
        data: what the JSON text decodes to.
        source: the file's name, for errors.

    Raises:
        AlarmError: PROBLEM_INVALID, naming the field and what it should be.
    """
    if not isinstance(data, dict):
        raise problem_invalid(source, "problem", f"should be a JSON object, got {type(data).__name__}")
    if "instances" not in data:
        return [Problem.from_mapping(data, source)]
    check_schema(data, source)
    instances = data["instances"]
    if not isinstance(instances, list):
        raise problem_invalid(source, "instances", f"should be a list, got {type(instances).__name__}")
    problems = []
    for position, instance in enumerate(instances):
        if not isinstance(instance, dict):
            raise problem_invalid(source, f"instances[{position}]", "should be a JSON object")
        problems.append(Problem.from_mapping(instance, f"{source}: instances[{position}]"))
    return problems
