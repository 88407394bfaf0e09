"""The simulated camera's frame socket: one byte asks, a header and perhaps pixels answer.

``G`` waits for the next frame of the stream, ``R`` fetches the pixels of the frame that was taken last.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import socket

GRAB: Final = b"G"
RETRIEVE: Final = b"R"
HEADER: Final = struct.Struct("!BIdHH")
"""Status, sequence, time stamp in simulated seconds, width, height; after a retrieval width x height grey bytes."""

NO_FRAME, FRAME, NOT_GRABBED = 0, 1, 2


def receive(connection: socket.socket, count: int) -> bytes:
    """Return exactly ``count`` bytes; raises `ConnectionError` where the other side has closed."""
    parts = bytearray()
    while len(parts) < count:
        part = connection.recv(count - len(parts))
        if not part:
            raise ConnectionError(f"closed after {len(parts)} of {count} bytes")
        parts += part
    return bytes(parts)
