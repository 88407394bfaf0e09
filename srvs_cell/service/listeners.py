"""The two doors of the service: a unix socket that may command, and a loopback port that may only read.

Who may do what is decided here, when the listeners are made, and travels with the request in the ASGI scope; no
header can change it. A request that came through no door of this file may read only.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import os
import pwd
import socket
import struct
from typing import TYPE_CHECKING, Any, cast

import uvicorn
from starlette.datastructures import Headers
from starlette.responses import JSONResponse
from uvicorn.protocols.http.h11_impl import H11Protocol

from srvs_cell.alarms import Alarm, AlarmError

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, Generator
    from pathlib import Path

    from starlette.types import ASGIApp, Receive, Scope, Send

MAY_COMMAND = "srvs_cell.may_command"
"""Key of the ASGI scope: true for requests that came through the unix socket."""

_ALLOW_OWNER_AND_GROUP = 0o117
_DIRECTORY_MODE = 0o750
_LOCK_MODE = 0o640
_WRITABLE_BY_OTHERS = 0o002
_MISDIRECTED_REQUEST = 421
_GRACE_S = 2
_BACKLOG = 64


@contextlib.contextmanager
def lock(path: Path, what: str) -> Generator[None]:
    """Hold the lock file ``path``; the kernel lets go of it however the process ends.

    Args:
        path: the lock file; it stays, being locked or not is what counts.
        what: what the lock stands for, for people.

    Raises:
        AlarmError: ALREADY_RUNNING where another process holds it, FILE_INVALID where it cannot be opened.
    """
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, _LOCK_MODE)
    except OSError as error:
        raise AlarmError(Alarm.FILE_INVALID, f"{path}: {error.strerror}.") from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise AlarmError(Alarm.ALREADY_RUNNING, f"{what} is in use by another process ({path}).") from error
        yield
    finally:
        os.close(descriptor)


def make_directory(path: Path) -> None:
    """Make ``path`` with mode 0750 where it is missing; raises `AlarmError` FILE_INVALID where that cannot be."""
    try:
        path.mkdir(mode=_DIRECTORY_MODE, parents=True, exist_ok=True)
    except OSError as error:
        raise AlarmError(Alarm.FILE_INVALID, f"{path}: {error.strerror}.") from error


@contextlib.contextmanager
def unix_listener(path: Path) -> Generator[socket.socket]:
    """Yield a socket listening on ``path`` with mode 0660, and remove it afterwards.

    The mode is right from the first instant: it comes from the umask during bind, not from a chmod after it. The lock
    file beside the socket tells a running daemon from the socket that a killed one left behind.

    Raises:
        AlarmError: ALREADY_RUNNING where another daemon serves the socket; CONFIG_INVALID where no socket can be there.
    """
    make_directory(path.parent)
    if path.parent.stat().st_mode & _WRITABLE_BY_OTHERS:
        raise AlarmError(Alarm.CONFIG_INVALID, f"socket {path}: everybody may write to its directory {path.parent}.")
    with lock(path.with_name(path.name + ".lock"), f"The socket {path}"), _listening(path) as listener:
        try:
            yield listener
        finally:
            path.unlink(missing_ok=True)


def _listening(path: Path) -> socket.socket:
    """Return a listening socket, moved to ``path`` when it listens: who finds it there can connect."""
    if path.exists() and not path.is_socket():
        raise AlarmError(Alarm.CONFIG_INVALID, f"socket {path}: something that is not a socket is there.")
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    unready = path.with_name(path.name + ".new")
    previous = os.umask(_ALLOW_OWNER_AND_GROUP)
    try:
        unready.unlink(missing_ok=True)
        listener.bind(str(unready))
        listener.listen(_BACKLOG)
        unready.replace(path)  # takes the place of the socket that a killed daemon left
    except OSError as error:
        listener.close()
        raise AlarmError(Alarm.CONFIG_INVALID, f"socket {path}: {error}.") from error
    finally:
        os.umask(previous)
    return listener


def tcp_listener(host: str, port: int) -> socket.socket:
    """Return a socket listening on ``host:port`` (0: any free port); raises `AlarmError` CONFIG_INVALID."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(_BACKLOG)
    except OSError as error:
        listener.close()
        cause = "another program listens there" if error.errno == errno.EADDRINUSE else str(error.strerror)
        raise AlarmError(Alarm.CONFIG_INVALID, f"http port {host}:{port}: {cause}.") from error
    return listener


def commanding(app: ASGIApp) -> ASGIApp:
    """Return ``app`` behind the door whose callers may command."""

    async def door(scope: Scope, receive: Receive, send: Send) -> None:
        scope[MAY_COMMAND] = True
        await app(scope, receive, send)

    return door


def reading(app: ASGIApp, host: str) -> ASGIApp:
    """Return ``app`` behind the door whose callers may only read.

    The Host header must name the loopback: a page of another site whose name was made to point here is refused
    (DNS rebinding).
    """
    allowed = {host, "localhost", "127.0.0.1", "[::1]"}

    async def door(scope: Scope, receive: Receive, send: Send) -> None:
        scope[MAY_COMMAND] = False
        named = Headers(scope=scope).get("host", "")
        if named.rpartition(":")[0] not in allowed and named not in allowed:
            detail = f"The Host header {named!r} is none of {', '.join(sorted(allowed))}."
            refusal = JSONResponse({"reason": detail}, status_code=_MISDIRECTED_REQUEST)
            await refusal(scope, receive, send)
            return
        await app(scope, receive, send)

    return door


class _PeerNamingProtocol(H11Protocol):
    """Fills the ASGI scope's client with (user, process id) of the peer, as the kernel knows it."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as in H11Protocol
        super().connection_made(transport)
        credentials = cast("socket.socket", transport.get_extra_info("socket")).getsockopt(
            socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i")
        )
        process_id, user_id, _ = struct.unpack("3i", credentials)
        self.client = (_user_name(user_id), process_id)


def _user_name(user_id: int) -> str:
    try:
        return pwd.getpwuid(user_id).pw_name
    except KeyError:
        return str(user_id)


class _Server(uvicorn.Server):
    """An HTTP server that leaves the process's signals to the composition root."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None]:
        """Capture none."""
        yield


@contextlib.asynccontextmanager
async def serving(
    app: ASGIApp, unix: socket.socket, tcp: socket.socket | None
) -> AsyncGenerator[tuple[asyncio.Task[None], ...]]:
    """Serve ``app`` behind its doors; yields the servers' tasks, which end only when something is wrong.

    Args:
        app: the API.
        unix: listening socket whose callers may command.
        tcp: listening loopback socket whose callers may read, or None.
    """
    servers = [(_Server(_server_config(commanding(app), _PeerNamingProtocol)), unix)]
    if tcp is not None:
        servers.append((_Server(_server_config(reading(app, tcp.getsockname()[0]), "h11")), tcp))
    tasks = tuple(asyncio.create_task(server.serve(sockets=[listener])) for server, listener in servers)
    try:
        yield tasks
    finally:
        for server, _ in servers:
            server.should_exit = True
        await asyncio.gather(*tasks)


def _server_config(app: ASGIApp, http: Any) -> uvicorn.Config:
    return uvicorn.Config(
        app,
        http=http,
        ws="none",
        lifespan="off",
        log_config=None,
        access_log=False,
        proxy_headers=False,
        server_header=False,
        timeout_graceful_shutdown=_GRACE_S,
    )
