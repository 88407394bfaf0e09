"""How the command line talks to the daemon: HTTP over the unix socket.

Without a library: the standard one's client imports TLS and e-mail, a quarter of what ``srvs-cell status`` takes, and
the daemon on the other end is our own.
"""

from __future__ import annotations

import json
import os
import socket
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Self

from srvs_cell.alarms import Alarm, AlarmError

if TYPE_CHECKING:
    from collections.abc import Iterator

DEFAULT_SOCKET = Path(os.environ.get("SRVS_CELL_SOCKET", "/run/srvs-cell/api.sock"))
_PREFIX = "/api/v1"
_TIMEOUT_S = 10.0  # several heartbeats of the event stream
_DATA = b"data: "


class DaemonClient:
    """One daemon behind one unix socket; a context manager. Every method raises `AlarmError` NO_DAEMON in silence.

    Args:
        path: the daemon's unix socket.
        timeout_s: longest wait for an answer; a command is answered when it is accepted, not when it is done.
    """

    def __init__(self, path: Path, timeout_s: float = _TIMEOUT_S) -> None:
        self._path = path
        self._timeout_s = timeout_s
        self._streams = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._streams.close()

    def read(self, name: str) -> dict[str, Any]:
        """Return ``GET /api/v1/<name>``."""
        return self._ask("GET", name, None)

    def command(self, name: str, body: dict[str, str] | None = None) -> dict[str, Any]:
        """Return the answer to ``POST /api/v1/<name>``; a refusal is an answer with ``accepted`` false."""
        return self._ask("POST", name, body)

    def changes(self) -> Iterator[dict[str, Any]]:
        """Yield the status now and after each change; the daemon's end is silence."""
        event = ""
        try:
            for line in self._streams.enter_context(self._answer("GET", "events", b"")):
                if line.startswith(b"event: "):
                    event = line.split()[1].decode()
                elif line.startswith(_DATA) and event == "status":
                    yield json.loads(line.removeprefix(_DATA))
            raise ConnectionError("the daemon has ended the stream")
        except OSError as error:
            raise self._silence(error) from error

    def _ask(self, method: str, name: str, body: dict[str, str] | None) -> dict[str, Any]:
        content = b"" if body is None else json.dumps(body).encode()
        try:
            with self._answer(method, name, content) as lines:
                answer: dict[str, Any] = json.loads(lines.read())
        except (OSError, ValueError) as error:
            raise self._silence(error) from error
        return answer

    @contextmanager
    def _answer(self, method: str, name: str, content: bytes) -> Iterator[BinaryIO]:
        """Send a request and give the body of the answer; raises `OSError` where none comes.

        HTTP/1.0: the answer is not in chunks and ends with the connection.
        """
        head = (
            f"{method} {_PREFIX}/{name} HTTP/1.0\r\nHost: srvs-cell\r\n"
            f"Content-Type: application/json\r\nContent-Length: {len(content)}\r\n\r\n"
        )
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as channel:
            channel.settimeout(self._timeout_s)
            channel.connect(str(self._path))
            channel.sendall(head.encode() + content)
            with channel.makefile("rb") as lines:
                if not lines.readline().startswith(b"HTTP/1."):
                    raise ConnectionError("no answer in HTTP")
                while lines.readline().strip():
                    pass  # a header; that the body is JSON or a stream of events is the daemon's contract
                yield lines

    def _silence(self, error: Exception) -> AlarmError:
        return AlarmError(Alarm.NO_DAEMON, f"socket {self._path}: {str(error) or type(error).__name__}.")
