"""The PackML unit: commands in, the states' work done, one snapshot out.

`Unit.run` does the work of the present state. A command changes the state at once; the work of the state that was left
is cancelled, which is always safe because no state's work moves anything itself: motion belongs to the job's task,
which is never cancelled in the middle of a motion but halted, its move stopped on request, and awaited.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING

import structlog

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell import packml
from srvs_cell.cell.job_places import JobPlaces
from srvs_cell.cell.journal import GripperKnowledge, utc_now
from srvs_cell.cell.manipulator import Hand
from srvs_cell.cell.notices import CELL, Notices
from srvs_cell.cell.packml import Command, Mode, State
from srvs_cell.cell.readiness import Readiness
from srvs_cell.cell.recovery import commands_after
from srvs_cell.cell.resolution import resolve, take_over, why_not_resolved
from srvs_cell.cell.runner import JobRunner
from srvs_cell.cell.snapshot import make_snapshot
from srvs_cell.cell.work import StateWork
from srvs_cell.ports import PortError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from datetime import datetime

    from srvs_cell.cell.job import Equipment
    from srvs_cell.cell.journal import Journal
    from srvs_cell.cell.snapshot import Json

_log = structlog.stdlib.get_logger("srvs_cell.cell")

_GOES_ON = frozenset({Command.CLEAR, Command.RESET, Command.START, Command.UNHOLD, Command.UNSUSPEND, Command.COMPLETE})
"""Commands after which something may move sooner or later: they need to know what the gripper holds."""

_HALTING = frozenset({State.HOLDING, State.STOPPING, State.ABORTING})
_FRESH = frozenset({State.CLEARING, State.RESETTING, State.UNHOLDING, State.UNSUSPENDING})
"""An operator has looked: what was wrong before is either gone or will be found again."""


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
        self._state, self._mode = packml.POWER_UP_STATE, Mode.PRODUCTION
        self._hand = Hand(GripperKnowledge.UNKNOWN)  # until the journal has told what the last process left
        self._notices = Notices(self._journal, self._devices.clock, now, self._fail)
        self._readiness = Readiness(equipment, self._notices)
        self._runner = JobRunner(equipment, self._hand, self._notices, self._readiness.keep_status)
        self._work = StateWork(equipment, self._hand, self._notices, self._readiness, self._runner, self._issue)
        self._transitions = asyncio.Event()
        self._opened = False
        self._rounds = 0

    @property
    def turns(self) -> int:
        """Grows while the unit's loops turn: with each round of the monitor and each change that can be seen."""
        return self._rounds + self._notices.version

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
            await self._open_journal()
        answer = self._judge(command)
        if answer.accepted:
            if command is Command.SUSPEND:
                self._work.resumes_itself = False
            self._apply(command, f"{command.title} by {source}")
            answer = CommandAnswer(accepted=True, state=self._state)
        detail = {"accepted": answer.accepted, "state": answer.state.title, "reason": answer.reason}
        await self._notices.noted(self._notices.event("command", command.title, source, detail))
        return answer

    async def set_mode(self, mode: Mode, source: str) -> CommandAnswer:
        """Change the mode; only in Stopped, Idle and Aborted."""
        if self._state in packml.MODE_CHANGE_STATES:
            self._mode = mode
            self._notices.changed()
            answer = CommandAnswer(accepted=True, state=self._state)
        else:
            valid = ", ".join(state.title for state in sorted(packml.MODE_CHANGE_STATES))
            reason = f"The mode cannot be changed in {self._state.title}; it can in {valid}."
            answer = CommandAnswer(False, self._state, reason, Alarm.MODE_REFUSED, (Command.STOP,))
        detail = {"accepted": answer.accepted, "reason": answer.reason}
        await self._notices.noted(self._notices.event("mode", mode.title, source, detail))
        return answer

    async def resolve_gripper(self, holds: str, source: str) -> CommandAnswer:
        """Take an operator's word for what the gripper holds, unless its own sensors say otherwise.

        Args:
            holds: ``empty`` or ``holding``.
            source: who says so.
        """
        reason = await why_not_resolved(holds, self._state, self._devices.gripper, self._notices)
        if not reason:
            await resolve(holds, source, self._hand, self._notices)
        detail = {"accepted": not reason, "reason": reason}
        await self._notices.noted(self._notices.event("resolve", holds, source, detail))
        return CommandAnswer(not reason, self._state, reason, Alarm.COMMAND_REFUSED if reason else None)

    async def forget_job(self, source: str) -> CommandAnswer:
        """Give up the places of an unfinished job: the next one takes those where the parts stand by then.

        Args:
            source: who says so, for the journal.
        """
        places, answer = self._runner.places, CommandAnswer(accepted=True, state=self._state)
        if self._runner.running:
            reason = f"The job is being done in {self._state.title}; hold, stop or abort it first."
            answer = CommandAnswer(False, self._state, reason, Alarm.COMMAND_REFUSED)
        elif places is None:
            answer = CommandAnswer(False, self._state, "There is no unfinished job.", Alarm.COMMAND_REFUSED)
        else:
            await self._runner.forget_places()
            self._notices.changed()
        detail = {"accepted": answer.accepted, "reason": answer.reason}
        await self._notices.noted(self._notices.event("command", "forget", source, detail))
        return answer

    # -- what anybody can see ----------------------------------------------------------------------------------------

    def snapshot(self) -> Json:
        """Return all that is known of the cell, as plain JSON values."""
        return make_snapshot(
            state=self._state,
            mode=self._mode,
            simulation=self.simulation,
            allowed=[command for command in Command if self._judge(command).accepted],
            runner=self._runner,
            notices=self._notices,
            hand=self._hand,
            status=self._readiness.status,
            devices=self._devices,
        )

    async def wait_change(self, version: int) -> int:
        """Return the snapshot's version as soon as it is greater than ``version``."""
        return await self._notices.wait_change(version)

    # -- the life of the unit ----------------------------------------------------------------------------------------

    async def run(self) -> None:
        """Do the work of the states until cancelled; a move under way is then stopped on request."""
        await self.open()
        await self._readiness.connect()
        self._notices.changed()
        monitor = asyncio.create_task(self._monitor())
        try:
            while True:
                await self._do_state()
        finally:
            monitor.cancel()
            await asyncio.gather(monitor, return_exceptions=True)
            if self._runner.running:
                await self._runner.halt("the daemon ends")
            await self._readiness.disconnect()

    async def close(self) -> None:
        """Close the journal; after `run` was cancelled."""
        await self._notices.close()

    async def open(self) -> None:
        """Open the journal and learn what the last process left behind, once; before anybody gives a command."""
        if not self._opened:
            self._opened = True
            await self._open_journal()

    async def _open_journal(self) -> None:
        try:
            left = await self._notices.written(self._journal.open())
            self._notices.clear_alarms(Alarm.JOURNAL_FAILED)
            self._runner.left_places = None if left.job_places is None else JobPlaces.from_json(left.job_places)
            take_over(self._hand, left)
        except AlarmError as error:
            self._notices.raise_alarm(error)

    async def _monitor(self) -> None:
        """Watch the arm at an interval."""
        interval_s = self.equipment.parameters.status_interval_s
        while True:
            self._rounds += 1
            try:
                await self._devices.clock.sleep(interval_s)
            except PortError as error:
                self._fail(error)
                # There is no other time to wait by until an operator's clear has reached the cell's clock again.
                await asyncio.sleep(interval_s)
                continue
            try:
                await self._readiness.watch(self._state)
            except AlarmError as error:
                # A motion under way ends with the fault itself and knows its name: a collision is not any fault.
                if error.alarm is not Alarm.ROBOT_FAULT or not self._runner.moving:
                    self._fail(error)

    async def _do_state(self) -> None:
        """Do the work of the present state until it is done or the state is left."""
        state = self._state
        self._transitions.clear()
        left = asyncio.create_task(self._transitions.wait())
        work = asyncio.create_task(self._guarded(state))
        try:
            await asyncio.wait({left, work}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            left.cancel()
            work.cancel()
            await asyncio.gather(left, work, return_exceptions=True)
        # A command that came while the work was finishing has won: only an unchanged state completes.
        if not work.cancelled() and self._state is state and not self._transitions.is_set():
            await self._after_work(state, work.result())

    async def _after_work(self, state: State, error: AlarmError | None) -> None:
        if error is not None:
            self._fail(error)
        if state is State.ABORTING or (error is None and state in packml.STATE_COMPLETE):
            self._transition(packml.STATE_COMPLETE[state], "state complete")
        elif self._state is state:
            await self._transitions.wait()

    async def _guarded(self, state: State) -> AlarmError | None:
        """Do a state's work; return how it failed, where it did."""
        try:
            await self._work.do(state, self._mode)
        except AlarmError as error:
            return error
        except Exception as error:  # noqa: BLE001 - the last line: whatever happens ends in a named alarm
            _log.exception("a state's work failed", state=state.title)
            return AlarmError(Alarm.INTERNAL_ERROR, f"{type(error).__name__}: {error}")
        return None

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

    def _issue(self, commands: Sequence[Command], cause: str) -> None:
        """Carry out the first of the cell's own commands that is valid now."""
        for command in commands:
            if self._apply(command, cause):
                return

    def _apply(self, command: Command, cause: str) -> bool:
        """Carry out a command; tell whether it was valid."""
        target = packml.target_state(self._state, command, self._mode)
        if target is None:
            return False
        self._transition(target, cause)
        return True

    def _transition(self, target: State, cause: str) -> None:
        former, self._state = self._state, target
        if target in _HALTING:
            self._runner.forbid_motion(cause)
        if target in _FRESH:
            self._notices.clear_alarms()
        detail = {"from": former.title, "cause": cause, "mode": self._mode.title}
        self._notices.note(self._notices.event("transition", target.title, CELL, detail))
        self._transitions.set()
        self._notices.changed()

    def _fail(self, error: AlarmError) -> None:
        """Raise an alarm and do what the registry says, or the next more severe thing that is possible."""
        self._notices.raise_alarm(error)
        self._issue(commands_after(error.alarm), error.alarm.name)
