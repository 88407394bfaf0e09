"""The tasks of a controller, executed side by side up to an instant of simulated time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.sim.tp.errors import TpAlarm
from drivers.sim.tp.memory import Memory
from drivers.sim.tp.task import LINE_S, Task

if TYPE_CHECKING:
    from collections.abc import Mapping

    from drivers.sim.tp.syntax import Program
    from drivers.sim.tp.task import ArmedDevices


class TpMachine:
    """Programs, registers and tasks.

    Args:
        programs: all that are loaded, by name.
        devices: signals, variables, frames and the arm.

    Attributes:
        programs, memory, arm: what tasks share.
        messages: what has been shown on the pendant.
        frozen: programs whose tasks stand still, as after a defect of the controller.
        paused: whether tasks that heed a pause stand still.
    """

    def __init__(self, programs: Mapping[str, Program], devices: ArmedDevices) -> None:
        self.programs = programs
        self.memory = Memory(devices)
        self.arm = devices
        self.messages: list[str] = []
        self.frozen: set[str] = set()
        self.paused = False
        self._tasks: list[Task] = []

    def running(self, program: str) -> bool:
        """Return whether a task was begun with this program, paused or not."""
        return any(task.main.name == program for task in self._tasks)

    def run(self, program: str, at_s: float) -> None:
        """Begin a task."""
        if self.running(program):
            raise TpAlarm(f"INTP-267 RUN {program} failed: it runs already")
        self._tasks.append(Task(self, self.programs[program], at_s))

    def abort(self) -> None:
        """End all tasks but those that ignore it; a pause ends with what was paused."""
        self._tasks = [task for task in self._tasks if task.main.ignores_abort]
        self.paused = False

    def power_off(self) -> None:
        """End all tasks; registers keep their values."""
        self._tasks.clear()
        self.paused = False

    def show(self, message: str) -> None:
        """Show a message."""
        self.messages.append(message)

    def catch_up(self, now_s: float) -> str | None:
        """Execute all tasks up to ``now_s``, the one first that is behind the others.

        Returns:
            The alarm that has stopped a task and paused the others, or None.
        """
        for task in self._tasks:
            if not self._may_run(task):
                task.time_s = now_s
        while ready := [task for task in self._tasks if self._may_run(task) and task.time_s + LINE_S <= now_s]:
            task = min(ready, key=lambda task: task.time_s)
            try:
                task.step()
            except TpAlarm as alarm:
                self.paused = True
                return f"{alarm} ({task.line})"
            if task.ended:
                self._tasks.remove(task)
        return None

    def _may_run(self, task: Task) -> bool:
        paused = self.paused and not task.main.ignores_pause
        return not paused and task.main.name not in self.frozen
