"""What a job does: look from both ends of the lateral path, perceive, plan, pick and place, look again and verify."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell.expectation import compare, expected_now
from srvs_cell.cell.export import plan_json
from srvs_cell.cell.grip_steps import Deliver, Pick, Place
from srvs_cell.cell.interlocks import check_certainty
from srvs_cell.cell.job import Job, Outcome, Step
from srvs_cell.cell.job_places import JobPlaces
from srvs_cell.cell.look_steps import Rise, look
from srvs_cell.cell.recovery import StepName
from srvs_cell.planning import KeptPlaces, footprint_centroid_mm, why_not_taken
from srvs_cell.scene import UNKNOWN_KIND, PlanStatus

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.config import ToleranceParameters
    from srvs_cell.planning import CellPlan
    from srvs_cell.scene import Point2, Workpiece

_FURTHER_LOOKS = 3
"""Looks beyond those that must agree, before an operator is asked."""


def whole_job(*, holding: bool) -> list[Step]:
    """Return the steps of the paper's job; a part that is still held is put where it belongs first."""
    return [Rise(), *([Deliver()] if holding else []), *start_over()]


def look_only() -> list[Step]:
    """Return the steps that look and perceive and grip nothing."""
    return [Rise(), *look()]


def retreat() -> list[Step]:
    """Return the steps that free the table."""
    return [Rise(StepName.RETREAT)]


def start_over() -> list[Step]:
    """Return the steps that look anew and plan from what is seen."""
    return [*look(), Confirm(), Plan()]


@dataclass(frozen=True)
class Confirm:
    """Believe what was seen when enough looks in a row saw the same: an unseen part is one that the arm may hit.

    Of each part the look counts that knows it best.
    """

    name: StepName = StepName.CONFIRM

    async def run(self, job: Job) -> Outcome:
        """Look again until the looks agree; raises LOOKS_DISAGREE where they do not within a few."""
        wanted, tolerance = job.equipment.parameters.look.agreeing_looks, job.equipment.parameters.tolerance
        job.sightings.append(job.progress.workpieces)
        seen = [len(sighting) for sighting in job.sightings]
        last = job.sightings[-wanted:]
        if len(last) == wanted and all(_same_parts(one, last[-1], tolerance) for one in last):
            job.sightings.clear()
            job.progress.workpieces = tuple(_surest(workpiece, last) for workpiece in last[-1])
            return Outcome({"parts": seen})
        if len(job.sightings) >= wanted + _FURTHER_LOOKS:
            job.sightings.clear()
            raise AlarmError(
                Alarm.LOOKS_DISAGREE, f"{', '.join(map(str, seen))} parts were seen in looks at the same table."
            )
        return Outcome({"parts": seen}, [*look(), self])


@dataclass(frozen=True)
class Plan:
    """Plan the relocation of what was perceived and put its moves into the queue."""

    name: StepName = StepName.PLAN

    async def run(self, job: Job) -> Outcome:
        """Plan; raises PLAN_INFEASIBLE with the reason for each workpiece, and PART_LEFT where none may be left."""
        workpieces, parameters = job.progress.workpieces, job.equipment.parameters
        if left := "; ".join(_left(workpiece) for workpiece in workpieces if why_not_taken(workpiece)):
            if parameters.unmovable_parts == "hold":
                raise AlarmError(Alarm.PART_LEFT, f"{left}. Nothing was moved for this plan.")
            job.warn(Alarm.PART_LEFT, f"{left}.")
        tolerance_mm = parameters.tolerance.verify_mm
        standing = [footprint_centroid_mm(w.footprint_mm) for w in workpieces if not why_not_taken(w)]
        places = await job.places_to_keep(standing, tolerance_mm)
        kept = None if places is None else KeptPlaces(places.points_mm, tolerance_mm)
        plan = await job.in_thread(lambda: job.equipment.plan(workpieces, kept))
        relocation = plan.relocation
        content = plan_json(plan)
        await job.save_json(f"plan_{job.looks - 1}", content)
        await job.journal_event("plan", relocation.status.value, content)
        unplanned = relocation.status is PlanStatus.NOT_PROVEN and not relocation.moves
        if relocation.status is PlanStatus.INFEASIBLE or unplanned:
            raise AlarmError(Alarm.PLAN_INFEASIBLE, f"{'; '.join(relocation.reasons)}.")
        if relocation.status is PlanStatus.NOT_PROVEN:
            job.warn(
                Alarm.PLAN_NOT_PROVEN,
                f"{len(relocation.moves)} moves (at least {relocation.bound_moves}), "
                f"{relocation.travel_mm:.0f} mm (at least {relocation.bound_travel_mm:.0f} mm).",
            )
        by_id = {workpiece.id: workpiece for workpiece in workpieces}
        for move in plan.moves:
            check_certainty(by_id[move.workpiece], parameters.tolerance)
        job.progress.plan, job.progress.moves_left = plan, len(plan.moves)
        job.carried = {}
        await job.keep_places(_places(job, places, plan, standing) if plan.moves else None)
        steps: list[Step] = []
        for number, move in enumerate(plan.moves, start=1):
            steps += [Pick(by_id[move.workpiece], move), Place(move)]
            if parameters.look.verify == "each_move" or number == len(plan.moves):
                steps += [*look(verifying=True), Verify()]
        if job.dry_run:
            steps = [step for step in steps if isinstance(step, Pick | Place)]
        return Outcome({"moves": len(plan.moves), "status": relocation.status.value}, steps)


@dataclass(frozen=True)
class Verify:
    """Compare what is seen after a move, or after the last one, with where everything should stand by then.

    One look is not believed against the plan: what it finds changed is looked at again, from aside.
    """

    again: bool = False
    name: StepName = StepName.VERIFY

    async def run(self, job: Job) -> Outcome:
        """Compare; raises VERIFY_FAILED naming what was moved, is missing or was added, on which the job plans anew."""
        tolerance, plan = job.equipment.parameters.tolerance, job.progress.plan
        if plan is None:
            raise AlarmError(Alarm.INTERNAL_ERROR, "There is no plan to verify.")
        expected = expected_now(plan, job.progress.workpieces, job.carried)
        found = compare(expected, job.progress.verified, tolerance)
        errors = {str(identifier): error_mm for identifier, error_mm in found.errors_mm.items()}
        evidence = {"tolerance_mm": tolerance.verify_mm, "errors_mm": errors, "changes": list(found.changes)}
        await job.save_json(f"verify_{job.looks - 1}", evidence)
        if found.changes and not self.again:
            job.aside = not job.aside
            return Outcome(evidence, [*look(verifying=True), Verify(again=True)])
        if found.changes:
            # This look counts where several must agree before the new plan; whoever came to stand here has a place.
            job.sightings = [job.progress.verified]
            if job.places is not None:
                known = job.places.points_mm
                added = [new for new in found.added_mm if all(math.dist(new, p) > tolerance.verify_mm for p in known)]
                await job.keep_places(replace(job.places, points_mm=(*known, *added)))
            changes = "; ".join(found.changes)
            job.warn(Alarm.SCENE_CHANGED, f"After move {job.progress.moves_done}: {changes}.")
            raise AlarmError(Alarm.VERIFY_FAILED, f"{changes} (allowed {tolerance.verify_mm} mm).")
        job.forget_failures(self.name)
        if not job.progress.moves_left:
            job.progress.workpieces = job.progress.verified
            await job.keep_places(None)
        return Outcome(evidence)


def _places(job: Job, former: JobPlaces | None, plan: CellPlan, standing: Sequence[Point2]) -> JobPlaces:
    """Return what a job, also another one, has to know of its places to go on after this plan."""
    if former is None:
        former = JobPlaces(job.run_number, job.run_number, tuple(standing))
    into_bin = sum(not goal.visible for goal in plan.goals)
    return replace(
        former,
        run=job.run_number,
        waits_mm=tuple(dict.fromkeys((*former.waits_mm, *plan.buffers_mm))),
        fewer=max(0, len(former.points_mm) - len(standing)) + into_bin,
    )


def _left(workpiece: Workpiece) -> str:
    x_mm, y_mm, _ = workpiece.position_mm
    return f"workpiece {workpiece.id} ({workpiece.kind}) at ({x_mm:.0f}, {y_mm:.0f}): {why_not_taken(workpiece)}"


def _surest(workpiece: Workpiece, looks: Sequence[tuple[Workpiece, ...]]) -> Workpiece:
    """Return what the look that knows a part and its place best says of it, under its number in the last look."""
    same = [min(look, key=lambda one: math.dist(one.position_mm, workpiece.position_mm)) for look in looks]
    best = min(same, key=lambda one: (one.kind == UNKNOWN_KIND, float(np.trace(one.covariance_mm2))))
    return replace(best, id=workpiece.id)


def _same_parts(one: tuple[Workpiece, ...], other: tuple[Workpiece, ...], tolerance: ToleranceParameters) -> bool:
    """Return whether two looks saw the same parts: as many, each at its place and of its height, which orders them."""
    return len(one) == len(other) and all(
        any(
            math.dist(a.position_mm[:2], b.position_mm[:2]) <= tolerance.verify_mm
            and abs(a.height_mm - b.height_mm) <= tolerance.verify_height_mm
            for b in other
        )
        for a in one
    )
