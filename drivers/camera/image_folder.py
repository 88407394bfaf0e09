"""Frames from image files, in the order of their names: to replay what a cell has seen."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from srvs_cell.alarms import Alarm
from srvs_cell.ports import (
    DriverContext,
    DriverSpec,
    Frame,
    FrameError,
    Lifecycle,
    NotConnectedError,
    NotReadyError,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.ports import Clock


_PNG_BEGIN: Final = b"\x89PNG\r\n\x1a\n"
_PNG_END: Final = b"IEND\xaeB`\x82"
_JPEG_BEGIN: Final = b"\xff\xd8\xff"
_JPEG_END: Final = b"\xff\xd9"


class ImageFolderConfig(BaseModel):
    """The camera's part of the cell's YAML."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    folder: Path = Field(description="where the images are")
    pattern: str = Field(default="*.png", min_length=1, description="which files of it")
    width: int | None = Field(
        default=None, ge=1, le=16384, description="pixels that every image must have; not given: as the first image"
    )
    height: int | None = Field(
        default=None, ge=1, le=16384, description="pixels that every image must have; not given: as the first image"
    )
    repeat: bool = Field(default=False, description="whether to begin anew after the last image")


class ImageFolderCamera:
    """Camera that shows one file after the other, each as if exposed when it is asked for."""

    def __init__(self, config: ImageFolderConfig, clock: Clock) -> None:
        self._config, self._clock = config, clock
        self._lifecycle = Lifecycle.DISCONNECTED
        self._files: list[Path] = []
        self._size_px: tuple[int, int] = (0, 0)
        self._shown = 0

    @property
    def lifecycle(self) -> Lifecycle:
        """Where the camera is in its life."""
        return self._lifecycle

    @property
    def description(self) -> str:
        """What stands behind the port, for people."""
        return f"images {self._config.pattern} of {self._config.folder}"

    async def connect(self) -> None:
        """List the files and read the first one.

        Raises:
            NotConnectedError: CAMERA_UNAVAILABLE where there is no such file.
            FrameError: IMAGE_INVALID where the first one cannot be read.
        """
        files = await asyncio.to_thread(lambda: sorted(self._config.folder.glob(self._config.pattern)))
        if not files:
            raise NotConnectedError(Alarm.CAMERA_UNAVAILABLE, f"There are no {self.description}.")
        first = await asyncio.to_thread(read_image, files[0])
        self._size_px = (self._config.width or first.shape[1], self._config.height or first.shape[0])
        self._files, self._shown = files, 0
        self._lifecycle = Lifecycle.INACTIVE

    async def activate(self) -> None:
        """Allow frames."""
        self._require(Lifecycle.INACTIVE, Lifecycle.ACTIVE)
        self._lifecycle = Lifecycle.ACTIVE

    async def deactivate(self) -> None:
        """Forbid frames."""
        if self._lifecycle == Lifecycle.ACTIVE:
            self._lifecycle = Lifecycle.INACTIVE

    async def disconnect(self) -> None:
        """Forget the files; the next `connect` begins with the first one."""
        self._lifecycle = Lifecycle.DISCONNECTED

    async def grab(self, not_before_s: float, timeout_s: float) -> Frame:
        """Return the next file's image, exposed now or, where that is later, at ``not_before_s``.

        Raises:
            FrameError: CAMERA_TIMEOUT after the last file or where ``not_before_s`` is further away than the
                time-out, IMAGE_INVALID where the file is missing, truncated or of another size.
            NotReadyError: the camera is not active.
        """
        self._require(Lifecycle.ACTIVE)
        wait_s = not_before_s - self._clock.now_s()
        if wait_s > timeout_s:
            await self._clock.sleep(timeout_s)
            raise FrameError(Alarm.CAMERA_TIMEOUT, f"No frame within {timeout_s} s: it was asked for {wait_s} s ahead.")
        if wait_s > 0.0:
            await self._clock.sleep(wait_s)
        if self._shown >= len(self._files) and not self._config.repeat:
            raise FrameError(Alarm.CAMERA_TIMEOUT, f"All {len(self._files)} {self.description} have been shown.")
        path = self._files[self._shown % len(self._files)]
        exposed_at_s = max(self._clock.now_s(), not_before_s)
        self._shown += 1
        with self._clock.working():
            image = await asyncio.to_thread(read_image, path)
        size_px = (image.shape[1], image.shape[0])
        if size_px != self._size_px:
            raise FrameError(Alarm.IMAGE_INVALID, f"{path} has {size_px} pixels, not {self._size_px}.")
        return Frame(image, exposed_at_s, self._shown)

    def _require(self, *allowed: Lifecycle) -> None:
        if self._lifecycle == Lifecycle.DISCONNECTED:
            raise NotConnectedError(Alarm.CAMERA_UNAVAILABLE, f"The {self.description} are not connected.")
        if self._lifecycle not in allowed:
            raise NotReadyError(Alarm.CAMERA_UNAVAILABLE, f"The {self.description} are {self._lifecycle.value}.")


def read_image(path: Path) -> NDArray[np.uint8]:
    """Return an image file as uint8, (H, W) or (H, W, 3) BGR; raises `FrameError` IMAGE_INVALID."""
    try:
        data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    except OSError as error:
        raise FrameError(Alarm.IMAGE_INVALID, f"{path}: {error.strerror}.") from error
    image = cv2.imdecode(data, cv2.IMREAD_ANYCOLOR) if _complete(data.tobytes()) else None
    if image is None:
        raise FrameError(Alarm.IMAGE_INVALID, f"{path}: not a complete image ({data.size} bytes).")
    return np.asarray(image, dtype=np.uint8)


def _complete(data: bytes) -> bool:
    """Say whether a PNG or JPEG has its end: OpenCV fills a truncated one up with grey. Other formats pass."""
    if data.startswith(_PNG_BEGIN):
        return data.endswith(_PNG_END)
    if data.startswith(_JPEG_BEGIN):
        return data.rstrip(b"\0").endswith(_JPEG_END)
    return bool(data)


def _make(config: ImageFolderConfig, context: DriverContext) -> ImageFolderCamera:
    return ImageFolderCamera(config, context.clock)


DRIVER = DriverSpec(ImageFolderConfig, _make)
