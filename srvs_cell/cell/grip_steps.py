"""The steps that grip: take a workpiece, put it down, deliver one that was held through a stop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell.interlocks import check_certainty
from srvs_cell.cell.job import Job, Outcome
from srvs_cell.cell.motion import held_part
from srvs_cell.cell.recovery import StepName
from srvs_cell.planning import Approach
from srvs_cell.ports import GripState

if TYPE_CHECKING:
    from srvs_cell.planning import CellMove, LegTops
    from srvs_cell.scene import Workpiece


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
        way = Approach.of(part.place, height_mm, job.equipment.parameters.motion.approach_mm)
        await _put_down(job, way, way)
        return Outcome({"workpiece": part.workpiece, "place": list(part.place.as_tuple())})


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
        job.last_looks.clear()
        carried, hand = job.carried_before(self.move), job.equipment.parameters.hand()
        at = hand.grasp_pose(carried.grasp(workpiece.grasp.choices[self.move.grasp]), self.move.turn_deg)
        part = held_part(workpiece, self.move, at, hand)
        way, lifted = hand.pick_way(at, _tops(job, self.move))
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
        await arm.move_linear(lifted, motion.travel_speed_mm_s, "to travel height")
        await arm.confirm_holding()
        return Outcome(evidence)


@dataclass(frozen=True)
class Place:
    """Put the held workpiece down: above the place, slowly down, open, confirm, up. In a dry run: above it."""

    move: CellMove
    name: StepName = StepName.PLACE

    async def run(self, job: Job) -> Outcome:
        """Place; raises GRIP_LOST where the part was lost on the way."""
        arm, move = job.manipulator, self.move
        if job.dry_run:
            # The hand is above the workpiece that it did not take.
            above = await arm.pose()
            target = replace(above, x_mm=move.to_mm[0], y_mm=move.to_mm[1], r_deg=above.r_deg + move.turn_deg)
            await arm.move_linear(target, job.equipment.parameters.motion.travel_speed_mm_s, "above the place")
        else:
            part = arm.hand.held
            if part is None:
                raise AlarmError(Alarm.GRIP_LOST, f"Workpiece {move.workpiece} is not in the gripper.")
            hand = job.equipment.parameters.hand()
            await _put_down(job, *hand.place_way(part.place, part.hang_mm, _tops(job, move)))
        job.carried[move.workpiece] = job.carried_before(move).then(move.carry)
        job.progress.moves_done += 1
        job.progress.moves_left -= 1
        return Outcome({"workpiece": move.workpiece, "to_mm": list(move.to_mm)})


def _tops(job: Job, move: CellMove) -> LegTops:
    """Return what the hand passes above; in a dry run nothing is where the plan would have it by then."""
    plan = job.progress.plan
    if plan is None:
        raise AlarmError(Alarm.INTERNAL_ERROR, "There is no plan to carry out.")
    return plan.above_all if job.dry_run else move.tops


async def _put_down(job: Job, way: Approach, leave: Approach) -> None:
    """Carry the held part to a place one way, let it go and leave another way."""
    arm, motion = job.manipulator, job.equipment.parameters.motion
    await arm.move_linear(way.above, motion.travel_speed_mm_s, "above the place")
    await arm.confirm_holding()
    if way.near != way.above:
        await arm.move_linear(way.near, motion.travel_speed_mm_s, "approach")
    await arm.move_linear(way.at, motion.approach_speed_mm_s, "down to the place")
    await arm.open("let go")
    job.progress.last_release_s = job.equipment.devices.clock.now_s()
    await arm.move_linear(leave.near, motion.approach_speed_mm_s, "up from the place")
    await arm.move_linear(leave.above, motion.travel_speed_mm_s, "to travel height")
