"""What every RobotArm promises, over the FANUC driver on its wire to a point and to the simulated arm, and the fake."""

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from drivers.fanuc.modbus import FanucModbusArm, FanucModbusConfig
from drivers.fanuc.rmi import FanucRmiArm, FanucRmiConfig
from drivers.sim.doubles import FakeArm, StepClock, World
from drivers.sim.karel_controller import KarelController
from drivers.sim.karel_server import PtyCarrier
from drivers.sim.modbus_controller import ModbusController
from drivers.sim.rmi_controller import RmiController
from srvs_cell.geometry import Transform, Xyzwpr, pose_difference
from srvs_cell.ports import (
    Clock,
    Lifecycle,
    MotionStoppedError,
    NotConnectedError,
    NotReadyError,
    RobotArm,
    RobotMode,
)
from tests.drivers.contracts.simulated import simulated_arm
from tests.drivers.fanuc.bench import HOME, MID_MOVE_S, PATIENT_S, SPEED_MM_S, TARGET, bench
from tests.drivers.fanuc.karel_bench import karel_bench, make_arm
from tests.drivers.fanuc.rmi_bench import rmi_bench


@dataclass
class ArmBench:
    """An arm that stands at ``home``, and where it truly is."""

    arm: RobotArm
    clock: Clock
    true_pose: Callable[[], Xyzwpr]
    home: Xyzwpr = HOME

    @property
    def target(self) -> Xyzwpr:
        return replace(self.home, x_mm=self.home.x_mm + TARGET.x_mm - HOME.x_mm)

    def on_the_way(self, pose: Xyzwpr) -> bool:
        return self.home.x_mm < pose.x_mm < self.target.x_mm

    def stands_at(self, pose: Xyzwpr) -> bool:
        return _near(self.true_pose(), pose)

    async def ready(self) -> None:
        await self.arm.connect()
        await self.arm.activate()

    async def begun_move(self) -> asyncio.Task[Xyzwpr]:
        task = asyncio.create_task(self.arm.move_linear(self.target, SPEED_MM_S))
        await self.clock.sleep(MID_MOVE_S)
        assert self.on_the_way(self.true_pose())
        return task


def _near(a: Xyzwpr, b: Xyzwpr) -> bool:
    distance_mm, angle_deg = pose_difference(
        Transform.from_xyzwpr("base", "tcp", a), Transform.from_xyzwpr("base", "tcp", b)
    )
    return distance_mm < 0.01 and angle_deg < 0.01


@contextlib.asynccontextmanager
async def fanuc_to_a_point(_folder: Path) -> AsyncIterator[ArmBench]:
    async with bench() as b:
        yield ArmBench(b.arm, b.clock, lambda: b.point.pose)


@contextlib.asynccontextmanager
async def fanuc_to_the_simulated_arm(folder: Path) -> AsyncIterator[ArmBench]:
    with simulated_arm(folder, ModbusController) as (port, clock, simulated):
        arm = FanucModbusArm(FanucModbusConfig(port=port, timeout_s=PATIENT_S), clock)
        try:
            yield ArmBench(arm, clock, lambda: simulated.pose, simulated.pose)
        finally:
            await arm.disconnect()


@contextlib.asynccontextmanager
async def rmi_to_a_point(_folder: Path) -> AsyncIterator[ArmBench]:
    async with rmi_bench() as b:
        yield ArmBench(b.arm, b.clock, lambda: b.point.pose)


@contextlib.asynccontextmanager
async def rmi_to_the_simulated_arm(folder: Path) -> AsyncIterator[ArmBench]:
    with simulated_arm(folder, RmiController) as (port, clock, simulated):
        arm = FanucRmiArm(FanucRmiConfig(port=port, timeout_s=PATIENT_S), clock)
        try:
            yield ArmBench(arm, clock, lambda: simulated.pose, simulated.pose)
        finally:
            await arm.disconnect()


@contextlib.asynccontextmanager
async def karel_over_tcp_to_a_point(_folder: Path) -> AsyncIterator[ArmBench]:
    async with karel_bench("tcp") as b:
        yield ArmBench(b.arm, b.clock, lambda: b.point.pose)


@contextlib.asynccontextmanager
async def karel_over_serial_to_a_point(_folder: Path) -> AsyncIterator[ArmBench]:
    async with karel_bench("serial") as b:
        yield ArmBench(b.arm, b.clock, lambda: b.point.pose)


@contextlib.asynccontextmanager
async def karel_over_serial_to_the_simulated_arm(folder: Path) -> AsyncIterator[ArmBench]:
    with simulated_arm(folder, lambda arm, time: KarelController(arm, time, PtyCarrier())) as (
        device,
        clock,
        simulated,
    ):
        arm = make_arm(clock, "serial", device, timeout_s=PATIENT_S)
        try:
            yield ArmBench(arm, clock, lambda: simulated.pose, simulated.pose)
        finally:
            await arm.disconnect()


_BENCHES = [
    fanuc_to_a_point,
    fanuc_to_the_simulated_arm,
    rmi_to_a_point,
    rmi_to_the_simulated_arm,
    karel_over_tcp_to_a_point,
    karel_over_serial_to_a_point,
    karel_over_serial_to_the_simulated_arm,
]


@contextlib.asynccontextmanager
async def fake(_folder: Path) -> AsyncIterator[ArmBench]:
    clock = StepClock()
    arm = FakeArm(clock, World([]), HOME)
    yield ArmBench(arm, clock, lambda: arm.pose)


@pytest.fixture(params=[*_BENCHES, fake], ids=lambda make: make.__name__)
async def b(request: pytest.FixtureRequest, tmp_path: Path) -> AsyncIterator[ArmBench]:
    async with request.param(tmp_path) as made:
        yield made


async def test_connecting_and_activating_move_nothing(b: ArmBench) -> None:
    lives = [b.arm.lifecycle]
    await b.arm.connect()
    lives.append(b.arm.lifecycle)
    await b.arm.activate()
    lives.append(b.arm.lifecycle)
    await b.clock.sleep(3.0)
    assert lives == [Lifecycle.DISCONNECTED, Lifecycle.INACTIVE, Lifecycle.ACTIVE]
    assert b.stands_at(b.home)
    assert b.arm.description


async def test_what_is_not_connected_cannot_be_read(b: ArmBench) -> None:
    with pytest.raises(NotConnectedError):
        await b.arm.status()


async def test_an_inactive_arm_is_read_but_not_moved(b: ArmBench) -> None:
    await b.arm.connect()
    status = await b.arm.status()
    assert _near(status.pose, b.home)
    assert (status.mode, status.moving) == (RobotMode.AUTO, False)
    for move in (b.arm.move_linear(b.target, SPEED_MM_S), b.arm.move_joint(b.target, 10.0)):
        with pytest.raises(NotReadyError):
            await move
    await b.clock.sleep(3.0)
    assert b.stands_at(b.home)


async def test_a_deactivated_arm_is_not_moved(b: ArmBench) -> None:
    await b.ready()
    await b.arm.deactivate()
    assert b.arm.lifecycle is Lifecycle.INACTIVE
    with pytest.raises(NotReadyError):
        await b.arm.move_linear(b.target, SPEED_MM_S)


@pytest.mark.parametrize("kind", ["linear", "joint"])
async def test_a_move_ends_at_its_target_and_returns_the_pose(b: ArmBench, kind: str) -> None:
    await b.ready()
    begun_s = b.clock.now_s()
    target = replace(b.target, r_deg=30.0)
    move = b.arm.move_linear(target, SPEED_MM_S) if kind == "linear" else b.arm.move_joint(target, 10.0)
    assert _near(await move, target)
    assert b.stands_at(target)
    assert b.clock.now_s() > begun_s
    assert not (await b.arm.status()).moving


async def test_a_linear_move_takes_the_time_that_its_speed_demands(b: ArmBench) -> None:
    await b.ready()
    begun_s = b.clock.now_s()
    await b.arm.move_linear(b.target, SPEED_MM_S)
    assert 4.999 < b.clock.now_s() - begun_s < 6.0


async def test_status_may_be_read_in_mid_move(b: ArmBench) -> None:
    await b.ready()
    task = await b.begun_move()
    status = await b.arm.status()
    assert status.moving
    assert b.on_the_way(status.pose)
    await task


async def test_a_second_move_is_refused_while_one_is_under_way(b: ArmBench) -> None:
    await b.ready()
    task = await b.begun_move()
    with pytest.raises(NotReadyError):
        await b.arm.move_linear(b.home, SPEED_MM_S)
    assert _near(await task, b.target)


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
    assert b.stands_at(stood)
    assert _near(await b.arm.move_linear(b.home, SPEED_MM_S), b.home)


async def test_a_stop_forbids_motion_until_the_arm_is_made_active_again(b: ArmBench) -> None:
    await b.ready()
    task = await b.begun_move()
    await b.arm.request_stop()
    assert b.arm.lifecycle is Lifecycle.INACTIVE
    with pytest.raises(MotionStoppedError):
        await task
    with pytest.raises(NotReadyError):
        await b.arm.move_linear(b.home, SPEED_MM_S)


async def test_a_stop_with_nothing_under_way_forbids_motion_too(b: ArmBench) -> None:
    await b.ready()
    await b.arm.request_stop()
    assert b.arm.lifecycle is Lifecycle.INACTIVE
    with pytest.raises(NotReadyError):
        await b.arm.move_linear(b.target, SPEED_MM_S)
    await b.arm.activate()
    assert _near(await b.arm.move_linear(b.target, SPEED_MM_S), b.target)


async def test_resetting_moves_nothing(b: ArmBench) -> None:
    await b.arm.connect()
    await b.arm.reset_fault()
    await b.clock.sleep(1.0)
    assert b.stands_at(b.home)
    assert (await b.arm.status()).fault is None


async def test_a_device_that_is_gone_can_be_let_go_of_twice(b: ArmBench) -> None:
    await b.arm.disconnect()
    await b.ready()
    await b.arm.disconnect()
    await b.arm.disconnect()
    assert b.arm.lifecycle is Lifecycle.DISCONNECTED
    await b.ready()
    assert _near(await b.arm.move_linear(b.target, SPEED_MM_S), b.target)
