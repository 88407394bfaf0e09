"""The V4L2 driver on the kernel's virtual video device: rates, read-back, each fault that vivid can inject, removal."""

from __future__ import annotations

import asyncio
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from srvs_cell.alarms import Alarm
from tests.vm.checks.camera import beginning_refused, grab, make_camera, refused, setting_refused, streaming
from tests.vm.checks.commands import run, wait_until

if TYPE_CHECKING:
    from tests.vm.checks.report import Report

_DEVICE = "/dev/v4l/by-path/platform-vivid.0-video-index0"
_DRIVER = Path("/sys/bus/platform/drivers/vivid")
_SIZE = {"width": 640, "height": 480}
_GRABS = 20


def check_vivid(report: Report) -> None:
    """Run all checks on vivid; its module is gone afterwards."""
    # One capture node with one webcam input and nothing else.
    run("modprobe", "vivid", "n_devs=1", "node_types=0x1", "num_inputs=1", "input_types=0x00")
    run("udevadm", "settle")
    report.check("vivid: stamps from the future refused", lambda: asyncio.run(_future()))
    # The start of exposure, as uvcvideo has it; vivid's end of exposure is a forecast.
    _control("timestamp_source=1")
    report.check("vivid: grabs", lambda: asyncio.run(_grabs()))
    report.check("vivid: unsupported size refused", lambda: asyncio.run(_wrong_size()))
    report.check("vivid: gain that does not hold refused", lambda: asyncio.run(_automatic_gain()))
    for fault, alarms in (
        ("percentage_of_dropped_buffers=100", {Alarm.CAMERA_TIMEOUT}),
        ("inject_fatal_streaming_error=1", {Alarm.CAMERA_UNAVAILABLE}),
        ("disconnect=1", {Alarm.CAMERA_UNAVAILABLE}),
    ):
        report.check(f"vivid: {fault} in the stream", partial(_run_fault, fault, alarms))
    report.check("vivid: refuses to stream", lambda: asyncio.run(_no_stream()))
    report.check("vivid: removed and back", lambda: asyncio.run(_removed()))
    run("modprobe", "--remove", "vivid")


def _run_fault(fault: str, alarms: set[Alarm]) -> str:
    return asyncio.run(_fault(fault, alarms))


def _control(assignment: str) -> None:
    run("v4l2-ctl", "--device", _DEVICE, "--set-ctrl", assignment)


async def _future() -> str:
    """At 5 frames a second vivid stamps a frame 180 ms after it hands it out."""
    camera = make_camera(_DEVICE, **_SIZE, fps=5.0)
    try:
        alarm, took_s = await beginning_refused(camera)
        assert alarm is Alarm.PROTOCOL_ERROR, alarm.name
    finally:
        await camera.disconnect()
    return f"{alarm.name} after {took_s:.1f} s"


async def _grabs() -> str:
    async with streaming(_DEVICE, **_SIZE, fps=15.0, fourcc="YUYV") as camera:
        started_s, waits_s = time.monotonic(), []
        for _ in range(_GRABS):
            asked_s = time.monotonic()
            frame = await grab(camera)
            assert frame.image.shape == (480, 640, 3), frame.image.shape
            waits_s.append(time.monotonic() - asked_s)
        rate_hz = _GRABS / (time.monotonic() - started_s)
    return (
        f"{_GRABS} frames, {rate_hz:.1f} a second of 15, longest wait {max(waits_s):.2f} s, none older than asked for"
    )


async def _wrong_size() -> str:
    return await setting_refused(_DEVICE, width=1000, height=333)


async def _automatic_gain() -> str:
    return await setting_refused(_DEVICE, **_SIZE, gain=40)


async def _fault(fault: str, alarms: set[Alarm]) -> str:
    async with streaming(_DEVICE, **_SIZE) as camera:
        await asyncio.to_thread(_control, fault)
        alarm, took_s = await refused(camera)
        assert alarm in alarms, alarm.name
    name = fault.partition("=")[0]
    if name.startswith("percentage"):
        await asyncio.to_thread(_control, f"{name}=0")
    async with streaming(_DEVICE, **_SIZE) as camera:
        await grab(camera)
    return f"{alarm.name} after {took_s:.1f} s; frames again after a new connection"


async def _no_stream() -> str:
    camera = make_camera(_DEVICE, **_SIZE)
    await asyncio.to_thread(_control, "inject_vidioc_streamon_error=1")
    try:
        alarm, took_s = await beginning_refused(camera)
    finally:
        await camera.disconnect()
    async with streaming(_DEVICE, **_SIZE) as again:
        await grab(again)
    return f"{alarm.name} after {took_s:.1f} s"


async def _removed() -> str:
    async with streaming(_DEVICE, **_SIZE) as camera:
        await asyncio.to_thread((_DRIVER / "unbind").write_text, "vivid.0")
        alarm, took_s = await refused(camera)
        assert alarm is Alarm.CAMERA_UNAVAILABLE, alarm.name
        await asyncio.to_thread((_DRIVER / "bind").write_text, "vivid.0")
        await asyncio.to_thread(wait_until, _DEVICE, Path(_DEVICE).exists, 10.0)
        await camera.connect()
        await camera.activate()
        await grab(camera)
    return f"{alarm.name} after {took_s:.1f} s; the same object connects again"
