"""Why a controller cannot be reached, for every wire in the same words."""

from __future__ import annotations

import contextlib
import errno
import socket
from typing import TYPE_CHECKING, Final

from srvs_cell.alarms import Alarm
from srvs_cell.ports import NotConnectedError

if TYPE_CHECKING:
    from collections.abc import Iterator

_NO_ROUTE: Final = frozenset({errno.EHOSTUNREACH, errno.ENETUNREACH, errno.EHOSTDOWN, errno.ENETDOWN})


@contextlib.contextmanager
def why_not_connected(address: str, host: str, port: int, timeout_s: float) -> Iterator[None]:
    """Turn what the socket says inside this context into a `NotConnectedError` that says why.

    Args:
        address: of the controller, for people.
        host: name or address that is connected to.
        port: its TCP port.
        timeout_s: how long was waited.
    """
    try:
        yield
    except TimeoutError as error:
        raise NotConnectedError(
            Alarm.CONNECTION_TIMEOUT, f"{address}: no answer to the connection within {timeout_s} s."
        ) from error
    except ConnectionRefusedError as error:
        raise NotConnectedError(
            Alarm.CONNECTION_REFUSED, f"{address}: connection refused, nothing listens on port {port}."
        ) from error
    except socket.gaierror as error:
        raise NotConnectedError(
            Alarm.DEVICE_UNAVAILABLE, f"{address}: the name {host!r} cannot be resolved ({error})."
        ) from error
    except OSError as error:
        reason = "no route to this address" if error.errno in _NO_ROUTE else "the connection failed"
        raise NotConnectedError(
            Alarm.DEVICE_UNAVAILABLE, f"{address}: {reason} ({error.strerror or error})."
        ) from error
