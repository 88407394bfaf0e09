"""What keeps a cell from working, looked at without a daemon: `srvs-cell doctor`.

Nothing here moves anything or writes an output. Devices that a daemon holds are not fought for: the daemon is asked.
"""

from __future__ import annotations

import asyncio
import fcntl
import os
import shutil
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.calibration import Level, check_calibration
from srvs_cell.cell import make_devices
from srvs_cell.ports import Diagnosable, Finding, FindingLevel, PortError
from srvs_cell.service.common_view import CommonView, check_places

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from srvs_cell.calibration import Calibration
    from srvs_cell.config import CellConfig
    from srvs_cell.ports import Device

_PATIENCE_S: Final = 60.0
_LEAST_FREE_BYTES: Final = 1_000_000_000
_STOP_FIRST: Final = "To have the devices looked at, end the daemon ('systemctl stop srvs-cell') and ask again."


@dataclass(frozen=True)
class Examined:
    """A finding and what it is about: calibration, state folder, daemon, clock, camera, arm or gripper."""

    part: str
    finding: Finding

    def as_json(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        found, alarm = self.finding, self.finding.alarm
        return {
            "part": self.part,
            "check": found.check,
            "level": found.level.value,
            "detail": found.detail,
            "alarm": None if alarm is None else {"code": alarm.code, "name": alarm.name},
            "cause": None if alarm is None else alarm.value.cause,
            "remedy": None if alarm is None else self.remedy,
            "facts": dict(found.facts),
        }

    @property
    def remedy(self) -> str:
        """What to do: what the finding says, or else what the registry says of its alarm."""
        found = self.finding
        return found.remedy or ("" if found.alarm is None else found.alarm.value.remedy)

    @property
    def line(self) -> str:
        """One line for people."""
        found, alarm = self.finding, self.finding.alarm
        said = f"{found.level.value:<8} {self.part}, {found.check}: {found.detail}"
        if alarm is None:
            return said
        return f"{said} [{alarm.code} {alarm.name}] Cause: {alarm.value.cause} Remedy: {self.remedy}"


def verdict(examined: Sequence[Examined]) -> FindingLevel:
    """Return failed if one finding is, else warning if one is, else ok."""
    levels = {one.finding.level for one in examined}
    for level in (FindingLevel.FAILED, FindingLevel.WARNING):
        if level in levels:
            return level
    return FindingLevel.OK


async def examine(config: CellConfig, state_dir: Path, daemon: Mapping[str, Any] | None) -> list[Examined]:
    """Look at everything that a cell needs before it can start.

    Args:
        config: the cell.
        state_dir: where its daemon keeps its journal.
        daemon: the status of the daemon that answers, None where none does.

    Raises:
        AlarmError: CONFIG_INVALID where the devices cannot be made of the config.
    """
    calibration, found = _calibration(config)
    examined = [Examined("calibration", finding) for finding in found]
    examined += [Examined("state folder", finding) for finding in _state_folder(state_dir)]
    if calibration is not None and config.planning.buffer_places_mm:
        examined.append(Examined("calibration", _places(config, calibration)))
    if daemon is not None:
        return examined + _asked(daemon)
    if _locked(state_dir / "daemon.lock"):
        detail = f"A daemon holds {state_dir}, but does not answer on its socket."
        error = AlarmError(Alarm.ALREADY_RUNNING, detail)
        return [*examined, Examined("daemon", Finding.failed("answer", error, f"Look at its log. {_STOP_FIRST}"))]
    examined.append(Examined("daemon", Finding.fine("answer", "none runs, the devices are free")))
    devices = make_devices(config)
    try:
        devices.clock.now_s()
    except PortError as error:
        return [*examined, Examined("clock", Finding.failed("time", error))]
    for name, device in devices.named():
        examined += [Examined(name, finding) for finding in await _diagnose(device)]
    if calibration is not None:
        examined += [Examined("calibration", finding) for finding in _fits(calibration, _facts(examined))]
    return examined


async def _diagnose(device: Device) -> Sequence[Finding]:
    try:
        async with asyncio.timeout(_PATIENCE_S):
            if isinstance(device, Diagnosable):
                return await device.diagnose()
            return await _reach(device)
    except TimeoutError:
        error = AlarmError(Alarm.CONNECTION_TIMEOUT, f"{device.description}: no end within {_PATIENCE_S} s.")
        return [Finding.failed("diagnosis", error)]


async def _reach(device: Device) -> Sequence[Finding]:
    """Look at a device whose driver has no diagnosis: connecting moves nothing, whatever the driver."""
    try:
        await device.connect()
    except PortError as error:
        return [Finding.failed("connection", error)]
    finally:
        await device.disconnect()
    return [Finding.fine("connection", device.description)]


def _calibration(config: CellConfig) -> tuple[Calibration | None, list[Finding]]:
    try:
        calibration = config.load_calibration()
    except AlarmError as error:
        return None, [Finding.failed("file", error)]
    findings = []
    for one in check_calibration(calibration):
        if one.level is Level.OK:
            continue
        detail = f"{one.check} is {one.value}, expected is {one.bound}."
        if one.level is Level.ERROR:
            unusable = AlarmError(Alarm.CALIBRATION_INVALID, detail)
            findings.append(Finding.failed("numbers", unusable, one.advice))
        else:
            findings.append(Finding.doubtful("numbers", Alarm.CALIBRATION_INVALID, detail, one.advice))
    return calibration, findings or [Finding.fine("numbers", f"{config.calibration}")]


def _places(config: CellConfig, calibration: Calibration) -> Finding:
    """Compute, as the daemon will, whether the looks see the configured places."""
    try:
        check_places(config, CommonView.of(config.cell, calibration))
    except AlarmError as error:
        return Finding.failed("sees the configured places", error, "Move the place; free buffer places can be found.")
    return Finding.fine("sees the configured places", f"{len(config.planning.buffer_places_mm)} buffer places")


def _fits(calibration: Calibration, facts: Mapping[str, object]) -> list[Finding]:
    """Compare the calibration with what was read of camera and arm, as the interlocks will before every motion."""
    findings = []
    if "width" in facts:
        seen, calibrated = (facts["width"], facts["height"]), calibration.image_size
        text = f"{calibrated[0]} x {calibrated[1]} px"
        if seen == calibrated:
            findings.append(Finding.fine("fits the camera", text))
        else:
            detail = f"The camera delivers {seen[0]} x {seen[1]} px, the calibration is for {text}."
            remedy = "Set width and height of the camera as calibrated, or calibrate again."
            findings.append(Finding.failed("fits the camera", AlarmError(Alarm.IMAGE_INVALID, detail), remedy))
    frames = {"user_frame": calibration.robot.user_frame, "user_tool": calibration.robot.user_tool}
    wanted = {name: number for name, number in frames.items() if number is not None and name in facts}
    wrong = {name: number for name, number in wanted.items() if facts[name] != number}
    if wrong:
        said = ", ".join(f"{name} is {facts[name]}, calibrated with {number}" for name, number in wrong.items())
        findings.append(Finding.failed("fits the robot's frames", AlarmError(Alarm.FRAME_CHANGED, f"{said}.")))
    elif wanted:
        said = ", ".join(f"{name} {number}" for name, number in wanted.items())
        findings.append(Finding.fine("fits the robot's frames", said))
    return findings


def _facts(examined: Sequence[Examined]) -> dict[str, object]:
    return {name: value for one in examined for name, value in one.finding.facts.items()}


def _state_folder(state_dir: Path) -> list[Finding]:
    folder = state_dir
    while not folder.exists() and folder != folder.parent:  # the daemon makes what is missing
        folder = folder.parent
    if not (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)):
        error = AlarmError(Alarm.JOURNAL_FAILED, f"{state_dir} cannot be written by this user.")
        return [Finding.failed("access", error, "Run as the daemon's user, or correct owner and mode.")]
    free_bytes = shutil.disk_usage(folder).free
    text = f"{folder}, {free_bytes / 1e9:.1f} GB free"
    if free_bytes < _LEAST_FREE_BYTES:
        remedy = "Make room: every job keeps its pictures; service.keep_runs bounds them."
        return [Finding.doubtful("room", Alarm.JOURNAL_FAILED, f"{text}.", remedy)]
    return [Finding.fine("access", text)]


def _locked(path: Path) -> bool:
    """Return whether a daemon holds the lock file; it is neither made nor kept."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    except OSError:  # not there, or not readable: then nothing of it can be told
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(descriptor)
    return False


def _asked(daemon: Mapping[str, Any]) -> list[Examined]:
    """Return what the daemon says of itself and of the devices that it holds."""
    state = f"{daemon['state']}, {daemon['mode']}{', SIMULATION' if daemon['simulation'] else ''}"
    found = [Examined("daemon", Finding.fine("answer", f"it runs ({state}) and holds the devices"))]
    found += [Examined("daemon", Finding.failed("alarm", _alarm_of(one))) for one in daemon["alarms"]]
    for name, device in daemon["devices"].items():
        text = f"{device['description']}: {device['lifecycle']}"
        if device["lifecycle"] == "disconnected":
            detail = f"{text}: the daemon has not reached it."
            remedy = f"'srvs-cell clear' lets it try. {_STOP_FIRST}"
            found.append(Examined(name, Finding.doubtful("daemon", Alarm.DEVICE_UNAVAILABLE, detail, remedy)))
        else:
            found.append(Examined(name, Finding.fine("daemon", f"{text}; not looked at. {_STOP_FIRST}")))
    return found


def _alarm_of(told: Mapping[str, Any]) -> AlarmError:
    """Return an alarm that the daemon tells of; one of a daemon of another version may not be in this registry."""
    try:
        return AlarmError(Alarm.from_code(told["code"]), told["detail"])
    except KeyError:
        text = f"{told['code']} {told['name']}: {told['detail']} {told['cause']} {told['remedy']}"
        return AlarmError(Alarm.INTERNAL_ERROR, text)
