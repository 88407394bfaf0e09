"""The virtual stream, its socket and the Camera port on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from drivers.sim.camera_client import DRIVER, SimCameraConfig, SimCapture
from drivers.sim.camera_server import CameraServer
from drivers.sim.camera_stream import FRAME_RATE_HZ, CameraStream
from drivers.sim.clock_authority import SimTime
from drivers.sim.clock_client import SimClock
from drivers.sim.clock_page import ClockPage
from drivers.sim.world import Snapshot
from drivers.sim.world_model import TIMESTEP_S
from srvs_cell.alarms import Alarm
from srvs_cell.ports import DriverContext, FrameError, NotConnectedError, PortError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from drivers.sim.camera_stream import Exposure

PERIOD_S = 1.0 / FRAME_RATE_HZ


class EmptyWorld:
    """A world in which only time passes."""

    def __init__(self) -> None:
        self.time_s = 0.0

    def snapshot(self) -> Snapshot:
        return Snapshot(self.time_s, np.zeros(0), np.eye(4))


class Cell:
    """Time, stream and server without physics and rendering."""

    def __init__(self, folder: Path, lag_s: float = 0.05) -> None:
        self.world = EmptyWorld()
        self.stream = CameraStream(self.world, lag_s, 4)
        self.page = ClockPage.create(folder / "clock")
        self.time = SimTime(self.step, self.page, 20.0)
        self.rendered: list[int] = []
        self.server = CameraServer(self.stream, self, self.time)

    def step(self) -> float:
        self.world.time_s += TIMESTEP_S
        self.stream.step()
        return self.world.time_s

    def picture(self, exposure: Exposure) -> NDArray[np.uint8]:
        self.rendered.append(exposure.sequence)
        return np.full((12, 16), exposure.sequence % 256, dtype=np.uint8)

    def pass_time(self, seconds: float) -> None:
        for _ in range(round(seconds / TIMESTEP_S)):
            self.step()


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[Cell]:
    cell = Cell(tmp_path)
    yield cell
    cell.page.close()


@pytest.fixture
def port(cell: Cell) -> Iterator[int]:
    cell.time.start()
    yield cell.server.start()
    cell.time.close()
    cell.server.close()


def test_after_a_pause_the_oldest_frames_come_first_and_then_there_is_a_gap(cell: Cell) -> None:
    cell.pass_time(2.0)
    stale = [cell.stream.take() for _ in range(5)]
    assert [frame.sequence for frame in stale if frame is not None] == [1, 2, 3, 4]
    assert stale[4] is None
    cell.pass_time(2 * PERIOD_S + 0.05)
    fresh = cell.stream.take()
    assert fresh is not None
    assert fresh.sequence > 20
    assert fresh.stamp_s > 2.0


def test_a_frame_can_only_be_had_after_the_lag(cell: Cell) -> None:
    cell.pass_time(0.04)
    assert cell.stream.take() is None
    cell.pass_time(0.02)
    frame = cell.stream.take()
    assert frame is not None
    assert frame.stamp_s == pytest.approx(TIMESTEP_S)


def test_a_frozen_camera_repeats_its_last_exposure(cell: Cell) -> None:
    cell.pass_time(0.01)
    cell.stream.frozen = True
    cell.pass_time(1.0)
    frames = [cell.stream.take() for _ in range(4)]
    assert {frame.stamp_s for frame in frames if frame is not None} == {TIMESTEP_S}


def test_only_frames_whose_pixels_are_wanted_are_rendered(cell: Cell, port: int) -> None:
    capture = SimCapture(SimCameraConfig(port=port))
    stamps = [capture.grab() for _ in range(6)]
    image = capture.retrieve()
    capture.close()
    assert all(stamp is not None for stamp in stamps)
    last = stamps[-1]
    assert last is not None
    assert cell.rendered == [last.sequence]
    assert (image == last.sequence % 256).all()


def test_pixels_without_a_grabbed_frame_are_refused(port: int) -> None:
    capture = SimCapture(SimCameraConfig(port=port))
    with pytest.raises(FrameError):
        capture.retrieve()
    capture.close()


def test_a_stream_that_has_stopped_says_that_no_frame_came(cell: Cell, port: int) -> None:
    capture = SimCapture(SimCameraConfig(port=port))
    cell.page.wake_s = 1e6
    cell.stream.running = False
    stamps = [capture.grab() for _ in range(5)]
    assert stamps[-1] is None
    capture.close()


def test_a_cut_connection_is_named(cell: Cell, port: int) -> None:
    capture = SimCapture(SimCameraConfig(port=port))
    assert capture.grab() is not None
    cell.server.disconnect()
    with pytest.raises(NotConnectedError) as caught:
        capture.grab()
    assert caught.value.alarm is Alarm.CAMERA_UNAVAILABLE
    capture.close()


async def test_the_camera_port_gives_the_first_frame_exposed_after_the_instant(port: int, tmp_path: Path) -> None:
    clock = SimClock(tmp_path / "clock")
    camera = DRIVER.factory(SimCameraConfig(port=port), DriverContext(clock))
    await camera.connect()
    await clock.sleep(1.0)  # the queue fills with frames that nobody takes
    await camera.activate()
    for _ in range(3):
        now_s = clock.now_s()
        frame = await camera.grab(now_s, 2.0)
        assert now_s <= frame.exposed_at_s < now_s + 3.0 * PERIOD_S
        assert (frame.image == frame.sequence % 256).all()
    await camera.deactivate()
    await camera.disconnect()


async def test_a_frozen_camera_ends_in_stale(cell: Cell, port: int, tmp_path: Path) -> None:
    clock = SimClock(tmp_path / "clock")
    camera = DRIVER.factory(SimCameraConfig(port=port), DriverContext(clock))
    await camera.connect()
    await camera.activate()
    await camera.grab(clock.now_s(), 2.0)
    cell.stream.frozen = True
    with pytest.raises(FrameError) as caught:
        await camera.grab(clock.now_s() + 0.2, 1.0)
    assert caught.value.alarm is Alarm.CAMERA_STALE
    await camera.disconnect()


async def test_no_camera_at_the_port_is_named(tmp_path: Path, cell: Cell) -> None:
    camera = DRIVER.factory(SimCameraConfig(port=1), DriverContext(SimClock(tmp_path / "clock")))
    with pytest.raises(PortError, match=r"127\.0\.0\.1:1") as caught:
        await camera.connect()
    assert caught.value.alarm is Alarm.CAMERA_UNAVAILABLE
    assert not cell.rendered
