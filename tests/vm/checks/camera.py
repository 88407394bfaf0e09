"""The product's V4L2 driver in this process, used as the cell uses it, and what a grab is measured by."""

from __future__ import annotations

import time
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

from drivers.camera.v4l2 import DRIVER
from drivers.clock.system import SystemClock
from srvs_cell.alarms import Alarm
from srvs_cell.ports import DriverContext, PortError

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from srvs_cell.ports import Camera, Frame

GRACE_S = 1.0
"""A loss is reported at most so long after the grab's deadline."""

TIMEOUT_S = 2.0
"""The cell's own ``frame_timeout_s``."""

_PATIENCE_S = 15.0
"""Where a frame must come: an emulated machine beside other work may be late."""


def make_camera(device: str, **settings: Any) -> Camera:
    """Return the driver's camera, disconnected."""
    config = DRIVER.config_model.model_validate({"device": device, **settings})
    camera: Camera = DRIVER.factory(config, DriverContext(SystemClock()))
    return camera


@asynccontextmanager
async def streaming(device: str, **settings: Any) -> AsyncIterator[Camera]:
    """Yield an active camera that has delivered its first frame; disconnect it afterwards."""
    camera = make_camera(device, **settings)
    try:
        await camera.connect()
        await camera.activate()
        await grab(camera)
        yield camera
    finally:
        await camera.disconnect()


async def grab(camera: Camera, timeout_s: float = _PATIENCE_S) -> Frame:
    """Grab a frame exposed from now on; raises `AssertionError` where it is older."""
    not_before_s = time.monotonic()
    frame = await camera.grab(not_before_s, timeout_s)
    assert frame.exposed_at_s >= not_before_s, f"exposed {not_before_s - frame.exposed_at_s:.3f} s too early"
    return frame


async def refused(camera: Camera) -> tuple[Alarm, float]:
    """Grab in vain; return the alarm and how long it took.

    Raises:
        AssertionError: a frame came, or the answer did more than `GRACE_S` after the deadline.
    """
    started_s = time.monotonic()
    try:
        await grab(camera, TIMEOUT_S)
    except PortError as error:
        alarm, took_s = error.alarm, time.monotonic() - started_s
    else:
        raise AssertionError("a frame came")
    assert took_s <= TIMEOUT_S + GRACE_S, f"{alarm.name} only after {took_s:.1f} s"
    return alarm, took_s


async def beginning_refused(camera: Camera) -> tuple[Alarm, float]:
    """Connect, and activate in vain, because the stream does not begin; return the alarm and how long it took.

    Raises:
        AssertionError: the stream has begun.
    """
    await camera.connect()
    started_s = time.monotonic()
    try:
        await camera.activate()
    except PortError as error:
        return error.alarm, time.monotonic() - started_s
    raise AssertionError("the stream has begun")


async def setting_refused(device: str, **settings: Any) -> str:
    """Connect with settings that the device does not take; return what the alarm says."""
    camera = make_camera(device, **settings)
    try:
        await camera.connect()
    except PortError as error:
        alarm, detail = error.alarm, error.detail
    else:
        await camera.disconnect()
        raise AssertionError(f"the camera took {settings}")
    assert alarm is Alarm.CAMERA_SETTING, f"{alarm.name}: {detail}"
    return f"{alarm.name}: {detail}"
