"""What a job does: look from both ends of the lateral path, perceive, plan, pick and place, look again and verify."""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import itemgetter
from typing import TYPE_CHECKING, ClassVar

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell.correction import correction_plan
from srvs_cell.cell.export import plan_json
from srvs_cell.cell.grip_steps import Deliver, Pick, Place
from srvs_cell.cell.interlocks import check_certainty
from srvs_cell.cell.job import Job, Outcome, Step
from srvs_cell.cell.look_steps import Rise, look
from srvs_cell.cell.recovery import StepName
from srvs_cell.planning import footprint_centroid_mm
from srvs_cell.scene import PlanStatus

if TYPE_CHECKING:
    from srvs_cell.config import ToleranceParameters
    from srvs_cell.planning import CellPlan
    from srvs_cell.scene import Workpiece

_FURTHER_LOOKS = 3
"""Looks beyond those that must agree, before an operator is asked."""
_CORRECTABLE_MM = 30.0
"""Farther from its goal a part was not misplaced by the cell: somebody else has moved it."""


def whole_job(*, holding: bool) -> list[Step]:
    """Return the steps of the paper's job; a part that is still held is put where it belongs first."""
    return [Rise(), *([Deliver()] if holding else []), *start_over(verifying=False)]


def look_only() -> list[Step]:
    """Return the steps that look and perceive and grip nothing."""
    return [Rise(), *look()]


def retreat() -> list[Step]:
    """Return the steps that free the table."""
    return [Rise(StepName.RETREAT)]


def start_over(*, verifying: bool) -> list[Step]:
    """Return the steps that look anew, and verify what was relocated or plan what is to be relocated."""
    return [*look(verifying=True), Verify()] if verifying else [*look(), Confirm(), Plan()]


@dataclass(frozen=True)
class Confirm:
    """Believe what was seen when enough looks in a row saw the same: an unseen part is one that the arm may hit."""

    name: StepName = StepName.CONFIRM
    verifying: ClassVar[bool] = False

    async def run(self, job: Job) -> Outcome:
        """Look again until the looks agree; raises LOOKS_DISAGREE where they do not within a few."""
        wanted, tolerance = job.equipment.parameters.look.agreeing_looks, job.equipment.parameters.tolerance
        job.sightings.append(job.progress.workpieces)
        seen = [len(sighting) for sighting in job.sightings]
        last = job.sightings[-wanted:]
        if len(last) == wanted and all(_same_parts(one, last[-1], tolerance) for one in last):
            job.sightings.clear()
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
    verifying: ClassVar[bool] = False

    async def run(self, job: Job) -> Outcome:
        """Plan; raises PLAN_INFEASIBLE with the reason for each workpiece."""
        workpieces = job.progress.workpieces
        plan = await job.in_thread(lambda: job.equipment.plan(workpieces))
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
            check_certainty(by_id[move.workpiece], job.equipment.parameters.tolerance)
        job.progress.plan, job.progress.moves_left = plan, len(plan.moves)
        job.offsets_mm = {}
        steps: list[Step] = []
        for move in plan.moves:
            steps += [Pick(by_id[move.workpiece], move), Place(move)]
        if steps and not job.dry_run:
            steps += start_over(verifying=True)
        return Outcome({"moves": len(plan.moves), "status": relocation.status.value}, steps)


@dataclass(frozen=True)
class Verify:
    """Compare what is seen after the relocation with where every workpiece should stand, moved or not."""

    name: StepName = StepName.VERIFY
    verifying: ClassVar[bool] = True

    async def run(self, job: Job) -> Outcome:
        """Compare; put parts that are only a little off onto their goals.

        Raises VERIFY_FAILED naming each workpiece that is not at its goal.
        """
        tolerance, plan = job.equipment.parameters.tolerance, job.progress.plan
        if plan is None:
            raise AlarmError(Alarm.INTERNAL_ERROR, "There is no plan to verify.")
        found = _find(job)
        errors_mm: dict[int, float | None] = {}
        off: dict[int, Workpiece] = {}
        wrong = []
        for goal in plan.goals:
            if not goal.visible:
                continue
            distance_mm, workpiece = found[goal.workpiece]
            errors_mm[goal.workpiece] = None if workpiece is None else round(distance_mm, 3)
            if distance_mm > tolerance.verify_mm:
                where = "not seen" if workpiece is None else f"{distance_mm:.1f} mm from its goal"
                x_mm, y_mm = goal.point_mm
                wrong.append(f"workpiece {goal.workpiece} is {where} ({x_mm:.1f}, {y_mm:.1f})")
                if workpiece is not None and distance_mm <= _CORRECTABLE_MM:
                    off[goal.workpiece] = workpiece
        errors = {str(identifier): error_mm for identifier, error_mm in errors_mm.items()}
        evidence = {"tolerance_mm": tolerance.verify_mm, "errors_mm": errors, "wrong": wrong}
        await job.save_json(f"verify_{job.looks - 1}", evidence)
        if not wrong:
            job.progress.workpieces = job.progress.verified
            return Outcome(evidence)
        distinct = len({workpiece.id for workpiece in off.values()}) == len(wrong)
        if distinct and job.corrections < job.equipment.parameters.retries.verify:
            return Outcome(evidence, await self._correct(job, plan, off))
        raise AlarmError(Alarm.VERIFY_FAILED, f"{'; '.join(wrong)} (allowed {tolerance.verify_mm} mm).")

    async def _correct(self, job: Job, former: CellPlan, off: dict[int, Workpiece]) -> list[Step]:
        """Return the steps that bring misplaced parts onto their goals and verify again."""
        job.corrections += 1
        seen_mm = {identifier: footprint_centroid_mm(workpiece.footprint_mm) for identifier, workpiece in off.items()}
        plan = await job.in_thread(lambda: correction_plan(former, seen_mm))
        content = plan_json(plan)
        await job.save_json(f"correction_{job.looks - 1}", content)
        await job.journal_event("plan", "correction", content)
        if not plan.moves or any(move.workpiece not in off for move in plan.moves):
            reasons = "; ".join(plan.relocation.reasons) or "another part would have to be moved"
            raise AlarmError(Alarm.VERIFY_FAILED, f"Misplaced parts cannot be put right: {reasons}.")
        job.offsets_mm = {}
        job.progress.moves_left += len(plan.moves)
        steps: list[Step] = []
        for move in plan.moves:
            steps += [Pick(off[move.workpiece], move), Place(move)]
        return [*steps, *start_over(verifying=True)]


def _same_parts(one: tuple[Workpiece, ...], other: tuple[Workpiece, ...], tolerance: ToleranceParameters) -> bool:
    """Return whether two looks saw the same parts: as many, each at its place and of its height."""
    return len(one) == len(other) and all(
        any(
            math.dist(a.position_mm[:2], b.position_mm[:2]) <= tolerance.verify_mm
            and abs(a.height_mm - b.height_mm) <= tolerance.verify_height_mm
            for b in other
        )
        for a in one
    )


def _find(job: Job) -> dict[int, tuple[float, Workpiece | None]]:
    """Return, for each workpiece that has a goal, the nearest part of its height and its distance from the goal."""
    plan, height_tolerance_mm = job.progress.plan, job.equipment.parameters.tolerance.verify_height_mm
    heights_mm = {workpiece.id: workpiece.height_mm for workpiece in job.progress.workpieces}
    found: dict[int, tuple[float, Workpiece | None]] = {}
    for goal in () if plan is None else plan.goals:
        best: tuple[float, Workpiece | None] = (math.inf, None)
        for workpiece in job.progress.verified:
            if abs(workpiece.height_mm - heights_mm[goal.workpiece]) <= height_tolerance_mm:
                distance_mm = math.dist(footprint_centroid_mm(workpiece.footprint_mm), goal.point_mm)
                best = min(best, (distance_mm, workpiece), key=itemgetter(0))
        found[goal.workpiece] = best
    return found
