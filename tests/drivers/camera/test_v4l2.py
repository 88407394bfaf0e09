"""The V4L2 camera on a scripted device: settings, stamps, stale frames, an unplugged cable."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import cv2
import pytest

from drivers.camera.grabber import GrabbingCamera
from drivers.camera.v4l2 import DRIVER, V4l2CameraConfig, open_v4l2
from srvs_cell.alarms import Alarm
from srvs_cell.ports import DriverContext, FrameError, Lifecycle, NotConnectedError, NotReadyError, PortError
from tests.drivers.camera.scripted import PERIOD_S, ScriptedVideo, going_on
from tests.drivers.stepped import SteppedClock, SteppedTime

DEVICE = "/dev/v4l/by-id/usb-Scripted-video-index0"


class Bench:
    """The camera as the entry point makes it, but for the first frame, which each test asks for itself."""

    def __init__(self, **settings: Any) -> None:
        self.time = SteppedTime()
        self.clock = SteppedClock(self.time)
        self.video = ScriptedVideo(self.time)
        config = V4l2CameraConfig.model_validate({"device": DEVICE, "width": 64, "height": 48, **settings})
        self.camera = GrabbingCamera(
            lambda: open_v4l2(config, self.clock, lambda *_: self.video, self.time.now_s), self.clock, DEVICE, (64, 48)
        )
        self.time.hold_while(lambda: self.time.awake(self.camera._thread))


@contextlib.asynccontextmanager
async def bench(**settings: Any) -> AsyncIterator[Bench]:
    b = Bench(**settings)
    try:
        yield b
    finally:
        b.time.release()
        await b.camera.disconnect()


@contextlib.asynccontextmanager
async def streaming(**settings: Any) -> AsyncIterator[Bench]:
    async with bench(**settings) as b:
        await b.camera.connect()
        await b.camera.activate()
        yield b


async def test_the_first_frame_exposed_after_the_instant_is_returned_and_no_other_is_fetched() -> None:
    async with streaming() as b:
        await b.clock.sleep(1.0)
        assert b.video.retrieved == 0
        not_before_s = b.clock.now_s()
        frame = await b.camera.grab(not_before_s, 1.0)
        assert not_before_s <= frame.exposed_at_s < not_before_s + PERIOD_S
        assert b.clock.now_s() > not_before_s + 4 * PERIOD_S  # it had to come through the queue of old ones
        assert b.video.retrieved == 1
        assert frame.image.shape == (48, 64, 3)


async def test_two_who_wait_for_different_instants_get_different_frames() -> None:
    async with streaming() as b:
        now_s = b.clock.now_s()
        late, early = await asyncio.gather(b.camera.grab(now_s + 0.5, 2.0), b.camera.grab(now_s, 2.0))
        assert early.exposed_at_s < now_s + 0.5 <= late.exposed_at_s
        assert early.sequence < late.sequence


async def test_a_frozen_stream_is_stale_not_silent() -> None:
    async with streaming() as b:
        await b.clock.sleep(0.5)
        b.video.frozen_at_s = b.clock.now_s()
        await b.clock.sleep(0.5)
        with pytest.raises(FrameError) as stale:
            await b.camera.grab(b.clock.now_s(), 1.0)
        assert stale.value.alarm is Alarm.CAMERA_STALE
        assert "too early" in stale.value.detail


async def test_no_frame_in_time() -> None:
    async with streaming() as b:
        with pytest.raises(FrameError) as late:
            await b.camera.grab(b.clock.now_s(), PERIOD_S / 2)
        assert late.value.alarm is Alarm.CAMERA_TIMEOUT


async def test_an_unplugged_camera_is_lost_and_can_be_connected_again() -> None:
    async with streaming() as b:
        b.video.fails = True
        with pytest.raises(NotConnectedError) as lost:
            await b.camera.grab(b.clock.now_s(), 5.0)
        assert lost.value.alarm is Alarm.CAMERA_UNAVAILABLE
        assert b.camera.lifecycle is Lifecycle.DISCONNECTED
        with pytest.raises(NotConnectedError):
            await b.camera.grab(b.clock.now_s(), 5.0)
        b.video.fails = False
        await b.camera.connect()
        await b.camera.activate()
        await b.camera.grab(b.clock.now_s(), 1.0)


async def test_stamps_that_are_not_monotonic_are_refused() -> None:
    async with streaming() as b:
        b.video.stamp_offset_s = 1.7e9  # seconds since 1970
        with pytest.raises(PortError) as error:
            await b.camera.grab(b.clock.now_s(), 1.0)
        assert error.value.alarm is Alarm.PROTOCOL_ERROR
        assert "CLOCK_MONOTONIC" in error.value.detail


async def test_a_frame_from_the_future_is_dropped_and_counted_and_the_stream_goes_on() -> None:
    async with streaming() as b:
        for _ in range(3):
            b.video.misdate(1)
            not_before_s = b.clock.now_s()
            frame = await b.camera.grab(not_before_s, 2.0)
            assert not_before_s <= frame.exposed_at_s <= b.clock.now_s()
        assert b.camera.counters["misdated"] == 3
        assert b.camera.counters["streams_lost"] == 0


async def test_a_frame_that_has_lain_for_minutes_is_stale() -> None:
    async with streaming() as b:
        b.video.stamp_offset_s = -90.0
        with pytest.raises(FrameError, match=r"exposed (89|90)\.\d+ s too early") as stale:
            await b.camera.grab(b.clock.now_s(), 1.0)
        assert stale.value.alarm is Alarm.CAMERA_STALE
        b.video.stamp_offset_s = 0.0
        await b.camera.grab(b.clock.now_s(), 1.0)


async def test_a_late_stamp_is_moved_back_to_the_start_of_exposure() -> None:
    async with streaming(exposure_before_stamp_s=0.1) as b:
        not_before_s = b.clock.now_s()
        frame = await b.camera.grab(not_before_s, 1.0)
        assert frame.exposed_at_s >= not_before_s
        assert b.clock.now_s() >= not_before_s + 0.1


async def test_a_picture_that_cannot_be_decoded_or_has_another_size_is_invalid_and_the_stream_goes_on() -> None:
    async with streaming() as b:
        b.video.broken = True
        with pytest.raises(FrameError) as broken:
            await b.camera.grab(b.clock.now_s(), 1.0)
        b.video.broken, b.video.size_px = False, (32, 48)
        with pytest.raises(FrameError) as small:
            await b.camera.grab(b.clock.now_s(), 1.0)
        b.video.size_px = (64, 48)
        await b.camera.grab(b.clock.now_s(), 1.0)
        assert {broken.value.alarm, small.value.alarm} == {Alarm.IMAGE_INVALID}
        assert "(32, 48)" in small.value.detail


async def test_an_inactive_camera_gives_no_frames() -> None:
    async with bench() as b:
        with pytest.raises(NotConnectedError):
            await b.camera.grab(0.0, 1.0)
        await b.camera.connect()
        with pytest.raises(NotReadyError):
            await b.camera.grab(0.0, 1.0)
        await b.camera.activate()
        await going_on(b.clock, b.camera.deactivate())
        with pytest.raises(NotReadyError):
            await b.camera.grab(0.0, 1.0)


async def test_all_settings_are_written_and_read_back() -> None:
    async with bench(fourcc="MJPG", fps=30.0, exposure_100us=150, gain=8, focus=0) as b:
        await b.camera.connect()
        expected = {
            cv2.CAP_PROP_FOURCC: cv2.VideoWriter.fourcc(*"MJPG"),
            cv2.CAP_PROP_FRAME_WIDTH: 64,
            cv2.CAP_PROP_FRAME_HEIGHT: 48,
            cv2.CAP_PROP_FPS: 30,
            cv2.CAP_PROP_AUTO_EXPOSURE: 1,
            cv2.CAP_PROP_EXPOSURE: 150,
            cv2.CAP_PROP_GAIN: 8,
            cv2.CAP_PROP_AUTOFOCUS: 0,
            cv2.CAP_PROP_FOCUS: 0,
        }
        assert b.video._values == expected


@pytest.mark.parametrize(
    ("prop", "value", "words"),
    [
        (cv2.CAP_PROP_FRAME_WIDTH, 640.0, "width was set to 64, reads back 640"),
        (cv2.CAP_PROP_EXPOSURE, 157.0, "exposure_100us was set to 150, reads back 157"),
        (cv2.CAP_PROP_AUTO_EXPOSURE, 3.0, "auto_exposure was set to 1, reads back 3"),
        (cv2.CAP_PROP_GAIN, -1.0, "gain was set to 8, reads back -1"),
        (cv2.CAP_PROP_FOURCC, float(cv2.VideoWriter.fourcc(*"YUYV")), "fourcc was set to MJPG, reads back YUYV"),
        (cv2.CAP_PROP_FPS, 15.0, "fps was set to 30, reads back 15"),
    ],
)
async def test_a_setting_that_is_not_taken_is_named(prop: int, value: float, words: str) -> None:
    async with bench(fourcc="MJPG", fps=30.0, exposure_100us=150, gain=8) as b:
        b.video.stuck[prop] = value
        with pytest.raises(PortError) as error:
            await b.camera.connect()
        assert error.value.alarm is Alarm.CAMERA_SETTING
        assert words in error.value.detail
        assert b.video.released
        assert b.camera.lifecycle is Lifecycle.DISCONNECTED


async def test_a_frame_rate_that_is_nearly_right_is_taken() -> None:
    async with bench(fps=30.0) as b:
        b.video.stuck[cv2.CAP_PROP_FPS] = 29.97
        await b.camera.connect()


async def test_a_device_that_cannot_be_opened() -> None:
    async with bench() as b:
        b.video.opened = False
        with pytest.raises(NotConnectedError) as error:
            await b.camera.connect()
        assert error.value.alarm is Alarm.CAMERA_UNAVAILABLE
        assert b.video.released


async def test_a_device_that_does_not_exist() -> None:
    config = DRIVER.config_model.model_validate({"device": "/dev/v4l/by-id/nothing"})
    camera = DRIVER.factory(config, DriverContext(SteppedClock(SteppedTime())))
    with pytest.raises(NotConnectedError) as error:
        await camera.connect()
    assert error.value.alarm is Alarm.CAMERA_UNAVAILABLE
    assert "no such device" in error.value.detail


@pytest.mark.parametrize(
    "settings", [{"device": "0"}, {"device": DEVICE, "fourcc": "MPEG4"}, {"device": DEVICE, "x": 1}]
)
def test_a_wrong_config_is_an_error(settings: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="validation error"):
        V4l2CameraConfig.model_validate(settings)


async def test_a_file_is_not_a_camera(tmp_path: Path) -> None:
    """OpenCV itself, on what is no device."""
    path = tmp_path / "video0"
    path.write_bytes(b"")
    config = V4l2CameraConfig.model_construct(device=str(path), width=64, height=48)
    with pytest.raises(NotConnectedError) as error:
        open_v4l2(config, SteppedClock(SteppedTime()))
    assert error.value.alarm is Alarm.CAMERA_UNAVAILABLE
