"""What a job does: look from both ends of the lateral path, perceive, plan, pick and place, look again and verify."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import TYPE_CHECKING

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.calibration import plan_right_pose
from srvs_cell.cell.correction import correction_plan
from srvs_cell.cell.export import plan_json, workpiece_json
from srvs_cell.cell.interlocks import check_certainty, check_frame
from srvs_cell.cell.job import Job, Outcome, Step
from srvs_cell.cell.motion import Approach, grasp_pose, held_part, travel_height_mm
from srvs_cell.cell.recovery import StepName
from srvs_cell.cell.senses import StereoLook
from srvs_cell.geometry import Transform
from srvs_cell.planning import footprint_centroid_mm
from srvs_cell.ports import GripState
from srvs_cell.scene import UNKNOWN_KIND, PlanStatus

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from srvs_cell.geometry import Xyzwpr
    from srvs_cell.planning import CellMove, CellPlan
    from srvs_cell.scene import Perception, Workpiece

_LEVEL_MM = 1.0
_CORRECTABLE_MM = 30.0
"""Farther from its goal a part was not misplaced by the cell: somebody else has moved it."""


def whole_job(*, holding: bool) -> list[Step]:
    """Return the steps of the paper's job; a part that is still held is put where it belongs first."""
    return [Rise(), *([Deliver()] if holding else []), *look(), Plan()]


def look_only() -> list[Step]:
    """Return the steps that look and perceive and grip nothing."""
    return [Rise(), *look()]


def look(*, verifying: bool = False) -> list[Step]:
    """Return the steps of one look along the lateral path."""
    return [ObserveLeft(verifying), MoveLaterally(verifying), ObserveRight(verifying), Perceive(verifying)]


def retreat() -> list[Step]:
    """Return the steps that free the table."""
    return [Rise(StepName.RETREAT)]


def _start_over(*, verifying: bool) -> list[Step]:
    return [*look(verifying=verifying), Verify() if verifying else Plan()]


@dataclass(frozen=True)
class Rise:
    """Go straight up to the observe pose's height, from wherever the last command has left the arm."""

    name: StepName = StepName.RISE

    async def run(self, job: Job) -> Outcome:
        """Rise where the arm is below."""
        await _rise(job, job.equipment.parameters.look.observe_pose.pose().z_mm)
        return Outcome()

    def reobserve(self) -> Sequence[Step]:
        """Rise, then look."""
        return [self, *_start_over(verifying=False)]


@dataclass(frozen=True)
class Deliver:
    """Put a part that was held through a stop where it belongs. New moves, never the interrupted one."""

    name: StepName = StepName.DELIVER

    async def run(self, job: Job) -> Outcome:
        """Put the held part down."""
        await job.manipulator.confirm_holding()
        part = job.manipulator.hand.held
        if part is None:
            raise AlarmError(Alarm.GRIPPER_OCCUPIED, "It is not known where the held part belongs.")
        height_mm = job.equipment.parameters.look.observe_pose.pose().z_mm
        await _put_down(job, part.place, height_mm, height_mm)
        return Outcome({"workpiece": part.workpiece, "place": list(part.place.as_tuple())})

    def reobserve(self) -> Sequence[Step]:
        """Rise, then look."""
        return [Rise(), *_start_over(verifying=False)]


@dataclass(frozen=True)
class ObserveLeft:
    """Take the left image at the observe pose."""

    verifying: bool = False
    name: StepName = StepName.OBSERVE_LEFT

    async def run(self, job: Job) -> Outcome:
        """Move to the observe pose and take an image."""
        parameters = job.equipment.parameters
        target = parameters.look.observe_pose.pose()
        if job.looks == 0:
            speed_percent = parameters.motion.joint_speed_percent
            pose = await job.manipulator.move_joint(target, speed_percent, "left end of the lateral path")
        else:
            await _rise(job, target.z_mm)
            speed_mm_s = parameters.motion.travel_speed_mm_s
            pose = await job.manipulator.move_linear(target, speed_mm_s, "left end of the lateral path")
        job.left = (await _grab(job, f"left_{job.looks}"), Transform.from_xyzwpr("base", "tcp", pose))
        return Outcome({"pose": list(pose.as_tuple())})

    def reobserve(self) -> Sequence[Step]:
        """Look again."""
        return _start_over(verifying=self.verifying)


@dataclass(frozen=True)
class MoveLaterally:
    """Move the camera sideways to the right end of the lateral path, and work on the left image meanwhile."""

    verifying: bool = False
    name: StepName = StepName.MOVE_LATERALLY

    async def run(self, job: Job) -> Outcome:
        """Move."""
        parameters = job.equipment.parameters
        left_end = Transform.from_xyzwpr("base", "tcp", parameters.look.observe_pose.pose())
        right_end = plan_right_pose(job.equipment.calibration, left_end, parameters.look.baseline_mm)
        speed_mm_s = parameters.motion.approach_speed_mm_s
        early = asyncio.create_task(_analyse_left(job, right_end))
        try:
            pose = await job.manipulator.move_linear(right_end.to_xyzwpr(), speed_mm_s, "right end of the lateral path")
            job.early = await early
        finally:
            early.cancel()
        return Outcome({"pose": list(pose.as_tuple())})

    def reobserve(self) -> Sequence[Step]:
        """Look again."""
        return _start_over(verifying=self.verifying)


@dataclass(frozen=True)
class ObserveRight:
    """Take the right image."""

    verifying: bool = False
    name: StepName = StepName.OBSERVE_RIGHT

    async def run(self, job: Job) -> Outcome:
        """Take an image."""
        pose = await job.manipulator.pose()
        job.right = (await _grab(job, f"right_{job.looks}"), Transform.from_xyzwpr("base", "tcp", pose))
        return Outcome({"pose": list(pose.as_tuple())})

    def reobserve(self) -> Sequence[Step]:
        """Look again."""
        return _start_over(verifying=self.verifying)


@dataclass(frozen=True)
class Perceive:
    """Turn the two images into workpieces."""

    verifying: bool = False
    name: StepName = StepName.PERCEIVE

    async def run(self, job: Job) -> Outcome:
        """Perceive; raises NOTHING_SEEN on an empty table, unless parts are expected there."""
        if job.left is None or job.right is None:
            raise AlarmError(Alarm.INTERNAL_ERROR, "An image of the stereo pair was not taken.")
        stereo = StereoLook(job.left[0], job.right[0], job.left[1], job.right[1], job.early)
        job.left = job.right = job.early = None
        perception = await job.in_thread(lambda: job.equipment.perceive(stereo))
        evidence = await self._record(job, perception)
        job.looks += 1
        if not perception.workpieces and not self.verifying:
            raise AlarmError(Alarm.NOTHING_SEEN, f"{len(perception.matches)} planes were matched, none is a workpiece.")
        for workpiece in perception.workpieces:
            if workpiece.kind == UNKNOWN_KIND:
                x_mm, y_mm, _ = workpiece.position_mm
                job.warn(Alarm.UNKNOWN_OBJECT, f"At x = {x_mm:.0f} mm, y = {y_mm:.0f} mm.")
        return Outcome(evidence)

    async def _record(self, job: Job, perception: Perception) -> dict[str, object]:
        workpieces = [workpiece_json(workpiece) for workpiece in perception.workpieces]
        progress = job.progress
        if self.verifying:
            progress.verified = perception.workpieces
        else:
            progress.workpieces = perception.workpieces
        for name, elapsed_ms in perception.timings_ms.items():
            key = f"perceive.{name}"
            progress.timings_ms[key] = progress.timings_ms.get(key, 0.0) + elapsed_ms
        content = {
            "verifying": self.verifying,
            "planes": [len(perception.left.planes), len(perception.right.planes)],
            "matches": len(perception.matches),
            "workpieces": workpieces,
            "timings_ms": perception.timings_ms,
        }
        await job.save_json(f"perception_{job.looks}", content)
        for name, picture in job.equipment.pictures(perception).items():
            await job.save_image(f"{name}_{job.looks}", picture)
        return {"workpieces": len(workpieces), "matches": len(perception.matches)}

    def reobserve(self) -> Sequence[Step]:
        """Look again."""
        return _start_over(verifying=self.verifying)


@dataclass(frozen=True)
class Plan:
    """Plan the relocation of what was perceived and put its moves into the queue."""

    name: StepName = StepName.PLAN

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
            steps += _start_over(verifying=True)
        return Outcome({"moves": len(plan.moves), "status": relocation.status.value}, steps)

    def reobserve(self) -> Sequence[Step]:
        """Look again."""
        return _start_over(verifying=False)


@dataclass(frozen=True)
class Pick:
    """Take a workpiece: above it, slowly down, close, confirm, slowly up. In a dry run: above it."""

    workpiece: Workpiece
    move: CellMove
    name: StepName = StepName.PICK

    async def run(self, job: Job) -> Outcome:
        """Pick; raises GRIP_EMPTY where nothing was there."""
        workpiece, arm, motion = self.workpiece, job.manipulator, job.equipment.parameters.motion
        if workpiece.grasp is None:
            raise AlarmError(Alarm.PLAN_INFEASIBLE, f"Workpiece {workpiece.id}: {workpiece.grasp_refusal}.")
        check_certainty(workpiece, job.equipment.parameters.tolerance)
        offset_mm = job.offsets_mm.get(workpiece.id, (0.0, 0.0))
        at = grasp_pose(workpiece.grasp, offset_mm, motion, await arm.pose())
        part = held_part(workpiece, self.move, at, job.equipment.parameters.table_z_mm, motion)
        way = Approach.of(at, _travel_z_mm(job), motion.approach_mm)
        evidence: dict[str, object] = {"workpiece": workpiece.id, "kind": workpiece.kind, "grasp": list(at.as_tuple())}
        await arm.move_linear(way.above, motion.travel_speed_mm_s, "above the workpiece")
        if job.dry_run:
            return Outcome(evidence)
        if await job.equipment.devices.gripper.state() is not GripState.OPEN:
            await arm.open("open before the pick")
        if way.near != way.above:
            await arm.move_linear(way.near, motion.travel_speed_mm_s, "approach")
        await arm.move_linear(way.at, motion.approach_speed_mm_s, "down to the workpiece")
        try:
            await arm.close(part)
        except AlarmError as error:
            if error.alarm is Alarm.GRIP_EMPTY:
                await arm.open("open after an empty grip")
                await arm.move_linear(way.above, motion.approach_speed_mm_s, "up from an empty grip")
            raise
        await arm.move_linear(way.near, motion.approach_speed_mm_s, "up with the workpiece")
        lifted = replace(way.above, z_mm=max(way.near.z_mm, _travel_z_mm(job, part.hang_mm)))
        await arm.move_linear(lifted, motion.travel_speed_mm_s, "to travel height")
        await arm.confirm_holding()
        return Outcome(evidence)

    def reobserve(self) -> Sequence[Step]:
        """Look again: the workpiece is not where it was seen."""
        return _start_over(verifying=False)


@dataclass(frozen=True)
class Place:
    """Put the held workpiece down: above the place, slowly down, open, confirm, up. In a dry run: above it."""

    move: CellMove
    name: StepName = StepName.PLACE

    async def run(self, job: Job) -> Outcome:
        """Place; raises GRIP_LOST where the part was lost on the way."""
        arm, move = job.manipulator, self.move
        if job.dry_run:
            target = replace(
                await arm.pose(), x_mm=move.to_mm[0], y_mm=move.to_mm[1], z_mm=_travel_z_mm(job)
            )  # fmt: skip
            await arm.move_linear(target, job.equipment.parameters.motion.travel_speed_mm_s, "above the place")
        else:
            part = arm.hand.held
            if part is None:
                raise AlarmError(Alarm.GRIP_LOST, f"Workpiece {move.workpiece} is not in the gripper.")
            await _put_down(job, part.place, _travel_z_mm(job, part.hang_mm), _travel_z_mm(job))
        x_mm, y_mm = job.offsets_mm.get(move.workpiece, (0.0, 0.0))
        job.offsets_mm[move.workpiece] = (
            x_mm + move.to_mm[0] - move.from_mm[0],
            y_mm + move.to_mm[1] - move.from_mm[1],
        )
        job.progress.moves_done += 1
        job.progress.moves_left -= 1
        return Outcome({"workpiece": move.workpiece, "to_mm": list(move.to_mm)})

    def reobserve(self) -> Sequence[Step]:
        """Look again."""
        return _start_over(verifying=False)


@dataclass(frozen=True)
class Verify:
    """Compare what is seen after the relocation with where every workpiece should stand, moved or not."""

    name: StepName = StepName.VERIFY

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
        return [*steps, *_start_over(verifying=True)]

    def reobserve(self) -> Sequence[Step]:
        """Look again."""
        return _start_over(verifying=True)


async def _analyse_left(job: Job, right_end: Transform) -> object:
    analyse, left = job.equipment.analyse_left, job.left
    if analyse is None or left is None:
        return None
    image, base_T_tcp_left = left
    return await job.in_thread(lambda: analyse(image, base_T_tcp_left, right_end))


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


def _travel_z_mm(job: Job, hang_mm: float = 0.0) -> float:
    parameters = job.equipment.parameters
    tallest_mm = max((workpiece.height_mm for workpiece in job.progress.workpieces), default=0.0)
    return travel_height_mm(parameters.table_z_mm, tallest_mm, parameters.motion.clearance_mm, hang_mm)


async def _rise(job: Job, z_mm: float) -> None:
    """Go straight up to a height; nothing where the arm is there or higher."""
    pose = await job.manipulator.pose()
    if pose.z_mm < z_mm - _LEVEL_MM:
        speed_mm_s = job.equipment.parameters.motion.approach_speed_mm_s
        await job.manipulator.move_linear(replace(pose, z_mm=z_mm), speed_mm_s, "straight up")


async def _put_down(job: Job, place: Xyzwpr, loaded_z_mm: float, free_z_mm: float) -> None:
    """Carry the held part to a place at one height, let it go and leave at another."""
    arm, motion = job.manipulator, job.equipment.parameters.motion
    way = Approach.of(place, loaded_z_mm, motion.approach_mm)
    await arm.move_linear(way.above, motion.travel_speed_mm_s, "above the place")
    await arm.confirm_holding()
    if way.near != way.above:
        await arm.move_linear(way.near, motion.travel_speed_mm_s, "approach")
    await arm.move_linear(way.at, motion.approach_speed_mm_s, "down to the place")
    await arm.open("let go")
    job.progress.last_release_s = job.equipment.devices.clock.now_s()
    leave = Approach.of(place, free_z_mm, motion.approach_mm)
    await arm.move_linear(leave.near, motion.approach_speed_mm_s, "up from the place")
    await arm.move_linear(leave.above, motion.travel_speed_mm_s, "to travel height")


async def _grab(job: Job, name: str) -> NDArray[np.uint8]:
    """Return a frame exposed after the arm has settled, of the calibrated size, and record it."""
    look_parameters, devices = job.equipment.parameters.look, job.equipment.devices
    await devices.clock.sleep(look_parameters.settle_s)
    not_before_s = devices.clock.now_s()
    frame = await devices.camera.grab(not_before_s, look_parameters.frame_timeout_s)
    check_frame(frame, not_before_s, job.equipment.calibration.camera)
    if job.progress.first_image_s is None:
        job.progress.first_image_s = frame.exposed_at_s
    await job.save_image(name, frame.image)
    return frame.image
