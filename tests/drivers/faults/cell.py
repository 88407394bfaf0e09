"""A whole cell - unit, journal, steps - on a FANUC driver and its wire to a controller double with a gripper."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

from drivers.gripper.robot_io import RobotIoGripper, RobotIoGripperConfig
from drivers.sim.doubles import FakeCamera, World
from srvs_cell.cell import Command, Devices, Unit
from srvs_cell.config import RetryParameters
from tests.cell.support import (
    CALIBRATION,
    HEIGHT_PX,
    PARAMETERS,
    WIDTH_PX,
    build,
    connected,
    running,
    seen,
    three_blocks,
)
from tests.drivers.fanuc.bench import Bench, bench
from tests.drivers.fanuc.karel_bench import KarelBench, karel_bench
from tests.drivers.fanuc.rmi_bench import RmiBench, rmi_bench
from tests.drivers.stepped import PointArm

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterator
    from pathlib import Path

    from drivers.sim.doubles import StepClock
    from srvs_cell.ports import Gripper
    from tests.cell.support import Cell
    from tests.drivers.stepped import SteppedTime

AnyBench = Bench | RmiBench | KarelBench

_CLOSE, _OPEN = 1, 2
_HELD, _FULLY_OPEN, _CLOSED_EMPTY = 1, 2, 3
_LOOK_S = 0.02
_SETTLED_S = 6.0
"""Longer than any watchdog, stop or time-out of the clock that a fault sets going."""


class GrippingArm(PointArm):
    """A point with a gripper on its outputs and inputs."""

    def __init__(self, time: SteppedTime) -> None:
        super().__init__(time)
        self.world = World(three_blocks())
        self._closed = False

    def set_output(self, n: int, on: bool) -> None:
        super().set_output(n, on)
        self.world.carry(self.pose)
        if n == _CLOSE and on:
            self._closed = True
            self.world.grip(self.pose)
        elif n == _OPEN and on:
            self._closed = False
            self.world.release()

    def input(self, n: int) -> bool:
        if self.world.held is not None:
            return n == _HELD
        return n == (_CLOSED_EMPTY if self._closed else _FULLY_OPEN)


@dataclass
class WireCell:
    """A cell that runs, and what a test may do to it.

    Attributes:
        cell: the unit.
        b: driver, wire and controller double.
        point: the double's arm.
    """

    cell: Cell
    b: AnyBench
    point: GrippingArm

    @property
    def motions(self) -> int:
        """How many motions the controller was told to begin."""
        return self.b.controller.motions_started

    async def reachable(self) -> None:
        """Wait until the unit has reached its devices."""
        await connected(self.cell)

    async def until_moving(self, step: str) -> None:
        """Wait until the arm is on its way in a step of the job."""
        while self.cell.unit.snapshot()["step"] != step or not self.point.moving:
            await self.b.clock.sleep(_LOOK_S)
        await self.b.clock.sleep(_LOOK_S)

    async def quiet(self) -> None:
        """Wait until nobody waits for an answer: the wire's time-out can be shortened for the next question only."""
        await self.b.clock.sleep(_LOOK_S)

    async def settled(self) -> None:
        """Let everything come to its end that a fault has set going."""
        await self.b.clock.sleep(_SETTLED_S)

    async def last_motion(self) -> str | None:
        """How the journal says that the last motion ended; None where that is not known."""
        motions = await self.cell.journal.motions()
        outcome: str | None = motions[0]["outcome"]
        return outcome

    async def recovered(self) -> None:
        """What an operator does when the cause is gone: say what the gripper holds where asked, clear, reset."""
        holds = "empty" if self.point.world.held is None else "holding"
        if self.cell.unit.snapshot()["gripper"]["knowledge"] == "unknown":
            assert (await self.cell.unit.resolve_gripper(holds, "test")).accepted
        if self.cell.state == "Aborted":
            await self.cell.give(Command.CLEAR)
            await self.cell.reaches("Stopped")
        await self.settled()


def _through_the_robot(b: AnyBench) -> Gripper:
    return RobotIoGripper(RobotIoGripperConfig(), b.clock, b.arm)


@contextlib.asynccontextmanager
async def wire_cell(
    wire: str, folder: Path, make_gripper: Callable[[AnyBench], Gripper] = _through_the_robot
) -> AsyncIterator[WireCell]:
    """Run a cell on ``modbus``, ``rmi``, ``karel`` (TCP) or ``karel_serial``."""
    async with contextlib.AsyncExitStack() as stack:
        b: AnyBench
        if wire == "modbus":
            b = await stack.enter_async_context(bench(make_point=GrippingArm))
        elif wire == "rmi":
            b = await stack.enter_async_context(rmi_bench(make_point=GrippingArm))
        else:
            carrier = "serial" if wire == "karel_serial" else "tcp"
            b = await stack.enter_async_context(karel_bench(carrier, make_point=GrippingArm))
        assert isinstance(b.point, GrippingArm)
        workers = 0
        wire_busy = b.clock.busy

        @contextlib.contextmanager
        def working() -> Iterator[None]:
            nonlocal workers
            workers += 1
            try:
                yield
            finally:
                workers -= 1

        b.clock.working = working  # type: ignore[method-assign]
        b.clock.busy = lambda: wire_busy() or workers > 0
        world = b.point.world
        cell = build(folder, parameters=replace(PARAMETERS, retries=RetryParameters(grip=0)))
        gripper = make_gripper(b)
        camera = FakeCamera(cast("StepClock", b.clock), (WIDTH_PX, HEIGHT_PX))
        devices = Devices(b.clock, camera, b.arm, gripper)
        robot = replace(CALIBRATION.robot, user_frame=1, user_tool=1)
        equipment = replace(
            cell.unit.equipment,
            devices=devices,
            calibration=replace(CALIBRATION, robot=robot),
            perceive=lambda _: seen(world),
        )
        cell.unit = Unit(equipment, simulation=True)
        async with running(cell):
            yield WireCell(cell, b, b.point)
