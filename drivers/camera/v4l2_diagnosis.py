"""What keeps a V4L2 camera from working: is it there, may it be opened, who has it, does it deliver what is wanted."""

from __future__ import annotations

import os
import stat
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from srvs_cell.alarms import Alarm
from srvs_cell.ports import Finding, FrameError, NotConnectedError, PortError

if TYPE_CHECKING:
    from collections.abc import Callable

    from drivers.camera.grabber import Capture, FrameStamp

_FRAMES: Final = 4
_PATIENCE_S: Final = 5.0
_BY_ID: Final = Path("/dev/v4l/by-id")
_PROCESSES: Final = Path("/proc")
_FORMAT: Final = "`v4l2-ctl -d DEVICE --list-formats-ext` and `--list-ctrls` show what this camera can do."
_STREAM: Final = "Plug it into a USB port of its own, without a hub; lower fps or resolution; try another cable."


def diagnose_v4l2(device: str, size_px: tuple[int, int], open_capture: Callable[[], Capture]) -> list[Finding]:
    """Look at the device file, the settings and the stream. Blocks for some seconds.

    Args:
        device: path of the device.
        size_px: (width, height) that pictures must have.
        open_capture: opens it and applies the settings.
    """
    if (absent := device_fault(device)) is not None:
        return [absent]
    try:
        capture = open_capture()
    except PortError as error:
        remedy = _FORMAT if error.alarm is Alarm.CAMERA_SETTING else ""
        return [Finding.failed("settings" if remedy else "device", _with_holders(error, device), remedy)]
    findings = [Finding.fine("device", device), Finding.fine("settings", "taken and read back")]
    try:
        findings += _stream(device, size_px, capture)
    except PortError as error:
        findings.append(Finding.failed("stream", error))
    finally:
        capture.close()
    return findings


def device_fault(device: str) -> Finding | None:
    """Return what is wrong with the device file, or None."""
    path = Path(device)
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        there = sorted(str(one) for one in _BY_ID.glob("*-index0")) or sorted(map(str, Path("/dev").glob("video*")))
        detail = f"{device}: no such device. There is: {', '.join(there) or 'no camera at all'}."
        remedy = "Plug the camera in, or put the path that is there into devices.camera.device."
        return Finding.failed("device", NotConnectedError(Alarm.CAMERA_UNAVAILABLE, detail), remedy)
    except OSError as error:
        return Finding.failed("device", NotConnectedError(Alarm.CAMERA_UNAVAILABLE, f"{device}: {error.strerror}."))
    if not stat.S_ISCHR(mode):
        no_device = NotConnectedError(Alarm.CAMERA_UNAVAILABLE, f"{device}: is a file, not a device.")
        return Finding.failed("device", no_device, "Put the camera's path into devices.camera.device.")
    if not os.access(path, os.R_OK | os.W_OK):
        forbidden = NotConnectedError(Alarm.CAMERA_UNAVAILABLE, f"{device}: no permission to read and write.")
        return Finding.failed(
            "device", forbidden, "Add this user to the group that owns it, usually video; log in again."
        )
    return None


def holders(device: str, processes: Path = _PROCESSES) -> list[str]:
    """Return the programs that have a device open, as far as this user may see them."""
    target, found = os.path.realpath(device), []
    for folder in sorted(processes.glob("[0-9]*")):
        if folder.name == str(os.getpid()):
            continue
        try:
            names = {os.path.realpath(link) for link in (folder / "fd").iterdir()}
            name = (folder / "comm").read_text(encoding="utf-8").strip()
        except OSError:  # another user's process, or one that has just ended
            continue
        if target in names:
            found.append(f"{name} (process {folder.name})")
    return found


def _with_holders(error: PortError, device: str) -> PortError:
    busy = holders(device)
    return error if not busy else type(error)(error.alarm, f"{error.detail} It is in use by {', '.join(busy)}.")


def _stream(device: str, size_px: tuple[int, int], capture: Capture) -> list[Finding]:
    stamps: list[FrameStamp] = []
    misdated: list[FrameError] = []
    begun_s = time.monotonic()
    while len(stamps) + len(misdated) < _FRAMES and time.monotonic() - begun_s < _PATIENCE_S:
        try:
            stamp = capture.grab()
        except FrameError as from_the_future:
            misdated.append(from_the_future)
        else:
            stamps += [] if stamp is None else [stamp]
    if len(misdated) > 1:  # one is dropped
        return [Finding.failed("stream", misdated[-1])]
    if not stamps:
        silent = FrameError(Alarm.CAMERA_TIMEOUT, f"{device}: no frame within {_PATIENCE_S} s.")
        return [Finding.failed("stream", silent, _STREAM)]
    image = capture.retrieve()
    height, width = image.shape[:2]
    if (width, height) != size_px:
        wanted = f"the config says {size_px[0]} x {size_px[1]}"
        error = FrameError(Alarm.IMAGE_INVALID, f"{device}: its pictures have {width} x {height} px, {wanted}.")
        return [Finding.failed("picture", error, _FORMAT)]
    picture = Finding.fine("picture", f"{width} x {height} px", width=width, height=height)
    if stamps[-1].stamp_s <= stamps[0].stamp_s:
        came = f"{len(stamps)} frames in {time.monotonic() - begun_s:.1f} s; their time stamps do not go on"
        return [picture, Finding.doubtful("stream", Alarm.CAMERA_STALE, f"{device}: {came}.", _STREAM)]
    rate = (len(stamps) - 1) / (stamps[-1].stamp_s - stamps[0].stamp_s)
    return [picture, Finding.fine("stream", f"{rate:.1f} frames a second, time stamps are monotonic")]
