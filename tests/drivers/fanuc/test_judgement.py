"""What readings mean, one rule at a time."""

from dataclasses import replace

import pytest

from drivers.fanuc import judgement
from drivers.fanuc.registers import FaultCode, Snapshot, State, UopOutput
from srvs_cell.alarms import Alarm
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import (
    CommandRejectedError,
    DeviceFaultError,
    MotionStoppedError,
    OutcomeUnknownError,
    PortError,
    RobotMode,
)

START = Xyzwpr(500.0, 0.0, 400.0, 180.0, 0.0, 0.0)
TARGET = Xyzwpr(600.0, 0.0, 400.0, 180.0, 0.0, 0.0)
READY = Snapshot(
    protocol=4201,
    acknowledged=7,
    state=State.DONE,
    fault_code=0,
    robot_heartbeat=1,
    mode=RobotMode.AUTO,
    uop=UopOutput.CMDENBL | UopOutput.SYSRDY | UopOutput.PROGRUN,
    alarm=None,
    pose=START,
    override_percent=100,
    user_frame=1,
    user_tool=1,
    sequence=7,
)
BUSY = replace(READY, state=State.BUSY, acknowledged=6)


def test_a_ready_robot_is_not_refused() -> None:
    assert judgement.refusal(READY) is None


@pytest.mark.parametrize(
    ("changes", "alarm"),
    [
        ({"uop": READY.uop | UopOutput.FAULT}, Alarm.ROBOT_FAULT),
        ({"uop": READY.uop | UopOutput.PAUSED}, Alarm.ROBOT_FAULT),
        ({"uop": READY.uop & ~UopOutput.PROGRUN}, Alarm.ROBOT_FAULT),
        ({"uop": READY.uop | UopOutput.TPENBL}, Alarm.MODE_NOT_AUTO),
        ({"mode": RobotMode.UNKNOWN}, Alarm.MODE_NOT_AUTO),
        ({"uop": READY.uop & ~UopOutput.SYSRDY}, Alarm.ROBOT_NOT_READY),
        ({"uop": READY.uop & ~UopOutput.CMDENBL}, Alarm.ROBOT_NOT_READY),
        ({"state": State.BUSY}, Alarm.ROBOT_BUSY),
        ({"acknowledged": 6}, Alarm.ROBOT_BUSY),
    ],
)
def test_why_a_robot_is_refused(changes: dict[str, object], alarm: Alarm) -> None:
    refused = judgement.refusal(replace(READY, **changes))  # type: ignore[arg-type]
    assert refused is not None
    assert refused.alarm is alarm


def _finished(snapshot: Snapshot) -> bool:
    return judgement.finished(snapshot, 7, START, hold_requested=False)


def test_a_command_is_finished_when_it_is_acknowledged_as_done() -> None:
    assert _finished(READY)
    assert not _finished(BUSY)
    assert not _finished(replace(BUSY, state=State.IDLE))


ALARMED = replace(BUSY, uop=READY.uop | UopOutput.FAULT | UopOutput.PAUSED)
REJECTING = [code for code in FaultCode if 0 < code < FaultCode.PC_HEARTBEAT]


@pytest.mark.parametrize(
    ("snapshot", "error", "alarm"),
    [
        *(
            (replace(READY, state=State.FAULT, fault_code=c), CommandRejectedError, Alarm.TARGET_REJECTED)
            for c in REJECTING
        ),
        (replace(READY, state=State.FAULT, fault_code=6), CommandRejectedError, Alarm.HEARTBEAT_LOST),
        (replace(READY, state=State.FAULT, fault_code=7), MotionStoppedError, Alarm.MOTION_STOPPED),
        (replace(READY, state=State.FAULT, fault_code=20), MotionStoppedError, Alarm.MOTION_STOPPED),
        (replace(READY, state=State.FAULT, fault_code=21), MotionStoppedError, Alarm.HEARTBEAT_LOST),
        (replace(READY, state=State.FAULT, fault_code=99), DeviceFaultError, Alarm.ROBOT_FAULT),
        (replace(READY, state=State.FAULT, fault_code=0), DeviceFaultError, Alarm.ROBOT_FAULT),
        (replace(READY, state=State.BUSY), OutcomeUnknownError, Alarm.MOTION_OUTCOME_UNKNOWN),
        (replace(READY, state=5), OutcomeUnknownError, Alarm.MOTION_OUTCOME_UNKNOWN),
        (replace(READY, sequence=8), OutcomeUnknownError, Alarm.MOTION_OUTCOME_UNKNOWN),
        (replace(ALARMED, alarm="SRVO-050"), DeviceFaultError, Alarm.COLLISION),
        (replace(ALARMED, alarm="SRVO-002"), DeviceFaultError, Alarm.ROBOT_FAULT),
        (replace(ALARMED, alarm=None), DeviceFaultError, Alarm.ROBOT_FAULT),
        (replace(ALARMED, alarm="MOTN-018"), CommandRejectedError, Alarm.TARGET_UNREACHABLE),
        (replace(ALARMED, alarm="MOTN-017", pose=TARGET), DeviceFaultError, Alarm.TARGET_UNREACHABLE),
        (replace(BUSY, uop=READY.uop | UopOutput.HELD), MotionStoppedError, Alarm.MOTION_STOPPED),
    ],
)
def test_how_a_command_ends_otherwise(snapshot: Snapshot, error: type[PortError], alarm: Alarm) -> None:
    with pytest.raises(error) as raised:
        _finished(snapshot)
    assert type(raised.value) is error
    assert raised.value.alarm is alarm


def test_time_is_counted_at_the_override_of_the_moment() -> None:
    budget = judgement.MotionBudget.of(START, TARGET, 50.0, 45.0, 3.0)
    assert budget.allowed_s == pytest.approx(2 * 100.0 / 50.0 + 3.0)
    assert budget.spend(10.0, 10)
    assert budget.spend(5.0, 100)
    assert not budget.spend(2.0, 100)


def test_a_turn_on_the_spot_has_its_time() -> None:
    turned = replace(START, r_deg=90.0)
    assert judgement.MotionBudget.of(START, turned, 50.0, 45.0, 1.0).allowed_s == pytest.approx(5.0)


def test_a_limit_counts_from_its_first_call() -> None:
    budget = judgement.MotionBudget(100.0)
    for _ in range(3):
        budget.limit(2.0)
        assert budget.spend(0.6, 100)
    budget.limit(2.0)
    assert not budget.spend(0.6, 100)


def test_arrival_compares_rotations_not_angles() -> None:
    """W 180, P 0, R 30 and W 0, P 180, R -150 are one orientation (references/fanuc.md section 3)."""
    target = replace(TARGET, r_deg=30.0)
    same = replace(TARGET, w_deg=0.0, p_deg=180.0, r_deg=-150.0)
    assert judgement.arrival_error(same, target, 0.5, 0.2) is None
    assert judgement.arrival_error(replace(target, r_deg=30.3), target, 0.5, 0.2) is not None
    assert judgement.arrival_error(replace(target, z_mm=400.6), target, 0.5, 0.2) is not None
