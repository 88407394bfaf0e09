"""A TCP connection that carries bytes and names its failures. Time-outs are real time: they bound the wire."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from drivers.fanuc.connection import why_not_connected
from srvs_cell.alarms import Alarm
from srvs_cell.ports import NotConnectedError

if TYPE_CHECKING:
    from collections.abc import Callable

    from srvs_cell.ports import PortError


class TcpLink(asyncio.Protocol):
    """Bytes that come are handed to ``on_bytes``, an end that was not asked for, once, to ``on_end``."""

    def __init__(self, host: str, port: int, timeout_s: float) -> None:
        self.address = f"{host}:{port}"
        self._host, self._port, self._timeout_s = host, port, timeout_s
        self._transport: asyncio.Transport | None = None
        self._on_bytes: Callable[[bytes], None] | None = None
        self._on_end: Callable[[PortError], None] | None = None

    @property
    def usable(self) -> bool:
        """Whether bytes can be sent."""
        return self._transport is not None and not self._transport.is_closing()

    async def open(self, on_bytes: Callable[[bytes], None], on_end: Callable[[PortError], None]) -> None:
        """Connect; raises `NotConnectedError` that says why it is not possible."""
        self._on_bytes, self._on_end = on_bytes, on_end
        with why_not_connected(self.address, self._host, self._port, self._timeout_s):
            async with asyncio.timeout(self._timeout_s):
                await asyncio.get_running_loop().create_connection(lambda: self, self._host, self._port)

    def send(self, data: bytes) -> None:
        """Send bytes; what becomes of them shows in the reply, or in the end of the connection."""
        if self._transport is not None:
            self._transport.write(data)

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
        if self._transport is not None and self._on_bytes is not None:
            self._on_bytes(data)

    def connection_lost(self, exc: Exception | None) -> None:
        """Take note of the end (asyncio calls this)."""
        if self._transport is not None and self._on_end is not None:
            why = f": {exc}" if exc is not None else ""
            self._transport = None
            self._on_end(NotConnectedError(Alarm.CONNECTION_LOST, f"{self.address}: the connection was cut{why}."))
