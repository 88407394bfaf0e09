"""One TCP connection that carries lines, with every failure named.

Time-outs here are real time: they bound the wire, not the work of the robot.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from drivers.fanuc.connection import why_not_connected
from drivers.fanuc.rmi.framing import LineBuffer
from srvs_cell.alarms import Alarm
from srvs_cell.ports import NotConnectedError, PortError

if TYPE_CHECKING:
    from collections.abc import Callable


class LineWire(asyncio.Protocol):
    """Hands every line to ``on_line`` and the end of the connection, once, to ``on_end``."""

    def __init__(self, on_line: Callable[[bytes], None], on_end: Callable[[PortError], None]) -> None:
        self.address = "not connected"
        self._on_line, self._on_end = on_line, on_end
        self._buffer = LineBuffer()
        self._transport: asyncio.Transport | None = None

    @property
    def open(self) -> bool:
        """Whether lines can be sent."""
        return self._transport is not None and not self._transport.is_closing()

    async def connect(self, host: str, port: int, timeout_s: float) -> None:
        """Open the connection; raises `NotConnectedError` that says why it cannot be opened."""
        self.address = address = f"{host}:{port}"
        with why_not_connected(address, host, port, timeout_s):
            async with asyncio.timeout(timeout_s):
                await asyncio.get_running_loop().create_connection(lambda: self, host, port)

    def send(self, packet: bytes) -> None:
        """Send one packet; what becomes of it shows in the reply, or in the end of the connection."""
        if self._transport is not None:
            self._transport.write(packet)

    def close(self) -> None:
        """Close the connection, if there is one; ``on_end`` is not called."""
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the connection (asyncio calls this)."""
        if isinstance(transport, asyncio.Transport):
            self._transport = transport

    def data_received(self, data: bytes) -> None:
        """Take bytes (asyncio calls this)."""
        try:
            lines = self._buffer.feed(data)
        except PortError as error:
            self._end(PortError(error.alarm, f"{self.address}: {error.detail}"))
            return
        for line in lines:
            if self._transport is None:  # an earlier line of this piece ended the connection
                return
            self._on_line(line)

    def connection_lost(self, exc: Exception | None) -> None:
        """Take note of the end (asyncio calls this)."""
        why = f": {exc}" if exc is not None else ""
        self._end(NotConnectedError(Alarm.CONNECTION_LOST, f"{self.address}: the connection was cut{why}."))

    def _end(self, error: PortError) -> None:
        if self._transport is not None:
            self._on_end(error)
            self.close()
