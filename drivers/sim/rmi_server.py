"""The two TCP ports of FANUC's Remote Motion Interface for a controller double, with faults on demand.

Written from the operator's manual (B-84184EN/03) and field reports, not from the driver: it shares no code with what
talks to it. Simulated time stands still from the arrival of a packet until its answer is sent.
"""

from __future__ import annotations

import json
import socket
from enum import Enum
from typing import TYPE_CHECKING, Any, Final, Protocol

from drivers.sim.one_client import OneClient
from drivers.sim.rmi_instructions import ALREADY_CONNECTED, BAD_COMMAND, BAD_TEXT

if TYPE_CHECKING:
    from drivers.sim.controlled_arm import HoldableTime

_NONSENSE: Final = b"HTTP/1.1 400 Bad Request\r\n\r\n"
_PIECE: Final = 4096
_CONNECT_S: Final = 30.0
"""Real seconds for a client's first line."""

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
        session_port: where a session is held; the wish for one until it listens.
    """

    def __init__(self, device: RmiDevice, time: HoldableTime, port: int, session_port: int) -> None:
        self.fault = RmiFault.NONE
        self.fault_at: str | None = None
        self.refuses_second = False
        self.redirect = True
        self.received: list[str] = []
        self.session_port = session_port
        self._device, self._time, self._port = device, time, port
        self._fillers: list[socket.socket] = []
        self._client = OneClient("RMI double")
        time.hold_while(lambda: self._client.unread)

    def start(self) -> int:
        """Listen; return the port for ``FRC_Connect``."""
        first = self._client.listen(self._port, self._welcome)
        try:
            self.session_port = self._client.listen(self.session_port, self._take)
        except OSError:  # somebody else's; the reply to FRC_Connect names another one
            self.session_port = self._client.listen(0, self._take)
        return first

    def close(self) -> None:
        """Close everything and wait for the threads."""
        for filler in self._fillers:
            filler.close()
        self._client.close()

    def cut(self) -> None:
        """Close the session's connection at once, as a pulled cable that is plugged in again would."""
        self._client.cut()

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
        with self._client.lock:  # no other packet between two pieces
            for piece in pieces:
                self._client.send(piece)
        if fault in {RmiFault.CUT, RmiFault.HALF_PACKET}:
            self.cut()

    def send_raw(self, data: bytes) -> None:
        """Send any bytes to whoever holds the session."""
        self._client.send(data)

    def _take(self, connection: socket.socket) -> None:
        self._client.take(connection, self._serve)

    def _welcome(self, connection: socket.socket) -> None:
        """Answer ``FRC_Connect`` on the first port, and close it; whoever says nothing keeps nobody else waiting."""
        connection.settimeout(_CONNECT_S)
        self._client.greet(connection, self._greet)

    def _greet(self, connection: socket.socket) -> None:
        line = b""
        while b"\n" not in line and len(line) <= _LONGEST_LINE and (piece := self._client.receive(connection, _PIECE)):
            line += piece
        if self.fault is not RmiFault.DEAF:
            reply = self._reply_to_greeting(_packet(line[: line.find(b"\n") + 1]))
            connection.sendall(json.dumps(reply).encode() + b"\r\n")

    def _reply_to_greeting(self, packet: dict[str, Any] | None) -> dict[str, Any]:
        kind, name = ("", "") if packet is None else next(iter(packet.items()))
        if kind != "Communication":
            return {"Command": "Unknown", "ErrorID": BAD_TEXT}
        if name != "FRC_Connect":  # FRC_Connect_STMO needs an option that is not here
            return {"Communication": name, "ErrorID": BAD_COMMAND}
        held = self._client.connected
        if held and self.refuses_second:
            return {"Communication": "FRC_Connect", "ErrorID": ALREADY_CONNECTED}
        major, minor = self._device.version()
        port = self._dead_port() if held else self.session_port
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

    def _serve(self, connection: socket.socket) -> None:
        rest = b""
        while (piece := self._client.receive(connection, _PIECE)) and len(rest) <= _LONGEST_LINE:
            *lines, rest = (rest + piece).split(b"\n")
            for line in lines:
                with self._time.hold():
                    self._hand_over(line)

    def _hand_over(self, line: bytes) -> None:
        packet = _packet(line)
        name = "?" if packet is None else str(next(iter(packet.values())))
        self.received.append(name)
        if self.fault is RmiFault.DEAF and self.fault_at in {None, name}:
            return
        self._device.take(packet)


def _packet(line: bytes) -> dict[str, Any] | None:
    """Return the packet of a line without its LF; None where it does not end with CR and is no JSON object."""
    if not line.rstrip(b"\n").endswith(b"\r"):
        return None
    try:
        packet = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return packet if isinstance(packet, dict) and packet else None
