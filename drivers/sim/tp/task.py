"""One task: a program and those that it calls, executed line by line in simulated time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from drivers.sim.tp.errors import TpAlarm
from drivers.sim.tp.memory import Devices, Memory
from drivers.sim.tp.syntax import (
    Assign,
    Call,
    Delay,
    End,
    If,
    Jump,
    Label,
    Message,
    Move,
    Remark,
    Run,
    Select,
    SkipCondition,
    TakePosition,
    UserAlarm,
    Wait,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from drivers.sim.tp.memory import Value
    from drivers.sim.tp.syntax import Expression, Program, Statement

LINE_S: Final = 0.0005
"""What a line takes: so that the order of lines can be seen from outside."""

_POLL_S: Final = 0.008
"""How often a line that waits looks again: the controller's interpolation period."""

_LEAD_S: Final = 0.1
"""From a motion line to the motion; with the lines before it about the 150 ms from register write to motion that were
measured on a controller (references/fanuc.md 1b)."""

_DEPTH: Final = 10


class Arm(Protocol):
    """What motion lines need."""

    @property
    def moving(self) -> bool:
        """Whether a motion is under way."""
        ...

    @property
    def stopped_short(self) -> bool:
        """Whether the last motion ended before its target."""
        ...

    def position(self) -> tuple[float, ...]:
        """Return X, Y, Z, W, P, R of the TCP in the active frames."""
        ...

    def start(self, position: Sequence[float], speed: float, *, joint: bool) -> None:
        """Begin a motion; raises `TpAlarm` where it cannot be made."""
        ...

    def stop(self) -> None:
        """Cancel the motion under way."""
        ...


class ArmedDevices(Devices, Arm, Protocol):
    """A controller with its arm."""


class Machine(Protocol):
    """What tasks share."""

    @property
    def programs(self) -> Mapping[str, Program]:
        """All programs by name."""
        ...

    @property
    def memory(self) -> Memory:
        """Registers."""
        ...

    @property
    def arm(self) -> Arm:
        """The arm."""
        ...

    def run(self, program: str, at_s: float) -> None:
        """Begin a task; raises `TpAlarm` where the program runs already."""
        ...

    def show(self, message: str) -> None:
        """Show a message on the pendant."""
        ...


@dataclass
class _Frame:
    """A program under way.

    Attributes:
        at: index of the statement that comes.
        skip: its SKIP CONDITION.
    """

    program: Program
    arguments: tuple[Value, ...] = ()
    at: int = 0
    skip: Expression | None = None


class Task:
    """A program under way and those that have called it.

    Attributes:
        main: the program that the task was begun with.
        time_s: up to when it has been executed.
        ended: whether it has come to its end.
        line: the line that was executed last, for people.
    """

    def __init__(self, machine: Machine, main: Program, at_s: float) -> None:
        self.main, self.time_s, self.ended = main, at_s, False
        self.line = main.file
        self._machine = machine
        self._frames = [_Frame(main)]
        self._since_s: float | None = None
        self._moving = self._skipped = False

    def step(self) -> None:
        """Execute one line, or look once whether one that waits may go on.

        Raises:
            TpAlarm: the line cannot be executed; the task stays on it.
        """
        frame = self._frames[-1]
        if frame.at >= len(frame.program.statements):
            self._return()
            return
        number, statement = frame.program.statements[frame.at]
        self.line = f"{frame.program.file}, line {number}"
        if self._since_s is None:
            self._since_s = self.time_s
        if self._execute(statement, frame):
            self._since_s = None
            self.time_s += LINE_S
        else:
            self.time_s += _POLL_S

    def _execute(self, statement: Statement, frame: _Frame) -> bool:
        """Carry out a statement; return whether the task may go on."""
        memory = self._machine.memory
        if isinstance(statement, Wait):
            return self._wait(statement, frame)
        if isinstance(statement, Move):
            return self._move(statement, frame)
        frame.at += 1
        if isinstance(statement, Assign):
            memory.assign(statement.target, statement.value, frame.arguments)
        elif isinstance(statement, TakePosition):
            memory.positions[statement.index] = list(self._machine.arm.position())
        elif isinstance(statement, Jump | Call):
            self._branch(statement, frame)
        elif isinstance(statement, If):
            if memory.condition(statement.condition, frame.arguments):
                self._execute_action(statement.action, frame)
        elif isinstance(statement, Select):
            self._select(statement, frame)
        elif isinstance(statement, Delay):
            self.time_s += statement.seconds
        elif isinstance(statement, SkipCondition):
            frame.skip = statement.condition
        elif isinstance(statement, Run):
            self._machine.run(statement.program, self.time_s + LINE_S)
        elif isinstance(statement, End):
            self._return()
        elif isinstance(statement, Message):
            self._machine.show(statement.text)
        elif isinstance(statement, UserAlarm):
            raise TpAlarm(f"INTP-213 UALM[{statement.number}]")
        else:
            _nothing(statement)
        return True

    def _execute_action(self, action: Jump | Call | Assign, frame: _Frame) -> None:
        if isinstance(action, Assign):
            self._machine.memory.assign(action.target, action.value, frame.arguments)
        else:
            self._branch(action, frame)

    def _branch(self, action: Jump | Call, frame: _Frame) -> None:
        if isinstance(action, Jump):
            frame.at = frame.program.labels[action.label]
            return
        if len(self._frames) >= _DEPTH:
            raise TpAlarm("INTP-222 Call program failed: too deep")
        arguments = tuple(self._machine.memory.value(value, frame.arguments) for value in action.arguments)
        self._frames.append(_Frame(self._machine.programs[action.program], arguments))

    def _select(self, statement: Select, frame: _Frame) -> None:
        memory = self._machine.memory
        subject = memory.number(statement.subject, frame.arguments)
        for value, action in statement.cases:
            if memory.number(value, frame.arguments) == subject:
                self._branch(action, frame)
                return
        if statement.otherwise is not None:
            self._branch(statement.otherwise, frame)

    def _wait(self, statement: Wait, frame: _Frame) -> bool:
        memory = self._machine.memory
        if memory.condition(statement.condition, frame.arguments):
            frame.at += 1
            return True
        if statement.timeout_label is not None and self._waited_s() >= memory.wait_timeout_s:
            frame.at = frame.program.labels[statement.timeout_label]
            return True
        return False

    def _move(self, statement: Move, frame: _Frame) -> bool:
        """Move; go on with the next line where the skip condition came, with the label's where it did not."""
        memory, arm = self._machine.memory, self._machine.arm
        if statement.skip_label is not None:
            if frame.skip is None:
                raise TpAlarm("INTP-241 Skip without a SKIP CONDITION in this program")
            if memory.condition(frame.skip, frame.arguments) and not self._skipped:
                self._skipped = True
                if self._moving:
                    arm.stop()
        if not self._moving and not self._skipped:
            if self._waited_s() >= _LEAD_S:
                speed = memory.number(statement.speed, frame.arguments)
                arm.start(memory.position(statement.position), speed, joint=statement.joint)
                self._moving = True
            return False
        if self._moving and arm.moving:
            return False
        if not self._skipped and arm.stopped_short:
            raise TpAlarm("SYST-999 The motion ended short of its target")
        if self._skipped or statement.skip_label is None:
            frame.at += 1
        else:
            frame.at = frame.program.labels[statement.skip_label]
        self._moving = self._skipped = False
        return True

    def _waited_s(self) -> float:
        return 0.0 if self._since_s is None else self.time_s - self._since_s

    def _return(self) -> None:
        self._frames.pop()
        self.ended = not self._frames


def _nothing(_: Remark | Label) -> None:
    """What has no effect."""
