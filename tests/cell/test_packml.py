"""The PackML table: every (state, command) cell, and properties over sequences of commands."""

from __future__ import annotations

import pytest
from hypothesis import settings
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from hypothesis.strategies import sampled_from

from srvs_cell.cell.packml import (
    ACTING_STATES,
    MODE_STATES,
    POWER_UP_STATE,
    STATE_COMPLETE,
    WAIT_STATES,
    Command,
    Mode,
    State,
    allowed_commands,
    leads_there,
    refuse,
    target_state,
)

S, C = State, Command

# Row: state; columns: the commands that are valid there with the states that they lead to. Written out by hand from
# ISA-TR88.00.02-2022, independently of the table in the source.
EXPECTED: dict[State, dict[Command, State]] = {
    S.CLEARING: {C.ABORT: S.ABORTING},
    S.STOPPED: {C.RESET: S.RESETTING, C.ABORT: S.ABORTING},
    S.STARTING: {C.STOP: S.STOPPING, C.HOLD: S.HOLDING, C.ABORT: S.ABORTING},
    S.IDLE: {C.START: S.STARTING, C.STOP: S.STOPPING, C.ABORT: S.ABORTING},
    S.SUSPENDED: {
        C.UNSUSPEND: S.UNSUSPENDING,
        C.HOLD: S.HOLDING,
        C.COMPLETE: S.COMPLETING,
        C.STOP: S.STOPPING,
        C.ABORT: S.ABORTING,
    },
    S.EXECUTE: {
        C.HOLD: S.HOLDING,
        C.SUSPEND: S.SUSPENDING,
        C.COMPLETE: S.COMPLETING,
        C.STOP: S.STOPPING,
        C.ABORT: S.ABORTING,
    },
    S.STOPPING: {C.ABORT: S.ABORTING},
    S.ABORTING: {},
    S.ABORTED: {C.CLEAR: S.CLEARING},
    S.HOLDING: {C.STOP: S.STOPPING, C.ABORT: S.ABORTING},
    S.HELD: {C.UNHOLD: S.UNHOLDING, C.COMPLETE: S.COMPLETING, C.STOP: S.STOPPING, C.ABORT: S.ABORTING},
    S.UNHOLDING: {C.STOP: S.STOPPING, C.HOLD: S.HOLDING, C.ABORT: S.ABORTING},
    S.SUSPENDING: {C.STOP: S.STOPPING, C.HOLD: S.HOLDING, C.ABORT: S.ABORTING},
    S.UNSUSPENDING: {C.STOP: S.STOPPING, C.HOLD: S.HOLDING, C.ABORT: S.ABORTING},
    S.RESETTING: {C.STOP: S.STOPPING, C.ABORT: S.ABORTING},
    S.COMPLETING: {C.STOP: S.STOPPING, C.ABORT: S.ABORTING},
    S.COMPLETE: {C.RESET: S.RESETTING, C.STOP: S.STOPPING, C.ABORT: S.ABORTING},
}


@pytest.mark.parametrize("state", State)
@pytest.mark.parametrize("command", Command)
def test_every_cell_of_the_table(state: State, command: Command) -> None:
    assert target_state(state, command) == EXPECTED[state].get(command)


def test_numbers_are_those_of_the_standard() -> None:
    assert [state.name for state in sorted(State)] == [
        "CLEARING", "STOPPED", "STARTING", "IDLE", "SUSPENDED", "EXECUTE", "STOPPING", "ABORTING", "ABORTED",
        "HOLDING", "HELD", "UNHOLDING", "SUSPENDING", "UNSUSPENDING", "RESETTING", "COMPLETING", "COMPLETE",
    ]  # fmt: skip
    assert [int(state) for state in sorted(State)] == list(range(1, 18))
    assert [command.title for command in sorted(Command)] == [
        "reset", "start", "stop", "hold", "unhold", "suspend", "unsuspend", "abort", "clear", "complete",
    ]  # fmt: skip
    assert [int(command) for command in sorted(Command)] == list(range(1, 11))
    assert {mode.title: int(mode) for mode in Mode} == {"Production": 1, "Maintenance": 2, "Manual": 3, "Dry run": 4}


def test_execute_is_left_by_command_only_and_every_other_acting_state_by_itself() -> None:
    assert ACTING_STATES - set(STATE_COMPLETE) == {State.EXECUTE}
    assert {S.STOPPED, S.IDLE, S.SUSPENDED, S.ABORTED, S.HELD, S.COMPLETE} == WAIT_STATES
    assert POWER_UP_STATE is S.ABORTED


@pytest.mark.parametrize("mode", Mode)
def test_a_mode_keeps_the_mandatory_states_and_leads_into_no_missing_one(mode: Mode) -> None:
    states = MODE_STATES[mode]
    assert {S.STOPPED, S.IDLE, S.EXECUTE, S.ABORTED} <= states
    for state in states:
        assert all(target_state(state, command, mode) in states for command in allowed_commands(state, mode))


def test_a_command_of_another_mode_is_refused_with_the_modes_name() -> None:
    assert target_state(S.EXECUTE, C.SUSPEND, Mode.MAINTENANCE) is None
    assert "Maintenance" in refuse(S.EXECUTE, C.SUSPEND, Mode.MAINTENANCE).reason


def test_a_refusal_names_the_commands_that_lead_there() -> None:
    assert refuse(S.ABORTED, C.START).leads_there == (C.CLEAR, C.RESET, C.START)
    assert "Give: clear, reset, start." in refuse(S.ABORTED, C.START).reason
    assert "valid in Idle" in refuse(S.ABORTED, C.START).reason
    assert refuse(S.IDLE, C.UNHOLD).leads_there == (C.START, C.HOLD, C.UNHOLD)
    assert refuse(S.STOPPED, C.STOP).leads_there == ()
    assert "the cell is Stopped" in refuse(S.STOPPED, C.STOP).reason


@pytest.mark.parametrize("state", State)
@pytest.mark.parametrize("command", Command)
def test_the_way_that_is_advised_really_leads_there(state: State, command: Command) -> None:
    way = leads_there(state, command)
    if not way:
        return
    assert way[-1] is command
    for step in way:
        while state in STATE_COMPLETE:
            state = STATE_COMPLETE[state]
        target = target_state(state, step)
        assert target is not None
        state = target


@pytest.mark.parametrize(
    ("text", "mode"), [("dry-run", Mode.DRY_RUN), ("Dry run", Mode.DRY_RUN), ("MANUAL", Mode.MANUAL)]
)
def test_modes_are_found_by_name(text: str, mode: Mode) -> None:
    assert Mode.parse(text) is mode


def test_an_unknown_mode_names_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"'party'.*Production, Maintenance, Manual, Dry run"):
        Mode.parse("party")


class Operator(RuleBasedStateMachine):
    """Any operator: any commands, in any order, while acting states complete or not."""

    def __init__(self) -> None:
        super().__init__()
        self.state = POWER_UP_STATE

    @rule(command=sampled_from(Command))
    def give(self, command: Command) -> None:
        target = target_state(self.state, command)
        if target is None:
            assert refuse(self.state, command).reason
        else:
            self.state = target

    @precondition(lambda self: self.state in STATE_COMPLETE)
    @rule()
    def complete(self) -> None:
        self.state = STATE_COMPLETE[self.state]

    @invariant()
    def abort_is_always_possible(self) -> None:
        assert self.state in {S.ABORTING, S.ABORTED} or target_state(self.state, C.ABORT) is S.ABORTING

    @invariant()
    def acting_states_lead_to_a_wait_state_or_execute(self) -> None:
        state, steps = self.state, 0
        while state in STATE_COMPLETE:
            state, steps = STATE_COMPLETE[state], steps + 1
        assert state in WAIT_STATES | {S.EXECUTE}
        assert steps <= 2

    @invariant()
    def there_is_a_way_to_execute(self) -> None:
        settled = self.state
        while settled in STATE_COMPLETE:
            settled = STATE_COMPLETE[settled]
        assert settled is S.EXECUTE or target_state(settled, C.START) is not None or leads_there(settled, C.START)


TestOperator = Operator.TestCase
TestOperator.settings = settings(max_examples=30, stateful_step_count=40)
