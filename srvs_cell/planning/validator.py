"""The independent check of a plan: replays every move in plain geometry.

Nothing is shared with the planner but the problem's types: footprints are compared edge by edge here, fingers are
built from their corners, goals are read from the problem. What the planner and this file agree on was computed twice.
Reasons are those of references/planning.md section 5, followed by what they are about.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from srvs_cell.planning.problem import AssignGoal, Disc, Polygon, Rectangle
from srvs_cell.scene import PlaceKind

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from srvs_cell.planning.legs import LegTops
    from srvs_cell.planning.problem import FingerGrip, Footprint, Obstacle, Palm, Problem, ProblemObject, RankGoal
    from srvs_cell.scene import Move, Place, Point2

_TOUCH_MM = 1e-6
_HEIGHT_EQUAL_MM = 1e-9

_Shape = tuple[list["Point2"], float]
"""Corner points and a rounding radius around them."""


def validate(problem: Problem, plan_moves: Sequence[Move], grips: Sequence[int] | None = None) -> list[str]:
    """Replay a plan; return the reasons why it is wrong, empty for a valid plan.

    Stops at the first move that cannot be carried out: what would follow it is not defined.

    Args:
        problem: the problem that the plan answers.
        plan_moves: moves in order.
        grips: which of its object's grips each move takes; None: any that has room.

    Returns:
        lines such as ``move 3: occupied (place 2 holds object 1)``.
    """
    stands = [item.start for item in problem.objects]
    table = _Table(problem)
    for number, move in enumerate(plan_moves, start=1):
        reason = _wrong_move(problem, stands, table, move, None if grips is None else grips[number - 1])
        if reason:
            return [f"move {number}: {reason}"]
        stands[move.object] = move.to_place
        table.moved(move)
    return [f"goal_not_reached ({what})" for what in _unmet_goals(problem, stands)]


def validate_legs(
    problem: Problem, plan_moves: Sequence[Move], tops: Sequence[LegTops], *, looks_between: bool
) -> list[str]:
    """Replay a valid plan; return the legs under which something rises higher than the plan says, empty for none.

    Args:
        problem: the problem that the plan answers.
        plan_moves: moves in order, as `validate` accepts them.
        tops: what each move's legs pass above.
        looks_between: whether the hand rises from every place to look, and comes back from above everything.
    """
    stands = [item.start for item in problem.objects]
    refusals = []
    hand_from: Place | None = None
    for number, (move, heights) in enumerate(zip(plan_moves, tops, strict=True), start=1):
        origin, target = problem.places[move.from_place], problem.places[move.to_place]
        highest = _under_mm(problem, stands, hand_from or origin, origin, None)
        if highest > heights.to_pick_mm:
            refusals.append(f"move {number}: something under the way to the workpiece is {highest:.1f} mm high")
        highest = _under_mm(problem, stands, origin, target, move.object)
        if highest > heights.carried_mm:
            refusals.append(f"move {number}: something under the carried workpiece is {highest:.1f} mm high")
        stands[move.object] = move.to_place
        looks = looks_between or number == len(plan_moves)
        following = target if looks else problem.places[plan_moves[number].from_place]
        highest = _under_mm(problem, stands, target, following, None)
        if highest > heights.away_mm:
            refusals.append(f"move {number}: something under the way from the place is {highest:.1f} mm high")
        hand_from = None if looks_between else target
    return refusals


def _under_mm(problem: Problem, stands: list[int], begin: Place, end: Place, held: int | None) -> float:
    """Return the height of the highest thing under the hand and what it holds; less for what only the palm passes."""
    things: list[tuple[Footprint, Place | Obstacle, float]] = [
        (_turned(item.footprint, item, stands[item.id]), problem.places[stands[item.id]], item.top_mm)
        for item in problem.objects
        if item.id != held
    ]
    things += [(obstacle.footprint, obstacle, obstacle.top_mm) for obstacle in problem.obstacles]
    hands = [
        (max(math.hypot(x, y) for x, y in shape.vertices_mm), length_mm)
        for item in problem.objects
        for grip in item.grips
        for shape, length_mm in (
            *((finger, 0.0) for finger in _fingers(grip)),
            *(() if grip.palm is None else ((_palm(grip, grip.palm), grip.palm.bottom_mm - grip.bottom_mm),)),
        )
    ]
    if held is not None:
        corners, round_mm = _corners(problem.objects[held].footprint, 0.0, 0.0)
        hands.append((max(math.hypot(x, y) for x, y in corners) + round_mm, 0.0))
    highest = 0.0
    line = [(begin.x_mm, begin.y_mm), (end.x_mm, end.y_mm)] if begin.id != end.id else [(begin.x_mm, begin.y_mm)]
    for shape, at, top_mm in things:
        corners, round_mm = _corners(shape, at.x_mm, at.y_mm)
        gap_mm = _gap_mm(line, corners) - round_mm
        for reach_mm, length_mm in hands:
            if gap_mm < reach_mm + problem.clearance_mm - _TOUCH_MM:
                highest = max(highest, top_mm - length_mm)
    return highest


class _Table:
    """Who stands near a place: squares of the table as wide as any object and its fingers reach."""

    def __init__(self, problem: Problem) -> None:
        radius_mm = max((_radius_mm(item) for item in problem.objects), default=0.0)
        # Twice over, for two objects; a square's corner is farther from its middle than its side.
        side_mm = 2.0 * (2.0 * radius_mm + problem.clearance_mm) + 1.0
        self._squares = [(math.floor(p.x_mm / side_mm), math.floor(p.y_mm / side_mm)) for p in problem.places]
        self._bins = [place.kind is PlaceKind.BIN for place in problem.places]
        self._on: dict[tuple[int, int], set[int]] = {}
        for item in problem.objects:
            self._put(item.id, item.start)

    def moved(self, move: Move) -> None:
        """Note a move."""
        self._on[self._squares[move.from_place]].discard(move.object)
        self._put(move.object, move.to_place)

    def near(self, *places: int) -> list[int]:
        """Return the objects in the squares of some places and in those around them; bins hold nobody."""
        found: set[int] = set()
        for place in places:
            column, row = self._squares[place]
            for x in (column - 1, column, column + 1):
                for y in (row - 1, row, row + 1):
                    found |= self._on.get((x, y), set())
        return sorted(found)

    def _put(self, item: int, place: int) -> None:
        if not self._bins[place]:
            self._on.setdefault(self._squares[place], set()).add(item)


def _radius_mm(item: ProblemObject) -> float:
    """Return the radius of a circle round the reference point that holds an object and its fingers."""
    corners, round_mm = _corners(item.footprint, 0.0, 0.0)
    shapes = [finger for grip in item.grips for finger in _fingers(grip)]
    shapes += [_palm(grip, grip.palm) for grip in item.grips if grip.palm is not None]
    hand = [point for shape in shapes for point in shape.vertices_mm]
    return max(*(math.hypot(x, y) + round_mm for x, y in corners), *(math.hypot(x, y) for x, y in hand), 0.0)


def _wrong_move(problem: Problem, stands: list[int], table: _Table, move: Move, taken: int | None) -> str:
    if not 0 <= move.object < len(problem.objects):
        return f"bad_object (there is no object {move.object})"
    for place_id in (move.from_place, move.to_place):
        if not 0 <= place_id < len(problem.places):
            return f"bad_place (there is no place {place_id})"
    if move.from_place == move.to_place:
        return f"same_place (object {move.object} is to be moved from place {move.from_place} to itself)"
    if stands[move.object] != move.from_place:
        return f"wrong_from (object {move.object} stands on place {stands[move.object]}, not {move.from_place})"
    origin, target = problem.places[move.from_place], problem.places[move.to_place]
    if origin.kind is PlaceKind.BIN:
        return f"pick_from_bin (place {origin.id})"
    if not origin.reachable:
        return f"unreachable_pick (place {origin.id})"
    if not target.reachable:
        return f"unreachable_place (place {target.id})"
    others = [
        (problem.objects[number], problem.places[stands[number]])
        for number in table.near(origin.id, target.id)
        if number != move.object
    ]
    item = problem.objects[move.object]
    for what, place in (("unreachable_pick", origin), ("unreachable_place", target)):
        for blocked, reason in item.blocked:
            if blocked == place.id:
                return f"{what} (object {item.id}, place {place.id}: {reason})"
    if target.kind is not PlaceKind.BIN:
        footprint = _turned(item.footprint, item, target.id)
        for other, place in others:
            if place.id == target.id:
                return f"occupied (place {target.id} holds object {other.id})"
        for other, place in others:
            if _near(footprint, target, _turned(other.footprint, other, place.id), place, problem.clearance_mm):
                return f"footprint_conflict (object {item.id} on place {target.id}, object {other.id} on {place.id})"
        for number, obstacle in enumerate(problem.obstacles):
            if _near(footprint, target, obstacle.footprint, obstacle, problem.clearance_mm):
                return f"obstacle_conflict (object {item.id} on place {target.id}, obstacle {number})"
    if item.grips and not any(
        all(_fingers_free(problem, item, grip, place, others) for place in (origin, target))
        for grip in (item.grips if taken is None else item.grips[taken : taken + 1])
    ):
        return f"gripper_blocked (object {item.id} from place {origin.id} to {target.id})"
    return ""


def _fingers_free(
    problem: Problem,
    item: ProblemObject,
    grip: FingerGrip,
    place: Place,
    others: Iterable[tuple[ProblemObject, Place]],
) -> bool:
    if place.id in grip.blocked:
        return False
    if place.kind is PlaceKind.BIN:
        return True
    solids = [(finger, grip.bottom_mm) for finger in _fingers(grip)]
    if grip.palm is not None:
        solids.append((_palm(grip, grip.palm), grip.palm.bottom_mm))
    for shape, bottom_mm in solids:
        solid = _turned(shape, item, place.id)
        for other, stands in others:
            standing = _turned(other.footprint, other, stands.id)
            if other.top_mm > bottom_mm and _near(solid, place, standing, stands, 0.0):
                return False
        for obstacle in problem.obstacles:
            if obstacle.top_mm > bottom_mm and _near(solid, place, obstacle.footprint, obstacle, 0.0):
                return False
    return True


def _turned(shape: Footprint, item: ProblemObject, place: int) -> Footprint:
    """Return a footprint of an object, or of the hand on it, as it lies when the object stands on a place."""
    turn_deg = dict(item.turns_deg).get(place, 0.0)
    if turn_deg == 0.0 or isinstance(shape, Disc):
        return shape
    cos, sin = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    corners, _ = _corners(shape, 0.0, 0.0)
    return Polygon(tuple((x * cos - y * sin, x * sin + y * cos) for x, y in corners))


def _fingers(grip: FingerGrip) -> list[Polygon]:
    """Return the two finger rectangles, counter-clockwise, relative to the object's reference point."""
    cos, sin = math.cos(math.radians(grip.yaw_deg)), math.sin(math.radians(grip.yaw_deg))
    rectangles = []
    for middle in (grip.inner_mm + grip.thick_mm / 2, -grip.inner_mm - grip.thick_mm / 2):
        corners = []
        for along, across in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            u, v = middle + along * grip.thick_mm / 2, across * grip.width_mm / 2
            corners.append((grip.centre_mm[0] + u * cos - v * sin, grip.centre_mm[1] + u * sin + v * cos))
        rectangles.append(Polygon(tuple(corners)))
    return rectangles


def _palm(grip: FingerGrip, palm: Palm) -> Polygon:
    """Return the palm's rectangle, counter-clockwise, relative to the object's reference point."""
    turn = complex(math.cos(math.radians(grip.yaw_deg)), math.sin(math.radians(grip.yaw_deg)))
    corners = []
    for along, across in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        corner = complex(*grip.centre_mm) + turn * complex(along * palm.half_along_mm, across * palm.half_across_mm)
        corners.append((corner.real, corner.imag))
    return Polygon(tuple(corners))


def _near(a: Footprint, a_at: Place, b: Footprint, b_at: Place | Obstacle, clearance_mm: float) -> bool:
    """Tell whether two footprints are nearer than the clearance; ``b_at`` is a place or an obstacle."""
    dx, dy = b_at.x_mm - a_at.x_mm, b_at.y_mm - a_at.y_mm
    if isinstance(a, Rectangle) and isinstance(b, Rectangle):
        gap_x = abs(dx) - a.half_x_mm - b.half_x_mm
        gap_y = abs(dy) - a.half_y_mm - b.half_y_mm
        return gap_x < clearance_mm - _TOUCH_MM and gap_y < clearance_mm - _TOUCH_MM
    if isinstance(a, Disc) and isinstance(b, Disc):
        return math.hypot(dx, dy) - a.radius_mm - b.radius_mm < clearance_mm - _TOUCH_MM
    (corners_a, round_a), (corners_b, round_b) = _corners(a, 0.0, 0.0), _corners(b, dx, dy)
    enough_mm = round_a + round_b + clearance_mm - _TOUCH_MM
    return _gap_mm(corners_a, corners_b, enough_mm) < enough_mm


def _corners(shape: Footprint, x: float, y: float) -> _Shape:
    if isinstance(shape, Disc):
        return [(x, y)], shape.radius_mm
    if isinstance(shape, Rectangle):
        signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        return [(x + sx * shape.half_x_mm, y + sy * shape.half_y_mm) for sx, sy in signs], 0.0
    return [(x + vx, y + vy) for vx, vy in shape.vertices_mm], 0.0


def _gap_mm(a: list[Point2], b: list[Point2], enough_mm: float = math.inf) -> float:
    """Return the distance of two convex counter-clockwise polygons; minus the depth where they overlap.

    Where it is certainly more than enough, less than the distance may be returned.
    """
    apart_mm = max(_apart_mm(a, b), _apart_mm(b, a))
    if apart_mm <= 0.0 or apart_mm >= enough_mm:
        return apart_mm
    return min(*(_point_to_edges_mm(point, b) for point in a), *(_point_to_edges_mm(point, a) for point in b))


def _apart_mm(a: list[Point2], b: list[Point2]) -> float:
    """Return the widest strip along an edge of ``a`` that parts ``a`` from ``b``; negative where none does.

    Of two points: their distance.
    """
    if len(a) == len(b) == 1:
        return math.dist(a[0], b[0])
    widest = -math.inf
    for (x0, y0), (x1, y1) in zip(a, a[1:] + a[:1], strict=True):
        length = math.hypot(x1 - x0, y1 - y0)
        if length > 0.0:
            nx, ny = (y1 - y0) / length, (x0 - x1) / length
            widest = max(widest, min(nx * (x - x0) + ny * (y - y0) for x, y in b))
    return widest


def _point_to_edges_mm(point: Point2, polygon: list[Point2]) -> float:
    nearest = math.inf
    for (x0, y0), (x1, y1) in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        ex, ey = x1 - x0, y1 - y0
        length2 = ex * ex + ey * ey
        part = max(0.0, min(1.0, ((point[0] - x0) * ex + (point[1] - y0) * ey) / length2)) if length2 > 0.0 else 0.0
        nearest = min(nearest, math.hypot(point[0] - x0 - part * ex, point[1] - y0 - part * ey))
    return nearest


def _unmet_goals(problem: Problem, stands: list[int]) -> list[str]:
    if isinstance(problem.goal, AssignGoal):
        unmet = [
            f"object {item} stands on place {place}, allowed are {sorted(problem.goal.allowed[item])}"
            for item, place in enumerate(stands)
            if place not in problem.goal.allowed[item]
        ]
        return unmet + [f"place {place} is empty" for place in sorted(problem.goal.must_fill - set(stands))]
    return _unmet_ranks(problem, problem.goal, stands)


def _unmet_ranks(problem: Problem, goal: RankGoal, stands: list[int]) -> list[str]:
    unmet = [
        f"object {i} stands on place {place}, which has no rank"
        for i, place in enumerate(stands)
        if place not in goal.slots
    ]
    if unmet:
        return unmet
    for earlier in problem.objects:
        for later in problem.objects:
            in_order = goal.slots.index(stands[earlier.id]) < goal.slots.index(stands[later.id])
            if in_order and later.height_mm - earlier.height_mm > goal.tolerance_mm + _HEIGHT_EQUAL_MM:
                unmet.append(
                    f"object {later.id} ({later.height_mm} mm) stands behind object {earlier.id} "
                    f"({earlier.height_mm} mm)"
                )
    return unmet
