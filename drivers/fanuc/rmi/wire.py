"""Lines over one TCP connection."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.fanuc.rmi.framing import LineBuffer
from drivers.fanuc.tcp_link import TcpLink
from srvs_cell.ports import PortError

if TYPE_CHECKING:
    from collections.abc import Callable


class LineWire:
    """Hands every line to ``on_line`` and the end of the connection, once, to ``on_end``.

    Args:
        host: the controller's address or name.
        port: its TCP port.
        timeout_s: real seconds for the connection.
        on_line: takes a line without its end.
        on_end: takes the reason.
    """

    def __init__(
        self,
        host: str,
        port: int,
        timeout_s: float,
        on_line: Callable[[bytes], None],
        on_end: Callable[[PortError], None],
    ) -> None:
        self._link = TcpLink(host, port, timeout_s)
        self._on_line, self._on_end = on_line, on_end
        self._buffer = LineBuffer()

    @property
    def address(self) -> str:
        """Where it leads, for people."""
        return self._link.address

    @property
    def open(self) -> bool:
        """Whether lines can be sent."""
        return self._link.usable

    async def connect(self) -> None:
        """Open the connection; raises `NotConnectedError` that says why it cannot be opened."""
        await self._link.open(self._take, self._on_end)

    def send(self, packet: bytes) -> None:
        """Send one packet; what becomes of it shows in the reply, or in the end of the connection."""
        self._link.send(packet)

    def close(self) -> None:
        """Close the connection, if there is one; ``on_end`` is not called."""
        self._link.close()

    def _take(self, data: bytes) -> None:
        try:
            lines = self._buffer.feed(data)
        except PortError as error:
            self._on_end(PortError(error.alarm, f"{self.address}: {error.detail}"))
            self.close()
            return
        for line in lines:
            if not self.open:  # an earlier line of this piece ended the connection
                return
            self._on_line(line)
