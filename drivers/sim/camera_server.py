"""Serves the simulated camera's frames on a loopback socket."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
from typing import TYPE_CHECKING, Final, Protocol

from drivers.sim.camera_wire import FRAME, GRAB, HEADER, NO_FRAME, NOT_GRABBED, RETRIEVE
from drivers.sim.one_client import has_event

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from drivers.sim.camera_stream import CameraStream, Exposure
    from drivers.sim.clock_authority import SimTime

_NO_FRAME_AFTER_S: Final = 1.0
_NO_FRAME_REAL_S: Final = 5.0
_READER_GRACE_S: Final = 0.2
_WAIT_S: Final = 0.2


class Pictures(Protocol):
    """What makes pictures of exposures."""

    def picture(self, exposure: Exposure) -> NDArray[np.uint8]:
        """Return the 8-bit picture, shape (H, W)."""
        ...


class CameraServer:
    """A camera that one program at a time may open.

    Args:
        stream: frames as they are exposed.
        pictures: renders them.
        time: simulated time; it stands still while a picture is rendered, and briefly while the reader takes note of
            a frame.
    """

    def __init__(self, stream: CameraStream, pictures: Pictures, time: SimTime) -> None:
        self._stream, self._pictures, self._time = stream, pictures, time
        self._thread: threading.Thread | None = None
        self._connection: socket.socket | None = None
        self._closing = threading.Event()
        self._in_hand = self._awaits_frame = False
        time.hold_while(self._unread)

    def start(self) -> int:
        """Serve; return the port."""
        listener = socket.create_server(("127.0.0.1", 0))
        listener.settimeout(_WAIT_S)
        self._thread = threading.Thread(target=self._serve, args=(listener,), name="camera server", daemon=True)
        self._thread.start()
        return int(listener.getsockname()[1])

    def close(self) -> None:
        """End the server; its reader's connection is cut."""
        self._closing.set()
        self.disconnect()
        if self._thread is not None:
            self._thread.join()

    def disconnect(self) -> None:
        """Cut the reader's connection, as a pulled plug would."""
        connection = self._connection
        if connection is not None:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def _unread(self) -> bool:
        """Whether a request has come, or is in hand, and no frame is waited for."""
        connection = self._connection
        if connection is None or self._awaits_frame:
            return False
        return has_event(connection, select.POLLIN, 0) or self._in_hand

    def _serve(self, listener: socket.socket) -> None:
        with listener:
            while not self._closing.is_set():
                try:
                    connection, _ = listener.accept()
                except TimeoutError:
                    continue
                with connection:
                    self._connection = connection
                    with contextlib.suppress(OSError):  # the reader has gone; the next one may come
                        self._attend(connection)
                    self._connection = None

    def _attend(self, connection: socket.socket) -> None:
        connection.settimeout(None)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        exposure: Exposure | None = None
        while not self._closing.is_set():
            self._in_hand = False
            connection.recv(1, socket.MSG_PEEK)
            self._in_hand = True
            request = connection.recv(1)
            if request == GRAB:
                exposure = self._next()
                if exposure is None:
                    connection.sendall(HEADER.pack(NO_FRAME, 0, 0.0, 0, 0))
                    continue
                with self._time.hold():
                    connection.sendall(HEADER.pack(FRAME, exposure.sequence, exposure.stamp_s, 0, 0))
                    select.select([connection], [], [], _READER_GRACE_S)
            elif request == RETRIEVE:
                self._send_picture(connection, exposure)
            else:
                return

    def _next(self) -> Exposure | None:
        """Wait for a frame, for a while of simulated time."""
        with self._time.lock:
            until_s = self._time.now_s() + _NO_FRAME_AFTER_S
            taken: list[Exposure] = []

            def ready() -> bool:
                exposure = self._stream.take()
                if exposure is not None:
                    taken.append(exposure)
                return (
                    exposure is not None or self._time.now_s() >= until_s or self._closing.is_set() or self._time.closed
                )

            self._awaits_frame = True
            self._time.lock.wait_for(ready, _NO_FRAME_REAL_S)
            self._awaits_frame = False
        return taken[0] if taken else None

    def _send_picture(self, connection: socket.socket, exposure: Exposure | None) -> None:
        if exposure is None:
            connection.sendall(HEADER.pack(NOT_GRABBED, 0, 0.0, 0, 0))
            return
        with self._time.hold():
            picture = self._pictures.picture(exposure)
            height, width = picture.shape
            header = HEADER.pack(FRAME, exposure.sequence, exposure.stamp_s, width, height)
            connection.sendall(header + picture.tobytes())
