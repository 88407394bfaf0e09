"""What systemd wants to hear: READY, STATUS, WATCHDOG, STOPPING (sd_notify(3)), without a library."""

from __future__ import annotations

import os
import socket
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

_MICROSECONDS_PER_SECOND = 1e6


def notify(*assignments: str, environment: Mapping[str, str] = os.environ) -> bool:
    """Send ``assignments`` such as ``"READY=1"`` to the service manager in one datagram.

    Returns:
        Whether it was sent. It is not where no service manager listens (``$NOTIFY_SOCKET`` is not set), nor where it
        does not read what was sent before: the cell does not wait for its supervisor.

    Raises:
        OSError: the socket that the service manager named cannot be reached.
    """
    address = environment.get("NOTIFY_SOCKET")
    if not address:
        return False
    if address.startswith("@"):
        address = "\0" + address[1:]  # Linux's abstract namespace
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as channel:
        channel.setblocking(False)
        channel.connect(address)
        try:
            channel.send("\n".join(assignments).encode())
        except BlockingIOError:
            return False
    return True


def watchdog_period_s(environment: Mapping[str, str] = os.environ) -> float | None:
    """Return WatchdogSec; None where nobody waits for a sign of life."""
    period_us = environment.get("WATCHDOG_USEC")
    if not period_us or environment.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return None
    return int(period_us) / _MICROSECONDS_PER_SECOND


def ask_for_watchdog_period(period_s: float) -> None:
    """Ask the service manager to wait for so long; it holds until the daemon ends."""
    notify(f"WATCHDOG_USEC={round(period_s * _MICROSECONDS_PER_SECOND)}")
