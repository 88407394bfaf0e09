"""The sockets and threads of a controller double, which like a controller serves one TCP client at a time.

What the bytes mean is not known here.
"""

from __future__ import annotations

import contextlib
import select
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
        self._server: threading.Thread | None = None
        self._in_hand: dict[socket.socket, bool] = {}
        self._threads: list[threading.Thread] = []

    def listen(self, port: int, welcome: Callable[[socket.socket], object]) -> int:
        """Hand every connection to ``welcome``, which takes or closes it; return the bound port."""
        listener = socket.create_server(("127.0.0.1", port))
        bound = int(listener.getsockname()[1])
        self._listeners.append(listener)
        self._spawn(listener, lambda: self._accept(listener, welcome))
        return bound

    def take(self, connection: socket.socket, serve: Callable[[socket.socket], None]) -> bool:
        """Let ``serve`` talk to a client until it returns; hang up on it where another one is there.

        Args:
            connection: the client's.
            serve: runs in a thread of its own, reads with `receive`; an OSError is the end of the connection.
        """
        with self.lock:
            free = not self.connected
            if free:
                self._client = connection
                self._server = self.greet(connection, serve)
        if not free:
            connection.close()
        return free

    def greet(self, connection: socket.socket, serve: Callable[[socket.socket], None]) -> threading.Thread:
        """Let ``serve`` talk to somebody who is not the client, beside it; arguments as above."""
        return self._spawn(connection, lambda: serve(connection))

    def receive(self, connection: socket.socket, most: int) -> bytes:
        """Wait for bytes and return them; until the next call they count as `unread`."""
        self._in_hand[connection] = False
        connection.recv(1, socket.MSG_PEEK)  # what has come is unread in the socket until it is in hand
        self._in_hand[connection] = True
        return connection.recv(most)

    @property
    def unread(self) -> bool:
        """Whether something has come, a connection or its end too, that a thread has not yet dealt with."""
        ends = list(self._in_hand)  # without the lock, which is held while a client is slow to take an answer
        return any(has_event(end, select.POLLIN, 0) or self._in_hand.get(end, False) for end in ends)

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
            ends = list(self._in_hand)
        for end in (*listeners, *ends):
            with contextlib.suppress(OSError):  # not connected, or closed by its thread: this only wakes it
                end.shutdown(socket.SHUT_RDWR)
        while self._threads:
            self._threads.pop().join()

    def _spawn(self, end: socket.socket, body: Callable[[], None]) -> threading.Thread:
        """Run what reads from a socket until the socket ends."""

        def run() -> None:
            try:
                with contextlib.suppress(OSError):
                    body()
            finally:
                with self.lock:
                    del self._in_hand[end]
                    if self._client is end:
                        self._client = None
                end.close()

        thread = threading.Thread(target=run, name=self._name, daemon=True)
        with self.lock:
            self._in_hand[end] = False
            if not self._listeners:  # closed meanwhile
                end.shutdown(socket.SHUT_RDWR)
            thread.start()
            # one whose client has gone is none to wait for
            self._threads[:] = [*(one for one in self._threads if one.is_alive()), thread]
        return thread

    def _accept(self, listener: socket.socket, welcome: Callable[[socket.socket], object]) -> None:
        while True:
            self._in_hand[listener] = False
            has_event(listener, select.POLLIN)
            self._in_hand[listener] = True
            connection, _ = listener.accept()  # an OSError where it was shut down
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._see_off()
            welcome(connection)

    def _see_off(self) -> None:
        """Wait until all is dealt with that a client sent which has gone: nobody is served before."""
        with self.lock:
            gone = self._client is None or has_event(self._client, select.POLLRDHUP, 0)
            server = self._server if gone else None
        if server is not None:
            server.join()


def has_event(end: socket.socket, event: int, within_ms: int | None = None) -> bool:
    """Return whether a socket has an event of `select.poll`; one that is closed has none."""
    poll = select.poll()
    with contextlib.suppress(ValueError):  # closed
        poll.register(end, event)
    return bool(poll.poll(within_ms))


def _ended(connection: socket.socket) -> bool:
    try:
        return connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True
