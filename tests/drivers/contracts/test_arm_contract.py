"""What every RobotArm promises, over the FANUC driver on its wire and over the object-level double."""

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, replace

import pytest

from drivers.sim.doubles import FakeArm, StepClock, World
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import (
    Clock,
    Lifecycle,
    MotionStoppedError,
    NotConnectedError,
    NotReadyError,
    RobotArm,
    RobotMode,
)
from tests.drivers.fanuc.bench import HOME, MID_MOVE_S, SPEED_MM_S, TARGET, bench


@dataclass
class ArmBench:
    """An arm at HOME, and where it truly is."""

    arm: RobotArm
    clock: Clock
    true_pose: Callable[[], Xyzwpr]

    async def ready(self) -> None:
        await self.arm.connect()
        await self.arm.activate()

    async def begun_move(self) -> asyncio.Task[Xyzwpr]:
        task = asyncio.create_task(self.arm.move_linear(TARGET, SPEED_MM_S))
        await self.clock.sleep(MID_MOVE_S)
        assert HOME.x_mm < self.true_pose().x_mm < TARGET.x_mm
        return task


@contextlib.asynccontextmanager
async def fanuc_over_modbus() -> AsyncIterator[ArmBench]:
    async with bench() as b:
        yield ArmBench(b.arm, b.clock, lambda: b.point.pose)


@contextlib.asynccontextmanager
async def fake() -> AsyncIterator[ArmBench]:
    clock = StepClock()
    arm = FakeArm(clock, World([]), HOME)
    yield ArmBench(arm, clock, lambda: arm.pose)


@pytest.fixture(params=[fanuc_over_modbus, fake], ids=lambda make: make.__name__)
async def b(request: pytest.FixtureRequest) -> AsyncIterator[ArmBench]:
    async with request.param() as made:
        yield made


async def test_connecting_and_activating_move_nothing(b: ArmBench) -> None:
    lives = [b.arm.lifecycle]
    await b.arm.connect()
    lives.append(b.arm.lifecycle)
    await b.arm.activate()
    lives.append(b.arm.lifecycle)
    await b.clock.sleep(3.0)
    assert lives == [Lifecycle.DISCONNECTED, Lifecycle.INACTIVE, Lifecycle.ACTIVE]
    assert b.true_pose() == HOME
    assert b.arm.description


async def test_what_is_not_connected_cannot_be_read(b: ArmBench) -> None:
    with pytest.raises(NotConnectedError):
        await b.arm.status()


async def test_an_inactive_arm_is_read_but_not_moved(b: ArmBench) -> None:
    await b.arm.connect()
    status = await b.arm.status()
    assert (status.pose, status.mode, status.moving) == (HOME, RobotMode.AUTO, False)
    for move in (b.arm.move_linear(TARGET, SPEED_MM_S), b.arm.move_joint(TARGET, 10.0)):
        with pytest.raises(NotReadyError):
            await move
    await b.clock.sleep(3.0)
    assert b.true_pose() == HOME


async def test_a_deactivated_arm_is_not_moved(b: ArmBench) -> None:
    await b.ready()
    await b.arm.deactivate()
    assert b.arm.lifecycle is Lifecycle.INACTIVE
    with pytest.raises(NotReadyError):
        await b.arm.move_linear(TARGET, SPEED_MM_S)


@pytest.mark.parametrize("kind", ["linear", "joint"])
async def test_a_move_ends_at_its_target_and_returns_the_pose(b: ArmBench, kind: str) -> None:
    await b.ready()
    begun_s = b.clock.now_s()
    target = replace(TARGET, r_deg=30.0)
    move = b.arm.move_linear(target, SPEED_MM_S) if kind == "linear" else b.arm.move_joint(target, 10.0)
    assert await move == target
    assert b.true_pose() == target
    assert b.clock.now_s() > begun_s
    assert not (await b.arm.status()).moving


async def test_a_linear_move_takes_the_time_that_its_speed_demands(b: ArmBench) -> None:
    await b.ready()
    begun_s = b.clock.now_s()
    await b.arm.move_linear(TARGET, SPEED_MM_S)
    assert 4.999 < b.clock.now_s() - begun_s < 5.5


async def test_status_may_be_read_in_mid_move(b: ArmBench) -> None:
    await b.ready()
    task = await b.begun_move()
    status = await b.arm.status()
    assert status.moving
    assert HOME.x_mm < status.pose.x_mm < TARGET.x_mm
    await task


async def test_a_second_move_is_refused_while_one_is_under_way(b: ArmBench) -> None:
    await b.ready()
    task = await b.begun_move()
    with pytest.raises(NotReadyError):
        await b.arm.move_linear(HOME, SPEED_MM_S)
    assert await task == TARGET


async def test_a_stop_in_mid_move_ends_it_for_good(b: ArmBench) -> None:
    await b.ready()
    task = await b.begun_move()
    asked_at = b.true_pose()
    await b.arm.request_stop()
    with pytest.raises(MotionStoppedError):
        await task
    stood = b.true_pose()
    assert math.dist(asked_at.as_tuple(), stood.as_tuple()) < 10.0
    await b.arm.activate()
    await b.clock.sleep(5.0)
    assert b.true_pose() == stood
    assert await b.arm.move_linear(HOME, SPEED_MM_S) == HOME


async def test_a_stop_with_nothing_under_way_does_no_harm(b: ArmBench) -> None:
    await b.ready()
    await b.arm.request_stop()
    await b.arm.activate()
    assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET


async def test_resetting_moves_nothing(b: ArmBench) -> None:
    await b.arm.connect()
    await b.arm.reset_fault()
    await b.clock.sleep(1.0)
    assert b.true_pose() == HOME
    assert (await b.arm.status()).fault is None


async def test_a_device_that_is_gone_can_be_let_go_of_twice(b: ArmBench) -> None:
    await b.arm.disconnect()
    await b.ready()
    await b.arm.disconnect()
    await b.arm.disconnect()
    assert b.arm.lifecycle is Lifecycle.DISCONNECTED
    await b.ready()
    assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET
