"""The simulated USB camera as a child process, and the V4L2 driver on it: exposure, unplug, frozen, faulty stream."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

from srvs_cell.alarms import Alarm
from tests.vm.checks.camera import grab, refused, setting_refused, streaming
from tests.vm.checks.commands import run, wait_until

if TYPE_CHECKING:
    from tests.vm.checks.report import Report

DEVICE = Path("/dev/v4l/by-id/usb-srvs_bench_Simulated_camera_SIM0001-video-index0")
SETTINGS: Final[dict[str, Any]] = {"width": 320, "height": 240, "fps": 5.0, "fourcc": "YUYV"}
_PLUG_S = 20.0
_GRABS = 10
_SAME_GREY = 3.0
_ENDED_S = 15.0
"""Three selects of two seconds each, and what a busy machine adds."""


class UsbCameraProcess:
    """`tests.vm.checks.usb_camera` as a child process; a context manager."""

    def __enter__(self) -> Self:
        run("modprobe", "vhci-hcd")  # uvcvideo comes with the camera
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.vm.checks.usb_camera"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()

    def tell(self, word: str) -> None:
        """Say ``word`` and wait until it is done."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(word + "\n")
        self._process.stdin.flush()
        assert self._process.stdout.readline().strip() == word, f"the simulated camera did not {word}"

    def plug(self) -> float:
        """Plug it in; return after how many seconds it can be opened."""
        self.tell("plug")
        took_s = wait_until(str(DEVICE), DEVICE.exists, _PLUG_S)
        run("udevadm", "settle")
        return took_s

    def unplug(self) -> None:
        """Unplug it and wait until its nodes are gone."""
        self.tell("unplug")
        wait_until(f"{DEVICE} is gone", lambda: not DEVICE.exists(), _PLUG_S)


def check_usb(report: Report, camera: UsbCameraProcess) -> None:
    """Run all checks on the driver; the camera is plugged in before and afterwards."""
    report.check("usb: grabs", lambda: asyncio.run(_grabs()))
    report.check("usb: exposure", lambda: asyncio.run(_exposure()))
    report.check("usb: exposure out of range refused", lambda: asyncio.run(_exposure_refused()))
    report.check("usb: a faulty and a short picture", lambda: asyncio.run(_spoilt(camera)))
    report.check("usb: frozen for a while", lambda: asyncio.run(_frozen(camera)))
    report.check("usb: frozen for long", lambda: asyncio.run(_ended(camera)))
    report.check("usb: unplugged and back", lambda: asyncio.run(_unplugged(camera)))


async def _grabs() -> str:
    async with streaming(str(DEVICE), **SETTINGS) as camera:
        started_s = time.monotonic()
        for _ in range(_GRABS):
            await grab(camera)
        # A frame exposed after the grab began is the one after the frame that is under way: at most every second one.
        rate_hz = _GRABS / (time.monotonic() - started_s)
    return f"{_GRABS} frames, {rate_hz:.1f} grabs a second at 5 frames a second"


async def _exposure() -> str:
    means = {}
    for exposure in (30, 300):
        async with streaming(str(DEVICE), **SETTINGS, exposure_100us=exposure) as camera:
            means[exposure] = float((await grab(camera)).image.mean())
    assert means[300] > means[30] + 50, means
    return ", ".join(f"{exposure / 10:.0f} ms read back: mean {mean:.0f}" for exposure, mean in means.items())


async def _exposure_refused() -> str:
    return await setting_refused(str(DEVICE), **SETTINGS, exposure_100us=99_999)


async def _spoilt(usb: UsbCameraProcess) -> str:
    async with streaming(str(DEVICE), **SETTINGS) as camera:
        usual = float((await grab(camera)).image.mean())
        for fault in ("error", "short"):
            await asyncio.to_thread(usb.tell, fault)
            for _ in range(3):
                mean = float((await grab(camera)).image.mean())
                assert abs(mean - usual) <= _SAME_GREY, f"{fault}: the spoilt picture, which is white, was handed out"
    return "dropped by the kernel, the next picture is whole"


async def _frozen(usb: UsbCameraProcess) -> str:
    async with streaming(str(DEVICE), **SETTINGS) as camera:
        await asyncio.to_thread(usb.tell, "freeze")
        await asyncio.sleep(0.5)  # what was under way before
        alarm, took_s = await refused(camera)
        assert alarm is Alarm.CAMERA_TIMEOUT, alarm.name
        await asyncio.to_thread(usb.tell, "thaw")
        await grab(camera)
    return f"{alarm.name} after {took_s:.1f} s; goes on when it thaws"


async def _ended(usb: UsbCameraProcess) -> str:
    async with streaming(str(DEVICE), **SETTINGS) as camera:
        await asyncio.to_thread(usb.tell, "freeze")
        started_s = time.monotonic()
        alarm = Alarm.CAMERA_TIMEOUT
        while alarm is Alarm.CAMERA_TIMEOUT:
            assert time.monotonic() - started_s < _ENDED_S, f"still {alarm.name}"
            alarm, _ = await refused(camera)
        took_s = time.monotonic() - started_s
        assert alarm is Alarm.CAMERA_UNAVAILABLE, alarm.name
        await asyncio.to_thread(usb.tell, "thaw")
        await camera.connect()
        await camera.activate()
        await grab(camera)
    return f"{alarm.name} after {took_s:.1f} s; the same object connects again"


async def _unplugged(usb: UsbCameraProcess) -> str:
    async with streaming(str(DEVICE), **SETTINGS) as camera:
        await asyncio.to_thread(usb.unplug)
        alarm, took_s = await refused(camera)
        assert alarm is Alarm.CAMERA_UNAVAILABLE, alarm.name
        plugged_s = await asyncio.to_thread(usb.plug)
        await camera.connect()
        await camera.activate()
        await grab(camera)
    return f"{alarm.name} after {took_s:.1f} s; back {plugged_s:.1f} s after the plug, the same object connects again"
