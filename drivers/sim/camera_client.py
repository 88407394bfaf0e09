"""The Camera port on a simulated cell's frame socket: the entry point ``camera.sim``."""

from __future__ import annotations

import math
import socket
from typing import TYPE_CHECKING, Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from drivers.camera.grabber import FrameStamp, GrabbingCamera
from drivers.sim.camera_wire import FRAME, GRAB, HEADER, RETRIEVE, receive
from srvs_cell.alarms import Alarm
from srvs_cell.ports import DriverContext, DriverSpec, FrameError, NotConnectedError, PortError

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MOST_PX: Final = 8192


class SimCameraConfig(BaseModel):
    """Where the simulated camera's frames are.

    Attributes:
        host, port: the frame socket, as the simulator names it on its first line.
        timeout_s: real seconds within which the simulator must answer; a picture takes it a second to render.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    host: str = Field(default="127.0.0.1", description="host of the simulated cell")
    port: int = Field(ge=1, le=65535, description="port of the frame socket")
    timeout_s: float = Field(default=30.0, gt=0.0, le=600.0, description="real seconds to wait for an answer")


class SimCapture:
    """An open connection to the frame socket, shaped like an OpenCV capture; time stamps are simulated seconds."""

    def __init__(self, config: SimCameraConfig) -> None:
        self._name = f"{config.host}:{config.port}"
        try:
            self._connection = socket.create_connection((config.host, config.port), config.timeout_s)
        except OSError as error:
            raise NotConnectedError(Alarm.CAMERA_UNAVAILABLE, f"Simulated camera {self._name}: {error}.") from error
        self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def grab(self) -> FrameStamp | None:
        """Wait for the next frame of the stream; None where none was exposed for a second of simulated time."""
        status, sequence, stamp_s, _, _ = self._ask(GRAB)
        if not math.isfinite(stamp_s):
            raise PortError(
                Alarm.PROTOCOL_ERROR, f"Simulated camera {self._name}: the time stamp {stamp_s} is no time."
            )
        return FrameStamp(stamp_s, sequence) if status == FRAME else None

    def retrieve(self) -> NDArray[np.uint8]:
        """Return the picture of the frame grabbed last, uint8, shape (H, W)."""
        status, _, _, width, height = self._ask(RETRIEVE)
        if status != FRAME:
            raise FrameError(Alarm.CAMERA_TIMEOUT, f"Simulated camera {self._name}: no frame was grabbed.")
        if max(width, height) > _MOST_PX:
            raise FrameError(
                Alarm.IMAGE_INVALID, f"Simulated camera {self._name}: a picture of {width} x {height} pixels is none."
            )
        return np.frombuffer(self._receive(width * height), dtype=np.uint8).reshape(height, width)

    def close(self) -> None:
        """Let go of the camera."""
        self._connection.close()

    def _ask(self, request: bytes) -> tuple[int, int, float, int, int]:
        try:
            self._connection.sendall(request)
        except OSError as error:
            raise self._lost(error) from error
        status, sequence, stamp_s, width, height = HEADER.unpack(self._receive(HEADER.size))
        return status, sequence, stamp_s, width, height

    def _receive(self, count: int) -> bytes:
        try:
            return receive(self._connection, count)
        except OSError as error:
            raise self._lost(error) from error

    def _lost(self, error: OSError) -> NotConnectedError:
        return NotConnectedError(Alarm.CAMERA_UNAVAILABLE, f"Simulated camera {self._name}: {error}.")


def _make(config: SimCameraConfig, context: DriverContext) -> GrabbingCamera:
    name = f"simulated camera at {config.host}:{config.port}"
    return GrabbingCamera(lambda: SimCapture(config), context.clock, name)


DRIVER = DriverSpec(SimCameraConfig, _make)
