"""The recovery policy as a table of decisions."""

from __future__ import annotations

from itertools import product

import pytest

from srvs_cell.alarms import Alarm, Reaction
from srvs_cell.cell.recovery import Recovery, StepName, decide
from srvs_cell.config import RetryParameters

RETRIES = RetryParameters(grip=2, frame=1, look=1, verify=1)


@pytest.mark.parametrize(
    ("step", "alarm", "before", "expected"),
    [
        (StepName.OBSERVE_LEFT, Alarm.CAMERA_TIMEOUT, 0, Recovery.RETRY),
        (StepName.OBSERVE_LEFT, Alarm.CAMERA_TIMEOUT, 1, Recovery.HOLD),
        (StepName.OBSERVE_RIGHT, Alarm.CAMERA_STALE, 0, Recovery.RETRY),
        (StepName.PICK, Alarm.GRIP_EMPTY, 1, Recovery.REOBSERVE),
        (StepName.PICK, Alarm.GRIP_EMPTY, 2, Recovery.HOLD),
        (StepName.PLAN, Alarm.UNCERTAIN_POSITION, 0, Recovery.REOBSERVE),
        (StepName.PLAN, Alarm.UNCERTAIN_POSITION, 1, Recovery.HOLD),
        (StepName.PERCEIVE, Alarm.NOTHING_SEEN, 0, Recovery.SUSPEND),
        (StepName.VERIFY, Alarm.VERIFY_FAILED, 0, Recovery.REOBSERVE),
        (StepName.VERIFY, Alarm.VERIFY_FAILED, 1, Recovery.HOLD),
        (StepName.PLACE, Alarm.GRIP_LOST, 1, Recovery.REOBSERVE),
        (StepName.PLACE, Alarm.GRIP_LOST, 2, Recovery.HOLD),
        (StepName.DELIVER, Alarm.GRIP_LOST, 0, Recovery.HOLD),
        (StepName.PICK, Alarm.MOTION_STOPPED, 0, Recovery.HOLD),
        (StepName.PICK, Alarm.MODE_NOT_AUTO, 0, Recovery.STOP),
        (StepName.PICK, Alarm.ROBOT_FAULT, 0, Recovery.ABORT),
        (StepName.PLACE, Alarm.MOTION_OUTCOME_UNKNOWN, 0, Recovery.ABORT),
        (StepName.PLAN, Alarm.PLAN_INVALID, 0, Recovery.ABORT),
        (StepName.PLAN, Alarm.PROBLEM_INVALID, 0, Recovery.HOLD),
    ],
)
def test_decisions(step: StepName, alarm: Alarm, before: int, expected: Recovery) -> None:
    assert decide(step, alarm, {(step, alarm): before}, RETRIES) is expected


def test_no_step_that_moves_a_part_is_ever_retried() -> None:
    moving = {StepName.PICK, StepName.PLACE, StepName.DELIVER, StepName.RISE, StepName.MOVE_LATERALLY, StepName.RETREAT}
    for step, alarm in product(moving, Alarm):
        assert decide(step, alarm, {}, RETRIES) is not Recovery.RETRY


def test_nothing_is_milder_than_what_an_abort_alarm_demands() -> None:
    for step, alarm in product(StepName, Alarm):
        if alarm.reaction is Reaction.ABORT:
            assert decide(step, alarm, {}, RETRIES) is Recovery.ABORT
