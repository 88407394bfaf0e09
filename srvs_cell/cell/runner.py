"""The unit's present job: begun, continued step by step, finished, halted. At most one runs, in a task of its own.

The task is never cancelled in the middle of a motion: whoever waits for it is shielded, whoever wants it to end asks
the arm to stop and waits for the motion's outcome.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell.job import End, Job
from srvs_cell.cell.journal import JOB_PLACES, GripperKnowledge
from srvs_cell.cell.manipulator import Manipulator
from srvs_cell.cell.notices import CELL
from srvs_cell.cell.packml import Mode
from srvs_cell.cell.recorder import RUN_FOLDER
from srvs_cell.cell.steps import look_only, retreat, start_over, whole_job
from srvs_cell.ports import PortError

if TYPE_CHECKING:
    from asyncio import Task
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from srvs_cell.cell.job import Equipment, JobEnd, Step
    from srvs_cell.cell.job_places import JobPlaces
    from srvs_cell.cell.manipulator import Hand
    from srvs_cell.cell.notices import Notices
    from srvs_cell.ports import RobotStatus

_STOP_REPEAT_S = 0.2


class JobRunner:
    """The present job and its task.

    Attributes:
        job: the present or the last job, or None before the first one.
        paused: whether it waits between two single steps.
        runs_done: jobs that were finished.
        left_places: places of the job that the last process has left unfinished.
    """

    def __init__(
        self, equipment: Equipment, hand: Hand, notices: Notices, on_status: Callable[[RobotStatus], None]
    ) -> None:
        self.job: Job | None = None
        self.paused = False
        self.runs_done = 0
        self.left_places: JobPlaces | None = None
        self._equipment, self._devices = equipment, equipment.devices
        self._hand, self._notices = hand, notices
        self._on_status = on_status
        self._task: Task[JobEnd] | None = None

    @property
    def running(self) -> bool:
        """Whether a job is being done."""
        return self._task is not None and not self._task.done()

    @property
    def moving(self) -> bool:
        """Whether a motion of the job is between its intent and its outcome."""
        return self.running and self.job is not None and self.job.manipulator.busy

    @property
    def places(self) -> JobPlaces | None:
        """Places of the job that is not finished; the next one goes on on them."""
        return self.left_places if self.job is None else self.job.places

    async def forget_places(self) -> None:
        """Let the next job take the places where the parts then stand; between two jobs."""
        entry = self._notices.event(JOB_PLACES, "forgotten", CELL, {})
        await self._notices.written(entry)
        self.left_places = None
        if self.job is not None:
            self.job.places = None

    async def run(self, mode: Mode) -> JobEnd:
        """Do a new job, or the next step of the paused one, and journal how it ended."""
        job = self.job
        if self.paused and job is not None:
            # The hold between two single steps has halted the former one for good.
            job.manipulator = self._make_manipulator(job.run_number)
        else:
            job = await self._begin(mode)
        self.paused = False
        self._task = asyncio.create_task(job.run(single_step=mode is Mode.MANUAL))
        end = await asyncio.shield(self._task)
        if end.end is End.PAUSED:
            self.paused = True
        elif end.end is End.FINISHED:
            await self._journal_end(job, "finished")
            self.runs_done += 1
        elif end.error is None or end.error.alarm is not Alarm.JOURNAL_FAILED:
            await self._journal_end(job, "halted" if end.error is None else end.error.alarm.name)
        # Not before: where a command comes while the journal writes, `halt` still has to tell what the job ended with.
        self._task = None
        if not self.paused:
            job.progress.step = None
        return end

    async def finish(self) -> None:
        """Let the job finish the part that it has in hand; raises what it ended with."""
        if self.job is not None and self._task is not None:
            self.job.finish = True
            end = await asyncio.shield(self._task)
            self._task = None
            await self._journal_end(self.job, end.end.value)
            if end.error is not None:
                raise end.error
        self.paused = False

    async def free_table(self) -> None:
        """Move the arm away after the job, as part of its run; raises what went wrong."""
        if self.job is None:
            return
        former = self.job
        self.job = self._make_job(retreat(), former.run_number, former.folder, dry_run=former.dry_run)
        self.job.progress = former.progress
        self._task = asyncio.create_task(self.job.run())
        end = await asyncio.shield(self._task)
        self._task = None
        self.job.progress.step = None
        if end.error is not None:
            raise end.error

    def forbid_motion(self, reason: str) -> None:
        """Let nothing begin to move any more in the present job; what moves is stopped by `halt`."""
        if self.job is not None:
            self.job.manipulator.halt(reason)

    async def halt(self, reason: str) -> None:
        """Let the job end: at once where nothing moves, by a stop request where something does.

        Raises:
            AlarmError: what the job ended with, if that is not the stop; MOTION_OUTCOME_UNKNOWN where the motion does
                not end in time.
        """
        job, task, clock = self.job, self._task, self._devices.clock
        if job is None or task is None:
            return
        self.paused = False
        job.manipulator.halt(reason)
        limit_s = self._equipment.parameters.motion.stop_timeout_s
        deadline_s = clock.now_s() + limit_s
        while not task.done():
            if job.manipulator.busy and clock.now_s() < deadline_s:
                await self._request_stop()
                await self._wait(task, _STOP_REPEAT_S)
                continue
            late = job.manipulator.busy
            task.cancel()
            await asyncio.wait({task})
            if late:
                self._hand.knowledge = GripperKnowledge.UNKNOWN
                raise AlarmError(
                    Alarm.MOTION_OUTCOME_UNKNOWN, f"The motion did not end within {limit_s} s of the stop request."
                )
        self._task = None
        job.progress.step = None
        end = None if task.cancelled() else task.result()
        await self._notices.noted(self._notices.journal.end_run(job.run_number, "halted"))
        if end is not None and end.error is not None and end.error.alarm is not Alarm.MOTION_STOPPED:
            raise end.error

    async def _begin(self, mode: Mode) -> Job:
        holding = self._hand.knowledge is GripperKnowledge.HOLDING
        steps = look_only() if mode is Mode.MAINTENANCE else whole_job(holding=holding)
        recorder, journal = self._equipment.recorder, self._notices.journal
        run = await self._notices.written(journal.begin_run(mode.title, str(recorder.state_dir / RUN_FOLDER)))
        with self._devices.clock.working():
            folder = await asyncio.to_thread(recorder.begin, run)
            unresolved = await journal.unresolved_runs()
            removed = await asyncio.to_thread(recorder.prune, run, unresolved)
        if removed:
            event = journal.event("prune", "run folders", run=run, source=CELL, detail={"runs": removed})
            await self._notices.written(event)
        self.job = self._make_job(steps, run, folder, dry_run=mode is Mode.DRY_RUN)
        self._notices.run = run
        return self.job

    def _make_manipulator(self, run: int) -> Manipulator:
        return Manipulator(
            self._equipment.parameters,
            self._devices,
            self._notices.journal,
            self._hand,
            self._equipment.calibration.robot,
            self._on_status,
            run,
        )

    def _make_job(self, steps: Sequence[Step], run: int, folder: Path, *, dry_run: bool) -> Job:
        return Job(
            self._equipment,
            self._make_manipulator(run),
            steps,
            start_over=start_over,
            run=run,
            folder=folder,
            dry_run=dry_run,
            places=self.places,
            on_change=self._notices.changed,
            warn=lambda alarm, detail: self._notices.raise_alarm(AlarmError(alarm, detail)),
        )

    async def _journal_end(self, job: Job, outcome: str) -> None:
        await self._notices.written(self._notices.journal.end_run(job.run_number, outcome))

    async def _request_stop(self) -> None:
        try:
            await self._devices.arm.request_stop()
        except PortError as error:
            # The wire is gone: the move itself will say so; the robot's own heartbeat check stops the arm.
            self._notices.raise_alarm(error)

    async def _wait(self, task: Task[Any], seconds: float) -> None:
        """Wait until a task is done, at most some seconds of the cell's clock."""
        timer = asyncio.create_task(self._devices.clock.sleep(seconds))
        try:
            await asyncio.wait({task, timer}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            timer.cancel()
            await asyncio.gather(timer, return_exceptions=True)
