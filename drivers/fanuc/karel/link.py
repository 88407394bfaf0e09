"""The two carriers of the line protocol: a TCP connection and a serial line. They carry bytes and name failures.

Time-outs here are real time: they bound the wire, not the work of the robot.
"""

from __future__ import annotations

import asyncio
import errno
from typing import TYPE_CHECKING, Final, Protocol

import serial

from drivers.fanuc.tcp_link import TcpLink
from srvs_cell.alarms import Alarm
from srvs_cell.ports import NotConnectedError

if TYPE_CHECKING:
    from collections.abc import Callable

    from drivers.fanuc.karel.config import FanucKarelConfig
    from srvs_cell.ports import PortError

_WHY_NOT_OPENED: Final = {
    errno.ENOENT: (Alarm.DEVICE_UNAVAILABLE, "there is no such device"),
    errno.EACCES: (Alarm.DEVICE_UNAVAILABLE, "no permission: the daemon's user must be in the group dialout"),
    errno.EBUSY: (Alarm.SESSION_HELD, "another program holds the port"),
    errno.EAGAIN: (Alarm.SESSION_HELD, "another program holds the port"),
}


class Link(Protocol):
    """A carrier. Bytes that come are handed to ``on_bytes``, an end that was not asked for, once, to ``on_end``."""

    @property
    def address(self) -> str:
        """Where it leads, for people."""
        ...

    async def open(self, on_bytes: Callable[[bytes], None], on_end: Callable[[PortError], None]) -> None:
        """Open it; raises `NotConnectedError` that says why it cannot be opened."""
        ...

    def send(self, data: bytes) -> None:
        """Send bytes; what becomes of them shows in the reply, or in the end of the connection."""
        ...

    def close(self) -> None:
        """Close it, if it is open; ``on_end`` is not called."""
        ...


def make_link(config: FanucKarelConfig) -> Link:
    """Return the carrier that the config names."""
    if config.serial is not None:
        return SerialLink(config.serial.device, config.serial.baud)
    if config.tcp is None:
        raise ValueError("the config names no wire")
    return TcpLink(config.tcp.host, config.tcp.port, config.timeout_s)


class SerialLink:
    """A serial line: 8 data bits, no parity, 1 stop bit, no flow control; locked against other programs."""

    def __init__(self, device: str, baud: int) -> None:
        self.address = f"{device} at {baud} 8N1"
        self._device, self._baud = device, baud
        self._serial: serial.Serial | None = None
        self._on_bytes: Callable[[bytes], None] | None = None
        self._on_end: Callable[[PortError], None] | None = None

    async def open(self, on_bytes: Callable[[bytes], None], on_end: Callable[[PortError], None]) -> None:
        """Open the port; whether anything is at its other end shows in the first reply only."""
        try:
            port = serial.Serial(
                self._device,
                self._baud,
                bytesize=serial.EIGHTBITS,
                parity=serial.PARITY_NONE,
                stopbits=serial.STOPBITS_ONE,
                timeout=0,
                write_timeout=0,
                exclusive=True,
            )
        except (OSError, ValueError) as error:
            number = error.errno if isinstance(error, OSError) else None
            alarm, why = _WHY_NOT_OPENED.get(number or 0, (Alarm.DEVICE_UNAVAILABLE, str(error)))
            raise NotConnectedError(alarm, f"{self.address}: {why}.") from error
        port.reset_input_buffer()
        self._serial, self._on_bytes, self._on_end = port, on_bytes, on_end
        asyncio.get_running_loop().add_reader(port.fileno(), self._readable)

    def send(self, data: bytes) -> None:
        """Send bytes; a line fits the port's buffer many times."""
        port = self._serial
        if port is None:
            return
        try:
            if port.write(data) != len(data):
                self._end("the port's buffer is full: nothing leaves it")
        except OSError as error:
            self._end(str(error))

    def close(self) -> None:
        """Close the port."""
        port, self._serial = self._serial, None
        if port is not None:
            asyncio.get_running_loop().remove_reader(port.fileno())
            port.close()

    def _readable(self) -> None:
        port = self._serial
        if port is None or self._on_bytes is None:
            return
        try:
            data = port.read(port.in_waiting or 1)
        except OSError as error:
            self._end(str(error))
            return
        if data:
            self._on_bytes(data)

    def _end(self, why: str) -> None:
        self.close()
        if self._on_end is not None:
            self._on_end(NotConnectedError(Alarm.CONNECTION_LOST, f"{self.address}: the port was lost: {why}."))
