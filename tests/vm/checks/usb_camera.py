"""A USB camera in user space, for a kernel with vhci-hcd and uvcvideo: USB/IP over a socket pair.

The kernel's own uvcvideo makes /dev/video of it, with what vivid lacks: exposure controls and a real unplug. Its
pictures are a ramp whose brightness follows exposure and brightness as they are set.

``python -m tests.vm.checks.usb_camera`` plugs it in and obeys lines on stdin: plug, unplug, freeze, thaw, error, short.
Each is answered with a line when it is done.
"""

from __future__ import annotations

import collections
import contextlib
import socket
import struct
import sys
import threading
import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

from tests.vm.checks import usb_descriptors as usb

if TYPE_CHECKING:
    from collections.abc import Callable

_ATTACH: Final = Path("/sys/devices/platform/vhci_hcd.0/attach")
_PORT, _DEVICE_ID, _HIGH_SPEED = 0, 65538, 3

_HEADER: Final = struct.Struct(">5I4si12s8s")
"""USB/IP header of the kernel's requests: command, sequence, device, direction, endpoint, victim, length, -, setup."""
_SUBMIT_REPLY: Final = struct.Struct(">5I5i8x")
_UNLINK_REPLY: Final = struct.Struct(">5Ii24x")
_UNLINK, _RET_SUBMIT, _RET_UNLINK = 2, 3, 4
_STALL, _RESET = -32, -104

_SET_CURRENT, _GET_CURRENT, _GET_LENGTH, _GET_INFO = 0x01, 0x81, 0x85, 0x86
_READ_WRITE = b"\x03"
_GET_DESCRIPTOR = 6
_PROBE: Final = struct.Struct("<HBBIHHHHHIIIBBBB")

_PAYLOAD_BYTES: Final = 16384
_END_OF_HEADER, _ERROR, _END_OF_FRAME = 0x80, 0x40, 0x02
_MANUAL: Final = 1
_DEFAULT_EXPOSURE: Final = 157
_BLACK, _WHITE, _NO_COLOUR = 16, 235, 128


@dataclass
class Control:
    """A control of the camera: its length in bytes and its values."""

    length: int
    least: int
    most: int
    step: int
    default: int
    value: int

    def answer(self, request: int) -> bytes | None:
        """Return what a GET request asks for; None where there is no such request."""
        value = {
            _GET_CURRENT: self.value, 0x82: self.least, 0x83: self.most, 0x84: self.step, 0x87: self.default,
        }.get(request)  # fmt: skip
        return None if value is None else value.to_bytes(self.length, "little")


class UsbCamera:
    """The camera; one at a time, on port 0 of the virtual host controller."""

    def __init__(self) -> None:
        self.automatic = Control(1, 1, 8, 9, 8, 8)
        self.exposure = Control(4, 1, 10_000, 1, _DEFAULT_EXPOSURE, _DEFAULT_EXPOSURE)
        self.brightness = Control(2, 0, 255, 1, 128, 128)
        self.gain = Control(2, 0, 100, 1, 0, 0)
        self._controls = {
            (1, 2): self.automatic, (1, 4): self.exposure, (2, 2): self.brightness, (2, 4): self.gain,
        }  # (unit, selector)  # fmt: skip
        self._changed = threading.Condition()
        self._connection: socket.socket | None = None
        self._wanted: collections.deque[int] = collections.deque()
        self._cancelled: set[int] = set()
        self._format = (1, usb.INTERVALS_100NS[0])
        self._frozen = False
        self._fault = ""

    def plug(self) -> None:
        """Plug it in: the kernel finds a new device."""
        ours, kernels = socket.socketpair()
        with self._changed:
            self._connection, self._frozen, self._fault = ours, False, ""
            self._wanted.clear()
            self._cancelled.clear()
        with kernels:
            _ATTACH.write_text(f"{_PORT} {kernels.fileno()} {_DEVICE_ID} {_HIGH_SPEED}", encoding="ascii")
        for body in (self._serve, self._stream):
            threading.Thread(target=body, args=(ours,), daemon=True).start()

    def unplug(self) -> None:
        """Pull the plug."""
        with self._changed:
            connection, self._connection = self._connection, None
            self._changed.notify_all()
        if connection is not None:
            with contextlib.suppress(OSError):  # the kernel has let go of it already
                connection.shutdown(socket.SHUT_RDWR)

    def freeze(self, *, frozen: bool) -> None:
        """Send no pictures any more, or go on; the device stays."""
        with self._changed:
            self._frozen = frozen
            self._changed.notify_all()

    def spoil(self, fault: str) -> None:
        """Spoil the next picture: ``error`` flags it as faulty, ``short`` sends half of it."""
        self._fault = fault

    # -- the kernel's requests ----------------------------------------------------------------------------------------

    def _serve(self, connection: socket.socket) -> None:
        stream = connection.makefile("rb")
        with connection, stream, contextlib.suppress(OSError):
            while len(head := stream.read(_HEADER.size)) == _HEADER.size:
                command, sequence, _, inwards, endpoint, victim, length, _, setup = _HEADER.unpack(head)
                if command == _UNLINK:
                    self._unlink(connection, sequence, int.from_bytes(victim, "big"))
                    continue
                data = stream.read(length) if not inwards and length > 0 else b""
                if endpoint == 0:
                    self._answer(connection, sequence, self._control(setup, data), length if inwards else None)
                else:
                    with self._changed:
                        if sequence not in self._cancelled:
                            self._wanted.append(sequence)
                        self._changed.notify_all()

    def _unlink(self, connection: socket.socket, sequence: int, victim: int) -> None:
        """Cancel a request; the kernel sometimes sends the cancellation before the request itself."""
        with self._changed:
            found = victim in self._wanted
            if found:
                self._wanted.remove(victim)
            else:
                self._cancelled.add(victim)
            connection.sendall(_UNLINK_REPLY.pack(_RET_UNLINK, sequence, 0, 0, 0, _RESET if found else 0))

    def _answer(self, connection: socket.socket, sequence: int, answer: bytes | None, asked: int | None) -> None:
        """Answer a control request; ``asked`` bytes where it reads, None where it writes."""
        if answer is None:
            self._reply(connection, sequence, _STALL, 0, b"")
        elif asked is None:
            self._reply(connection, sequence, 0, len(answer), b"")
        else:
            self._reply(connection, sequence, 0, len(answer[:asked]), answer[:asked])

    def _reply(self, connection: socket.socket, sequence: int, status: int, actual: int, data: bytes) -> None:
        head = _SUBMIT_REPLY.pack(_RET_SUBMIT, sequence, 0, 0, 0, status, actual, 0, 0, 0)
        with self._changed:
            connection.sendall(head + data)

    # -- control endpoint ---------------------------------------------------------------------------------------------

    def _control(self, setup: bytes, data: bytes) -> bytes | None:
        """Return the answer; None stalls the endpoint."""
        kind, request, value, index, _ = struct.unpack("<BBHHH", setup)
        if kind & 0x60 == 0:
            return self._standard(request, value) if kind & 0x80 else data
        if index & 0xFF == 1:
            return self._negotiate(request, data)
        control = self._controls.get((index >> 8, value >> 8))
        if control is None:
            return None
        if request == _SET_CURRENT:
            control.value = int.from_bytes(data[: control.length], "little")
            return data
        if request == _GET_LENGTH:
            return struct.pack("<H", control.length)
        return _READ_WRITE if request == _GET_INFO else control.answer(request)

    @staticmethod
    def _standard(request: int, value: int) -> bytes | None:
        if request != _GET_DESCRIPTOR:
            return b"\0\0"
        match value >> 8:
            case 1:
                return usb.device_descriptor()
            case 2:
                return usb.configuration_descriptor()
            case 3:
                return usb.string_descriptor(value & 0xFF)
        return None

    def _negotiate(self, request: int, data: bytes) -> bytes:
        """Probe and commit: which size, which rate."""
        if request == _SET_CURRENT:
            number, interval = data[3], int.from_bytes(data[4:8], "little")
            known = number if 1 <= number <= len(usb.SIZES_PX) else 1
            self._format = (known, interval or usb.INTERVALS_100NS[0])
            return data
        if request == _GET_LENGTH:
            return struct.pack("<H", _PROBE.size)
        if request == _GET_INFO:
            return _READ_WRITE
        number, interval = self._format
        width, height = usb.SIZES_PX[number - 1]
        size = width * height * usb.BYTES_PER_PIXEL
        return _PROBE.pack(1, 1, number, interval, 0, 0, 0, 0, 0, size, _PAYLOAD_BYTES, usb.CLOCK_HZ, 3, 0, 0, 0)

    # -- streaming endpoint -------------------------------------------------------------------------------------------

    def _picture(self) -> bytes:
        """Return a ramp from left to right, as bright as exposure and brightness say."""
        width, height = usb.SIZES_PX[self._format[0] - 1]
        exposure = self.exposure.value if self.automatic.value == _MANUAL else _DEFAULT_EXPOSURE
        luma = _BLACK + exposure * 100 // _DEFAULT_EXPOSURE + self.brightness.value - self.brightness.default
        return _ramp(luma, width) * height

    def _stream(self, connection: socket.socket) -> None:
        frame_id, due_s = 0, time.monotonic()
        with contextlib.suppress(OSError):
            while self._connection is connection:
                fault, self._fault = self._fault, ""
                picture = self._picture()
                if fault:  # white, so that it shows where it is handed out all the same
                    picture = bytes([_WHITE, _NO_COLOUR]) * (len(picture) // 2)
                if fault == "short":
                    picture = picture[: len(picture) // 2]
                flags = _END_OF_HEADER | frame_id | (_ERROR if fault == "error" else 0)
                part_bytes = _PAYLOAD_BYTES - 2
                for at in range(0, len(picture), part_bytes):
                    part = picture[at : at + part_bytes]
                    end = _END_OF_FRAME if at + part_bytes >= len(picture) else 0
                    if not self._send(connection, bytes([2, flags | end]) + part):
                        return
                frame_id ^= 1
                due_s = max(due_s + self._format[1] / 1e7, time.monotonic())
                time.sleep(max(0.0, due_s - time.monotonic()))

    def _send(self, connection: socket.socket, payload: bytes) -> bool:
        """Send a payload when the kernel wants one and the camera is not frozen; False where the plug was pulled.

        Taking the kernel's request and answering it is one act: in between the kernel might cancel it.
        """
        with self._changed:
            self._changed.wait_for(
                lambda: self._connection is not connection or (bool(self._wanted) and not self._frozen)
            )
            if self._connection is not connection:
                return False
            self._reply(connection, self._wanted.popleft(), 0, len(payload), payload)
            return True


@lru_cache
def _ramp(luma: int, width: int) -> bytes:
    """Return one row of the picture, YUYV."""
    greys = (luma // 2 + luma * column // width for column in range(width))
    return b"".join(bytes([min(_WHITE, max(_BLACK, grey)), _NO_COLOUR]) for grey in greys)


def main() -> None:
    """Plug a camera in and obey stdin until it closes."""
    camera = UsbCamera()
    deeds: dict[str, Callable[[], None]] = {
        "plug": camera.plug,
        "unplug": camera.unplug,
        "freeze": lambda: camera.freeze(frozen=True),
        "thaw": lambda: camera.freeze(frozen=False),
        "error": lambda: camera.spoil("error"),
        "short": lambda: camera.spoil("short"),
    }
    for line in sys.stdin:
        deeds[line.strip()]()
        sys.stdout.write(line)
        sys.stdout.flush()
    camera.unplug()


if __name__ == "__main__":
    main()
