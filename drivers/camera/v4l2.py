"""A Linux camera (USB video class or any V4L2 device) through OpenCV.

Time stamps: OpenCV's V4L2 backend returns the time stamp of the buffer it took last as CAP_PROP_POS_MSEC, and the
kernel stamps buffers with CLOCK_MONOTONIC, which is Python's `time.monotonic`. The difference to the present instant
is the frame's age; it is taken off the process's clock. The driver uvcvideo stamps the start of exposure; a driver
that stamps the end of a frame needs ``exposure_before_stamp_s``.

A frozen device lets OpenCV's grab return after 10 s; the environment variable OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT
(seconds, read when OpenCV is imported) shortens that; `srvs-cell run` sets it to 2 where it is not set. Whoever
waits for a frame has a time-out of his own.

Settings are written, read back and compared: a UVC camera accepts values that it then does not use. Automatics are
switched off first where a value of theirs is given, because an automatic gain takes its value back.
"""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Protocol, cast

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from drivers.camera.grabber import FrameStamp, GrabbingCamera
from drivers.camera.v4l2_diagnosis import diagnose_v4l2
from srvs_cell.alarms import Alarm
from srvs_cell.ports import DriverContext, DriverSpec, FrameError, NotConnectedError, PortError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from srvs_cell.ports import Clock, Finding

_MANUAL_EXPOSURE: Final = 1.0  # V4L2_EXPOSURE_MANUAL
_FUTURE_S: Final = 0.05
_RELATIVE_TOLERANCE: Final = 0.05
_ABSOLUTE_TOLERANCE: Final = 0.5


class VideoCapture(Protocol):
    """The part of ``cv2.VideoCapture`` that is used."""

    def isOpened(self) -> bool:
        """Whether the device is open."""
        ...

    def grab(self) -> bool:
        """Take the next buffer."""
        ...

    def retrieve(self) -> tuple[bool, NDArray[np.uint8] | None]:
        """Decode the buffer taken last."""
        ...

    def set(self, prop: int, value: float, /) -> bool:
        """Write a property."""
        ...

    def get(self, prop: int, /) -> float:
        """Read a property."""
        ...

    def release(self) -> None:
        """Close the device."""
        ...


class V4l2CameraConfig(BaseModel):
    """The camera's part of the cell's YAML; what is not given is left as the device has it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    device: Annotated[
        str,
        Field(
            min_length=1,
            pattern=r"^/dev/",
            description="path; one of /dev/v4l/by-id/ stays the same when cameras are plugged in another order",
        ),
    ]
    width: int = Field(default=640, ge=16, le=8192, description="pixels, as in the calibration")
    height: int = Field(default=480, ge=16, le=8192, description="pixels, as in the calibration")
    fps: float | None = Field(default=None, gt=0.0, le=1000.0, description="frames per second")
    fourcc: str | None = Field(
        default=None, pattern=r"^[A-Z0-9 ]{4}$", description="pixel format, such as YUYV or MJPG"
    )
    exposure_100us: int | None = Field(
        default=None,
        ge=1,
        le=100_000,
        description="exposure time in 100 microseconds (V4L2_CID_EXPOSURE_ABSOLUTE); switches the automatic off",
    )
    gain: int | None = Field(default=None, ge=0, le=100_000, description="in the device's units")
    focus: int | None = Field(
        default=None, ge=0, le=100_000, description="in the device's units; switches the autofocus off"
    )
    first_frame_timeout_s: float = Field(
        default=5.0, gt=0.0, le=30.0, description="how long the stream may take to begin; a slow camera needs seconds"
    )
    open_timeout_s: float = Field(
        default=10.0, gt=0.0, le=60.0, description="real seconds that opening and setting the device may take"
    )
    exposure_before_stamp_s: float = Field(
        default=0.0, ge=0.0, le=2.0, description="how long before its time stamp a frame's exposure begins"
    )


@dataclass(frozen=True)
class Setting:
    """One property as it is wanted: its name for people, its number, its value, how it is written."""

    name: str
    prop: int
    value: float
    exact: bool = True

    @property
    def text(self) -> str:
        """The value as people write it."""
        return _fourcc_text(self.value) if self.prop == cv2.CAP_PROP_FOURCC else f"{self.value:g}"


def settings_of(config: V4l2CameraConfig) -> Iterator[Setting]:
    """Yield what is to be set, in an order that works: format, size, rate, then controls after their automatics."""
    if config.fourcc is not None:
        yield Setting("fourcc", cv2.CAP_PROP_FOURCC, float(cv2.VideoWriter.fourcc(*config.fourcc)))
    yield Setting("width", cv2.CAP_PROP_FRAME_WIDTH, config.width)
    yield Setting("height", cv2.CAP_PROP_FRAME_HEIGHT, config.height)
    if config.fps is not None:
        yield Setting("fps", cv2.CAP_PROP_FPS, config.fps, exact=False)
    if config.exposure_100us is not None:
        yield Setting("auto_exposure", cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)
        yield Setting("exposure_100us", cv2.CAP_PROP_EXPOSURE, config.exposure_100us)
    if config.gain is not None:
        yield Setting("gain", cv2.CAP_PROP_GAIN, config.gain)
    if config.focus is not None:
        yield Setting("autofocus", cv2.CAP_PROP_AUTOFOCUS, 0.0)
        yield Setting("focus", cv2.CAP_PROP_FOCUS, config.focus)


def apply_settings(capture: VideoCapture, config: V4l2CameraConfig) -> None:
    """Write all settings, then read all of them back: a later one may have changed an earlier one.

    Raises:
        PortError: CAMERA_SETTING, naming control, value asked for and value read back.
    """
    settings = list(settings_of(config))
    for setting in settings:
        capture.set(setting.prop, setting.value)  # its answer is not to be trusted: gain says True and does nothing
    for setting in settings:
        got = capture.get(setting.prop)
        tolerance = _ABSOLUTE_TOLERANCE if setting.exact else _RELATIVE_TOLERANCE * setting.value
        if abs(got - setting.value) > tolerance:
            raise PortError(
                Alarm.CAMERA_SETTING,
                f"{config.device}: {setting.name} was set to {setting.text}, reads back "
                f"{replace(setting, value=got).text}.",
            )


class V4l2Capture:
    """Capture on an opened ``cv2.VideoCapture``.

    Args:
        capture: the open device.
        config: where it is and how its stamps are meant.
        clock: the process's clock.
        monotonic: CLOCK_MONOTONIC in seconds.
    """

    def __init__(
        self,
        capture: VideoCapture,
        config: V4l2CameraConfig,
        clock: Clock,
        monotonic: Callable[[], float],
    ) -> None:
        self._capture, self._config, self._clock, self._monotonic = capture, config, clock, monotonic
        self._sequence = 0

    def grab(self) -> FrameStamp | None:
        """Take the next buffer; None where the device gave none (unplugged: at once; frozen: after its time-out).

        Raises:
            FrameError: PROTOCOL_ERROR where the buffer's stamp lies in the future: it is not of CLOCK_MONOTONIC.
        """
        if not self._capture.grab():
            return None
        self._sequence += 1
        stamp_s = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
        age_s = self._monotonic() - stamp_s
        if age_s < -_FUTURE_S:
            raise FrameError(
                Alarm.PROTOCOL_ERROR,
                f"{self._config.device}: time stamp {stamp_s:.3f} s lies {-age_s:.3f} s in the future of "
                "CLOCK_MONOTONIC; without a monotonic stamp a stale frame cannot be told.",
            )
        return FrameStamp(self._clock.now_s() - age_s - self._config.exposure_before_stamp_s, self._sequence)

    def retrieve(self) -> NDArray[np.uint8]:
        """Return the picture of the buffer taken last; raises `FrameError` IMAGE_INVALID where it cannot be decoded."""
        decoded, image = self._capture.retrieve()
        if not decoded or image is None or image.size == 0 or image.dtype != np.uint8:
            raise FrameError(Alarm.IMAGE_INVALID, f"{self._config.device}: frame {self._sequence} cannot be decoded.")
        return image

    def close(self) -> None:
        """Close the device."""
        self._capture.release()


def open_v4l2(
    config: V4l2CameraConfig,
    clock: Clock,
    opener: Callable[[str, int], VideoCapture] | None = None,
    monotonic: Callable[[], float] = time.monotonic,
) -> V4l2Capture:
    """Open the device, by default with OpenCV, and apply its settings.

    Raises:
        NotConnectedError: CAMERA_UNAVAILABLE where there is no such device or it cannot be opened.
        PortError: CAMERA_SETTING.
    """
    if opener is None:
        if not Path(config.device).exists():
            raise NotConnectedError(Alarm.CAMERA_UNAVAILABLE, f"{config.device}: no such device.")
        opener = _opencv
    capture = opener(config.device, cv2.CAP_V4L2)
    try:
        if not capture.isOpened():
            raise NotConnectedError(
                Alarm.CAMERA_UNAVAILABLE,
                f"{config.device}: cannot be opened: in use by another program, no permission (group video), "
                "or not a capture device.",
            )
        apply_settings(capture, config)
    except PortError:
        capture.release()
        raise
    return V4l2Capture(capture, config, clock, monotonic)


def _opencv(device: str, backend: int) -> VideoCapture:
    return cast("VideoCapture", cv2.VideoCapture(device, backend))


def _fourcc_text(value: float) -> str:
    return (int(value) & 0xFFFFFFFF).to_bytes(4, "little").decode("latin-1")


class V4l2Camera(GrabbingCamera):
    """The camera that the entry point makes.

    Args:
        config: where it is and how it is set.
        clock: the process's clock.
        open_capture: opens the device; by default with OpenCV.
    """

    def __init__(
        self, config: V4l2CameraConfig, clock: Clock, open_capture: Callable[[], V4l2Capture] | None = None
    ) -> None:
        self._config = config
        self._open_device = open_capture or (lambda: open_v4l2(config, clock))
        super().__init__(
            self._open_device,
            clock,
            config.device,
            (config.width, config.height),
            config.first_frame_timeout_s,
            config.open_timeout_s,
        )

    async def diagnose(self) -> list[Finding]:
        """Open the device, take some frames, close it; see `srvs_cell.ports.Diagnosable`."""
        size_px = (self._config.width, self._config.height)
        return await asyncio.to_thread(diagnose_v4l2, self._config.device, size_px, self._open_device)


def _make(config: V4l2CameraConfig, context: DriverContext) -> V4l2Camera:
    return V4l2Camera(config, context.clock)


DRIVER = DriverSpec(V4l2CameraConfig, _make)
