"""What a USB camera does that is not in its data sheet: slow beginnings, hanging, unplugging, freezing, other sizes.

What real kernels do in each case was seen with vivid and with a simulated UVC camera: an unplugged camera fails every
grab at once, a frozen one after OpenCV's select time-out.
"""

import asyncio
import contextlib
import threading
import time
from collections.abc import AsyncIterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera.grabber import FrameStamp, GrabbingCamera, _Wanted
from drivers.camera.v4l2 import V4l2Camera, V4l2CameraConfig, V4l2Capture, open_v4l2
from srvs_cell.alarms import Alarm
from srvs_cell.ports import Frame, FrameError, Lifecycle, NotConnectedError
from tests.drivers.camera.scripted import PERIOD_S, ScriptedVideo, going_on
from tests.drivers.stepped import SteppedClock, SteppedTime

DEVICE = "/dev/v4l/by-id/usb-Scripted-video-index0"
REPORTED_WITHIN_S = 1.0
"""After a grab's deadline; all of it in the process's own time."""


class Bench:
    def __init__(self, **settings: Any) -> None:
        self.time = SteppedTime()
        self.clock = SteppedClock(self.time)
        self.video = ScriptedVideo(self.time)
        self.opened = 0
        self.config = V4l2CameraConfig.model_validate({"device": DEVICE, "width": 64, "height": 48, **settings})
        self.camera = V4l2Camera(self.config, self.clock, self.open)
        self.time.hold_while(lambda: self.time.awake(self.camera._thread))

    def open(self) -> V4l2Capture:
        self.opened += 1
        return open_v4l2(self.config, self.clock, lambda *_: self.video, self.time.now_s)


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


async def test_a_stream_that_begins_slowly_is_waited_for() -> None:
    async with bench(first_frame_timeout_s=5.0) as b:
        b.video.begins_at_s = b.clock.now_s() + 3.0
        await b.camera.connect()
        await b.camera.activate()
        assert b.camera.lifecycle is Lifecycle.ACTIVE
        assert b.clock.now_s() >= b.video.begins_at_s
        await b.camera.grab(b.clock.now_s(), 1.0)


async def test_a_stream_that_does_not_begin_is_named_and_the_camera_stays_inactive() -> None:
    async with bench(first_frame_timeout_s=2.0) as b:
        b.video.begins_at_s = b.clock.now_s() + 20.0
        await b.camera.connect()
        begun_s = b.clock.now_s()
        with pytest.raises(FrameError) as late:
            await b.camera.activate()
        assert late.value.alarm is Alarm.CAMERA_TIMEOUT
        assert b.clock.now_s() - begun_s < 2.0 + REPORTED_WITHIN_S
        assert b.camera.lifecycle is Lifecycle.INACTIVE
        b.video.begins_at_s = 0.0
        await going_on(b.clock, b.camera.activate())
        await b.camera.grab(b.clock.now_s(), 1.0)


async def test_pictures_of_another_size_are_found_when_the_stream_begins() -> None:
    async with bench() as b:
        b.video.size_px = (32, 24)
        await b.camera.connect()
        with pytest.raises(FrameError) as wrong:
            await b.camera.activate()
        assert wrong.value.alarm is Alarm.IMAGE_INVALID
        assert "(32, 24)" in wrong.value.detail
        assert b.camera.counters["invalid"] == 3


async def test_a_stream_may_begin_with_torn_pictures() -> None:
    async with bench() as b:
        whole, torn = b.video.retrieve, iter(range(2))
        b.video.retrieve = lambda: whole() if next(torn, None) is None else (False, None)  # type: ignore[method-assign]
        await b.camera.connect()
        await b.camera.activate()
        assert b.camera.counters["invalid"] == 2
        await b.camera.grab(b.clock.now_s(), 1.0)


async def test_a_device_that_hangs_in_opening_is_given_up_and_closed_when_it_opens_after_all() -> None:
    may_open = threading.Event()
    b = Bench(open_timeout_s=0.05)

    def hangs() -> V4l2Capture:
        may_open.wait(30.0)
        return b.open()

    camera = V4l2Camera(b.config, b.clock, hangs)
    try:
        with pytest.raises(NotConnectedError) as stuck:
            await camera.connect()
        assert stuck.value.alarm is Alarm.CAMERA_UNAVAILABLE
        assert "longer than 0.05 s" in stuck.value.detail
        assert camera.lifecycle is Lifecycle.DISCONNECTED
    finally:
        may_open.set()
    while not b.video.released:  # noqa: ASYNC110 - a thread has no asyncio event
        await asyncio.sleep(0.001)


@pytest.mark.parametrize("timeout_s", [0.5, 2.0])
async def test_an_unplugged_camera_is_reported_before_the_deadline(timeout_s: float) -> None:
    async with streaming() as b:
        b.video.fails = True
        begun_s = b.clock.now_s()
        with pytest.raises(NotConnectedError):
            await b.camera.grab(begun_s, timeout_s)
        assert b.clock.now_s() - begun_s < timeout_s + REPORTED_WITHIN_S


@pytest.mark.parametrize("timeout_s", [0.5, 2.0])
async def test_a_frozen_camera_is_reported_at_the_deadline_though_the_device_holds_its_grab(timeout_s: float) -> None:
    async with streaming() as b:
        await b.clock.sleep(0.5)
        b.video.holds_s = 10.0  # the select time-out where nobody has shortened it
        begun_s = b.clock.now_s()
        with pytest.raises(FrameError) as late:
            await b.camera.grab(begun_s, timeout_s)
        assert late.value.alarm in {Alarm.CAMERA_TIMEOUT, Alarm.CAMERA_STALE}
        assert timeout_s <= b.clock.now_s() - begun_s < timeout_s + REPORTED_WITHIN_S
        b.video.holds_s = None
        await b.clock.sleep(10.0)
        assert b.camera.lifecycle is Lifecycle.ACTIVE  # one wait without a frame is no lost camera
        await b.camera.grab(b.clock.now_s(), 1.0)


async def test_a_camera_that_stays_frozen_is_lost_and_back_after_a_thaw_without_a_new_process() -> None:
    async with streaming() as b:
        b.video.holds_s = 2.0
        with pytest.raises(NotConnectedError) as lost:
            await b.camera.grab(b.clock.now_s() + 1.0, 30.0)
        assert lost.value.alarm is Alarm.CAMERA_UNAVAILABLE
        b.video.holds_s, b.video = None, ScriptedVideo(b.time)
        await going_on(b.clock, b.camera.connect())
        await b.camera.activate()
        await b.camera.grab(b.clock.now_s(), 1.0)
        assert b.opened == 2
        assert b.camera.counters["streams_lost"] == 1


async def test_replugged_as_another_node_the_camera_is_opened_by_its_id() -> None:
    async with streaming() as b:
        b.video.fails = True
        with pytest.raises(NotConnectedError):
            await b.camera.grab(b.clock.now_s(), 5.0)
        b.video.opened = False
        with pytest.raises(NotConnectedError, match="cannot be opened"):
            await b.camera.connect()
        assert b.camera.lifecycle is Lifecycle.DISCONNECTED
        b.video = ScriptedVideo(b.time)
        await b.camera.connect()
        await b.camera.activate()
        await b.camera.grab(b.clock.now_s(), 1.0)


async def test_what_goes_wrong_is_counted() -> None:
    async with streaming() as b:
        await b.clock.sleep(1.0)
        assert (await b.camera.grab(b.clock.now_s(), 1.0)).sequence > 4
        counted = b.camera.counters
        assert counted["frames"] >= 20
        assert counted["too_old"] >= 4  # what the driver's queue held when somebody asked
        assert (counted["timeouts"], counted["invalid"], counted["failed_grabs"]) == (0, 0, 0)
        with pytest.raises(FrameError):
            await b.camera.grab(b.clock.now_s(), PERIOD_S / 2)
        b.video.broken = True
        with pytest.raises(FrameError):
            await b.camera.grab(b.clock.now_s(), 1.0)
        b.video.fails = True
        with pytest.raises(NotConnectedError):
            await b.camera.grab(b.clock.now_s(), 5.0)
        counted = b.camera.counters
        assert (counted["timeouts"], counted["invalid"], counted["failed_grabs"]) == (1, 1, 3)
        assert counted["streams_lost"] == 1


class _Pictures:
    """A capture that knows which frame is fetched."""

    def __init__(self) -> None:
        self.fetched: list[float] = []

    def grab(self) -> FrameStamp | None:
        pytest.fail("the rule for stale frames only reads stamps")

    def retrieve(self) -> Any:
        pytest.fail("the rule for stale frames only reads stamps")

    def close(self) -> None:
        pytest.fail("the rule for stale frames only reads stamps")


STAMPS = st.lists(st.integers(0, 50), max_size=40).map(sorted)


@given(STAMPS, st.lists(st.integers(0, 60), max_size=6))
def test_everybody_gets_the_first_frame_that_is_new_enough_for_him_and_nobody_an_older_one(
    stamps: list[int], asked: list[int]
) -> None:
    """The rule against stale frames, for any stream and any number of people who wait."""
    served: dict[int, float] = {}
    camera = GrabbingCamera(lambda: _Pictures(), SteppedClock(SteppedTime()), "camera")  # noqa: PLW0108 - a factory
    camera._picture = lambda _, stamp: Frame(None, stamp.stamp_s, stamp.sequence)  # type: ignore[method-assign,assignment,arg-type]
    for number, not_before in enumerate(asked):
        wanted = _Wanted(float(not_before), None, None)  # type: ignore[arg-type]
        monkey: Any = wanted
        monkey.resolve = lambda frame, number=number: served.setdefault(number, frame.exposed_at_s)
        camera._wanted.append(wanted)
    for sequence, stamp in enumerate(stamps):
        camera._offer(_Pictures(), FrameStamp(float(stamp), sequence))
    for number, not_before in enumerate(asked):
        new_enough = [stamp for stamp in stamps if stamp >= not_before]
        assert served.get(number) == (min(new_enough) if new_enough else None)
    assert len(camera._wanted) == len(asked) - len(served)


async def test_a_camera_that_is_let_go_of_while_it_is_frozen_takes_no_longer_than_its_grab() -> None:
    async with streaming() as b:
        b.video.holds_s = 2.0
        begun = time.monotonic()
        leaving = asyncio.create_task(b.camera.disconnect())
        await b.clock.sleep(3.0)
        await leaving
        assert b.video.released
        assert time.monotonic() - begun < 30.0
