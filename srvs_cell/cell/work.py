"""The work of the states: what is done in each acting state, and in Suspended, until it is done or the state is left.

Cancelling any of it is safe, because none of it moves anything itself: motion belongs to the job's task.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell.job import End
from srvs_cell.cell.journal import GripperKnowledge
from srvs_cell.cell.packml import Command, Mode, State
from srvs_cell.cell.recovery import Recovery, commands_after
from srvs_cell.cell.resolution import compare_with_sensors

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from srvs_cell.cell.job import Equipment
    from srvs_cell.cell.manipulator import Hand
    from srvs_cell.cell.notices import Notices
    from srvs_cell.cell.readiness import Readiness
    from srvs_cell.cell.runner import JobRunner


class StateWork:
    """What the cell does in each state.

    Attributes:
        resumes_itself: whether Suspended ends by itself, because the cell and not an operator has suspended.
    """

    def __init__(
        self,
        equipment: Equipment,
        hand: Hand,
        notices: Notices,
        readiness: Readiness,
        runner: JobRunner,
        issue: Callable[[Sequence[Command], str], None],
    ) -> None:
        self.resumes_itself = False
        self._equipment = equipment
        self._hand, self._notices = hand, notices
        self._readiness, self._runner = readiness, runner
        self._issue = issue

    async def do(self, state: State, mode: Mode) -> None:
        """Do the work of a state; nothing in the other wait states. Raises what it ends with."""
        match state:
            case State.CLEARING:
                await self._readiness.clear()
            case State.RESETTING:
                await self._reset()
            case State.STARTING:
                await self._readiness.check_camera()
            case State.EXECUTE:
                await self._execute(mode)
            case State.HOLDING:
                await self._runner.halt("hold")
            case State.UNHOLDING | State.UNSUSPENDING:
                # A stop request has forbidden motion. Execute then looks again and plans anew.
                await self._readiness.make_ready()
            case State.SUSPENDING:
                await self._runner.finish()
            case State.SUSPENDED:
                await self._wait_for_parts()
            case State.COMPLETING:
                await self._complete()
            case State.STOPPING:
                await self._runner.halt("stop")
                await self._readiness.forbid_motion()
            case State.ABORTING:
                try:
                    await self._runner.halt("abort")
                finally:
                    await self._readiness.forbid_as_far_as_possible()

    async def _reset(self) -> None:
        """Make everything ready to move, and know what the gripper holds."""
        await self._readiness.make_ready()
        await compare_with_sensors(self._hand, self._equipment.devices.gripper, self._notices)
        self._runner.paused = False

    async def _execute(self, mode: Mode) -> None:
        """Do the job, or its next step in Manual; what it comes to is a command like an operator's."""
        end = await self._runner.run(mode)
        if end.end is End.PAUSED and self._runner.job is not None:
            self._issue((Command.HOLD,), f"single step done, next: {self._runner.job.next_step()}")
        elif end.end is End.FINISHED:
            self._issue((Command.COMPLETE, Command.STOP), "job finished")
        elif end.error is not None:
            self.resumes_itself = end.recovery is Recovery.SUSPEND
            self._notices.raise_alarm(end.error)
            self._issue(commands_after(end.error.alarm), end.error.alarm.name)

    async def _wait_for_parts(self) -> None:
        """Look again after the interval, where the cell has suspended itself; otherwise wait for the command."""
        if self.resumes_itself:
            await self._equipment.devices.clock.sleep(self._equipment.parameters.look.look_again_s)
            self._issue((Command.UNSUSPEND,), "look again")

    async def _complete(self) -> None:
        """Finish the part in hand and free the table."""
        await self._runner.finish()
        if self._hand.knowledge is not GripperKnowledge.EMPTY:
            raise AlarmError(Alarm.GRIPPER_OCCUPIED, "The job cannot be completed with a part in the gripper.")
        if self._runner.job is not None:
            await self._readiness.allow_motion()
            await self._runner.free_table()
