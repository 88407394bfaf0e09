"""The sockets and threads of a controller double, which like a controller serves one TCP client at a time.

What the bytes mean is not known here.
"""

from __future__ import annotations

import contextlib
import socket
import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


class OneClient:
    """Ports on loopback, and at most one client.

    Args:
        name: of its threads, for people.

    Attributes:
        lock: held while the client changes and while bytes are sent to it.
    """

    def __init__(self, name: str) -> None:
        self.lock = threading.RLock()
        self._name = name
        self._listeners: list[socket.socket] = []
        self._client: socket.socket | None = None
        self._threads: list[threading.Thread] = []

    def listen(self, port: int, welcome: Callable[[socket.socket], object]) -> int:
        """Hand every connection to ``welcome``, which takes or closes it; return the bound port."""
        listener = socket.create_server(("127.0.0.1", port))
        self._listeners.append(listener)
        self._spawn(lambda: self._accept(listener, welcome))
        return int(listener.getsockname()[1])

    def take(self, connection: socket.socket, serve: Callable[[socket.socket], None]) -> bool:
        """Let ``serve`` talk to a client until it returns; hang up on it where another one is there.

        Args:
            connection: the client's.
            serve: runs in a thread of its own; an OSError is the end of the connection.
        """
        with self.lock:
            free = bool(self._listeners) and not self.connected
            if free:
                self._client = connection
        if free:
            self._spawn(lambda: self._serve(connection, serve))
        else:
            connection.close()
        return free

    @property
    def serving(self) -> bool:
        """Whether a client is served; all that it had sent has been read when this turns false."""
        with self.lock:
            return self._client is not None

    @property
    def connected(self) -> bool:
        """Whether a client is there: not one that has closed, though its thread may not have noticed yet."""
        with self.lock:
            return self._client is not None and not _ended(self._client)

    def send(self, data: bytes) -> None:
        """Send bytes to the client; one that has gone hears nothing."""
        with self.lock, contextlib.suppress(OSError):
            if self._client is not None:
                self._client.sendall(data)

    def cut(self) -> None:
        """Close the connection at once, as a pulled cable that is plugged in again would."""
        with self.lock:
            client, self._client = self._client, None
        if client is not None:
            with contextlib.suppress(OSError):  # the client may have closed it already
                client.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close everything and wait for the threads."""
        with self.lock:
            listeners, self._listeners = self._listeners, []
        for listener in listeners:
            with contextlib.suppress(OSError):  # not connected: shutdown only wakes the accept
                listener.shutdown(socket.SHUT_RDWR)
            listener.close()
        self.cut()
        for thread in self._threads:
            thread.join()
        self._threads.clear()

    def _spawn(self, body: Callable[[], None]) -> None:
        thread = threading.Thread(target=body, name=self._name, daemon=True)
        self._threads.append(thread)
        thread.start()

    @staticmethod
    def _accept(listener: socket.socket, welcome: Callable[[socket.socket], object]) -> None:
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:  # the listener was closed
                return
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            welcome(connection)

    def _serve(self, connection: socket.socket, serve: Callable[[socket.socket], None]) -> None:
        with connection, contextlib.suppress(OSError):  # a connection that is cut ends its thread
            serve(connection)
        with self.lock:
            if self._client is connection:
                self._client = None


def _ended(connection: socket.socket) -> bool:
    try:
        return connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True
