"""What is known of the gripper, against what the last process left, what its sensors feel and what a person says."""

from __future__ import annotations

from typing import TYPE_CHECKING

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell import packml
from srvs_cell.cell.journal import GripperKnowledge
from srvs_cell.cell.motion import HeldPart
from srvs_cell.cell.notices import CELL
from srvs_cell.cell.packml import State
from srvs_cell.ports import GripState, Lifecycle, PortError

if TYPE_CHECKING:
    from srvs_cell.cell.journal import LeftOver
    from srvs_cell.cell.manipulator import Hand
    from srvs_cell.cell.notices import Notices
    from srvs_cell.ports import Gripper

_RESOLVABLE = packml.WAIT_STATES - {State.SUSPENDED}
_CONTRADICTIONS = {
    GripperKnowledge.EMPTY.value: {GripState.HOLDING},
    GripperKnowledge.HOLDING.value: {GripState.OPEN, GripState.CLOSED_EMPTY},
}


def take_over(hand: Hand, left: LeftOver) -> None:
    """Learn what the last process left behind; raises RESTART_UNRESOLVED where a person must judge it."""
    held = left.held
    if left.motions and held is None:
        held = left.motions[-1]["detail"].get("held")
    if left.unresolved:
        hand.knowledge = GripperKnowledge.UNKNOWN
        hand.held = None if held is None else HeldPart.from_json(held)
        raise AlarmError(Alarm.RESTART_UNRESOLVED, f"When the last process ended, {left.unresolved}")
    hand.knowledge = GripperKnowledge.EMPTY


async def compare_with_sensors(hand: Hand, gripper: Gripper, notices: Notices) -> None:
    """Compare what is known with what is felt; a part that is no longer felt is no longer known either.

    Raises:
        AlarmError: GRIPPER_OCCUPIED where a part is held that the cell cannot put anywhere.
    """
    sensors, known = await gripper.state(), hand.knowledge
    if sensors is GripState.HOLDING and known is not GripperKnowledge.HOLDING:
        raise AlarmError(Alarm.GRIPPER_OCCUPIED, "The sensors feel a part, none was picked.")
    if known is GripperKnowledge.HOLDING and hand.held is None:
        raise AlarmError(Alarm.GRIPPER_OCCUPIED, "It is not known where the part in the gripper belongs.")
    if known is GripperKnowledge.HOLDING and sensors in {GripState.OPEN, GripState.CLOSED_EMPTY}:
        await notices.written(notices.journal.resolve(GripperKnowledge.EMPTY, None, f"sensors: {sensors.value}"))
        hand.knowledge, hand.held = GripperKnowledge.EMPTY, None


async def why_not_resolved(holds: str, state: State, gripper: Gripper, notices: Notices) -> str:
    """Return why a person's word on what the gripper holds is not taken now, or an empty string."""
    if holds not in _CONTRADICTIONS:
        return f"'{holds}' is neither 'empty' nor 'holding'."
    if state not in _RESOLVABLE:
        return f"The gripper cannot be resolved in {state.title}; hold, stop or abort first."
    if gripper.lifecycle is Lifecycle.DISCONNECTED:
        return ""
    try:
        sensors = await gripper.state()
    except PortError as error:
        detail = {"alarm": error.alarm.name}
        await notices.noted(notices.journal.event("device", "gripper", run=None, source=CELL, detail=detail))
        return ""
    if sensors in _CONTRADICTIONS[holds]:
        return f"The gripper's sensors say {sensors.value}."
    return ""


async def resolve(holds: str, source: str, hand: Hand, notices: Notices) -> None:
    """Take a person's word, that nothing speaks against, for what the gripper holds."""
    knowledge = GripperKnowledge(holds)
    held = hand.held if knowledge is GripperKnowledge.HOLDING else None
    hand.knowledge, hand.held = knowledge, held
    await notices.noted(notices.journal.resolve(knowledge, None if held is None else held.as_json(), source))
    notices.clear_alarms(Alarm.RESTART_UNRESOLVED, Alarm.GRIPPER_STATE_UNKNOWN, Alarm.GRIPPER_OCCUPIED)
    notices.changed()
