"""What every Camera promises: V4L2 on a scripted device, the simulated camera's socket, image files, and the fake."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.camera.image_folder import ImageFolderCamera, ImageFolderConfig
from drivers.sim.doubles import FakeCamera, StepClock
from srvs_cell.alarms import Alarm
from srvs_cell.ports import Camera, Clock, FrameError, Lifecycle, NotConnectedError, NotReadyError
from tests.drivers.camera.test_v4l2 import bench
from tests.drivers.contracts.simulated import simulated_camera


@dataclass
class CameraBench:
    """A camera; `freeze`, where it can, lets it repeat a frame from now on, time stamp included."""

    camera: Camera
    clock: Clock
    freeze: Callable[[], None] | None = None

    async def ready(self) -> None:
        await self.camera.connect()
        await self.camera.activate()


@contextlib.asynccontextmanager
async def v4l2(_folder: Path) -> AsyncIterator[CameraBench]:
    async with bench() as made:
        yield CameraBench(made.camera, made.clock, lambda: setattr(made.video, "frozen_at_s", made.clock.now_s()))


@contextlib.asynccontextmanager
async def simulated(folder: Path) -> AsyncIterator[CameraBench]:
    with simulated_camera(folder) as (camera, clock, stream):
        try:
            yield CameraBench(camera, clock, lambda: setattr(stream, "frozen", True))
        finally:
            await camera.disconnect()


@contextlib.asynccontextmanager
async def image_folder(folder: Path) -> AsyncIterator[CameraBench]:
    for number in range(3):
        cv2.imwrite(str(folder / f"{number}.png"), np.full((48, 64), number, np.uint8))
    clock = StepClock()
    yield CameraBench(ImageFolderCamera(ImageFolderConfig(folder=folder, repeat=True), clock), clock)


@contextlib.asynccontextmanager
async def fake(_folder: Path) -> AsyncIterator[CameraBench]:
    clock = StepClock()
    camera = FakeCamera(clock)
    yield CameraBench(camera, clock, lambda: setattr(camera, "frozen", clock.now_s()))


@pytest.fixture(params=[v4l2, simulated, image_folder, fake], ids=lambda make: make.__name__)
async def b(request: pytest.FixtureRequest, tmp_path: Path) -> AsyncIterator[CameraBench]:
    async with request.param(tmp_path) as made:
        yield made


async def test_its_life(b: CameraBench) -> None:
    lives = [b.camera.lifecycle]
    await b.camera.connect()
    lives.append(b.camera.lifecycle)
    await b.camera.activate()
    lives.append(b.camera.lifecycle)
    assert lives == [Lifecycle.DISCONNECTED, Lifecycle.INACTIVE, Lifecycle.ACTIVE]
    assert b.camera.description


async def test_a_frame_is_exposed_after_the_instant_asked_for(b: CameraBench) -> None:
    await b.ready()
    for ahead_s in (0.0, 0.3, 0.0):
        not_before_s = b.clock.now_s() + ahead_s
        frame = await b.camera.grab(not_before_s, 2.0)
        assert not_before_s <= frame.exposed_at_s <= b.clock.now_s()
        await b.clock.sleep(0.2)


async def test_frames_are_counted_and_are_bytes(b: CameraBench) -> None:
    await b.ready()
    frames = [await b.camera.grab(b.clock.now_s(), 2.0) for _ in range(3)]
    assert [frame.sequence for frame in frames] == sorted({frame.sequence for frame in frames})
    assert {frame.image.dtype for frame in frames} == {np.dtype(np.uint8)}
    assert {frame.image.shape[:2] for frame in frames} == {(48, 64)}


async def test_a_frame_that_is_too_far_away_does_not_come(b: CameraBench) -> None:
    await b.ready()
    begun_s = b.clock.now_s()
    with pytest.raises(FrameError):
        await b.camera.grab(begun_s + 5.0, 0.5)
    assert 0.45 < b.clock.now_s() - begun_s < 2.0


async def test_what_is_not_connected_gives_no_frames(b: CameraBench) -> None:
    with pytest.raises((NotConnectedError, NotReadyError)):
        await b.camera.grab(b.clock.now_s(), 2.0)


async def test_an_inactive_camera_gives_no_frames(b: CameraBench) -> None:
    await b.camera.connect()
    with pytest.raises(NotReadyError):
        await b.camera.grab(b.clock.now_s(), 2.0)
    await b.camera.activate()
    await b.camera.grab(b.clock.now_s(), 2.0)
    # A scripted device delivers only while time passes, and a read that is under way is waited for.
    await asyncio.gather(b.camera.deactivate(), b.clock.sleep(1.0))
    assert b.camera.lifecycle is Lifecycle.INACTIVE
    with pytest.raises(NotReadyError):
        await b.camera.grab(b.clock.now_s(), 2.0)


async def test_frames_that_are_all_too_old_are_stale(b: CameraBench) -> None:
    if b.freeze is None:
        pytest.skip("image files are exposed when they are asked for")
    await b.ready()
    await b.camera.grab(b.clock.now_s(), 2.0)
    b.freeze()
    await b.clock.sleep(0.5)
    begun_s = b.clock.now_s()
    with pytest.raises(FrameError) as raised:
        await b.camera.grab(begun_s, 1.0)
    assert raised.value.alarm is Alarm.CAMERA_STALE
    assert b.clock.now_s() - begun_s > 0.95


async def test_it_can_be_let_go_of_before_it_is_connected(b: CameraBench) -> None:
    await b.camera.disconnect()
    assert b.camera.lifecycle is Lifecycle.DISCONNECTED
