"""Lines out of a byte stream: packets may come in pieces, or several at once. Pure."""

from __future__ import annotations

from typing import Final

from srvs_cell.alarms import Alarm
from srvs_cell.ports import PortError

END: Final = b"\r\n"
LINE_LIMIT: Final = 8192
"""Longer than any packet of the manual; what is longer is no RMI."""


class LineBuffer:
    """Collects bytes until a line is whole. Ends are CR LF; a bare LF is taken for one too."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines that ``data`` completes, without their ends; empty lines are dropped.

        Raises:
            PortError: PROTOCOL_ERROR where `LINE_LIMIT` bytes have no end.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
        if max(map(len, (*lines, self._rest))) > LINE_LIMIT:
            raise PortError(Alarm.PROTOCOL_ERROR, f"More than {LINE_LIMIT} bytes without a line end: this is not RMI.")
        return [line for line in (whole.removesuffix(b"\r") for whole in lines) if line]
