"""The operator's state model: ISA-TR88.00.02 (PackML) states, commands and modes, all from the tables in this file.

Numbers and valid source states: OPC 30050 v1.01 and the 2022 edition as in Siemens' open documentation. Hold is
accepted in Execute and Suspended (2022) and also in Starting, Unholding, Suspending and Unsuspending (OPC 30050),
because an operator's hold has to work whenever the cell might move. Execute is left by command only: a finished job
issues Complete itself.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import IntEnum


class State(IntEnum):
    """The 17 states with the numbers of ``Status.StateCurrent``."""

    CLEARING = 1
    STOPPED = 2
    STARTING = 3
    IDLE = 4
    SUSPENDED = 5
    EXECUTE = 6
    STOPPING = 7
    ABORTING = 8
    ABORTED = 9
    HOLDING = 10
    HELD = 11
    UNHOLDING = 12
    SUSPENDING = 13
    UNSUSPENDING = 14
    RESETTING = 15
    COMPLETING = 16
    COMPLETE = 17

    @property
    def title(self) -> str:
        """The name as operators read it."""
        return self.name.capitalize()


class Command(IntEnum):
    """The 10 commands with the numbers of ``Command.CntrlCmd``."""

    RESET = 1
    START = 2
    STOP = 3
    HOLD = 4
    UNHOLD = 5
    SUSPEND = 6
    UNSUSPEND = 7
    ABORT = 8
    CLEAR = 9
    COMPLETE = 10

    @property
    def title(self) -> str:
        """The name as operators type it."""
        return self.name.lower()


class Mode(IntEnum):
    """The unit modes with the numbers of ``Status.UnitModeCurrent``; 4 is a user mode."""

    PRODUCTION = 1
    MAINTENANCE = 2
    MANUAL = 3
    DRY_RUN = 4

    @property
    def title(self) -> str:
        """The name as operators read it."""
        return self.name.replace("_", " ").capitalize()

    @classmethod
    def parse(cls, text: str) -> Mode:
        """Return the mode called ``text`` in any case, with blanks, hyphens or underscores; raises `ValueError`."""
        name = text.strip().upper().replace(" ", "_").replace("-", "_")
        if name not in cls.__members__:
            raise ValueError(f"no mode is called {text!r}; modes: {', '.join(mode.title for mode in cls)}")
        return cls[name]


POWER_UP_STATE = State.ABORTED

STATE_COMPLETE: dict[State, State] = {
    State.CLEARING: State.STOPPED,
    State.RESETTING: State.IDLE,
    State.STARTING: State.EXECUTE,
    State.HOLDING: State.HELD,
    State.UNHOLDING: State.EXECUTE,
    State.SUSPENDING: State.SUSPENDED,
    State.UNSUSPENDING: State.EXECUTE,
    State.COMPLETING: State.COMPLETE,
    State.STOPPING: State.STOPPED,
    State.ABORTING: State.ABORTED,
}
"""Where an acting state goes by itself when its work is done. Execute is not here: it is left by command only."""

ACTING_STATES = frozenset(STATE_COMPLETE) | {State.EXECUTE}
WAIT_STATES = frozenset(State) - ACTING_STATES

_NOT_STOPPABLE = {State.STOPPING, State.STOPPED, State.CLEARING, State.ABORTING, State.ABORTED}
_HOLDABLE = {
    State.EXECUTE,
    State.SUSPENDED,
    State.STARTING,
    State.UNHOLDING,
    State.SUSPENDING,
    State.UNSUSPENDING,
}

COMMANDS: dict[Command, tuple[frozenset[State], State]] = {
    Command.RESET: (frozenset({State.STOPPED, State.COMPLETE}), State.RESETTING),
    Command.START: (frozenset({State.IDLE}), State.STARTING),
    Command.STOP: (frozenset(State) - _NOT_STOPPABLE, State.STOPPING),
    Command.HOLD: (frozenset(_HOLDABLE), State.HOLDING),
    Command.UNHOLD: (frozenset({State.HELD}), State.UNHOLDING),
    Command.SUSPEND: (frozenset({State.EXECUTE}), State.SUSPENDING),
    Command.UNSUSPEND: (frozenset({State.SUSPENDED}), State.UNSUSPENDING),
    Command.ABORT: (frozenset(State) - {State.ABORTING, State.ABORTED}, State.ABORTING),
    Command.CLEAR: (frozenset({State.ABORTED}), State.CLEARING),
    Command.COMPLETE: (frozenset({State.EXECUTE, State.HELD, State.SUSPENDED}), State.COMPLETING),
}
"""Command -> (states in which it is valid, state that it leads to)."""

_SUSPEND_AND_COMPLETE = {
    State.SUSPENDING,
    State.SUSPENDED,
    State.UNSUSPENDING,
    State.COMPLETING,
    State.COMPLETE,
}

MODE_STATES: dict[Mode, frozenset[State]] = {
    Mode.PRODUCTION: frozenset(State),
    Mode.MAINTENANCE: frozenset(State) - _SUSPEND_AND_COMPLETE,
    Mode.MANUAL: frozenset(State),
    Mode.DRY_RUN: frozenset(State),
}
"""The states that each mode has; a command that leads to a missing state is refused."""

MODE_CHANGE_STATES = frozenset({State.STOPPED, State.IDLE, State.ABORTED})


@dataclass(frozen=True)
class Refusal:
    """Why a command changes nothing.

    Attributes:
        reason: for people.
        leads_there: the operator's commands, in order, that lead from here to where the command does its work;
            empty where none do.
    """

    reason: str
    leads_there: tuple[Command, ...]


def target_state(state: State, command: Command, mode: Mode = Mode.PRODUCTION) -> State | None:
    """Return the state that a command leads to, or None where it is not valid."""
    sources, target = COMMANDS[command]
    return target if state in sources and target in MODE_STATES[mode] else None


def allowed_commands(state: State, mode: Mode = Mode.PRODUCTION) -> tuple[Command, ...]:
    """Return the commands that are valid now, in the order of their numbers: what a page enables its buttons from."""
    return tuple(command for command in Command if target_state(state, command, mode) is not None)


def leads_there(state: State, command: Command, mode: Mode = Mode.PRODUCTION) -> tuple[Command, ...]:
    """Return the shortest sequence of commands that ends with ``command``; empty where it is valid now or never.

    Between two commands the acting states are taken to complete. Abort is not offered as a way.
    """
    if target_state(state, command, mode) is not None:
        return ()
    offered = [way for way in Command if way not in {Command.ABORT, command}]
    paths: deque[tuple[State, tuple[Command, ...]]] = deque([(_settle(state), ())])
    seen = {_settle(state)}
    while paths:
        here, path = paths.popleft()
        if target_state(here, command, mode) is not None:
            return (*path, command)
        for way in offered:
            target = target_state(here, way, mode)
            if target is not None and (after := _settle(target)) not in seen:
                seen.add(after)
                paths.append((after, (*path, way)))
    return ()


def refuse(state: State, command: Command, mode: Mode = Mode.PRODUCTION) -> Refusal:
    """Return why ``command`` is not valid in ``state`` and what leads there."""
    sources, target = COMMANDS[command]
    if target not in MODE_STATES[mode]:
        return Refusal(f"'{command.title}' is not part of the mode {mode.title}.", ())
    if _settle(target) is _settle(state):
        return Refusal(f"'{command.title}' changes nothing: the cell is {state.title}.", ())
    valid = ", ".join(source.title for source in sorted(sources))
    path = leads_there(state, command, mode)
    hint = f" Give: {', '.join(step.title for step in path)}." if path else ""
    return Refusal(f"'{command.title}' is not valid in {state.title}; it is valid in {valid}.{hint}", path)


def _settle(state: State) -> State:
    """Return the state reached when acting states complete; Execute stays."""
    while state in STATE_COMPLETE:
        state = STATE_COMPLETE[state]
    return state
