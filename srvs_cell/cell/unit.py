"""The PackML unit: commands in, acting states that do real work, one snapshot out.

`Unit.run` does the work of the present state. A command changes the state at once; the work of the state that was left
is cancelled, which is always safe because no state's work moves anything itself: motion belongs to the job's task,
which is never cancelled in the middle of a motion but halted, its move stopped on request, and awaited.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import structlog

from srvs_cell.alarms import Alarm, AlarmError, Reaction
from srvs_cell.cell import packml
from srvs_cell.cell.alarm_list import AlarmList
from srvs_cell.cell.export import plan_json, plan_list, status_json, workpiece_json
from srvs_cell.cell.interlocks import check_frame, check_robot_ready
from srvs_cell.cell.job import End, Job
from srvs_cell.cell.journal import GripperKnowledge, utc_now
from srvs_cell.cell.manipulator import Hand, Manipulator
from srvs_cell.cell.motion import HeldPart
from srvs_cell.cell.packml import Command, Mode, State
from srvs_cell.cell.recorder import RUN_FOLDER
from srvs_cell.cell.recovery import Recovery
from srvs_cell.cell.steps import look_only, retreat, whole_job
from srvs_cell.ports import GripState, Lifecycle, PortError

if TYPE_CHECKING:
    from asyncio import Future, Task
    from collections.abc import Awaitable, Callable, Sequence
    from datetime import datetime
    from pathlib import Path

    from srvs_cell.cell.job import Equipment, JobEnd, Step
    from srvs_cell.cell.journal import Journal
    from srvs_cell.ports import Device, RobotStatus

_log = structlog.stdlib.get_logger("srvs_cell.cell")

T = TypeVar("T")
Json = dict[str, Any]

_STOP_REPEAT_S = 0.2
_INTERNAL = "cell"

_GOES_ON = frozenset({Command.CLEAR, Command.RESET, Command.START, Command.UNHOLD, Command.UNSUSPEND, Command.COMPLETE})
"""Commands after which something may move sooner or later: they need to know what the gripper holds."""

_HALTING = frozenset({State.HOLDING, State.STOPPING, State.ABORTING})
_FRESH = frozenset({State.CLEARING, State.RESETTING, State.UNHOLDING, State.UNSUSPENDING})
"""An operator has looked: what was wrong before is either gone or will be found again."""

_ARM_WATCHED = frozenset(State) - {State.ABORTED, State.ABORTING, State.CLEARING}
_READINESS_WATCHED = frozenset(
    {
        State.STARTING,
        State.EXECUTE,
        State.UNHOLDING,
        State.SUSPENDING,
        State.SUSPENDED,
        State.UNSUSPENDING,
        State.COMPLETING,
    }
)
_RESOLVABLE = packml.WAIT_STATES - {State.SUSPENDED}

_FALLBACKS: dict[Recovery, tuple[Command, ...]] = {
    Recovery.SUSPEND: (Command.SUSPEND, Command.HOLD, Command.STOP, Command.ABORT),
    Recovery.HOLD: (Command.HOLD, Command.STOP, Command.ABORT),
    Recovery.STOP: (Command.STOP, Command.ABORT),
    Recovery.ABORT: (Command.ABORT,),
}
"""What a recovery does, and what more severe command stands in where that one is not valid."""

_COMMUNICATION = frozenset(
    {
        Alarm.CONNECTION_REFUSED,
        Alarm.CONNECTION_TIMEOUT,
        Alarm.CONNECTION_LOST,
        Alarm.HEARTBEAT_LOST,
        Alarm.PROTOCOL_ERROR,
        Alarm.PROTOCOL_VERSION,
        Alarm.DEVICE_UNAVAILABLE,
        Alarm.CAMERA_UNAVAILABLE,
        Alarm.MOTION_OUTCOME_UNKNOWN,
    }
)
"""After one of these, the next clear connects every device afresh."""

_RECOVERY_OF = {
    Reaction.SUSPEND: Recovery.SUSPEND,
    Reaction.HOLD: Recovery.HOLD,
    Reaction.STOP: Recovery.STOP,
    Reaction.ABORT: Recovery.ABORT,
}


@dataclass(frozen=True)
class CommandAnswer:
    """What became of a command.

    Attributes:
        accepted: whether it was carried out.
        state: the state after it.
        reason: why it was refused; empty where it was not.
        alarm: the alarm of a refusal.
        leads_there: the commands that lead to where it is valid.
    """

    accepted: bool
    state: State
    reason: str = ""
    alarm: Alarm | None = None
    leads_there: tuple[Command, ...] = ()


class Unit:
    """One cell."""

    def __init__(self, equipment: Equipment, *, simulation: bool, now: Callable[[], datetime] = utc_now) -> None:
        self.equipment = equipment
        self.simulation = simulation
        self._devices, self._journal = equipment.devices, equipment.journal
        self._now = now
        self._state, self._mode = packml.POWER_UP_STATE, Mode.PRODUCTION
        self._hand = Hand(GripperKnowledge.EMPTY)
        self._alarms = AlarmList(now)
        self._status: RobotStatus | None = None
        self._job: Job | None = None
        self._job_task: Task[JobEnd] | None = None
        self._paused = False
        self._resumes_itself = False
        self._reconnect = False
        self._runs_done = 0
        self._version = 0
        self._changed = asyncio.Event()
        self._transitions = asyncio.Event()
        self._pending: set[Future[Any]] = set()
        self._work: dict[State, Callable[[], Awaitable[None]]] = {
            State.CLEARING: self._clear,
            State.RESETTING: self._reset,
            State.STARTING: self._start,
            State.EXECUTE: self._execute,
            State.HOLDING: self._hold,
            State.UNHOLDING: self._unhold,
            State.SUSPENDING: self._finish_job,
            State.SUSPENDED: self._wait_for_parts,
            State.UNSUSPENDING: self._unhold,
            State.COMPLETING: self._complete,
            State.STOPPING: self._stop,
            State.ABORTING: self._abort,
        }

    @property
    def state(self) -> State:
        """The PackML state."""
        return self._state

    @property
    def journal(self) -> Journal:
        """The journal, for reading."""
        return self._journal

    # -- what an operator can do -------------------------------------------------------------------------------------

    async def command(self, command: Command, source: str) -> CommandAnswer:
        """Carry out an operator's command, or refuse it with the reason; a refused command changes nothing.

        Stop, hold and abort keep anything further from moving before this returns.

        Args:
            command: what is asked for.
            source: who asks, for the journal.
        """
        if command is Command.CLEAR and not self._journal.is_open:
            await self._try_journal()
        answer = self._judge(command)
        if answer.accepted:
            self._apply(command, source, "")
            answer = CommandAnswer(accepted=True, state=self._state)
        detail = {"accepted": answer.accepted, "state": answer.state.title, "reason": answer.reason}
        await self._noted(self._journal.event("command", command.title, run=self._run, source=source, detail=detail))
        return answer

    async def set_mode(self, mode: Mode, source: str) -> CommandAnswer:
        """Change the mode; only in Stopped, Idle and Aborted."""
        if self._state in packml.MODE_CHANGE_STATES:
            self._mode = mode
            self._touch()
            answer = CommandAnswer(accepted=True, state=self._state)
        else:
            valid = ", ".join(state.title for state in sorted(packml.MODE_CHANGE_STATES))
            reason = f"The mode cannot be changed in {self._state.title}; it can in {valid}."
            answer = CommandAnswer(False, self._state, reason, Alarm.MODE_REFUSED, (Command.STOP,))
        detail = {"accepted": answer.accepted, "reason": answer.reason}
        await self._noted(self._journal.event("mode", mode.title, run=self._run, source=source, detail=detail))
        return answer

    async def resolve_gripper(self, holds: str, source: str) -> CommandAnswer:
        """Take an operator's word for what the gripper holds, unless its own sensors say otherwise.

        Args:
            holds: ``empty`` or ``holding``.
            source: who says so.
        """
        reason = await self._why_not_resolved(holds)
        if not reason:
            knowledge = GripperKnowledge(holds)
            held = self._hand.held if knowledge is GripperKnowledge.HOLDING else None
            self._hand.knowledge, self._hand.held = knowledge, held
            held_json = None if held is None else held.as_json()
            await self._noted(self._journal.resolve(knowledge, held_json, source))
            for alarm in (Alarm.RESTART_UNRESOLVED, Alarm.GRIPPER_STATE_UNKNOWN, Alarm.GRIPPER_OCCUPIED):
                self._note_cleared(self._alarms.remove(alarm))
            self._touch()
        detail = {"accepted": not reason, "reason": reason}
        await self._noted(self._journal.event("resolve", holds, run=self._run, source=source, detail=detail))
        return CommandAnswer(not reason, self._state, reason, Alarm.COMMAND_REFUSED if reason else None)

    # -- what anybody can see ----------------------------------------------------------------------------------------

    def snapshot(self) -> Json:
        """Return all that is known of the cell, as plain JSON values."""
        job = self._job
        progress = None if job is None else job.progress
        plan = None if progress is None else progress.plan
        held = self._hand.held
        now_s = self._devices.clock.now_s()
        return {
            "version": self._version,
            "state": self._state.title,
            "state_number": int(self._state),
            "mode": self._mode.title,
            "mode_number": int(self._mode),
            "simulation": self.simulation,
            "job": self._run,
            "step": None if progress is None or progress.step is None else progress.step.value,
            "next_step": job.next_step() if job is not None and self._paused else None,
            "workpieces": [] if progress is None else [workpiece_json(w) for w in progress.workpieces],
            "plan": [] if plan is None else plan_list(plan),
            "plan_detail": None if plan is None else plan_json(plan),
            "moves_done": 0 if progress is None else progress.moves_done,
            "moves_total": 0 if progress is None else progress.moves_done + progress.moves_left,
            "alarms": self._alarms.as_json(),
            "gripper": {
                "knowledge": self._hand.knowledge.value,
                "workpiece": None if held is None else held.workpiece,
                "kind": None if held is None else held.kind,
            },
            "arm": None if self._status is None else status_json(self._status, now_s),
            "devices": {
                name: {"lifecycle": device.lifecycle.value, "description": device.description}
                for name, device in self._named_devices()
            },
            "allowed_commands": [command.title for command in Command if self._judge(command).accepted],
            "mode_change_allowed": self._state in packml.MODE_CHANGE_STATES,
            "timings_ms": {} if progress is None else {k: round(v, 3) for k, v in progress.timings_ms.items()},
            "runs_done": self._runs_done,
            "run_directory": None if job is None else str(job.folder),
            "artefacts": {} if progress is None else dict(progress.artefacts),
            "job_time_s": None if progress is None else progress.job_time_s,
            "clock_s": round(now_s, 3),
        }

    async def wait_change(self, version: int) -> int:
        """Return the snapshot's version as soon as it is greater than ``version``."""
        while self._version <= version:
            await self._changed.wait()
        return self._version

    # -- the life of the unit ----------------------------------------------------------------------------------------

    async def run(self) -> None:
        """Do the work of the states until cancelled; a move under way is then stopped on request."""
        await self._take_over()
        monitor = asyncio.create_task(self._monitor())
        try:
            while True:
                await self._do_state()
        finally:
            monitor.cancel()
            await asyncio.gather(monitor, return_exceptions=True)
            await self._leave()

    async def close(self) -> None:
        """Close the journal; after `run` was cancelled."""
        await asyncio.gather(*self._pending, return_exceptions=True)
        await self._journal.close()

    async def _take_over(self) -> None:
        """Learn what the last process left behind; reach the devices, so that they can be read."""
        await self._try_journal()
        for name, device in self._named_devices():
            try:
                await device.connect()
            except PortError as error:
                self._raise(AlarmError(error.alarm, f"{name}: {error.detail}"))
        self._touch()

    async def _try_journal(self) -> None:
        try:
            await self._open_journal()
        except AlarmError as error:
            self._raise(error)

    async def _open_journal(self) -> None:
        """Open the journal; raises RESTART_UNRESOLVED where a person must judge what the last process left."""
        left = await self._written(self._journal.open())
        self._note_cleared(self._alarms.remove(Alarm.JOURNAL_FAILED))
        held = left.held
        if left.motions and held is None:
            held = left.motions[-1]["detail"].get("held")
        if left.unresolved:
            self._hand.knowledge = GripperKnowledge.UNKNOWN
            self._hand.held = None if held is None else HeldPart.from_json(held)
            raise AlarmError(Alarm.RESTART_UNRESOLVED, f"When the last process ended, {left.unresolved}")

    async def _leave(self) -> None:
        """Stop what moves and let go of the devices."""
        if self._job_task is not None and not self._job_task.done():
            await self._halt_job("the daemon ends")
        for _, device in self._named_devices():
            await device.disconnect()

    async def _do_state(self) -> None:
        """Do the work of the present state until it is done or the state is left."""
        state = self._state
        self._transitions.clear()
        left = asyncio.create_task(self._transitions.wait())
        work = asyncio.create_task(self._guarded(self._work[state])) if state in self._work else None
        try:
            await asyncio.wait({task for task in (left, work) if task is not None}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in (left, work):
                if task is not None:
                    task.cancel()
            await asyncio.gather(*(task for task in (left, work) if task is not None), return_exceptions=True)
        # A command that came while the work was finishing has won: only an unchanged state completes.
        if work is not None and not work.cancelled() and self._state is state and not self._transitions.is_set():
            await self._after_work(state, work.result())

    async def _after_work(self, state: State, error: AlarmError | None) -> None:
        if error is not None:
            self._fail(error)
        if state is State.ABORTING or (error is None and state in packml.STATE_COMPLETE):
            self._transition(packml.STATE_COMPLETE[state], "state complete")
        elif self._state is state:
            await self._transitions.wait()

    async def _guarded(self, work: Callable[[], Awaitable[None]]) -> AlarmError | None:
        """Do a state's work; return how it failed, where it did."""
        try:
            await work()
        except AlarmError as error:
            return error
        except Exception as error:  # noqa: BLE001 - the last line: whatever happens ends in a named alarm
            _log.exception("a state's work failed", state=self._state.title)
            return AlarmError(Alarm.INTERNAL_ERROR, f"{type(error).__name__}: {error}")
        return None

    # -- the work of the acting states -------------------------------------------------------------------------------

    async def _clear(self) -> None:
        """Reach what cannot be reached, reset the controller's fault: both only because an operator has asked."""
        await self._written(self._journal.event("clear", "devices", run=None, source=_INTERNAL, detail={}))
        failed = []
        for name, device in self._named_devices():
            try:
                if self._reconnect:
                    await device.disconnect()
                await self._reach(device)
            except PortError as error:
                failed.append((name, error))
        if failed:
            raise AlarmError(failed[0][1].alarm, " ".join(f"{name}: {error.detail}" for name, error in failed))
        self._reconnect = False
        status = await self._read_status()
        if status.fault is not None:
            await self._devices.arm.reset_fault()
            status = await self._read_status()
            if status.fault is not None:
                raise AlarmError(Alarm.ROBOT_FAULT, f"The controller still reports after a reset: {status.fault}.")

    async def _reach(self, device: Device) -> None:
        """Connect a device; an arm that does not answer is connected afresh."""
        if device is self._devices.arm and device.lifecycle is not Lifecycle.DISCONNECTED:
            try:
                await self._devices.arm.status()
            except PortError as error:
                detail = {"alarm": error.alarm.name, "detail": error.detail}
                await self._written(
                    self._journal.event("device", "reconnect arm", run=None, source=_INTERNAL, detail=detail)
                )
                await device.disconnect()
        if device.lifecycle is Lifecycle.DISCONNECTED:
            await device.connect()

    async def _reset(self) -> None:
        """Make everything ready to move, and know what the gripper holds. Moves nothing."""
        await self._activate()
        check_robot_ready(await self._read_status(), self.equipment.calibration.robot)
        await self._compare_gripper()
        self._paused = False

    async def _activate(self) -> None:
        """Allow motion, on an operator's command."""
        for _, device in self._named_devices():
            if device.lifecycle is not Lifecycle.ACTIVE:
                await device.activate()

    async def _compare_gripper(self) -> None:
        """Compare what is known of the gripper with what its sensors say."""
        sensors, known = await self._devices.gripper.state(), self._hand.knowledge
        if sensors is GripState.HOLDING and known is not GripperKnowledge.HOLDING:
            raise AlarmError(Alarm.GRIPPER_OCCUPIED, "The sensors feel a part, none was picked.")
        if known is GripperKnowledge.HOLDING and self._hand.held is None:
            raise AlarmError(Alarm.GRIPPER_OCCUPIED, "It is not known where the part in the gripper belongs.")
        if known is GripperKnowledge.HOLDING and sensors in {GripState.OPEN, GripState.CLOSED_EMPTY}:
            await self._written(self._journal.resolve(GripperKnowledge.EMPTY, None, f"sensors: {sensors.value}"))
            self._hand.knowledge, self._hand.held = GripperKnowledge.EMPTY, None

    async def _start(self) -> None:
        """See whether the camera delivers what the calibration is for."""
        camera, clock = self._devices.camera, self._devices.clock
        not_before_s = clock.now_s()
        frame = await camera.grab(not_before_s, self.equipment.parameters.look.frame_timeout_s)
        check_frame(frame, not_before_s, self.equipment.calibration.camera)

    async def _execute(self) -> None:
        """Do the job, or its next step in Manual; what it comes to is a command like an operator's."""
        if self._paused and self._job is not None:
            # The hold between two single steps has halted the former one for good.
            self._job.manipulator = self._make_manipulator(self._job.run_number)
        else:
            await self._begin_job()
        self._paused = False
        job = self._job
        if job is None:
            raise AlarmError(Alarm.INTERNAL_ERROR, "No job was made.")
        self._job_task = asyncio.create_task(job.run(single_step=self._mode is Mode.MANUAL))
        end = await asyncio.shield(self._job_task)
        await self._job_ended(job, end)

    async def _begin_job(self) -> None:
        holding = self._hand.knowledge is GripperKnowledge.HOLDING
        steps = look_only() if self._mode is Mode.MAINTENANCE else whole_job(holding=holding)
        directory = str(self.equipment.recorder.state_dir / RUN_FOLDER)
        run = await self._written(self._journal.begin_run(self._mode.title, directory))
        with self._devices.clock.working():
            folder = await asyncio.to_thread(self.equipment.recorder.begin, run)
        self._job = self._make_job(steps, run, folder)

    def _make_manipulator(self, run: int) -> Manipulator:
        return Manipulator(
            self.equipment.parameters,
            self._devices,
            self._journal,
            self._hand,
            self.equipment.calibration.robot,
            self._keep_status,
            run,
        )

    def _make_job(self, steps: Sequence[Step], run: int, folder: Path) -> Job:
        return Job(
            self.equipment,
            self._make_manipulator(run),
            steps,
            run=run,
            folder=folder,
            dry_run=self._mode is Mode.DRY_RUN,
            on_change=self._touch,
            warn=lambda alarm, detail: self._raise(AlarmError(alarm, detail)),
        )

    async def _job_ended(self, job: Job, end: JobEnd) -> None:
        self._job_task = None
        if end.end is End.PAUSED:
            self._paused = True
            self._apply(Command.HOLD, _INTERNAL, f"single step done, next: {job.next_step()}")
            return
        if end.end is End.FINISHED:
            self._runs_done += 1
            await self._written(self._journal.end_run(job.run_number, "finished"))
            self._issue((Command.COMPLETE, Command.STOP), "job finished")
            return
        await self._end_failed_run(job, end)
        if end.error is not None and end.recovery is not None:
            self._resumes_itself = end.recovery is Recovery.SUSPEND
            self._raise(end.error)
            self._issue(_FALLBACKS[end.recovery], str(end.error.alarm.name))

    async def _end_failed_run(self, job: Job, end: JobEnd) -> None:
        name = "halted" if end.error is None else end.error.alarm.name
        if end.error is None or end.error.alarm is not Alarm.JOURNAL_FAILED:
            await self._written(self._journal.end_run(job.run_number, name))

    async def _hold(self) -> None:
        """Stand still, keep what is held."""
        await self._halt_job("hold")

    async def _unhold(self) -> None:
        """Make the arm ready again: a stop request has forbidden motion. Execute then looks again and plans anew."""
        await self._activate()
        check_robot_ready(await self._read_status(), self.equipment.calibration.robot)

    async def _finish_job(self) -> None:
        """Let the job finish the part that it has in hand."""
        if self._job is not None and self._job_task is not None:
            self._job.finish = True
            end = await asyncio.shield(self._job_task)
            self._job_task = None
            await self._written(self._journal.end_run(self._job.run_number, end.end.value))
            if end.error is not None:
                raise end.error
        self._paused = False

    async def _wait_for_parts(self) -> None:
        """Look again after the interval, where the cell has suspended itself; otherwise wait for the command."""
        if self._resumes_itself:
            await self._devices.clock.sleep(self.equipment.parameters.look.look_again_s)
            self._apply(Command.UNSUSPEND, _INTERNAL, "look again")

    async def _complete(self) -> None:
        """Finish the part in hand and free the table."""
        await self._finish_job()
        if self._hand.knowledge is not GripperKnowledge.EMPTY:
            raise AlarmError(Alarm.GRIPPER_OCCUPIED, "The job cannot be completed with a part in the gripper.")
        if self._job is not None:
            await self._activate()
            former = self._job
            self._job = self._make_job(retreat(), former.run_number, former.folder)
            self._job.progress = former.progress
            self._job_task = asyncio.create_task(self._job.run())
            end = await asyncio.shield(self._job_task)
            self._job_task = None
            self._job.progress.step = None
            if end.error is not None:
                raise end.error

    async def _stop(self) -> None:
        """Stand still and forbid motion; what is held stays held."""
        await self._halt_job("stop")
        await self._devices.arm.deactivate()
        await self._devices.gripper.deactivate()

    async def _abort(self) -> None:
        """Stand still and forbid motion as far as the devices still answer."""
        try:
            await self._halt_job("abort")
        finally:
            for name, device in self._named_devices():
                await self._deactivate(name, device)

    async def _deactivate(self, name: str, device: Device) -> None:
        if device.lifecycle is not Lifecycle.ACTIVE:
            return
        try:
            await device.deactivate()
        except PortError as error:
            self._raise(AlarmError(error.alarm, f"{name}: {error.detail}"))

    async def _halt_job(self, reason: str) -> None:
        """Let the job end: at once where nothing moves, by a stop request where something does.

        Raises:
            AlarmError: what the job ended with, if that is not the stop; MOTION_OUTCOME_UNKNOWN where the motion does
                not end in time.
        """
        job, task, clock = self._job, self._job_task, self._devices.clock
        if job is None or task is None:
            return
        self._paused = False
        job.manipulator.halt(reason)
        deadline_s = clock.now_s() + self.equipment.parameters.motion.stop_timeout_s
        while not task.done():
            if job.manipulator.busy and clock.now_s() < deadline_s:
                await self._request_stop()
                await self._wait_for(task, _STOP_REPEAT_S)
                continue
            late = job.manipulator.busy
            task.cancel()
            await asyncio.wait({task})
            if late:
                self._hand.knowledge = GripperKnowledge.UNKNOWN
                limit_s = self.equipment.parameters.motion.stop_timeout_s
                raise AlarmError(
                    Alarm.MOTION_OUTCOME_UNKNOWN, f"The motion did not end within {limit_s} s of the stop request."
                )
        self._job_task = None
        job.progress.step = None
        await self._settle_halted(job, task)

    async def _settle_halted(self, job: Job, task: Task[JobEnd]) -> None:
        end = None if task.cancelled() else task.result()
        await self._noted(self._journal.end_run(job.run_number, "halted"))
        if end is not None and end.error is not None and end.error.alarm is not Alarm.MOTION_STOPPED:
            raise end.error

    async def _request_stop(self) -> None:
        try:
            await self._devices.arm.request_stop()
        except PortError as error:
            # The wire is gone: the move itself will say so; the robot's own heartbeat check stops the arm.
            self._raise(error)

    async def _wait_for(self, task: Task[Any], seconds: float) -> None:
        """Wait until a task is done, at most some seconds of the cell's clock."""
        timer = asyncio.create_task(self._devices.clock.sleep(seconds))
        try:
            await asyncio.wait({task, timer}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            timer.cancel()
            await asyncio.gather(timer, return_exceptions=True)

    # -- the arm's status --------------------------------------------------------------------------------------------

    async def _monitor(self) -> None:
        """Read the arm's status at an interval and react to what must not go unnoticed between motions."""
        while True:
            try:
                await self._devices.clock.sleep(self.equipment.parameters.status_interval_s)
            except PortError as error:
                self._fail(error)
                return
            try:
                await self._watch()
            except AlarmError as error:
                self._fail(error)

    async def _watch(self) -> None:
        if self._devices.arm.lifecycle is Lifecycle.DISCONNECTED and self._state not in _ARM_WATCHED:
            self._status = None
            return
        try:
            status = await self._read_status()
        except PortError:
            if self._state in _ARM_WATCHED:
                raise
            self._status = None
            return
        if self._state in _READINESS_WATCHED:
            check_robot_ready(status, self.equipment.calibration.robot)
        elif self._state in _ARM_WATCHED and status.fault is not None:
            raise AlarmError(Alarm.ROBOT_FAULT, f"The controller reports: {status.fault}.")

    async def _read_status(self) -> RobotStatus:
        status = await self._devices.arm.status()
        self._keep_status(status)
        return status

    def _keep_status(self, status: RobotStatus) -> None:
        self._status = status
        self._touch()

    # -- commands and transitions ------------------------------------------------------------------------------------

    def _judge(self, command: Command) -> CommandAnswer:
        """Return what would become of a command now."""
        if packml.target_state(self._state, command, self._mode) is None:
            refusal = packml.refuse(self._state, command, self._mode)
            return CommandAnswer(False, self._state, refusal.reason, Alarm.COMMAND_REFUSED, refusal.leads_there)
        if command in _GOES_ON and self._hand.knowledge is GripperKnowledge.UNKNOWN:
            reason = (
                "It is not known what the gripper holds: give 'resolve gripper empty' or 'resolve gripper holding'."
            )
            return CommandAnswer(False, self._state, reason, Alarm.GRIPPER_STATE_UNKNOWN)
        return CommandAnswer(accepted=True, state=self._state)

    async def _why_not_resolved(self, holds: str) -> str:
        """Return why an operator's word on the gripper is not taken, or an empty string."""
        if holds not in {GripperKnowledge.EMPTY.value, GripperKnowledge.HOLDING.value}:
            return f"'{holds}' is neither 'empty' nor 'holding'."
        if self._state not in _RESOLVABLE:
            return f"The gripper cannot be resolved in {self._state.title}; hold, stop or abort first."
        if self._devices.gripper.lifecycle is Lifecycle.DISCONNECTED:
            return ""
        try:
            sensors = await self._devices.gripper.state()
        except PortError as error:
            await self._noted(
                self._journal.event("device", "gripper", run=None, source=_INTERNAL, detail={"alarm": error.alarm.name})
            )
            return ""
        contradicts = {
            GripperKnowledge.EMPTY.value: {GripState.HOLDING},
            GripperKnowledge.HOLDING.value: {GripState.OPEN, GripState.CLOSED_EMPTY},
        }
        if sensors in contradicts[holds]:
            return f"The gripper's sensors say {sensors.value}."
        return ""

    def _apply(self, command: Command, source: str, cause: str) -> None:
        """Carry out a command that is valid now."""
        target = packml.target_state(self._state, command, self._mode)
        if target is None:
            return
        if command is Command.SUSPEND and source is not _INTERNAL:
            self._resumes_itself = False
        self._transition(target, cause or f"{command.title} by {source}")

    def _issue(self, commands: Sequence[Command], cause: str) -> None:
        """Carry out the first of the cell's own commands that is valid now."""
        for command in commands:
            if packml.target_state(self._state, command, self._mode) is not None:
                self._apply(command, _INTERNAL, cause)
                return

    def _transition(self, target: State, cause: str) -> None:
        former, self._state = self._state, target
        if target in _HALTING and self._job is not None:
            self._job.manipulator.halt(cause)
        if target in _FRESH:
            self._note_cleared(self._alarms.clear())
        detail = {"from": former.title, "cause": cause, "mode": self._mode.title}
        self._note(self._journal.event("transition", target.title, run=self._run, source=_INTERNAL, detail=detail))
        self._transitions.set()
        self._touch()

    def _fail(self, error: AlarmError) -> None:
        """Raise an alarm and do what the registry says, or the next more severe thing that is possible."""
        self._raise(error)
        self._issue(_FALLBACKS[_RECOVERY_OF.get(error.alarm.reaction, Recovery.HOLD)], error.alarm.name)

    def _raise(self, error: AlarmError) -> None:
        """Show an alarm and journal it, once for as long as it is active."""
        self._reconnect = self._reconnect or error.alarm in _COMMUNICATION
        if self._alarms.add(error.alarm, error.detail) and error.alarm is not Alarm.JOURNAL_FAILED:
            self._note(self._journal.raise_alarm(error.alarm, error.detail, run=self._run))
        self._touch()

    def _note_cleared(self, codes: Sequence[int]) -> None:
        if codes:
            self._note(self._journal.clear_alarms(codes))

    def _note(self, entry: Future[Any]) -> None:
        """Keep a journal entry that need not be waited for; where it fails, the cell aborts."""
        self._pending.add(entry)
        entry.add_done_callback(self._noted_later)

    def _noted_later(self, entry: Future[Any]) -> None:
        self._pending.discard(entry)
        error = None if entry.cancelled() else entry.exception()
        if isinstance(error, AlarmError):
            self._fail(error)

    async def _noted(self, entry: Future[Any]) -> None:
        """Wait for a journal entry; where it fails, the cell aborts."""
        try:
            await self._written(entry)
        except AlarmError as error:
            self._fail(error)

    async def _written(self, entry: Future[T]) -> T:
        """Wait for a journal entry while a simulated clock stands still."""
        with self._devices.clock.working():
            return await entry

    def _touch(self) -> None:
        """Wake up whoever waits for a change."""
        self._version += 1
        self._changed.set()
        self._changed = asyncio.Event()

    @property
    def _run(self) -> int | None:
        return None if self._job is None else self._job.run_number

    def _named_devices(self) -> tuple[tuple[str, Device], ...]:
        devices = self._devices
        return ("camera", devices.camera), ("arm", devices.arm), ("gripper", devices.gripper)
