"""Plan for the cell: workpieces in, validated moves in millimetres out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.planning.planner import has_plan, plan
from srvs_cell.planning.rules import make_rule
from srvs_cell.planning.table import TableProblem, table_problem
from srvs_cell.planning.validator import validate
from srvs_cell.scene import PlaceKind, PlanStatus, Point2, RelocationPlan

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.planning.buffers import Workspace
    from srvs_cell.planning.parameters import PlanningParameters
    from srvs_cell.planning.rules import Rule
    from srvs_cell.scene import Workpiece


@dataclass(frozen=True)
class CellMove:
    """One pick and place: a workpiece's footprint centroid goes from one point to another, its yaw stays.

    Attributes:
        workpiece: `Workpiece.id`.
        from_mm, to_mm: x and y of the footprint's centroid on the table, base frame.
    """

    workpiece: int
    from_mm: Point2
    to_mm: Point2


@dataclass(frozen=True)
class CellGoal:
    """Where a workpiece's footprint centroid has to be in the end, moved or not."""

    workpiece: int
    point_mm: Point2


@dataclass(frozen=True)
class CellPlan:
    """A validated plan in the cell's terms.

    Attributes:
        table: the problem that was planned.
        relocation: the planner's answer; its reasons also say which workpieces were left as obstacles.
        moves: the moves in order.
        goals: one per movable workpiece; empty where there is no plan.
        buffers_mm: the buffer places, configured or found.
    """

    table: TableProblem
    relocation: RelocationPlan
    moves: tuple[CellMove, ...]
    goals: tuple[CellGoal, ...]
    buffers_mm: tuple[Point2, ...]


def plan_relocation(
    workpieces: Sequence[Workpiece], parameters: PlanningParameters, workspace: Workspace, rule: Rule | None = None
) -> CellPlan:
    """Plan what the goal rule wants for what was perceived, and replay the plan in the validator.

    Where one buffer place that was found is not enough, more are looked for.

    Args:
        workpieces: what was recognised.
        parameters: tolerances, fingers, buffer places, caps.
        workspace: where the hand may go.
        rule: the goal rule; None for the one that the parameters name.

    Returns:
        the plan; an infeasible one is returned, with its reasons, not raised.

    Raises:
        AlarmError: NO_BUFFER_PLACE; UNCERTAIN_POSITION where there is a plan, but not with three sigma of room around
            what was perceived; PLAN_INVALID where the validator refuses the planner's plan.
    """
    if rule is None and (parameters.rule != "height_order" or parameters.rule_settings):
        rule = make_rule(parameters.rule, parameters.rule_settings)
    try:
        table = table_problem(workpieces, parameters, workspace, rule=rule)
    except AlarmError as error:
        if error.alarm is Alarm.NO_BUFFER_PLACE and _is_solvable_if_exact(workpieces, parameters, workspace, 1, rule):
            raise _too_uncertain((error.detail.rstrip("."),), ()) from error
        raise
    answer = plan(table.problem, parameters.limits)
    found = sum(place.kind is PlaceKind.BUFFER for place in table.problem.places)
    if found and not parameters.buffer_places_mm:
        for buffers in range(found + 1, parameters.max_found_buffers + 1):
            if answer.status is not PlanStatus.INFEASIBLE:
                break
            try:
                wider = table_problem(workpieces, parameters, workspace, buffers, rule=rule)
            except AlarmError as error:
                # One place was found before, so that "infeasible" and its reasons say more than the alarm would.
                answer = replace(answer, reasons=(*answer.reasons, f"no further buffer place: {error.detail}"))
                break
            table, answer = wider, plan(wider.problem, parameters.limits)
    if answer.status is PlanStatus.INFEASIBLE and _is_solvable_if_exact(workpieces, parameters, workspace, found, rule):
        raise _too_uncertain(answer.reasons, table.notes)
    return _cell_plan(table, answer)


def _too_uncertain(reasons: tuple[str, ...], notes: tuple[str, ...]) -> AlarmError:
    said = (
        "Blocked by the vision's uncertainty; were positions exact instead of known to 3 sigma, there would be a plan"
    )
    return AlarmError(Alarm.UNCERTAIN_POSITION, f"{said}: {'; '.join((*reasons, *notes))}.")


def _is_solvable_if_exact(
    workpieces: Sequence[Workpiece],
    parameters: PlanningParameters,
    workspace: Workspace,
    buffers: int,
    rule: Rule | None,
) -> bool:
    """Tell whether there would be a plan without the room that is kept for the vision's uncertainty."""
    try:
        exact = table_problem(workpieces, parameters, workspace, max(buffers, 1), rule=rule, exact=True)
    except AlarmError:
        return False
    return has_plan(plan(exact.problem, parameters.limits))


def _cell_plan(table: TableProblem, answer: RelocationPlan) -> CellPlan:
    problem = table.problem
    planned = has_plan(answer)
    refusal = validate(problem, answer.moves) if planned else []
    if refusal:
        raise AlarmError(Alarm.PLAN_INVALID, f"{'; '.join(refusal)}.")
    points = [(place.x_mm, place.y_mm) for place in problem.places]
    ends = {item.id: item.start for item in problem.objects}
    ends |= {move.object: move.to_place for move in answer.moves}
    return CellPlan(
        table=table,
        relocation=replace(answer, reasons=(*answer.reasons, *table.notes)),
        moves=tuple(
            CellMove(table.workpieces[move.object], points[move.from_place], points[move.to_place])
            for move in answer.moves
        ),
        goals=tuple(CellGoal(table.workpieces[i], points[end]) for i, end in ends.items()) if planned else (),
        buffers_mm=tuple(points[place.id] for place in problem.places if place.kind is PlaceKind.BUFFER),
    )
