"""The FANUC driver over the KAREL line protocol on a real wire to the controller double, in stepped time."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivers.fanuc.karel import DRIVER, FanucKarelArm
from drivers.sim.karel_controller import KarelController
from drivers.sim.karel_server import PtyCarrier, TcpCarrier
from srvs_cell.ports import DriverContext
from tests.drivers.fanuc.bench import MID_MOVE_S, PATIENT_S, SPEED_MM_S, TARGET
from tests.drivers.stepped import PointArm, SteppedClock, SteppedTime

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Mapping

    from srvs_cell.geometry import Xyzwpr
    from srvs_cell.ports import Clock

CARRIERS = ("tcp", "serial")
POLL_S = 0.2
"""Fewer readings in a move than the driver's default: enough to see all that happens."""


def make_arm(clock: Clock, carrier: str, address: str, **settings: object) -> FanucKarelArm:
    wire: dict[str, Any] = {"device": address} if carrier == "serial" else {"host": "127.0.0.1", "port": int(address)}
    config = DRIVER.config_model.model_validate({carrier: wire, **settings})
    arm = DRIVER.factory(config, DriverContext(clock))
    assert isinstance(arm, FanucKarelArm)
    return arm


@dataclass
class KarelBench:
    time: SteppedTime
    clock: SteppedClock
    point: PointArm
    controller: KarelController
    arm: FanucKarelArm
    carrier: str
    address: str

    async def ready(self) -> None:
        await self.arm.connect()
        await self.arm.activate()

    def moving(self) -> bool:
        return self.point.moving

    def begin_move(self) -> asyncio.Task[Xyzwpr]:
        return asyncio.create_task(self.arm.move_linear(TARGET, SPEED_MM_S))

    async def begun_move(self) -> asyncio.Task[Xyzwpr]:
        """Return a move that is well on its way."""
        task = self.begin_move()
        await self.clock.sleep(MID_MOVE_S)
        assert self.point.moving
        return task


@contextlib.asynccontextmanager
async def karel_bench(
    carrier: str = "tcp",
    timeout_s: float = PATIENT_S,
    make_point: Callable[[SteppedTime], PointArm] = PointArm,
    sources: Mapping[str, str] | None = None,
    **settings: float,
) -> AsyncIterator[KarelBench]:
    time = SteppedTime()
    point = make_point(time)
    controller = KarelController(point, time, PtyCarrier() if carrier == "serial" else TcpCarrier(), sources)
    address = controller.start()
    clock = SteppedClock(time)
    arm = make_arm(clock, carrier, address, timeout_s=timeout_s, **{"poll_s": POLL_S, **settings})
    clock.busy = lambda: arm._session.busy
    time.hold_while(lambda: time.awake(controller._scanner))
    try:
        yield KarelBench(time, clock, point, controller, arm, carrier, address)
    finally:
        await arm.disconnect()
        time.release()
        controller.close()
