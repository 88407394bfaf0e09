"""A second plan for parts that were put down near their goals but not on them: the goals stay, the parts are moved."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.planning import AssignGoal, CellPlan, cell_moves, plan, validate
from srvs_cell.scene import Place, PlaceKind

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srvs_cell.scene import Point2


def correction_plan(former: CellPlan, seen_mm: Mapping[int, Point2]) -> CellPlan:
    """Return the validated moves that bring misplaced workpieces from where they are seen to their goals.

    Args:
        former: the plan that was carried out; footprints, grips, obstacles and goals are taken from it.
        seen_mm: for each misplaced workpiece of that plan, where its reference point is seen.

    Raises:
        AlarmError: PLAN_INVALID where the validator refuses the planner's plan.
    """
    problem, goals = former.table.problem, former.goals
    count = len(goals)
    spots = list(seen_mm)
    places = [
        Place(i, *goal.point_mm, PlaceKind.SLOT if goal.visible else PlaceKind.BIN) for i, goal in enumerate(goals)
    ]
    places += [Place(count + i, *seen_mm[workpiece], PlaceKind.LOOSE) for i, workpiece in enumerate(spots)]
    starts = [count + spots.index(goal.workpiece) if goal.workpiece in seen_mm else i for i, goal in enumerate(goals)]
    task = replace(
        problem,
        id="correction",
        places=tuple(places),
        objects=tuple(replace(item, start=start) for item, start in zip(problem.objects, starts, strict=True)),
        goal=AssignGoal(tuple(frozenset({i}) for i in range(count)), frozenset()),
    )
    answer = plan(task)
    refusal = validate(task, answer.moves) if answer.moves else []
    if refusal:
        raise AlarmError(Alarm.PLAN_INVALID, f"Correction: {'; '.join(refusal)}.")
    return replace(
        former,
        table=replace(former.table, problem=task),
        relocation=answer,
        moves=cell_moves(task, answer.moves, [goal.workpiece for goal in goals]),
        buffers_mm=(),
    )
