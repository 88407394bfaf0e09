"""Object-level doubles of clock, camera, arm and gripper, coupled through a small world of blocks.

No wires, no physics, no pixels: for tests of what stands above the ports. What the gripper takes is what stands
between the fingers, what is placed stands where it was let go, and moves take the time that their speed demands.
"""

from __future__ import annotations

import asyncio
import heapq
import itertools
import math
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.alarms import Alarm
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import (
    DeviceFaultError,
    Frame,
    FrameError,
    GripState,
    Lifecycle,
    MotionStoppedError,
    NotConnectedError,
    NotReadyError,
    OutcomeUnknownError,
    RobotMode,
    RobotStatus,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from srvs_cell.ports import PortError

_QUIET_ROUNDS = 15
"""Turns of the event loop after which every task is taken to wait for the clock."""
_MOTION_SLICE_S = 0.1
_JOINT_SPEED_MM_S = 1000.0
_GRIP_TIME_S = 0.3
_FRAME_TIME_S = 0.033
_STANDS_MM = 3.0
_FULL_PERCENT = 100.0


class StepClock:
    """A clock that jumps to the next deadline as soon as every task waits and no computation is under way."""

    def __init__(self) -> None:
        self._now_s = 0.0
        self._order = itertools.count()
        self._sleepers: list[tuple[float, int, asyncio.Future[None]]] = []
        self._computations = 0
        self._idle = asyncio.Event()
        self._idle.set()
        self._driver: asyncio.Task[None] | None = None

    def now_s(self) -> float:
        """Return seconds since the clock was made."""
        return self._now_s

    async def sleep(self, seconds: float) -> None:
        """Return when the clock has been advanced by ``seconds``."""
        if seconds <= 0.0:
            await asyncio.sleep(0)
            return
        due: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        heapq.heappush(self._sleepers, (self._now_s + seconds, next(self._order), due))
        if self._driver is None or self._driver.done():
            self._driver = asyncio.create_task(self._drive())
        await due

    @contextmanager
    def working(self) -> Iterator[None]:
        """Keep the clock from advancing."""
        self._computations += 1
        self._idle.clear()
        try:
            yield
        finally:
            self._computations -= 1
            if not self._computations:
                self._idle.set()

    async def _drive(self) -> None:
        while self._sleepers:
            await self._idle.wait()
            for _ in range(_QUIET_ROUNDS):
                await asyncio.sleep(0)
            if not self._idle.is_set():
                continue
            deadline_s, _, due = heapq.heappop(self._sleepers)
            if not due.done():
                self._now_s = max(self._now_s, deadline_s)
                due.set_result(None)


@dataclass
class Block:
    """An upright block on the table.

    Attributes:
        name: for people and tests.
        x_mm, y_mm: centre of the footprint, base frame.
        length_mm, width_mm, height_mm: size.
        yaw_deg: direction of the length, from base x towards base y.
        bottom_mm: height of its underside above the table.
    """

    name: str
    x_mm: float
    y_mm: float
    height_mm: float
    length_mm: float = 40.0
    width_mm: float = 30.0
    bottom_mm: float = 0.0
    yaw_deg: float = 0.0


@dataclass
class World:
    """The table, what stands on it and what is in the gripper.

    Attributes:
        blocks: everything there is.
        table_z_mm: height of the table in the base frame.
        held: the block in the gripper with its place in the TCP's level frame: x, y, z and yaw.
        dropped: names of blocks that were let go above the table or lost.
    """

    blocks: list[Block]
    table_z_mm: float = 0.0
    held: tuple[Block, tuple[float, float, float, float]] | None = None
    dropped: list[str] = field(default_factory=list)

    def grip(self, tcp: Xyzwpr) -> bool:
        """Take the block whose upper part is between the fingers; tell whether there is one."""
        for block in self.blocks:
            along_mm, across_mm = _turned(tcp.x_mm - block.x_mm, tcp.y_mm - block.y_mm, -block.yaw_deg)
            inside = abs(along_mm) < block.length_mm / 2 and abs(across_mm) < block.width_mm / 2
            depth_mm = self.table_z_mm + block.bottom_mm + block.height_mm - tcp.z_mm
            if inside and 0.0 < depth_mm <= block.height_mm:
                bottom_mm = self.table_z_mm + block.bottom_mm - tcp.z_mm
                level_mm = _turned(block.x_mm - tcp.x_mm, block.y_mm - tcp.y_mm, -tcp.r_deg)
                self.held = (block, (*level_mm, bottom_mm, block.yaw_deg - tcp.r_deg))
                return True
        return False

    def carry(self, tcp: Xyzwpr) -> None:
        """Move the held block along."""
        if self.held is not None:
            block, (x_mm, y_mm, z_mm, yaw_deg) = self.held
            dx_mm, dy_mm = _turned(x_mm, y_mm, tcp.r_deg)
            block.x_mm, block.y_mm, block.yaw_deg = tcp.x_mm + dx_mm, tcp.y_mm + dy_mm, tcp.r_deg + yaw_deg
            block.bottom_mm = tcp.z_mm + z_mm - self.table_z_mm

    def release(self) -> None:
        """Let go: the block stands where it is, or falls."""
        if self.held is not None:
            block, self.held = self.held[0], None
            if block.bottom_mm > _STANDS_MM:
                self.dropped.append(block.name)
            block.bottom_mm = 0.0

    def lose(self) -> None:
        """Lose the held block on the way."""
        if self.held is not None:
            self.held[0].bottom_mm = math.inf
            self.release()


def _turned(x_mm: float, y_mm: float, turn_deg: float) -> tuple[float, float]:
    cos, sin = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    return x_mm * cos - y_mm * sin, x_mm * sin + y_mm * cos


class _FakeDevice:
    """The life that the doubles share; ``unreachable`` makes connecting and everything else fail."""

    def __init__(self, description: str) -> None:
        self.description = description
        self.lifecycle = Lifecycle.DISCONNECTED
        self.unreachable = False

    async def connect(self) -> None:
        self.check_reachable()
        if self.lifecycle is Lifecycle.DISCONNECTED:
            self.lifecycle = Lifecycle.INACTIVE

    async def activate(self) -> None:
        self.check_reachable()
        if self.lifecycle is Lifecycle.DISCONNECTED:
            raise NotConnectedError(Alarm.DEVICE_UNAVAILABLE, f"The {self.description} is not connected.")
        self.lifecycle = Lifecycle.ACTIVE

    async def deactivate(self) -> None:
        self.check_reachable()
        if self.lifecycle is Lifecycle.ACTIVE:
            self.lifecycle = Lifecycle.INACTIVE

    async def disconnect(self) -> None:
        self.lifecycle = Lifecycle.DISCONNECTED

    def check_reachable(self) -> None:
        if self.unreachable:
            raise NotConnectedError(Alarm.CONNECTION_LOST, f"The {self.description} does not answer.")

    def check_active(self) -> None:
        self.check_reachable()
        if self.lifecycle is not Lifecycle.ACTIVE:
            raise NotReadyError(
                Alarm.DEVICE_UNAVAILABLE, f"The {self.description} is {self.lifecycle.value}, not active."
            )


class FakeArm(_FakeDevice):
    """An arm that moves along straight lines.

    Attributes:
        targets: every target that a move was commanded to, in order.
        trouble: number of a move, from 1 -> the error that it ends with half-way.
        present: the status that is reported, without pose, moving and time.
    """

    def __init__(self, clock: StepClock, world: World, pose: Xyzwpr) -> None:
        super().__init__("fake arm")
        self.targets: list[Xyzwpr] = []
        self.trouble: dict[int, PortError] = {}
        self.stop_requests = 0
        self.fault_resets = 0
        self.pose = pose
        self.present = RobotStatus(pose, RobotMode.AUTO, False, True, False, 100, None, 0, 1, None, 0.0)
        self._clock, self._world = clock, world
        self._moving = False
        self._stop = False

    async def status(self) -> RobotStatus:
        """Return ``present`` with the pose of now."""
        self.check_reachable()
        if self.lifecycle is Lifecycle.DISCONNECTED:
            raise NotConnectedError(Alarm.DEVICE_UNAVAILABLE, "The fake arm is not connected.")
        return replace(self.present, pose=self.pose, moving=self._moving, read_at_s=self._clock.now_s())

    async def move_linear(self, target: Xyzwpr, speed_mm_s: float) -> Xyzwpr:
        """Move in a straight line."""
        return await self._move(target, speed_mm_s)

    async def move_joint(self, target: Xyzwpr, speed_percent: float) -> Xyzwpr:
        """Move in a straight line, too."""
        return await self._move(target, _JOINT_SPEED_MM_S * speed_percent / _FULL_PERCENT)

    async def request_stop(self) -> None:
        """Stop at the next slice of the motion; no motion until the next `activate`."""
        self.check_reachable()
        self.stop_requests += 1
        self._stop = self._moving
        await self.deactivate()

    async def reset_fault(self) -> None:
        """Reset the fault."""
        self.check_reachable()
        self.fault_resets += 1
        self.present = replace(self.present, fault=None)

    async def _move(self, target: Xyzwpr, speed_mm_s: float) -> Xyzwpr:
        self.check_reachable()
        if self.lifecycle is not Lifecycle.ACTIVE or self._moving:
            raise NotReadyError(Alarm.ROBOT_NOT_READY, "The fake arm is not active or is moving already.")
        self.targets.append(target)
        trouble = self.trouble.pop(len(self.targets), None)
        start = np.array(self.pose.as_tuple())
        way = np.array(target.as_tuple()) - start
        duration_s = max(float(np.linalg.norm(way[:3])) / speed_mm_s, _MOTION_SLICE_S)
        slices = math.ceil(duration_s / _MOTION_SLICE_S)
        self._moving = True
        try:
            for part in range(1, slices + 1):
                await self._clock.sleep(duration_s / slices)
                if self._stop:
                    raise MotionStoppedError(Alarm.MOTION_STOPPED, f"Stopped at {self.pose} on the way to {target}.")
                self.pose = Xyzwpr(*(float(value) for value in start + way * part / slices))
                self._world.carry(self.pose)
                self._interrupt(trouble if 2 * part >= slices else None, target)
        finally:
            self._moving = self._stop = False
        self.pose = target
        return target

    def _interrupt(self, trouble: PortError | None, target: Xyzwpr) -> None:
        if isinstance(trouble, DeviceFaultError):
            self.present = replace(self.present, fault=trouble.detail)
        if trouble is not None:
            raise trouble
        if self.unreachable:
            raise OutcomeUnknownError(Alarm.MOTION_OUTCOME_UNKNOWN, f"Silence on the way to {target}.")


class FakeCamera(_FakeDevice):
    """A camera of grey frames.

    Attributes:
        silent: frames that do not come; counts down with each grab.
        frozen: every frame was exposed at this time, if not None.
        frames: frames that were delivered.
    """

    def __init__(self, clock: StepClock, size: tuple[int, int] = (64, 48)) -> None:
        super().__init__("fake camera")
        self.size = size
        self.silent = 0
        self.frozen: float | None = None
        self.frames = 0
        self._clock = clock

    async def grab(self, not_before_s: float, timeout_s: float) -> Frame:
        """Return a grey frame; raises CAMERA_TIMEOUT or CAMERA_STALE as a real camera does."""
        self.check_active()
        wait_s = max(0.0, not_before_s - self._clock.now_s())
        if self.silent or (self.frozen is None and wait_s > timeout_s):
            self.silent = max(0, self.silent - 1)
            await self._clock.sleep(timeout_s)
            raise FrameError(Alarm.CAMERA_TIMEOUT, f"No frame within {timeout_s} s.")
        if self.frozen is not None and self.frozen < not_before_s:
            await self._clock.sleep(timeout_s)
            raise FrameError(
                Alarm.CAMERA_STALE, f"Every frame was exposed {not_before_s - self.frozen:.3f} s too early."
            )
        await self._clock.sleep(wait_s + _FRAME_TIME_S)
        self.frames += 1
        width, height = self.size
        exposed_at_s = self._clock.now_s() if self.frozen is None else self.frozen
        return Frame(np.full((height, width), self.frames % 256, np.uint8), exposed_at_s, self.frames)


class FakeGripper(_FakeDevice):
    """A gripper whose sensors feel what the world has between its fingers.

    Attributes:
        misses: grips that close beside the part; counts down.
        silent: whether the sensors do not confirm.
    """

    def __init__(self, clock: StepClock, world: World, arm: FakeArm) -> None:
        super().__init__("fake gripper")
        self.misses = 0
        self.silent = False
        self._clock, self._world, self._arm = clock, world, arm
        self._closed = False

    async def state(self) -> GripState:
        """Return what the sensors feel."""
        self.check_reachable()
        if self.silent:
            return GripState.UNKNOWN
        if self._world.held is not None:
            return GripState.HOLDING
        return GripState.CLOSED_EMPTY if self._closed else GripState.OPEN

    async def open(self) -> None:
        """Open and let go."""
        self.check_active()
        await self._clock.sleep(_GRIP_TIME_S)
        self._closed = False
        self._world.release()
        self._confirm()

    async def close(self) -> GripState:
        """Close on what is between the fingers."""
        self.check_active()
        await self._clock.sleep(_GRIP_TIME_S)
        self._closed = True
        if self.misses:
            self.misses -= 1
        else:
            self._world.grip(self._arm.pose)
        self._confirm()
        return GripState.CLOSED_EMPTY if self._world.held is None else GripState.HOLDING

    def _confirm(self) -> None:
        if self.silent:
            raise OutcomeUnknownError(Alarm.GRIP_TIMEOUT, "The sensors did not confirm.")
