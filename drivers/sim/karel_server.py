"""The two carriers of the KAREL line protocol for a controller double, with faults on demand.

A carrier only carries bytes: what they mean is the business of the robot's program that the double executes. Simulated
time stands still from the arrival of bytes until what they lead to is sent.
"""

from __future__ import annotations

import os
import select
import threading
import tty
from enum import Enum
from typing import TYPE_CHECKING, Final, Protocol

from drivers.sim.one_client import OneClient

if TYPE_CHECKING:
    import socket

    from drivers.sim.controlled_arm import HoldableTime

_PIECE: Final = 4096
_LOOK_S: Final = 0.05
_NONSENSE: Final = b"HTTP/1.1 400 Bad Request\r\n\r\n"
_CHECKSUM_DIGITS: Final = b"0123456789"


class KarelDevice(Protocol):
    """What is behind the wire."""

    def take(self, data: bytes) -> None:
        """Take bytes and carry out what they say."""
        ...

    def connection_changed(self) -> None:
        """Notice that a client has come or gone."""
        ...


class KarelFault(Enum):
    """What the wire does wrong, from now on until it is told otherwise."""

    NONE = "none"
    SILENT = "carries lines to the robot and nothing back"
    DEAF = "carries nothing to the robot"
    CUT = "is cut instead of carrying an answer"
    HALF_LINE = "carries the first half of an answer, and nothing afterwards"
    NONSENSE = "carries something else than the answer"
    WRONG_CHECKSUM = "garbles a digit of the answer's checksum"
    GARBLED = "garbles a character of the answer"
    WRONG_SEQUENCE = "carries an answer, rightly checked, to another command"
    DUPLICATE = "carries the answer twice"
    BYTE_BY_BYTE = "carries every byte alone, which is allowed"
    GARBLED_COMMAND = "garbles a character of the command"


class Carrier(Protocol):
    """A wire."""

    @property
    def connected(self) -> bool:
        """Whether somebody can be on it."""
        ...

    @property
    def unread(self) -> bool:
        """Whether something has come that was not yet dealt with."""
        ...

    def let_in(self) -> bool:
        """Let in a client that waits; return whether somebody can be on it now."""
        ...

    def start(self, device: KarelDevice) -> str:
        """Serve; return what a client connects to: a port number, or the name of a device."""
        ...

    def close(self) -> None:
        """End."""
        ...

    def hang_up(self) -> None:
        """Let go of the client, if the wire can."""
        ...

    def send(self, data: bytes) -> None:
        """Send bytes to the client, if there is one."""
        ...


class KarelWire:
    """A carrier with faults.

    Attributes:
        fault: what goes wrong.
        fault_at: the only command that it goes wrong at (``MOVL``); None is every one.
        count: after how many lines it stops to go wrong; None is never.
        received: the commands of all lines, in order.
        spoken: every piece of the conversation in order: ``>`` to the robot, ``<`` from it.
    """

    def __init__(self, carrier: Carrier, device: KarelDevice, time: HoldableTime) -> None:
        self.fault = KarelFault.NONE
        self.fault_at: str | None = None
        self.count: int | None = None
        self.received: list[str] = []
        self.spoken: list[tuple[str, bytes]] = []
        self._carrier, self._device, self._time = carrier, device, time
        self._command = ""
        time.hold_while(lambda: carrier.unread)

    @property
    def connected(self) -> bool:
        """Whether somebody can be on the wire."""
        return self._carrier.connected

    def let_in(self) -> bool:
        """Let in a client that waits; return whether somebody can be on the wire now."""
        return self._carrier.let_in()

    def start(self) -> str:
        """Serve; return what a client connects to."""
        return self._carrier.start(self)

    def close(self) -> None:
        """End."""
        self._carrier.close()

    def hang_up(self) -> None:
        """Let go of the client."""
        self._carrier.hang_up()

    def cut(self) -> None:
        """Cut the wire, as a pulled cable that is plugged in again would."""
        self._carrier.hang_up()

    def connection_changed(self) -> None:
        """Notice that a client has come or gone."""
        with self._time.hold():
            self._device.connection_changed()

    def take(self, data: bytes) -> None:
        """Carry bytes to the robot, line by line."""
        with self._time.hold():
            for line in data.splitlines(keepends=True):
                self.spoken.append((">", line))
                if line.startswith(b">") and line.count(b","):
                    self._command = line.split(b"*")[0].split(b",")[1].decode("ascii", "replace")
                    self.received.append(self._command)
                fault = self._fault_now({KarelFault.DEAF, KarelFault.GARBLED_COMMAND})
                if fault is KarelFault.GARBLED_COMMAND:
                    self._device.take(line.replace(b",", b"?", 1))
                elif fault is not KarelFault.DEAF:
                    self._device.take(line)

    def send(self, data: bytes) -> None:
        """Carry an answer, or what a fault makes of it."""
        fault = self._fault_now(set(KarelFault) - {KarelFault.DEAF, KarelFault.GARBLED_COMMAND})
        pieces = {
            KarelFault.SILENT: [],
            KarelFault.CUT: [],
            KarelFault.HALF_LINE: [data[: len(data) // 2]],
            KarelFault.NONSENSE: [_NONSENSE],
            KarelFault.WRONG_CHECKSUM: [_garble(data, len(data) - 3)],
            KarelFault.GARBLED: [_garble(data, data.index(b",") - 1)],
            KarelFault.WRONG_SEQUENCE: [_renumber(data)],
            KarelFault.DUPLICATE: [data, data],
            KarelFault.BYTE_BY_BYTE: [bytes([byte]) for byte in data],
        }.get(fault, [data])
        for piece in pieces:
            self.spoken.append(("<", piece))
            self._carrier.send(piece)
        if fault is KarelFault.CUT:
            self.cut()
        if fault is KarelFault.HALF_LINE:
            self.fault, self.fault_at, self.count = KarelFault.SILENT, None, None

    def send_raw(self, data: bytes) -> None:
        """Send any bytes to the client."""
        self._carrier.send(data)

    def _fault_now(self, kinds: set[KarelFault]) -> KarelFault:
        if self.fault not in kinds or self.fault_at not in {None, self._command}:
            return KarelFault.NONE
        fault = self.fault
        if self.count is not None:
            self.count -= 1
            if self.count <= 0:
                self.fault, self.count = KarelFault.NONE, None
        return fault


def _garble(data: bytes, at: int) -> bytes:
    """Change one digit."""
    changed = _CHECKSUM_DIGITS[(data[at] - _CHECKSUM_DIGITS[0] + 1) % len(_CHECKSUM_DIGITS)]
    return data[:at] + bytes([changed]) + data[at + 1 :]


def _renumber(data: bytes) -> bytes:
    """Give an answer another sequence number and the checksum that goes with it."""
    sequence, _, rest = data[1:].partition(b",")
    body = b"<%d,%b" % (int(sequence) % 30000 + 500, rest.rpartition(b"*")[0])
    low = high = 0
    for byte in body:
        low = (low + byte) % 255
        high = (high + low) % 255
    return b"%b*%d\r\n" % (body, high * 256 + low)


class TcpCarrier:
    """A server tag of User Socket Messaging on loopback: one client at a time is let in by MSG_CONNECT.

    Attributes:
        refuses_second: whether another client is let go at once; otherwise it waits, unanswered. Which of both a
            controller does is not known.
    """

    def __init__(self, port: int = 0) -> None:
        self.refuses_second = True
        self._port = port
        self._device: KarelDevice | None = None
        self._client = OneClient("KAREL double")
        self._waiting: socket.socket | None = None

    @property
    def connected(self) -> bool:
        """Whether a client is there."""
        return self._client.connected

    @property
    def unread(self) -> bool:
        """Whether something has come that was not yet dealt with."""
        return self._client.unread

    def let_in(self) -> bool:
        """Take the client that waits."""
        with self._client.lock:
            waiting, self._waiting = self._waiting, None
        return waiting is not None and self._client.take(waiting, self._serve)

    def start(self, device: KarelDevice) -> str:
        """Listen; return the port."""
        self._device = device
        return str(self._client.listen(self._port, self._welcome))

    def close(self) -> None:
        """Close everything and wait for the threads."""
        self._client.close()
        if self._waiting is not None:
            self._waiting.close()

    def hang_up(self) -> None:
        """Close the connection of the client that is in."""
        self._client.cut()

    def send(self, data: bytes) -> None:
        """Send bytes to the client."""
        self._client.send(data)

    def _welcome(self, connection: socket.socket) -> None:
        with self._client.lock:
            held = self._waiting is not None or (self.refuses_second and self.connected)
            if not held:
                self._waiting = connection
        if held:
            connection.close()
        elif self._device is not None:
            self._device.connection_changed()

    def _serve(self, connection: socket.socket) -> None:
        device = self._device
        if device is None:
            return
        try:
            while data := self._client.receive(connection, _PIECE):
                device.take(data)
        finally:
            device.connection_changed()


class PtyCarrier:
    """A serial line on a pseudo-terminal: nobody can tell whether something is at its other end."""

    connected = True

    def __init__(self) -> None:
        self._master = self._slave = -1
        self._thread: threading.Thread | None = None
        self._closing = threading.Event()
        self._in_hand = False

    @property
    def unread(self) -> bool:
        """Whether something has come that was not yet dealt with."""
        return self._thread is not None and (self._has_bytes(0.0) or self._in_hand)

    def let_in(self) -> bool:
        """Do nothing: there is no door."""
        return True

    def start(self, device: KarelDevice) -> str:
        """Open it; return the device that a client opens."""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self._thread = threading.Thread(target=self._serve, args=(device,), name="KAREL double", daemon=True)
        self._thread.start()
        return os.ttyname(self._slave)

    def close(self) -> None:
        """Close it and wait for the thread."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join()
            os.close(self._slave)
            os.close(self._master)
            self._thread = None

    def hang_up(self) -> None:
        """Do nothing: a serial line has nothing to hang up."""

    def send(self, data: bytes) -> None:
        """Send bytes down the line."""
        os.write(self._master, data)

    def _serve(self, device: KarelDevice) -> None:
        while not self._closing.is_set():
            self._in_hand = False
            if self._has_bytes(_LOOK_S):
                self._in_hand = True
                device.take(os.read(self._master, _PIECE))

    def _has_bytes(self, within_s: float) -> bool:
        return bool(select.select([self._master], [], [], within_s)[0])
