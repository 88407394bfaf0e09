"""The FANUC driver over RMI on real loopback sockets to the controller double, in stepped time."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

from drivers.fanuc.rmi import DRIVER, FanucRmiArm
from drivers.sim.rmi_controller import RmiController
from srvs_cell.ports import DriverContext
from tests.drivers.fanuc.bench import MID_MOVE_S, PATIENT_S, SPEED_MM_S, TARGET
from tests.drivers.stepped import PointArm, SteppedClock, SteppedTime

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from srvs_cell.geometry import Xyzwpr


def make_arm(clock: SteppedClock, **settings: object) -> FanucRmiArm:
    arm = DRIVER.factory(DRIVER.config_model.model_validate(settings), DriverContext(clock))
    assert isinstance(arm, FanucRmiArm)
    return arm


@dataclass
class RmiBench:
    time: SteppedTime
    clock: SteppedClock
    point: PointArm
    controller: RmiController
    arm: FanucRmiArm
    port: int

    async def ready(self) -> None:
        await self.arm.connect()
        await self.arm.activate()

    async def heard(self) -> None:
        """Return when the double has dealt with all that was sent, a session's end too; the driver does not wait."""
        await self.clock.sleep(0.0)

    def begin_move(self) -> asyncio.Task[Xyzwpr]:
        return asyncio.create_task(self.arm.move_linear(TARGET, SPEED_MM_S))

    async def begun_move(self) -> asyncio.Task[Xyzwpr]:
        """Return a move that is well on its way."""
        task = self.begin_move()
        await self.clock.sleep(MID_MOVE_S)
        assert self.point.moving
        return task


@contextlib.asynccontextmanager
async def rmi_bench(
    timeout_s: float = PATIENT_S, make_point: Callable[[SteppedTime], PointArm] = PointArm, **settings: float
) -> AsyncIterator[RmiBench]:
    time = SteppedTime()
    point = make_point(time)
    controller = RmiController(point, time)
    port = controller.start()
    clock = SteppedClock(time)
    arm = make_arm(clock, port=port, timeout_s=timeout_s, **settings)
    clock.busy = lambda: arm._session.busy and not controller.working
    time.hold_while(lambda: time.awake(controller._scanner))
    try:
        yield RmiBench(time, clock, point, controller, arm, port)
    finally:
        await arm.disconnect()
        time.release()
        controller.close()
