"""A Modbus RTU device's end of a pseudo-terminal, with faults on demand.

Written from "Modbus over serial line" V1.02, with its own framing and checksum: it shares no code with what talks to
it. Requests are told apart by their length, where the function code gives it, and by silence.
"""

from __future__ import annotations

import contextlib
import os
import select
import tempfile
import threading
import tty
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

_SILENCE_S: Final = 0.05
_PIECE: Final = 256
_CRC_START, _CRC_POLYNOMIAL = 0xFFFF, 0xA001
_BITS: Final = 8
_LEAST: Final = 4
_DEVICE_FAILURE: Final = 4
_FIXED_LENGTH: Final = 8
_FIXED: Final = range(1, 7)
"""Functions whose requests have the fixed length; a request of one that is not counted either ends with a silence."""
_COUNTED: Final = {15: 6, 16: 6, 23: 10}
"""Function -> where in the request the number of data bytes stands."""
_NONSENSE: Final = b"\r\nlogin: "


class LineFault(Enum):
    """What the device does wrong, from now on until it is told otherwise."""

    NONE = "none"
    SILENT = "takes requests, carries them out and does not answer"
    DEAF = "takes requests, ignores them and does not answer"
    LATE = "answers a request only when the next one arrives"
    WRONG_CRC = "answers with a wrong checksum"
    HALF_FRAME = "sends the first half of an answer"
    NONSENSE = "answers with what is not Modbus"
    WRONG_DEVICE = "answers as another device"
    EXCEPTION = "answers every request with exception 4, device failure"
    PIECES = "sends every byte alone, which is allowed while the pauses are short"


def checksum(data: bytes) -> bytes:
    """Return the two bytes that end a frame, the lower one first (CRC-16, "Modbus over serial line" 6.2.2)."""
    crc = _CRC_START
    for byte in data:
        crc ^= byte
        for _ in range(_BITS):
            crc = crc >> 1 ^ (_CRC_POLYNOMIAL if crc & 1 else 0)
    return crc.to_bytes(2, "little")


class RtuLine:
    """Answers requests to one device.

    Attributes:
        fault: what goes wrong.
        fault_after: so many requests are still answered properly.
        received: whole requests, in order.
    """

    def __init__(self, answer: Callable[[bytes], bytes], device_id: int) -> None:
        self.fault = LineFault.NONE
        self.fault_after = 0
        self.received: list[bytes] = []
        self._answer, self._device_id = answer, device_id
        self._ours = self._theirs = self._wake = -1
        self._thread: threading.Thread | None = None
        self._name = Path()

    def start(self) -> str:
        """Open the pseudo-terminal; return the path of the other end."""
        self._ours, self._theirs = os.openpty()  # the other end is held open, or it would hang up when a PC closes it
        tty.setraw(self._theirs)
        read_end, self._wake = os.pipe()
        self._thread = threading.Thread(target=self._serve, args=(read_end,), name="RTU double", daemon=True)
        self._thread.start()
        # a name of its own, as udev gives one: the kernel gives a number that was hung up to whoever asks next
        self._name = Path(tempfile.mkdtemp(prefix="srvs-rtu-")) / "line"
        self._name.symlink_to(os.ttyname(self._theirs))
        return str(self._name)

    def close(self) -> None:
        """Hang up, and wait for the thread."""
        thread, self._thread = self._thread, None
        if thread is not None:
            os.close(self._wake)
            thread.join()
            self._name.unlink()
            self._name.parent.rmdir()
            os.close(self._ours)
            os.close(self._theirs)

    def _serve(self, ended: int) -> None:
        buffer, late = b"", b""
        while True:
            ready, _, _ = select.select([self._ours, ended], [], [], _SILENCE_S if buffer else None)
            if ended in ready:
                os.close(ended)
                return
            if not ready:  # a silence ends a frame: one of an unknown length, or one that is not whole
                late, buffer = self._take(buffer, late) if len(buffer) >= _LEAST else late, b""
                continue
            with contextlib.suppress(OSError):  # EIO: nobody has the other end open
                buffer += os.read(self._ours, _PIECE)
            while (length := _request_length(buffer)) and len(buffer) >= length:
                request, buffer = buffer[:length], buffer[length:]
                late = self._take(request, late)

    def _take(self, request: bytes, late: bytes) -> bytes:
        """Answer one request; return the answer that is kept for the next one."""
        if checksum(request[:-2]) != request[-2:] or request[0] != self._device_id:
            return late
        self.received.append(request)
        fault, self.fault_after = (self.fault, 0) if not self.fault_after else (LineFault.NONE, self.fault_after - 1)
        if fault is LineFault.DEAF:
            return late
        pdu = self._answer(request[1:-2])
        if fault is LineFault.EXCEPTION:
            pdu = bytes([pdu[0] | 0x80, _DEVICE_FAILURE])
        device_id = self._device_id + (fault is LineFault.WRONG_DEVICE)
        frame = bytes([device_id]) + pdu
        frame += checksum(frame)
        if fault is LineFault.LATE:
            frame, late = late, frame
        self._send(frame, fault)
        return late

    def _send(self, frame: bytes, fault: LineFault) -> None:
        pieces = {
            LineFault.SILENT: [],
            LineFault.WRONG_CRC: [frame[:-1] + bytes([frame[-1] ^ 0xFF])] if frame else [],
            LineFault.HALF_FRAME: [frame[: len(frame) // 2]],
            LineFault.NONSENSE: [_NONSENSE],
            LineFault.PIECES: [bytes([byte]) for byte in frame],
        }.get(fault, [frame])
        with contextlib.suppress(OSError):  # nobody has the other end open
            for piece in pieces:
                os.write(self._ours, piece)


def _request_length(buffer: bytes) -> int:
    """Return how long the request is that a buffer begins with, checksum included; 0 where that cannot be told yet."""
    if len(buffer) < _LEAST:
        return 0
    if buffer[1] in _FIXED:
        return _FIXED_LENGTH
    at = _COUNTED.get(buffer[1], len(buffer))
    return at + 1 + buffer[at] + 2 if len(buffer) > at else 0
