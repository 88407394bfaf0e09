"""How the command line talks to the daemon: HTTP over the unix socket.

httpx2 costs 60 ms of import beside http.client (measured: docs/benchmarks.md), and brings time-outs, event streams
and unix sockets that are tested elsewhere.
"""

from __future__ import annotations

import os
import ssl
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import httpx2

from srvs_cell.alarms import Alarm, AlarmError

if TYPE_CHECKING:
    from collections.abc import Iterator

DEFAULT_SOCKET = Path(os.environ.get("SRVS_CELL_SOCKET", "/run/srvs-cell/api.sock"))
_PREFIX = "http://srvs-cell/api/v1"
_TIMEOUT_S = 10.0
_SILENCE_S = 10.0  # several heartbeats of the event stream


class DaemonClient:
    """One daemon behind one unix socket; a context manager. Every method raises `AlarmError` NO_DAEMON in silence.

    Args:
        path: the daemon's unix socket.
        timeout_s: longest wait for an answer; a command is answered when it is accepted, not when it is done.
    """

    def __init__(self, path: Path, timeout_s: float = _TIMEOUT_S) -> None:
        self._path = path
        # A context without certificates: plain HTTP needs none, and loading the system's takes 60 ms.
        transport = httpx2.HTTPTransport(uds=str(path), verify=ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT))
        self._http = httpx2.Client(transport=transport, timeout=timeout_s, trust_env=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._http.close()

    def read(self, name: str, **query: int) -> dict[str, Any]:
        """Return ``GET /api/v1/<name>``."""
        body: dict[str, Any] = self._request("GET", name, params=query).json()
        return body

    def command(self, name: str, body: dict[str, str] | None = None) -> dict[str, Any]:
        """Return the answer to ``POST /api/v1/<name>``; a refusal is an answer with ``accepted`` false."""
        answer: dict[str, Any] = self._request("POST", name, json=body).json()
        return answer

    def changes(self) -> Iterator[dict[str, Any]]:
        """Yield the status now and after each change."""
        timeout = httpx2.Timeout(_TIMEOUT_S, read=_SILENCE_S)
        try:
            with self._http.sse(f"{_PREFIX}/events", timeout=timeout) as stream:
                for event in stream:
                    if event.event == "status":
                        status: Any = event.json()
                        yield status
        except httpx2.TransportError as error:
            raise self._silence(error) from error

    def _request(self, method: str, name: str, **arguments: Any) -> httpx2.Response:
        try:
            return self._http.request(method, f"{_PREFIX}/{name}", **arguments)
        except httpx2.TransportError as error:
            raise self._silence(error) from error

    def _silence(self, error: Exception) -> AlarmError:
        return AlarmError(Alarm.NO_DAEMON, f"socket {self._path}: {error}.")
