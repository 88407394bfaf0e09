"""A job: a queue of steps, each with evidence and an outcome, and what an error in one of them leads to."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import structlog

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell.journal import JOB_PLACES, GripperKnowledge
from srvs_cell.cell.recovery import BETTER_SEEN_AGAIN, CARRYING, Recovery, StepName, decide
from srvs_cell.planning import Carry

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from srvs_cell.calibration import Calibration
    from srvs_cell.cell.devices import Devices
    from srvs_cell.cell.job_places import JobPlaces
    from srvs_cell.cell.journal import Journal
    from srvs_cell.cell.manipulator import Manipulator
    from srvs_cell.cell.recorder import RunRecorder
    from srvs_cell.cell.senses import AnalyseLeft, Perceive, Pictures, PlanJob
    from srvs_cell.config import CellParameters
    from srvs_cell.geometry import Transform
    from srvs_cell.planning import CellMove, CellPlan
    from srvs_cell.scene import Point2, Workpiece

_log = structlog.stdlib.get_logger("srvs_cell.cell")

T = TypeVar("T")
Json = dict[str, Any]


@dataclass(frozen=True)
class Outcome:
    """What a step leaves.

    Attributes:
        evidence: for the journal.
        following: steps to be done next, before those that were already waiting.
    """

    evidence: Json = field(default_factory=dict)
    following: Sequence[Step] = ()


class Step(Protocol):
    """One step of a job."""

    @property
    def name(self) -> StepName:
        """Which step it is."""
        ...

    async def run(self, job: Job) -> Outcome:
        """Do the step; raises `AlarmError` where it cannot be done."""
        ...


class End(StrEnum):
    """How a call of `Job.run` ended."""

    FINISHED = "finished"
    PAUSED = "paused"
    FAILED = "failed"


@dataclass(frozen=True)
class JobEnd:
    """How a call of `Job.run` ended; with what recovery and error where it failed."""

    end: End
    recovery: Recovery | None = None
    error: AlarmError | None = None


@dataclass(frozen=True, eq=False)
class Equipment:
    """What every job works with."""

    parameters: CellParameters
    devices: Devices
    journal: Journal
    recorder: RunRecorder
    calibration: Calibration
    perceive: Perceive
    plan: PlanJob
    pictures: Pictures
    analyse_left: AnalyseLeft | None = None
    in_every_look: Callable[[Workpiece], bool] = lambda _: True


@dataclass
class Progress:
    """What a job has come to, for the snapshot.

    Attributes:
        step: the step that is being done.
        workpieces: of the perception that was planned with, after the verification of that one.
        verified: of the look after the relocation.
        plan: the plan that is being carried out.
        moves_done: finished moves of this job, also of earlier plans.
        moves_left: moves of the present plan that are not finished.
        timings_ms: per step, summed over the job; vision's own steps as ``perceive.NAME``.
        artefacts: name -> path of what was written to the run folder.
        first_image_s: clock time of the job's first exposure.
        last_release_s: clock time at which the last part was let go.
    """

    step: StepName | None = None
    workpieces: tuple[Workpiece, ...] = ()
    verified: tuple[Workpiece, ...] = ()
    plan: CellPlan | None = None
    moves_done: int = 0
    moves_left: int = 0
    timings_ms: dict[str, float] = field(default_factory=dict)
    artefacts: dict[str, str] = field(default_factory=dict)
    first_image_s: float | None = None
    last_release_s: float | None = None

    @property
    def job_time_s(self) -> float | None:
        """The paper's figure: time from the first image to the last release."""
        if self.first_image_s is None or self.last_release_s is None:
            return None
        return self.last_release_s - self.first_image_s


class Job:
    """The job's queue, its memory and its services to the steps.

    Attributes:
        equipment: devices, journal, callables.
        manipulator: the only way to move.
        dry_run: move above the parts without gripping.
        progress: for the snapshot.
        left, right: the images and poses of the present look.
        early: what was made of the left image while the arm travelled.
        looks: finished looks.
        aside: looks are taken from aside: it changes with every look that was doubted.
        last_looks: what the last look from the observe pose (False) and from aside (True) saw since the last pick.
        places: the places that the job is about; before it has planned those of a former one that is not finished.
        sightings: what each look saw since the last confirmation.
        carried: how each workpiece has been carried since it was perceived.
        finish: end at the next moment at which the gripper is empty.
    """

    def __init__(
        self,
        equipment: Equipment,
        manipulator: Manipulator,
        steps: Sequence[Step],
        *,
        start_over: Callable[[], Sequence[Step]],
        run: int,
        folder: Path,
        dry_run: bool,
        places: JobPlaces | None,
        on_change: Callable[[], None],
        warn: Callable[[Alarm, str], None],
    ) -> None:
        self.equipment = equipment
        self.manipulator = manipulator
        self.run_number = run
        self.folder = folder
        self.dry_run = dry_run
        self.progress = Progress()
        self.left: tuple[NDArray[np.uint8], Transform] | None = None
        self.right: tuple[NDArray[np.uint8], Transform] | None = None
        self.early: Any = None
        self.looks = 0
        self.aside = False
        self.last_looks: dict[bool, tuple[Workpiece, ...]] = {}
        self.places = places
        self.sightings: list[tuple[Workpiece, ...]] = []
        self.carried: dict[int, Carry] = {}
        self.finish = False
        self._steps: deque[Step] = deque(steps)
        self._start_over = start_over
        self._attempts: Counter[tuple[StepName, Alarm]] = Counter()
        self._on_change = on_change
        self.warn = warn

    async def run(self, *, single_step: bool = False) -> JobEnd:
        """Do the steps that are waiting, or only the next one."""
        while self._steps:
            if self.finish and self.manipulator.hand.knowledge is GripperKnowledge.EMPTY:
                return JobEnd(End.FINISHED)
            step = self._steps.popleft()
            if (failed := await self._do(step)) is not None:
                return failed
            if single_step and self._steps:
                return JobEnd(End.PAUSED)
        return JobEnd(End.FINISHED)

    def carried_before(self, move: CellMove) -> Carry:
        """Return how a move's workpiece had been carried before it, since it was perceived."""
        return self.carried.get(move.workpiece, Carry(move.from_mm, move.from_mm))

    def next_step(self) -> StepName | None:
        """Return the step that is waiting at the head of the queue."""
        return self._steps[0].name if self._steps else None

    async def in_thread(self, work: Callable[[], T]) -> T:
        """Run a computation in a worker thread while a simulated clock stands still."""
        with self.equipment.devices.clock.working():
            return await asyncio.to_thread(work)

    async def save_image(self, name: str, image: NDArray[np.uint8]) -> None:
        """Write an image into the run folder and journal its path."""
        path = await self.in_thread(lambda: self.equipment.recorder.image(self.folder, name, image))
        await self._artefact(name, path)

    async def save_json(self, name: str, content: Json) -> None:
        """Write JSON into the run folder and journal its path."""
        path = await self.in_thread(lambda: self.equipment.recorder.json(self.folder, name, content))
        await self._artefact(name, path)

    async def journal_event(self, kind: str, name: str, detail: Json) -> None:
        """Record an event of this job."""
        with self.equipment.devices.clock.working():
            await self.equipment.journal.event(kind, name, run=self.run_number, source="job", detail=detail)

    async def keep_places(self, places: JobPlaces | None) -> None:
        """Record the places that the job is about, on disk before anything moves; None: it is finished."""
        if self.dry_run or places == self.places:
            return
        await self.journal_event(
            JOB_PLACES, "forgotten" if places is None else "kept", places.as_json() if places else {}
        )
        self.places = places

    async def places_to_keep(self, standing_mm: Sequence[Point2], tolerance_mm: float) -> JobPlaces | None:
        """Return the places to plan on: the job's own, or those of a former job where the parts allow it.

        What becomes of a former job is logged and journalled.
        """
        places = self.places
        if places is None or places.run == self.run_number:
            return places
        reason = places.why_given_up(standing_mm, tolerance_mm)
        said = "given up" if reason else "continued"
        _log.info("unfinished job", begun_by=places.begun_by, run=self.run_number, places=said, reason=reason)
        await self.journal_event("unfinished_job", said, {"begun_by": places.begun_by, "reason": reason})
        return None if reason else places

    def forget_failures(self, step: StepName) -> None:
        """Begin to count anew how often a step has failed: the job has come forward."""
        for key in [key for key in self._attempts if key[0] is step]:
            del self._attempts[key]

    def changed(self) -> None:
        """Say that the progress has changed."""
        self._on_change()

    async def _artefact(self, name: str, path: Path) -> None:
        self.progress.artefacts[name] = str(path)
        await self.journal_event("artefact", name, {"path": str(path)})

    async def _named_alarms(self, step: Step) -> Outcome:
        """Run a step; whatever it fails with that has no name becomes INTERNAL_ERROR."""
        try:
            return await step.run(self)
        except AlarmError:
            raise
        except Exception as error:
            _log.exception("a step failed", step=step.name.value, run=self.run_number)
            raise AlarmError(Alarm.INTERNAL_ERROR, f"{type(error).__name__}: {error}.") from error

    async def _do(self, step: Step) -> JobEnd | None:
        """Do one step; return how the job ended where it did."""
        clock = self.equipment.devices.clock
        self.progress.step = step.name
        self.changed()
        await self.journal_event("step", step.name.value, {"phase": "begin"})
        started_s = clock.now_s()
        try:
            outcome = await self._named_alarms(step)
        except AlarmError as error:
            recovery = decide(step.name, error.alarm, self._attempts, self.equipment.parameters.retries)
            self._attempts[step.name, error.alarm] += 1
            detail: Json = {
                "phase": "failed",
                "alarm": error.alarm.name,
                "detail": error.detail,
                "recovery": recovery.value,
            }
            if error.alarm is not Alarm.JOURNAL_FAILED:
                await self.journal_event("step", step.name.value, detail)
            if recovery is Recovery.RETRY:
                self._steps.appendleft(step)
            elif recovery is Recovery.REOBSERVE:
                if step.name in CARRYING:
                    self.warn(Alarm.SCENE_CHANGED, error.detail)
                if error.alarm in BETTER_SEEN_AGAIN:
                    self.aside = not self.aside
                # Nothing of the former plan is continued.
                self._steps = deque(self._start_over())
                self.progress.plan, self.progress.moves_left = None, 0
            else:
                return JobEnd(End.FAILED, recovery, error)
            return None
        self._steps.extendleft(reversed(outcome.following))
        elapsed_ms = (clock.now_s() - started_s) * 1000.0
        timings = self.progress.timings_ms
        timings[step.name.value] = timings.get(step.name.value, 0.0) + elapsed_ms
        detail = {"phase": "done", "elapsed_ms": round(elapsed_ms, 3), **outcome.evidence}
        await self.journal_event("step", step.name.value, detail)
        self.changed()
        return None
