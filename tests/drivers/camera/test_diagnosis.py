"""What a diagnosis says of a V4L2 camera: missing, no permission, busy, wrong format, no stream."""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import pytest

from drivers.camera.v4l2 import V4l2Camera, V4l2CameraConfig, open_v4l2
from drivers.camera.v4l2_diagnosis import device_fault, holders
from srvs_cell.alarms import Alarm
from srvs_cell.ports import Diagnosable, Finding, FindingLevel, Lifecycle
from tests.drivers.camera.scripted import ScriptedVideo
from tests.drivers.stepped import SteppedClock, SteppedTime

DEVICE = "/dev/null"
"""A device file that everybody may open; what is behind it is scripted."""


class RunningTime(SteppedTime):
    """Time that goes on when somebody sleeps: the diagnosis reads in a thread, and nobody else waits."""

    def sleep(self, seconds: float) -> None:
        self._now_s += seconds


def wrong(findings: Sequence[Finding]) -> dict[str, tuple[FindingLevel, Alarm | None]]:
    return {one.check: (one.level, one.alarm) for one in findings if one.level is not FindingLevel.OK}


def _camera(**settings: Any) -> tuple[V4l2Camera, ScriptedVideo]:
    time = RunningTime()
    clock, video = SteppedClock(time), ScriptedVideo(time, lag=0)
    config = V4l2CameraConfig.model_validate({"device": DEVICE, "width": 64, "height": 48, **settings})
    camera = V4l2Camera(config, clock, lambda: open_v4l2(config, clock, lambda *_: video, time.now_s))
    return camera, video


async def test_a_camera_that_works() -> None:
    camera, video = _camera(exposure_100us=100)
    assert isinstance(camera, Diagnosable)
    findings = await camera.diagnose()
    assert wrong(findings) == {}
    assert [one.facts for one in findings if one.facts] == [{"width": 64, "height": 48}]
    assert "25.0 frames a second" in findings[-1].detail
    assert video.released
    assert camera.lifecycle is Lifecycle.DISCONNECTED


async def test_a_setting_that_is_not_taken() -> None:
    camera, video = _camera(fourcc="MJPG")
    video.stuck[cv2.CAP_PROP_FOURCC] = float(cv2.VideoWriter.fourcc(*"YUYV"))
    findings = await camera.diagnose()
    assert wrong(findings) == {"settings": (FindingLevel.FAILED, Alarm.CAMERA_SETTING)}
    assert "fourcc was set to MJPG, reads back YUYV" in findings[0].detail
    assert "--list-formats-ext" in findings[0].remedy


async def test_pictures_of_another_size() -> None:
    camera, video = _camera()
    video.size_px = (80, 60)
    findings = await camera.diagnose()
    assert wrong(findings) == {"picture": (FindingLevel.FAILED, Alarm.IMAGE_INVALID)}
    assert "80 x 60 px, the config says 64 x 48" in findings[-1].detail


async def test_a_camera_that_gives_no_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.camera.v4l2_diagnosis._PATIENCE_S", 0.05)
    camera, video = _camera()
    video.fails = True
    assert wrong(await camera.diagnose()) == {"stream": (FindingLevel.FAILED, Alarm.CAMERA_TIMEOUT)}
    assert video.released


async def test_a_frozen_stream() -> None:
    camera, video = _camera()
    video.frozen_at_s = 100.0
    assert wrong(await camera.diagnose()) == {"stream": (FindingLevel.WARNING, Alarm.CAMERA_STALE)}


async def test_pictures_that_cannot_be_decoded_and_stamps_of_another_clock() -> None:
    camera, video = _camera()
    video.broken = True
    assert wrong(await camera.diagnose()) == {"stream": (FindingLevel.FAILED, Alarm.IMAGE_INVALID)}
    camera, video = _camera()
    video.stamp_offset_s = 1.7e9
    assert wrong(await camera.diagnose()) == {"stream": (FindingLevel.FAILED, Alarm.PROTOCOL_ERROR)}


async def test_one_frame_from_the_future_is_nothing() -> None:
    camera, video = _camera()
    video.misdate(1)
    assert wrong(await camera.diagnose()) == {}


async def test_a_device_that_does_not_open() -> None:
    camera, video = _camera()
    video.opened = False
    findings = await camera.diagnose()
    assert wrong(findings) == {"device": (FindingLevel.FAILED, Alarm.CAMERA_UNAVAILABLE)}


def test_a_device_that_is_missing_is_told_with_what_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "usb-Other_Camera-video-index0").touch()
    monkeypatch.setattr("drivers.camera.v4l2_diagnosis._BY_ID", tmp_path)
    found = device_fault(str(tmp_path / "video9"))
    assert found is not None
    assert found.alarm is Alarm.CAMERA_UNAVAILABLE
    assert "no such device. There is: " in found.detail
    assert "usb-Other_Camera-video-index0" in found.detail


def test_a_file_is_no_camera(tmp_path: Path) -> None:
    file = tmp_path / "video0"
    file.touch()
    found = device_fault(str(file))
    assert found is not None
    assert "not a device" in found.detail


def test_a_device_that_this_user_may_not_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    found = device_fault(DEVICE)
    assert found is not None
    assert "no permission" in found.detail
    assert "video" in found.remedy


async def test_a_device_that_another_program_has_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.camera.v4l2_diagnosis.holders", lambda _: ["guvcview (process 4711)"])
    camera, video = _camera()
    video.opened = False
    assert "in use by guvcview (process 4711)" in (await camera.diagnose())[0].detail


def test_programs_are_found_by_the_files_that_they_have_open(tmp_path: Path) -> None:
    device = tmp_path / "video0"
    device.touch()
    program = "import sys; f = open(sys.argv[1]); print(flush=True); sys.stdin.read()"
    with subprocess.Popen(
        [sys.executable, "-c", program, str(device)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None
        other.stdout.readline()
        found = holders(str(device))
        assert other.stdin is not None
        other.stdin.close()
    assert len(found) == 1
    assert f"(process {other.pid})" in found[0]
    assert holders(str(device)) == []
