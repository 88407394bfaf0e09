"""The steps that look: from both ends of the lateral path, and what is perceived there."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.calibration import moved_aside, plan_right_pose
from srvs_cell.cell.export import workpiece_json
from srvs_cell.cell.hidden_parts import with_hidden
from srvs_cell.cell.interlocks import check_frame
from srvs_cell.cell.job import Job, Outcome, Step
from srvs_cell.cell.recovery import StepName
from srvs_cell.cell.senses import StereoLook
from srvs_cell.geometry import Transform
from srvs_cell.planning import why_not_taken
from srvs_cell.scene import UNKNOWN_KIND

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from srvs_cell.scene import Perception, Workpiece

_LEVEL_MM = 1.0


def look(*, verifying: bool = False) -> list[Step]:
    """Return the steps of one look along the lateral path; a verifying one leaves what the plan was made from."""
    return [ObserveLeft(), MoveLaterally(), ObserveRight(), Perceive(verifying)]


@dataclass(frozen=True)
class Rise:
    """Go straight up to the observe pose's height, from wherever the last command has left the arm."""

    name: StepName = StepName.RISE

    async def run(self, job: Job) -> Outcome:
        """Rise where the arm is below."""
        parameters = job.equipment.parameters
        await _rise(job, parameters.look.observe_pose.pose().z_mm, parameters.motion.approach_speed_mm_s)
        return Outcome()


@dataclass(frozen=True)
class ObserveLeft:
    """Take the left image at the observe pose, or a little aside of it."""

    name: StepName = StepName.OBSERVE_LEFT

    async def run(self, job: Job) -> Outcome:
        """Move to the left end of the lateral path and take an image."""
        parameters = job.equipment.parameters
        target = _left_end(job).to_xyzwpr()
        if job.looks == 0:
            speed_percent = parameters.motion.joint_speed_percent
            pose = await job.manipulator.move_joint(target, speed_percent, "left end of the lateral path")
        else:
            # In a job the hand is above what stands around it by then.
            speed_mm_s = parameters.motion.travel_speed_mm_s
            await _rise(job, target.z_mm, speed_mm_s)
            pose = await job.manipulator.move_linear(target, speed_mm_s, "left end of the lateral path")
        job.left = (await _grab(job, f"left_{job.looks}"), Transform.from_xyzwpr("base", "tcp", pose))
        return Outcome({"pose": list(pose.as_tuple())})


@dataclass(frozen=True)
class MoveLaterally:
    """Move the camera sideways to the right end of the lateral path, and work on the left image meanwhile."""

    name: StepName = StepName.MOVE_LATERALLY

    async def run(self, job: Job) -> Outcome:
        """Move."""
        parameters = job.equipment.parameters
        right_end = plan_right_pose(job.equipment.calibration, _left_end(job), parameters.look.baseline_mm)
        speed_mm_s = parameters.motion.approach_speed_mm_s
        early = asyncio.create_task(_analyse_left(job, right_end))
        try:
            pose = await job.manipulator.move_linear(right_end.to_xyzwpr(), speed_mm_s, "right end of the lateral path")
            job.early = await early
        finally:
            early.cancel()
        return Outcome({"pose": list(pose.as_tuple())})


@dataclass(frozen=True)
class ObserveRight:
    """Take the right image."""

    name: StepName = StepName.OBSERVE_RIGHT

    async def run(self, job: Job) -> Outcome:
        """Take an image."""
        pose = await job.manipulator.pose()
        job.right = (await _grab(job, f"right_{job.looks}"), Transform.from_xyzwpr("base", "tcp", pose))
        return Outcome({"pose": list(pose.as_tuple())})


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
        parts = with_hidden(
            perception.workpieces,
            job.last_looks.get(not job.aside, ()),
            job.equipment.in_every_look,
            job.equipment.parameters.tolerance.verify_mm,
        )
        job.last_looks[job.aside] = perception.workpieces
        evidence = await self._record(job, perception, parts)
        job.looks += 1
        if not parts and not self.verifying:
            raise AlarmError(Alarm.NOTHING_SEEN, f"{len(perception.matches)} planes were matched, none is a workpiece.")
        unknown = [workpiece for workpiece in parts if workpiece.kind == UNKNOWN_KIND]
        if unknown:
            where = "; ".join(_where_and_why(workpiece) for workpiece in unknown)
            job.warn(Alarm.UNKNOWN_OBJECT, f"At {where}.")
        return Outcome(evidence)

    async def _record(self, job: Job, perception: Perception, parts: tuple[Workpiece, ...]) -> dict[str, object]:
        workpieces = [workpiece_json(workpiece) for workpiece in parts]
        progress = job.progress
        if self.verifying:
            progress.verified = parts
        else:
            progress.workpieces = parts
        for name, elapsed_ms in perception.timings_ms.items():
            key = f"perceive.{name}"
            progress.timings_ms[key] = progress.timings_ms.get(key, 0.0) + elapsed_ms
        content = {
            "verifying": self.verifying,
            "planes": [len(perception.left.planes), len(perception.right.planes)],
            "matches": len(perception.matches),
            "ambiguous_px": [list(plane.centre_px) for plane in perception.ambiguous_planes],
            "workpieces": workpieces,
            "from_other_look": len(parts) - len(perception.workpieces),
            "timings_ms": perception.timings_ms,
        }
        await job.save_json(f"perception_{job.looks}", content)
        for name, picture in job.equipment.pictures(perception).items():
            await job.save_image(f"{name}_{job.looks}", picture)
        return {"workpieces": len(workpieces), "matches": len(perception.matches)}


def _where_and_why(workpiece: Workpiece) -> str:
    x_mm, y_mm, _ = workpiece.position_mm
    return f"x = {x_mm:.0f} mm, y = {y_mm:.0f} mm ({why_not_taken(workpiece)})"


def _left_end(job: Job) -> Transform:
    """Return where the present look begins: at the observe pose, or aside where that was doubtful."""
    parameters, calibration = job.equipment.parameters.look, job.equipment.calibration
    observe = Transform.from_xyzwpr("base", "tcp", parameters.observe_pose.pose())
    return moved_aside(calibration, observe, *parameters.aside_mm) if job.aside else observe


async def _analyse_left(job: Job, right_end: Transform) -> object:
    analyse, left = job.equipment.analyse_left, job.left
    if analyse is None or left is None:
        return None
    image, base_T_tcp_left = left
    return await job.in_thread(lambda: analyse(image, base_T_tcp_left, right_end))


async def _rise(job: Job, z_mm: float, speed_mm_s: float) -> None:
    """Go straight up to a height; nothing where the arm is there or higher."""
    pose = await job.manipulator.pose()
    if pose.z_mm < z_mm - _LEVEL_MM:
        await job.manipulator.move_linear(replace(pose, z_mm=z_mm), speed_mm_s, "straight up")


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
