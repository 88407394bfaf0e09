"""What every Gripper promises, over the robot's I/O, its own serial wire, and the object-level double."""

import contextlib
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass

import pytest

from drivers.gripper.robot_io import RobotIoGripper, RobotIoGripperConfig
from drivers.sim.doubles import Block, FakeArm, FakeGripper, StepClock, World
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import Clock, Gripper, GripState, Lifecycle, NotReadyError, OutcomeUnknownError
from tests.drivers.fanuc.bench import bench
from tests.drivers.fanuc.rmi_bench import rmi_bench
from tests.drivers.gripper.robotiq_bench import PART_AT, robotiq_bench
from tests.drivers.gripper.valve import CONFIG, Valve
from tests.drivers.stepped import PointArm, SteppedClock, SteppedTime


@dataclass
class GripperBench:
    """An open gripper; `put_part` puts a part between the fingers, `break_sensors` lets them confirm nothing."""

    gripper: Gripper
    clock: Clock
    put_part: Callable[[], None]
    break_sensors: Callable[[], None]

    async def ready(self) -> None:
        await self.gripper.connect()
        await self.gripper.activate()


@contextlib.asynccontextmanager
async def robot_io() -> AsyncIterator[GripperBench]:
    clock = SteppedClock(SteppedTime())
    valve = Valve(clock)
    yield GripperBench(
        RobotIoGripper(CONFIG, clock, valve),
        clock,
        lambda: setattr(valve, "part", True),
        lambda: setattr(valve, "stuck", True),
    )


class _GrippingArm(PointArm):
    """A point with a gripper that closes at once."""

    def __init__(self, time: SteppedTime) -> None:
        super().__init__(time)
        self.part = False
        self.broken = False

    def input(self, n: int) -> bool:
        closed = self.output(1)
        on = 2 if not closed else 1 if self.part else 3
        return n == on and not self.broken


@contextlib.asynccontextmanager
async def robot_io_over_modbus() -> AsyncIterator[GripperBench]:
    async with bench(make_point=_GrippingArm) as b:
        await b.arm.connect()
        yield GripperBench(
            RobotIoGripper(RobotIoGripperConfig(), b.clock, b.arm),
            b.clock,
            lambda: setattr(b.point, "part", True),
            lambda: setattr(b.point, "broken", True),
        )


@contextlib.asynccontextmanager
async def robot_io_over_rmi() -> AsyncIterator[GripperBench]:
    async with rmi_bench(make_point=_GrippingArm) as b:
        await b.arm.connect()
        yield GripperBench(
            RobotIoGripper(RobotIoGripperConfig(), b.clock, b.arm),
            b.clock,
            lambda: setattr(b.point, "part", True),
            lambda: setattr(b.point, "broken", True),
        )


@contextlib.asynccontextmanager
async def robotiq() -> AsyncIterator[GripperBench]:
    async with robotiq_bench() as b:
        yield GripperBench(
            b.gripper,
            b.clock,
            lambda: setattr(b.fingers, "part_at", PART_AT),
            lambda: setattr(b.fingers, "stuck", True),
        )


@contextlib.asynccontextmanager
async def fake() -> AsyncIterator[GripperBench]:
    clock = StepClock()
    world = World([])
    gripper = FakeGripper(clock, world, FakeArm(clock, world, Xyzwpr(0.0, 0.0, 20.0, 180.0, 0.0, 0.0)))
    yield GripperBench(
        gripper,
        clock,
        lambda: world.blocks.append(Block("part", 0.0, 0.0, 30.0)),
        lambda: setattr(gripper, "silent", True),
    )


MAKERS = [robot_io, robot_io_over_modbus, robot_io_over_rmi, robotiq, fake]


@pytest.fixture(params=MAKERS, ids=lambda make: make.__name__)
async def b(request: pytest.FixtureRequest) -> AsyncIterator[GripperBench]:
    async with request.param() as made:
        yield made


async def test_its_life(b: GripperBench) -> None:
    lives = [b.gripper.lifecycle]
    await b.gripper.connect()
    lives.append(b.gripper.lifecycle)
    await b.gripper.activate()
    lives.append(b.gripper.lifecycle)
    await b.gripper.deactivate()
    lives.append(b.gripper.lifecycle)
    await b.gripper.disconnect()
    lives.append(b.gripper.lifecycle)
    assert lives == [
        Lifecycle.DISCONNECTED,
        Lifecycle.INACTIVE,
        Lifecycle.ACTIVE,
        Lifecycle.INACTIVE,
        Lifecycle.DISCONNECTED,
    ]


async def test_it_tells_a_part_from_nothing(b: GripperBench) -> None:
    await b.ready()
    assert await b.gripper.state() is GripState.OPEN
    assert await b.gripper.close() is GripState.CLOSED_EMPTY
    assert await b.gripper.state() is GripState.CLOSED_EMPTY
    await b.gripper.open()
    b.put_part()
    assert await b.gripper.close() is GripState.HOLDING
    assert await b.gripper.state() is GripState.HOLDING
    await b.gripper.open()
    assert await b.gripper.state() is GripState.OPEN


async def test_what_is_held_is_still_held_after_a_new_connection(b: GripperBench) -> None:
    await b.ready()
    b.put_part()
    await b.gripper.close()
    await b.gripper.deactivate()
    await b.gripper.disconnect()
    await b.ready()
    assert await b.gripper.state() is GripState.HOLDING


@pytest.mark.parametrize("action", ["open", "close"])
async def test_without_the_sensors_the_outcome_is_unknown(b: GripperBench, action: str) -> None:
    await b.ready()
    b.break_sensors()
    begun_s = b.clock.now_s()
    with pytest.raises(OutcomeUnknownError):
        await (b.gripper.open() if action == "open" else b.gripper.close())
    assert b.clock.now_s() > begun_s


@pytest.mark.parametrize("action", ["open", "close"])
async def test_an_inactive_gripper_is_read_but_does_not_act(b: GripperBench, action: str) -> None:
    await b.gripper.connect()
    b.put_part()
    for _ in ("never active", "no longer active"):
        with pytest.raises(NotReadyError):
            await (b.gripper.open() if action == "open" else b.gripper.close())
        assert await b.gripper.state() is GripState.OPEN
        await b.gripper.activate()
        await b.gripper.deactivate()
