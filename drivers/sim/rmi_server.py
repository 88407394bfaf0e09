"""The two TCP ports of FANUC's Remote Motion Interface for a controller double, with faults on demand.

Written from the operator's manual (B-84184EN/03) and field reports, not from the driver: it shares no code with what
talks to it. Simulated time stands still from the arrival of a packet until its answer is sent.
"""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from enum import Enum
from typing import TYPE_CHECKING, Any, Final, Protocol

if TYPE_CHECKING:
    from drivers.sim.modbus_server import HoldableTime

_ALREADY_CONNECTED: Final = 2556954
_NONSENSE: Final = b"HTTP/1.1 400 Bad Request\r\n\r\n"
_PIECE: Final = 4096
_LONGEST_LINE: Final = 8192
"""Longer than any packet of the manual; who sends more without an end is hung up on."""


class RmiDevice(Protocol):
    """What is behind the wire."""

    def version(self) -> tuple[int, int]:
        """Return major and minor version of the interface."""
        ...

    def take(self, packet: dict[str, Any] | None) -> None:
        """Carry out a packet and send what there is to answer; None is one that is no JSON object."""
        ...


class RmiFault(Enum):
    """What the server does wrong with its answers, from now on until it is told otherwise."""

    NONE = "none"
    SILENT = "takes packets, carries them out and does not answer"
    DEAF = "takes packets, ignores them and does not answer"
    CUT = "closes the connection instead of answering"
    HALF_PACKET = "sends the first half of an answer and cuts the connection"
    NONSENSE = "answers with what is not RMI"
    DUPLICATE = "answers twice"
    WRONG_SEQUENCE = "answers an instruction with the number of another one"
    WRONG_NAME = "answers with the name of something else"
    NO_ERROR_ID = "answers without ErrorID"
    BYTE_BY_BYTE = "sends every byte alone, which is allowed"


class RmiServer:
    """Serves one device on loopback; takes one session at a time.

    Attributes:
        fault: what goes wrong.
        fault_at: the only name that it goes wrong at; None is every one.
        refuses_second: whether a second client is told that it is second, as the manual has it; otherwise it is sent
            to a port that does not answer, as a controller was seen to do.
        redirect: whether the reply to ``FRC_Connect`` names the session's port.
        received: names of all packets, in order.
    """

    def __init__(self, device: RmiDevice, time: HoldableTime, port: int, session_port: int) -> None:
        self.fault = RmiFault.NONE
        self.fault_at: str | None = None
        self.refuses_second = False
        self.redirect = True
        self.received: list[str] = []
        self._device, self._time, self._port, self._session_port = device, time, port, session_port
        self._listeners: list[socket.socket] = []
        self._fillers: list[socket.socket] = []
        self._connection: socket.socket | None = None
        self._threads: list[threading.Thread] = []
        self._lock = threading.RLock()

    def start(self) -> int:
        """Listen; return the port for ``FRC_Connect``."""
        first = socket.create_server(("127.0.0.1", self._port))
        session = socket.create_server(("127.0.0.1", self._session_port))
        self._port, self._session_port = first.getsockname()[1], session.getsockname()[1]
        self._listeners = [first, session]
        self._spawn(self._welcome, first)
        self._spawn(self._accept, session)
        return int(self._port)

    def close(self) -> None:
        """Close everything and wait for the threads."""
        with self._lock:
            listeners, self._listeners = self._listeners, []
        for listener in listeners:
            with contextlib.suppress(OSError):  # not connected: shutdown only wakes the accept
                listener.shutdown(socket.SHUT_RDWR)
            listener.close()
        for filler in self._fillers:
            filler.close()
        self.cut()
        for thread in self._threads:
            thread.join()
        self._threads.clear()

    @property
    def in_session(self) -> bool:
        """Whether a client has the session; all that it had sent is read when this turns false."""
        with self._lock:
            return self._connection is not None

    def cut(self) -> None:
        """Close the session's connection at once, as a pulled cable that is plugged in again would."""
        with self._lock:
            connection, self._connection = self._connection, None
        if connection is not None:
            with contextlib.suppress(OSError):  # the client may have closed it already
                connection.shutdown(socket.SHUT_RDWR)

    def send(self, packet: dict[str, Any]) -> None:
        """Send a packet to whoever holds the session; to nobody where there is none."""
        name = str(next(iter(packet.values())))
        fault = self.fault if self.fault_at in {None, name} else RmiFault.NONE
        if fault is RmiFault.WRONG_SEQUENCE and "SequenceID" in packet:
            packet = {**packet, "SequenceID": packet["SequenceID"] + 1}
        elif fault is RmiFault.WRONG_NAME:
            packet = {**packet, next(iter(packet)): "FRC_ReadTCPSpeed"}
        elif fault is RmiFault.NO_ERROR_ID:
            packet = {key: value for key, value in packet.items() if key != "ErrorID"}
        line = json.dumps(packet).encode() + b"\r\n"
        pieces = {
            RmiFault.SILENT: [],
            RmiFault.DEAF: [],
            RmiFault.CUT: [],
            RmiFault.HALF_PACKET: [line[: len(line) // 2]],
            RmiFault.NONSENSE: [_NONSENSE],
            RmiFault.DUPLICATE: [line, line],
            RmiFault.BYTE_BY_BYTE: [bytes([byte]) for byte in line],
        }.get(fault, [line])
        with self._lock, contextlib.suppress(OSError):  # a client that has gone hears nothing
            if self._connection is not None:
                for piece in pieces:
                    self._connection.sendall(piece)
        if fault in {RmiFault.CUT, RmiFault.HALF_PACKET}:
            self.cut()

    def send_raw(self, data: bytes) -> None:
        """Send any bytes to whoever holds the session."""
        with self._lock, contextlib.suppress(OSError):  # a client that has gone hears nothing
            if self._connection is not None:
                self._connection.sendall(data)

    def _spawn(self, target: object, argument: socket.socket) -> None:
        thread = threading.Thread(target=target, args=(argument,), name="RMI double", daemon=True)  # type: ignore[arg-type]
        self._threads.append(thread)
        thread.start()

    def _welcome(self, listener: socket.socket) -> None:
        """Answer ``FRC_Connect`` on the first port, and close it."""
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:  # the listener was closed
                return
            with connection, contextlib.suppress(OSError, ValueError, RecursionError):  # whoever sends no line
                line = connection.makefile("rb").readline(_LONGEST_LINE)
                packet = json.loads(line)
                asked = isinstance(packet, dict) and next(iter(packet.items()), None)
                if asked == ("Communication", "FRC_Connect") and self.fault is not RmiFault.DEAF:
                    connection.sendall(json.dumps(self._reply_to_connect()).encode() + b"\r\n")

    def _reply_to_connect(self) -> dict[str, Any]:
        with self._lock:
            held = self._connection is not None and not _ended(self._connection)
        if held and self.refuses_second:
            return {"Communication": "FRC_Connect", "ErrorID": _ALREADY_CONNECTED}
        major, minor = self._device.version()
        port = self._dead_port() if held else self._session_port
        redirect = {"PortNumber": port} if self.redirect else {}
        return {
            "Communication": "FRC_Connect",
            "ErrorID": 0,
            **redirect,
            "MajorVersion": major,
            "MinorVersion": minor,
        }

    def _dead_port(self) -> int:
        """Return a port whose queue of connections is full, so that a new one is neither taken nor refused."""
        full = socket.socket()
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        filler = socket.create_connection(full.getsockname())
        self._fillers += [filler, full]
        return int(full.getsockname()[1])

    def _accept(self, listener: socket.socket) -> None:
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:  # the listener was closed
                return
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with self._lock:
                taken = not self._listeners or (self._connection is not None and not _ended(self._connection))
                if not taken:
                    self._connection = connection
            if taken:
                connection.close()
            else:
                self._spawn(self._serve, connection)

    def _serve(self, connection: socket.socket) -> None:
        rest = b""
        with connection, contextlib.suppress(OSError):  # a connection that is cut ends its thread
            while (piece := connection.recv(_PIECE)) and len(rest) <= _LONGEST_LINE:
                *lines, rest = (rest + piece).split(b"\r\n")
                for line in lines:
                    with self._time.hold():
                        self._hand_over(line)
        with self._lock:
            if self._connection is connection:
                self._connection = None

    def _hand_over(self, line: bytes) -> None:
        try:
            packet = json.loads(line)
        except (ValueError, RecursionError):
            packet = None
        if not isinstance(packet, dict) or not packet:
            packet = None
        name = "?" if packet is None else str(next(iter(packet.values())))
        self.received.append(name)
        if self.fault is RmiFault.DEAF and self.fault_at in {None, name}:
            return
        self._device.take(packet)


def _ended(connection: socket.socket) -> bool:
    """Return whether the client has closed a connection, though its thread may not have noticed yet."""
    try:
        return connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True
