"""Arm and gripper as the job uses them: interlocks before, the journal before and after, never a second command.

A motion is journalled as an intent, then commanded once, then its outcome is journalled. `Manipulator.halt` makes
every later motion impossible until an operator's command makes a new manipulator; the check stands directly before
the command, so that a stop requested while the interlocks were read is not overtaken by the motion.
"""

from __future__ import annotations

import math
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell.interlocks import check_robot_ready, check_speed, check_target
from srvs_cell.cell.journal import GripperKnowledge
from srvs_cell.geometry import Transform, Xyzwpr, pose_difference
from srvs_cell.ports import (
    CommandRejectedError,
    GripState,
    MotionStoppedError,
    NotReadyError,
    OutcomeUnknownError,
    PortError,
)

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator

    from srvs_cell.calibration import RobotFrames
    from srvs_cell.cell.devices import Devices
    from srvs_cell.cell.journal import Journal
    from srvs_cell.cell.motion import HeldPart
    from srvs_cell.config import CellParameters
    from srvs_cell.ports import RobotStatus

T = TypeVar("T")

_ARRIVAL_MM = 2.0
_ARRIVAL_DEG = 1.0
_IN_ONE_GO_DEG = 150.0
"""Turn on one straight move of which nobody doubts the sense."""


@dataclass
class Hand:
    """What is known of the gripper. One object, shared by the unit and the manipulators of its jobs.

    Attributes:
        knowledge: empty, holding or unknown.
        held: the part, where it is held and known.
    """

    knowledge: GripperKnowledge = GripperKnowledge.UNKNOWN
    held: HeldPart | None = None


class Manipulator:
    """Moves the arm and the gripper for one job."""

    def __init__(
        self,
        parameters: CellParameters,
        devices: Devices,
        journal: Journal,
        hand: Hand,
        frames: RobotFrames,
        on_status: Callable[[RobotStatus], None],
        run: int,
    ) -> None:
        self.hand = hand
        self._parameters = parameters
        self._arm, self._gripper = devices.arm, devices.gripper
        self._clock = devices.clock
        self._journal = journal
        self._frames = frames
        self._on_status = on_status
        self._run = run
        self._halt_reason = ""
        self._under_way = 0
        self._commanded_to: Xyzwpr | None = None

    @property
    def busy(self) -> bool:
        """Whether a motion is between its intent and its outcome: the task that awaits it must not be cancelled."""
        return self._under_way > 0

    def halt(self, reason: str) -> None:
        """Let nothing move any more through this object."""
        self._halt_reason = self._halt_reason or reason

    async def pose(self) -> Xyzwpr:
        """Return the present TCP pose; raises what an interlock finds."""
        return (await self._ready_status()).pose

    async def move_linear(self, target: Xyzwpr, speed_mm_s: float, purpose: str) -> Xyzwpr:
        """Move in a straight line; return the pose reported at the end.

        A controller turns the tool the shorter way round, which near half a turn may be either: a move that turns it
        farther stops on its way.

        Raises:
            AlarmError: an interlock's, the arm's, JOURNAL_FAILED (nothing has moved), or MOTION_STOPPED.
        """
        check_speed(speed_mm_s, self._parameters.motion)
        *stops, _ = turning_stops(self._commanded_to or target, target)
        for stop in stops:
            await self._straight(stop, speed_mm_s, f"{purpose}, on the way of a long turn")
        return await self._straight(target, speed_mm_s, purpose)

    async def _straight(self, target: Xyzwpr, speed_mm_s: float, purpose: str) -> Xyzwpr:
        return await self._move(
            "move_linear",
            target,
            {"speed_mm_s": speed_mm_s},
            purpose,
            lambda: self._arm.move_linear(target, speed_mm_s),
        )

    async def move_joint(self, target: Xyzwpr, speed_percent: float, purpose: str) -> Xyzwpr:
        """Move joint-interpolated; otherwise as `move_linear`."""
        return await self._move(
            "move_joint",
            target,
            {"speed_percent": speed_percent},
            purpose,
            lambda: self._arm.move_joint(target, speed_percent),
        )

    async def open(self, purpose: str) -> None:
        """Open the gripper; it is known to be empty afterwards, unknown where the sensors do not confirm."""

        async def act() -> tuple[str, GripperKnowledge, HeldPart | None]:
            await self._gripper.open()
            return "opened", GripperKnowledge.EMPTY, None

        await self._grip("open", {"purpose": purpose}, act)

    async def close(self, part: HeldPart) -> None:
        """Close the gripper on a part; where the sensors do not confirm, the part is kept as what may be held.

        Raises:
            AlarmError: GRIP_EMPTY where it closed on nothing; otherwise as `open`.
        """

        async def act() -> tuple[str, GripperKnowledge, HeldPart | None]:
            self.hand.held = part
            if await self._gripper.close() is GripState.HOLDING:
                return "holding", GripperKnowledge.HOLDING, part
            return "closed_empty", GripperKnowledge.EMPTY, None

        if await self._grip("close", {"purpose": "pick", "held": part.as_json()}, act) == "closed_empty":
            raise AlarmError(Alarm.GRIP_EMPTY, f"Workpiece {part.workpiece} ({part.kind}) was not where it was seen.")

    async def confirm_holding(self) -> None:
        """Raise `AlarmError` GRIP_LOST where the sensors no longer feel the part that should be held."""
        state = await self._gripper.state()
        held = self.hand.held
        if state is GripState.HOLDING or held is None:
            return
        motion = await self._journal.intend("grip_lost", {"held": held.as_json()}, run=self._run)
        await self._journal.outcome(motion, "lost", {"sensors": state.value}, (GripperKnowledge.EMPTY, None))
        self.hand.knowledge, self.hand.held = GripperKnowledge.EMPTY, None
        raise AlarmError(Alarm.GRIP_LOST, f"Workpiece {held.workpiece} ({held.kind}): the sensors say {state.value}.")

    async def _move(
        self,
        kind: str,
        target: Xyzwpr,
        speed: dict[str, float],
        purpose: str,
        command: Callable[[], Awaitable[Xyzwpr]],
    ) -> Xyzwpr:
        check_target(target, self._parameters.workspace)
        await self._ready_status()
        detail = {"target": list(target.as_tuple()), "purpose": purpose, **speed}
        with self._motion():
            motion = await self._intend(kind, detail)
            try:
                reached: Xyzwpr = await self._commanded(motion, command)
            except OutcomeUnknownError:
                self.hand.knowledge = GripperKnowledge.UNKNOWN
                raise
            await self._record(motion, "done", {"pose": list(reached.as_tuple())})
        self._commanded_to = target
        _check_arrival(target, reached)
        return reached

    async def _grip(
        self,
        kind: str,
        detail: dict[str, Any],
        act: Callable[[], Awaitable[tuple[str, GripperKnowledge, HeldPart | None]]],
    ) -> str:
        await self._ready_status()
        with self._motion():
            motion = await self._intend(kind, detail)
            try:
                outcome, knowledge, held = await self._commanded(motion, act)
            except OutcomeUnknownError:
                self.hand.knowledge = GripperKnowledge.UNKNOWN
                raise
            self.hand.knowledge, self.hand.held = knowledge, held
            with self._clock.working():
                held_json = None if held is None else held.as_json()
                await self._journal.outcome(motion, outcome, {}, (knowledge, held_json))
        return outcome

    @contextmanager
    def _motion(self) -> Iterator[None]:
        self._under_way += 1
        try:
            yield
        finally:
            self._under_way -= 1

    async def _ready_status(self) -> RobotStatus:
        status = await self._arm.status()
        self._on_status(status)
        check_robot_ready(status, self._frames)
        return status

    async def _intend(self, kind: str, detail: dict[str, Any]) -> int:
        with self._clock.working():
            return await self._journal.intend(kind, detail, run=self._run)

    async def _record(self, motion: int, outcome: str, result: dict[str, Any]) -> None:
        with self._clock.working():
            await self._journal.outcome(motion, outcome, result)

    async def _commanded(self, motion: int, command: Callable[[], Awaitable[T]]) -> T:
        """Run a command whose intent is on disk and journal how it failed, where it fails.

        An unknown outcome leaves the intent open: after a restart, too, a person has to look.
        """
        if self._halt_reason:
            await self._record(motion, "not_begun", {"reason": self._halt_reason})
            raise MotionStoppedError(Alarm.MOTION_STOPPED, f"Not begun: {self._halt_reason}.")
        try:
            return await command()
        except MotionStoppedError as error:
            await self._record(motion, "stopped", {"detail": error.detail})
            raise
        except (NotReadyError, CommandRejectedError) as error:
            await self._record(motion, "rejected", {"alarm": error.alarm.name, "detail": error.detail})
            raise
        except OutcomeUnknownError:
            raise
        except PortError as error:
            await self._record(motion, "failed", {"alarm": error.alarm.name, "detail": error.detail})
            raise


def turning_stops(begin: Xyzwpr, end: Xyzwpr) -> list[Xyzwpr]:
    """Return where a straight move ends, and before that where it stops so that its R nowhere changes by too much."""
    parts = max(1, math.ceil(abs(end.r_deg - begin.r_deg) / _IN_ONE_GO_DEG))
    a, b = np.array(begin.as_tuple()), np.array(end.as_tuple())
    return [*(Xyzwpr(*(a + (b - a) * number / parts).tolist()) for number in range(1, parts)), end]


def _check_arrival(target: Xyzwpr, reached: Xyzwpr) -> None:
    """Refuse a move that claims to be done somewhere else: another frame, another tool, another owner."""
    distance_mm, angle_deg = pose_difference(
        Transform.from_xyzwpr("base", "tcp", target), Transform.from_xyzwpr("base", "tcp", reached)
    )
    if distance_mm > _ARRIVAL_MM or angle_deg > _ARRIVAL_DEG:
        raise AlarmError(
            Alarm.ROBOT_FAULT,
            f"The move to {target} ended at {reached}, {distance_mm:.2f} mm and {angle_deg:.2f} deg away "
            f"(allowed {_ARRIVAL_MM} mm, {_ARRIVAL_DEG} deg).",
        )
