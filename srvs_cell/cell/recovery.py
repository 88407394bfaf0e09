"""What an error in a step leads to. A pure function of the step, the alarm and what was tried before.

Nothing that could move twice is retried blindly: after a pick that came up empty, a part that was lost or a scene that
is not as expected the cell looks and plans anew; an interrupted or unknown motion is never continued.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING

from srvs_cell.alarms import Alarm, Reaction
from srvs_cell.cell.packml import Command

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srvs_cell.config import RetryParameters


class StepName(StrEnum):
    """The steps of a job."""

    RISE = "rise"
    DELIVER = "deliver"
    OBSERVE_LEFT = "observe_left"
    MOVE_LATERALLY = "move_laterally"
    OBSERVE_RIGHT = "observe_right"
    PERCEIVE = "perceive"
    CONFIRM = "confirm"
    PLAN = "plan"
    PICK = "pick"
    PLACE = "place"
    VERIFY = "verify"
    RETREAT = "retreat"


class Recovery(StrEnum):
    """What happens next."""

    RETRY = "retry"
    REOBSERVE = "reobserve"
    SUSPEND = "suspend"
    HOLD = "hold"
    STOP = "stop"
    ABORT = "abort"


_OF_REACTION = {
    Reaction.NONE: Recovery.HOLD,
    Reaction.SUSPEND: Recovery.SUSPEND,
    Reaction.HOLD: Recovery.HOLD,
    Reaction.STOP: Recovery.STOP,
    Reaction.ABORT: Recovery.ABORT,
}
"""An alarm that ends a step and says nothing more severe holds the cell: a step without result cannot be skipped."""

_COMMANDS: dict[Recovery, tuple[Command, ...]] = {
    Recovery.SUSPEND: (Command.SUSPEND, Command.HOLD, Command.STOP, Command.ABORT),
    Recovery.HOLD: (Command.HOLD, Command.STOP, Command.ABORT),
    Recovery.STOP: (Command.STOP, Command.ABORT),
    Recovery.ABORT: (Command.ABORT,),
}

_OBSERVING = frozenset({StepName.OBSERVE_LEFT, StepName.OBSERVE_RIGHT})
_CAMERA_TROUBLE = frozenset({Alarm.CAMERA_TIMEOUT, Alarm.CAMERA_STALE})
CARRYING = frozenset({StepName.PICK, StepName.PLACE})
_NOT_IN_THE_HAND = frozenset({Alarm.GRIP_EMPTY, Alarm.GRIP_LOST})
"""Felt where the hand is up already: what fell is looked for like anything else that stands where it should not."""
BETTER_SEEN_AGAIN = frozenset({Alarm.UNCERTAIN_POSITION, Alarm.PART_LEFT})
_BEFORE_ANY_GRIP = frozenset({StepName.PERCEIVE, StepName.PLAN})


def decide(
    step: StepName, alarm: Alarm, attempts: Mapping[tuple[StepName, Alarm], int], retries: RetryParameters
) -> Recovery:
    """Return what follows an alarm.

    Args:
        step: the step that ended with it.
        alarm: what it ended with.
        attempts: how often in this job each step has ended with each alarm *before*.
        retries: the config's bounds.
    """
    before = attempts.get((step, alarm), 0)
    if step in _OBSERVING and alarm in _CAMERA_TROUBLE and before < retries.frame:
        return Recovery.RETRY
    if step in CARRYING and alarm in _NOT_IN_THE_HAND and before < retries.grip:
        return Recovery.REOBSERVE
    if step in _BEFORE_ANY_GRIP and alarm in BETTER_SEEN_AGAIN and before < retries.look:
        return Recovery.REOBSERVE
    if step is StepName.PERCEIVE and alarm is Alarm.IMAGE_INVALID and before < retries.frame:
        return Recovery.REOBSERVE
    if step is StepName.VERIFY and alarm is Alarm.VERIFY_FAILED and before < retries.verify:
        return Recovery.REOBSERVE
    return _OF_REACTION[alarm.reaction]


def commands_after(alarm: Alarm) -> tuple[Command, ...]:
    """Return the command that an alarm leads to, and more severe ones to stand in where it is not valid."""
    return _COMMANDS[_OF_REACTION[alarm.reaction]]
