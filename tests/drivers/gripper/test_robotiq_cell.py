"""A whole cell with a Robotiq gripper on a serial wire: what a fault while a part is carried ends in."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING

import pytest

from drivers.gripper.robotiq import DRIVER, RobotiqGripper
from drivers.sim.robotiq_double import RobotiqDouble
from drivers.sim.robotiq_fingers import ScriptedFingers
from drivers.sim.rtu_line import LineFault
from srvs_cell.cell import Command
from srvs_cell.ports import DriverContext
from tests.drivers.faults.cell import GrippingArm, WireCell, wire_cell
from tests.drivers.gripper.robotiq_bench import IMPATIENT_S, PART_AT, PATIENT_S, STROKE

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable
    from pathlib import Path

    from srvs_cell.ports import Gripper
    from tests.drivers.faults.cell import AnyBench

_CLOSE_OUTPUT, _OPEN_OUTPUT = 1, 2


class _Fingers(ScriptedFingers):
    """Fingers at the end of the arm: they close on the block that stands between them."""

    def __init__(self, now_s: Callable[[], float], point: GrippingArm) -> None:
        super().__init__(now_s)
        self._point = point

    def go(self, request: int, speed: float) -> None:
        self._point.set_output(_CLOSE_OUTPUT if request else _OPEN_OUTPUT, True)
        self.part_at = None if self._point.world.held is None else PART_AT
        super().go(request, speed)


class _Robotiq:
    """Double and driver, made for the bench of an arm."""

    def __init__(self) -> None:
        self.double: RobotiqDouble
        self.fingers: _Fingers
        self.driver: RobotiqGripper

    def make(self, b: AnyBench) -> Gripper:
        assert isinstance(b.point, GrippingArm)
        self.fingers = _Fingers(b.time.now_s, b.point)
        self.double = RobotiqDouble(self.fingers, b.time.now_s)
        self.double.make_ready()
        settings = {"port": self.double.start(), "stroke": STROKE, "answer_timeout_s": PATIENT_S}
        self.driver = DRIVER.factory(DRIVER.config_model.model_validate(settings), DriverContext(b.clock))
        busy = b.clock.busy
        b.clock.busy = lambda: busy() or self.driver._wire.busy
        return self.driver

    def hasten(self) -> None:
        assert self.driver._wire._client is not None
        self.driver._wire._client.ctx.comm_params.timeout_connect = IMPATIENT_S


@contextlib.asynccontextmanager
async def carrying(folder: Path) -> AsyncIterator[tuple[WireCell, _Robotiq]]:
    """Run a job up to the middle of its first way with a part."""
    robotiq = _Robotiq()
    try:
        async with asyncio.timeout(100.0), wire_cell("modbus", folder, robotiq.make) as c:
            await c.reachable()
            await c.cell.start()
            await c.until_moving("place")
            yield c, robotiq
    finally:
        robotiq.double.close()


def _lose_the_part(c: WireCell, robotiq: _Robotiq) -> None:
    c.point.world.lose()
    robotiq.fingers.lose_part()


def _let_it_slip(c: WireCell, robotiq: _Robotiq) -> None:
    del c
    robotiq.fingers.slip_to(PART_AT + 40)


def _cut_its_power(c: WireCell, robotiq: _Robotiq) -> None:
    del c
    robotiq.double.lose_power()


def _overload_it(c: WireCell, robotiq: _Robotiq) -> None:
    del c
    robotiq.double.fault_code = 0x0E


def _silence_it(c: WireCell, robotiq: _Robotiq) -> None:
    del c
    robotiq.hasten()
    robotiq.double.line.fault = LineFault.DEAF


@pytest.mark.parametrize(
    ("strike", "alarm", "state", "knowledge"),
    [
        (_lose_the_part, "GRIP_LOST", "Held", "empty"),
        (_let_it_slip, "GRIPPER_STATE_UNKNOWN", "Aborted", "holding"),
        (_cut_its_power, "GRIPPER_STATE_UNKNOWN", "Aborted", "holding"),
        (_overload_it, "GRIPPER_FAULT", "Aborted", "holding"),
        (_silence_it, "CONNECTION_TIMEOUT", "Aborted", "holding"),
    ],
)
async def test_a_fault_while_a_part_is_carried(
    strike: Callable[[WireCell, _Robotiq], None], alarm: str, state: str, knowledge: str, tmp_path: Path
) -> None:
    async with carrying(tmp_path) as (c, robotiq):
        sent = list(robotiq.double.commands)
        assert await robotiq.driver.state() == "holding"
        strike(c, robotiq)
        await c.cell.reaches(state)
        await c.settled()
        assert c.cell.alarms[0] == alarm, c.cell.unit.snapshot()["alarms"]
        assert c.cell.unit.snapshot()["gripper"]["knowledge"] == knowledge
        assert robotiq.double.commands == sent, "the fingers were commanded after the fault"
        assert not c.point.moving
        moved = c.motions
        robotiq.double.line.fault = LineFault.NONE
        await c.recovered()
        assert c.motions == moved
        assert robotiq.double.commands == sent


async def test_a_part_that_a_new_activation_would_drop_is_taken_out_first(tmp_path: Path) -> None:
    async with carrying(tmp_path) as (c, robotiq):
        robotiq.double.lose_power()
        await c.cell.reaches("Aborted")
        await c.settled()
        sent = list(robotiq.double.commands)
        await c.cell.give(Command.CLEAR)
        await c.cell.reaches("Stopped")
        await c.cell.give(Command.RESET)
        await c.cell.reaches("Aborted", "Stopped", "Idle")
        await c.settled()
        assert "GRIPPER_STATE_UNKNOWN" in c.cell.alarms, c.cell.unit.snapshot()["alarms"]
        assert robotiq.double.commands == sent


async def test_a_whole_job(tmp_path: Path) -> None:
    async with carrying(tmp_path) as (c, robotiq):
        await c.cell.reaches("Complete", "Suspended")
        assert c.cell.alarms == []
        assert c.point.world.dropped == []
        assert {command[0] for command in robotiq.double.commands} == {0x09}
