"""The cell's own problem: perceived workpieces on the table, and what a goal rule wants of them.

Each workpiece's perceived place is a slot, and its reference point is its footprint's centroid. Without another rule
the highest goes to the slot with the largest y (the paper, "Recognition and relocation"). A workpiece keeps its
orientation when moved, unless the rule says at which yaw parts are put down on a place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.alarms import AlarmError
from srvs_cell.planning.access import Access
from srvs_cell.planning.buffers import Workspace, find_buffer
from srvs_cell.planning.carrying import Carry, turn_to_deg
from srvs_cell.planning.clearance import convex_hull
from srvs_cell.planning.goals import goal_rule
from srvs_cell.planning.problem import FingerGrip, Obstacle, Palm, Polygon, Problem, ProblemObject
from srvs_cell.planning.rules import HeightOrder, Standing
from srvs_cell.planning.uncertainty import (
    SIGMAS,
    finger_growth_mm,
    footprint_growth_mm,
    grown,
    sigma_mm,
    top_mm,
    wider,
)
from srvs_cell.scene import UNKNOWN_KIND, Place, PlaceKind, Point2, Workpiece

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from srvs_cell.planning.hand import HandMotion
    from srvs_cell.planning.kept_places import KeptPlaces
    from srvs_cell.planning.parameters import PlanningParameters
    from srvs_cell.planning.rules import Rule
    from srvs_cell.scene import Grasp


@dataclass(frozen=True)
class TableProblem:
    """A problem made of workpieces.

    Attributes:
        problem: the problem; its first places are the slots, in the order of its objects.
        workpieces: id of the workpiece behind each object.
        static: ids of the workpieces that are obstacles because they cannot be taken.
        notes: why, one line for each of them.
    """

    problem: Problem
    workpieces: tuple[int, ...]
    static: tuple[int, ...]
    notes: tuple[str, ...]


def table_problem(
    workpieces: Sequence[Workpiece],
    parameters: PlanningParameters,
    workspace: Workspace,
    buffers: int = 1,
    *,
    rule: Rule | None = None,
    hand: HandMotion | None = None,
    kept: KeptPlaces | None = None,
    exact: bool = False,
) -> TableProblem:
    """Make the problem of the workpieces on the table; without a rule that of `HeightOrder`.

    Args:
        workpieces: what was recognised; unknown shapes and workpieces without a grasp become obstacles.
        parameters: tolerances, fingers, buffer places.
        workspace: where the hand may go; workpieces outside it count as out of reach.
        buffers: how many buffer places to look for where none is configured and the order is not kept already.
        rule: what the scene should become.
        hand: how the cell moves the hand; None: heights, reach and joint limits play no part.
        kept: the places of the job, where it has begun already; None: the places where parts stand.
        exact: take the positions for exact, and not for as uncertain as the vision says.

    Raises:
        AlarmError: NO_BUFFER_PLACE where the order is not kept and no free place is found on the table; PLAN_INFEASIBLE
            where the rule finds that it cannot be kept.
    """
    movable = [w for w in workpieces if not why_not_taken(w)]
    static = [w for w in workpieces if why_not_taken(w)]
    centres = [footprint_centroid_mm(w.footprint_mm) for w in movable]
    slots = tuple(Place(i, x, y, PlaceKind.SLOT, workspace.contains(x, y)) for i, (x, y) in enumerate(centres))
    if rule is None:
        rule = HeightOrder(
            height_tolerance_mm=parameters.height_tolerance_mm, place_tolerance_mm=parameters.place_tolerance_mm
        )
    on_place, vacant = ([True] * len(movable), ()) if kept is None else kept.compare(centres)
    choice = rule.choose([Standing(*each) for each in zip(movable, centres, on_place, strict=True)], vacant)
    slots += tuple(
        Place(len(slots) + i, x, y, kind, workspace.contains(x, y)) for i, ((x, y), kind) in enumerate(choice.further)
    )
    access = None if hand is None else Access(hand, parameters.arm, workspace)
    configured = tuple(
        Place(len(slots) + i, x, y, PlaceKind.BUFFER, workspace.contains(x, y))
        for i, (x, y) in enumerate(parameters.buffer_places_mm)
    )
    problem = Problem(
        id="table",
        places=slots + configured,
        objects=tuple(
            replace(
                _object(i, workpiece, centre, parameters, hand, () if exact else workpieces),
                turns_deg=_turns_deg(i, workpiece, choice.yaws_deg),
            )
            for i, (workpiece, centre) in enumerate(zip(movable, centres, strict=True))
        ),
        obstacles=tuple(_obstacle(w, parameters, exact=exact) for w in static),
        goal=choice.goal,
        home_mm=parameters.home_mm,
        clearance_mm=parameters.clearance_mm,
    )
    reached = goal_rule(problem).is_reached(tuple(range(len(movable))))
    allowed = accessible(movable, access)
    if not configured and not reached:
        for _ in range(buffers):
            try:
                problem = find_buffer(problem, workspace, parameters.buffer_grid_mm, allowed)
            except AlarmError:
                # Where places are free from the beginning the search finds out whether that is enough.
                if not choice.further:
                    raise
                break
    return TableProblem(
        with_access(problem, movable, access),
        tuple(w.id for w in movable),
        tuple(w.id for w in static),
        (
            *choice.notes,
            *(f"{_name(w)} stays where it is: {why_not_taken(w)}" for w in static),
            *(
                _out_of_reach(w, centre, workspace)
                for w, centre in zip(movable, centres, strict=True)
                if not workspace.contains(*centre)
            ),
            *(
                ()
                if exact
                else (
                    _uncertain(w, parameters)
                    for w in workpieces
                    if footprint_growth_mm(w, parameters.clearance_mm) > 0.0
                )
            ),
        ),
    )


def accessible(
    movable: Sequence[Workpiece], access: Access | None
) -> Callable[[ProblemObject, NDArray[np.float64]], NDArray[np.bool_]] | None:
    """Return what tells, of an object and points (N, 2), where it can be picked and put down."""
    if access is None:
        return None

    def allowed(item: ProblemObject, points_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
        workpiece = movable[item.id]
        if workpiece.grasp is None:
            return np.zeros(len(points_mm), dtype=bool)
        offsets_mm = points_mm - np.array(footprint_centroid_mm(workpiece.footprint_mm))
        masks = [access.mask(grasp, offsets_mm, item.top_mm) for grasp in workpiece.grasp.choices]
        anyhow: NDArray[np.bool_] = np.any(masks, axis=0)
        return anyhow

    return allowed


def with_access(
    problem: Problem, movable: Sequence[Workpiece], access: Access | None, places: Sequence[Place] | None = None
) -> Problem:
    """Return the problem with the places where each object can be neither picked nor put down.

    Args:
        problem: the problem.
        movable: the workpiece behind each object.
        access: where the hand may go; None: everywhere.
        places: those that are new; what is known of the others stays; None: all.
    """
    if access is None:
        return problem
    new = problem.places if places is None else places
    known = {place.id for place in problem.places} - {place.id for place in new}
    reachable = [place for place in new if place.reachable]
    objects = []
    for item, workpiece in zip(problem.objects, movable, strict=True):
        here = problem.places[item.start]
        grasps = () if workpiece.grasp is None else workpiece.grasp.choices
        carries = [
            Carry((here.x_mm, here.y_mm), (place.x_mm, place.y_mm), item.turn_deg(place.id)) for place in reachable
        ]
        # Per grasp, per place.
        why_not = [access.why_not(grasp, carries, item.top_mm) for grasp in grasps]
        grips = tuple(
            replace(
                grip,
                blocked=(
                    *(place for place in grip.blocked if place in known),
                    *(place.id for place, reason in zip(reachable, reasons, strict=True) if reason),
                ),
            )
            for grip, reasons in zip(item.grips, why_not, strict=True)
        )
        blocked = {place: reason for place, reason in item.blocked if place in known}
        for place, *reasons in zip(reachable, *why_not, strict=True):
            if reasons and all(reasons):
                blocked[place.id] = reasons[0]
        for place in new:
            if place.id not in blocked and place.id != item.start and (unseen := access.why_unseen(item, place)):
                blocked[place.id] = unseen
        objects.append(replace(item, grips=grips, blocked=tuple(blocked.items())))
    return replace(problem, objects=tuple(objects))


def _turns_deg(start: int, workpiece: Workpiece, yaws_deg: Mapping[int, float]) -> tuple[tuple[int, float], ...]:
    """Return by how much a workpiece is turned on the places that say a yaw; where it stands it has its own."""
    turns_deg = ((place, turn_to_deg(workpiece, yaw_deg)) for place, yaw_deg in yaws_deg.items() if place != start)
    return tuple((place, turn_deg) for place, turn_deg in turns_deg if turn_deg != 0.0)


def footprint_centroid_mm(footprint_mm: NDArray[np.float64]) -> Point2:
    """Return the centroid of the area of a convex polygon of shape (N, 2); of its vertices where it has no area."""
    hull = convex_hull(footprint_mm)
    following = np.roll(hull, -1, axis=0)
    cross = hull[:, 0] * following[:, 1] - following[:, 0] * hull[:, 1]
    twice_area = float(cross.sum())
    if twice_area <= 0.0:
        x, y = hull.mean(axis=0)
    else:
        x, y = ((hull + following) * cross[:, None]).sum(axis=0) / (3.0 * twice_area)
    return float(x), float(y)


def _relative_polygon(footprint_mm: NDArray[np.float64], centre_mm: Point2) -> Polygon:
    hull = convex_hull(footprint_mm - np.array(centre_mm))
    return Polygon(tuple((float(x), float(y)) for x, y in hull))


def _object(
    index: int,
    workpiece: Workpiece,
    centre_mm: Point2,
    parameters: PlanningParameters,
    hand: HandMotion | None,
    uncertain: Sequence[Workpiece],
) -> ProblemObject:
    """Return the object of a workpiece; with ``uncertain`` workpieces around, room for three sigma is kept."""
    footprint = _relative_polygon(workpiece.footprint_mm, centre_mm)
    grasps = () if workpiece.grasp is None else workpiece.grasp.choices
    grips = tuple(_grip(grasp, centre_mm, parameters, hand) for grasp in grasps)
    if uncertain:
        footprint = grown(footprint, footprint_growth_mm(workpiece, parameters.clearance_mm))
        growth_mm = finger_growth_mm(workpiece, uncertain)
        grips = tuple(wider(grip, growth_mm) for grip in grips)
    return ProblemObject(
        id=index,
        height_mm=workpiece.height_mm,
        footprint=footprint,
        start=index,
        grips=grips,
        name=_name(workpiece),
        top_mm=top_mm(workpiece, parameters.unknown_height_mm) if uncertain else workpiece.height_mm,
    )


def _grip(grasp: Grasp, centre_mm: Point2, parameters: PlanningParameters, hand: HandMotion | None) -> FingerGrip:
    """Return the room that the hand sweeps: the fingers from closed on the workpiece to open, and the palm.

    What stands lower than the tips, by the clearance at least, may be under them.
    """
    fingers = parameters.fingers
    closed_mm = grasp.opening_mm / 2.0
    open_mm = closed_mm + fingers.clearance_mm if fingers.open_mm is None else max(fingers.open_mm / 2.0, closed_mm)
    tips_mm = 0.0 if hand is None else hand.hang_mm(hand.grasp_pose(grasp)) - parameters.clearance_mm
    palm = None
    if hand is not None and fingers.length_mm is not None:
        along_mm, across_mm = fingers.palm_mm
        palm = Palm(along_mm / 2.0, across_mm / 2.0, tips_mm + fingers.length_mm)
    return FingerGrip(
        name=f"yaw {grasp.yaw_deg:.1f} deg",
        centre_mm=(grasp.position_mm[0] - centre_mm[0], grasp.position_mm[1] - centre_mm[1]),
        yaw_deg=grasp.yaw_deg,
        inner_mm=closed_mm,
        thick_mm=open_mm - closed_mm + fingers.thickness_mm,
        width_mm=fingers.width_mm,
        bottom_mm=max(0.0, tips_mm),
        palm=palm,
    )


def _obstacle(workpiece: Workpiece, parameters: PlanningParameters, *, exact: bool) -> Obstacle:
    """Return a workpiece that stays where it is; however exact its place is, nobody knows what was not seen of it."""
    centre_mm = footprint_centroid_mm(workpiece.footprint_mm)
    growth_mm = 0.0 if exact else footprint_growth_mm(workpiece, parameters.clearance_mm)
    shape = grown(_relative_polygon(workpiece.footprint_mm, centre_mm), growth_mm)
    return Obstacle(shape, *centre_mm, top_mm=top_mm(workpiece, parameters.unknown_height_mm))


def _out_of_reach(workpiece: Workpiece, centre_mm: Point2, workspace: Workspace) -> str:
    return f"{_name(workpiece)} cannot leave: out of reach by {workspace.beyond_mm(*centre_mm):.0f} mm"


def _uncertain(workpiece: Workpiece, parameters: PlanningParameters) -> str:
    room_mm = SIGMAS * sigma_mm(workpiece)
    return (
        f"{_name(workpiece)}: its place is known to {room_mm:.1f} mm (3 sigma) only, more than half the clearance of "
        f"{parameters.clearance_mm:g} mm; places nearer than that count as blocked"
    )


def _name(workpiece: Workpiece) -> str:
    return f"workpiece {workpiece.id} ({workpiece.kind}, {workpiece.height_mm:.1f} mm high)"


def why_not_taken(workpiece: Workpiece) -> str:
    """Return why a workpiece cannot be taken and stays where it is, or an empty string."""
    if workpiece.kind == UNKNOWN_KIND:
        return workpiece.grasp_refusal or "its shape is in no library"
    if workpiece.grasp is None:
        return workpiece.grasp_refusal or "there is no grasp for it"
    return ""
