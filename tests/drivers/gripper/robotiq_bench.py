"""The Robotiq driver on a pseudo-terminal to the gripper double, in stepped time."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

from drivers.gripper.robotiq import DRIVER, RobotiqGripper
from drivers.sim.robotiq_double import RobotiqDouble
from drivers.sim.robotiq_fingers import ScriptedFingers
from srvs_cell.ports import DriverContext
from tests.drivers.stepped import SteppedClock, SteppedTime

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

PATIENT_S = 5.0
"""A wire time-out that a busy machine does not reach."""

IMPATIENT_S = 0.2
"""A wire time-out that a test waits for."""

STROKE = ((3, 85.0), (230, 0.0))
PART_AT = 120
PART_MM = 85.0 * (230 - PART_AT) / (230 - 3)


@dataclass
class RobotiqBench:
    clock: SteppedClock
    double: RobotiqDouble
    fingers: ScriptedFingers
    gripper: RobotiqGripper
    port: str

    def lose_patience(self, timeout_s: float = IMPATIENT_S) -> None:
        """Wait no longer for answers on this connection than a test likes to."""
        assert self.gripper._wire._client is not None
        self.gripper._wire._client.ctx.comm_params.timeout_connect = timeout_s

    async def ready(self) -> None:
        await self.gripper.connect()
        await self.gripper.activate()

    async def holding(self) -> None:
        await self.ready()
        self.fingers.part_at = PART_AT
        await self.gripper.close()


@contextlib.asynccontextmanager
async def robotiq_bench(
    answer_timeout_s: float = PATIENT_S, *, activated: bool = True, **settings: object
) -> AsyncIterator[RobotiqBench]:
    time = SteppedTime()
    clock = SteppedClock(time)
    fingers = ScriptedFingers(time.now_s)
    double = RobotiqDouble(fingers, time.now_s)
    if activated:
        double.make_ready()
    port = double.start()
    config = {"port": port, "answer_timeout_s": answer_timeout_s, "stroke": STROKE, **settings}
    gripper = DRIVER.factory(DRIVER.config_model.model_validate(config), DriverContext(clock))
    assert isinstance(gripper, RobotiqGripper)
    clock.busy = lambda: gripper._wire.busy
    try:
        yield RobotiqBench(clock, double, fingers, gripper, port)
    finally:
        await gripper.disconnect()
        double.close()
