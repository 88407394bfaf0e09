"""The FANUC driver on a real loopback socket to the controller double, in stepped time."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

from drivers.fanuc.modbus import FanucModbusArm, FanucModbusConfig
from drivers.sim.modbus_controller import ModbusController
from drivers.sim.modbus_server import WireFault
from srvs_cell.geometry import Xyzwpr
from tests.drivers.stepped import PointArm, SteppedClock, SteppedTime

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Mapping

HOME = Xyzwpr(500.0, 0.0, 400.0, 180.0, 0.0, 0.0)
TARGET = Xyzwpr(600.0, 0.0, 400.0, 180.0, 0.0, 0.0)
SPEED_MM_S = 20.0
MID_MOVE_S = 1.0

PATIENT_S = 10.0
"""A wire time-out that a busy machine does not reach."""

IMPATIENT_S = 0.4
"""A wire time-out that a test waits for."""

NEVER_ANSWERED = {WireFault.SILENT, WireFault.DEAF, WireFault.LATE, WireFault.NONSENSE}
"""What only a time-out ends."""

_HASTY_S = 0.1


@dataclass
class Bench:
    time: SteppedTime
    clock: SteppedClock
    point: PointArm
    controller: ModbusController
    arm: FanucModbusArm
    port: int

    async def ready(self) -> None:
        await self.arm.connect()
        await self.arm.activate()

    def break_wire(self, fault: WireFault) -> None:
        """Let the wire go wrong; only where a time-out is what ends it, the wire's is short from now on."""
        self.controller.server.fault = fault
        client = self.arm._wire._client
        if fault in NEVER_ANSWERED and client is not None:
            client.ctx.comm_params.timeout_connect = _HASTY_S

    def begin_move(self) -> asyncio.Task[Xyzwpr]:
        return asyncio.create_task(self.arm.move_linear(TARGET, SPEED_MM_S))

    async def begun_move(self) -> asyncio.Task[Xyzwpr]:
        """Return a move that is well on its way."""
        task = self.begin_move()
        await self.clock.sleep(MID_MOVE_S)
        assert self.point.moving
        return task


@contextlib.asynccontextmanager
async def bench(
    timeout_s: float = PATIENT_S,
    make_point: Callable[[SteppedTime], PointArm] = PointArm,
    sources: Mapping[str, str] | None = None,
    **settings: float,
) -> AsyncIterator[Bench]:
    time = SteppedTime()
    point = make_point(time)
    controller = ModbusController(point, time, sources=sources)
    port = controller.start()
    clock = SteppedClock(time)
    config = FanucModbusConfig.model_validate({"port": port, "timeout_s": timeout_s, **settings})
    arm = FanucModbusArm(config, clock)
    clock.busy = lambda: arm._wire.busy
    time.hold_while(lambda: time.awake(controller._scanner))
    try:
        yield Bench(time, clock, point, controller, arm, port)
    finally:
        await arm.disconnect()
        time.release()
        controller.close()
