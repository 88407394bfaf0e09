"""A small Modbus TCP server for controller doubles, with faults on demand.

Written from the Modbus application protocol (V1.1b3) and messaging guide, not from the driver: it shares no code
with what talks to it. Simulated time stands still from the arrival of a request until its answer is sent.
"""

from __future__ import annotations

import struct
from enum import Enum
from typing import TYPE_CHECKING, Final, Protocol

from drivers.sim.one_client import OneClient

if TYPE_CHECKING:
    import socket

    from drivers.sim.controlled_arm import HoldableTime

_HEADER: Final = struct.Struct(">HHHB")
_ILLEGAL_FUNCTION: Final = 1
_ILLEGAL_ADDRESS: Final = 2
_ILLEGAL_VALUE: Final = 3
_DEVICE_FAILURE: Final = 4
_EXCEPTION_FLAG: Final = 0x80
_COIL_ON: Final = 0xFF00
_COIL_OFF: Final = 0
_READ_COILS, _READ_INPUTS, _READ_WORDS = 1, 2, 3
_WRITE_COIL, _WRITE_WORD, _WRITE_COILS, _WRITE_WORDS = 5, 6, 15, 16
_MOST: Final = {
    _READ_COILS: 2000,
    _READ_INPUTS: 2000,
    _READ_WORDS: 125,
    _WRITE_COILS: 1968,
    _WRITE_WORDS: 123,
}
"""How many of each one request may be about."""
_LONGEST: Final = 254
"""Unit and PDU of the longest packet; one that says it is longer is none."""
_NONSENSE: Final = b"HTTP/1.1 400 Bad Request\r\n\r\n"


class ModbusDevice(Protocol):
    """What is behind the wire; addresses are 0-based as on the wire. An IndexError is answered as illegal address."""

    def read_words(self, address: int, count: int) -> list[int]:
        """Return holding registers."""
        ...

    def write_words(self, address: int, values: list[int]) -> None:
        """Set holding registers."""
        ...

    def read_coils(self, address: int, count: int) -> list[bool]:
        """Return coils."""
        ...

    def write_coils(self, address: int, values: list[bool]) -> None:
        """Set coils."""
        ...

    def read_inputs(self, address: int, count: int) -> list[bool]:
        """Return discrete inputs."""
        ...


class WireFault(Enum):
    """What a server does wrong, from now on until it is told otherwise."""

    NONE = "none"
    SILENT = "takes requests, carries them out and does not answer"
    DEAF = "takes requests, ignores them and does not answer"
    LATE = "answers a request only when the next one arrives"
    HALF_PACKET = "sends the first half of an answer and cuts the connection"
    NONSENSE = "answers with what is not Modbus"
    EXCEPTION = "answers every request with exception 4, device failure"
    CUT = "closes the connection instead of answering"
    DUPLICATE = "answers every request twice"


class ModbusServer:
    """Serves one device on loopback; like the controller it takes one connection at a time and refuses a second."""

    def __init__(self, device: ModbusDevice, time: HoldableTime, port: int, unit_id: int) -> None:
        self.fault = WireFault.NONE
        self.requests = 0
        self._device, self._time, self._port, self._unit_id = device, time, port, unit_id
        self._client = OneClient("Modbus double")
        time.hold_while(lambda: self._client.unread)

    def start(self) -> int:
        """Listen; return the bound port."""
        return self._client.listen(self._port, lambda connection: self._client.take(connection, self._serve))

    def close(self) -> None:
        """Close listener and connection and wait for the threads."""
        self._client.close()

    def cut(self) -> None:
        """Close the connection at once, as a pulled cable that is plugged in again would."""
        self._client.cut()

    def _serve(self, connection: socket.socket) -> None:
        late = b""
        while header := self._receive(connection, _HEADER.size):
            transaction, protocol, length, unit = _HEADER.unpack(header)
            if protocol != 0 or not 1 < length <= _LONGEST or not (pdu := self._receive(connection, length - 1)):
                return
            if unit != self._unit_id:  # a wrong unit id meets silence on the real server too
                continue
            with self._time.hold():
                self.requests += 1
                fault = self.fault
                if fault is WireFault.DEAF:
                    continue
                answer = self._answer(pdu, fault)
                packet = _HEADER.pack(transaction, 0, len(answer) + 1, unit) + answer
                if fault is WireFault.SILENT:
                    continue
                if fault is WireFault.CUT:
                    return
                if fault is WireFault.HALF_PACKET:
                    connection.sendall(packet[: len(packet) // 2])
                    return
                if fault is WireFault.LATE:
                    packet, late = late, packet
                if fault is WireFault.DUPLICATE:
                    packet *= 2
                connection.sendall(_NONSENSE if fault is WireFault.NONSENSE else packet)

    def _receive(self, connection: socket.socket, count: int) -> bytes:
        """Return exactly ``count`` bytes, or none where the connection ends before."""
        received = b""
        while len(received) < count:
            piece = self._client.receive(connection, count - len(received))
            if not piece:
                return b""
            received += piece
        return received

    def _answer(self, pdu: bytes, fault: WireFault) -> bytes:
        function = pdu[0]
        if fault is WireFault.EXCEPTION:
            return bytes([function | _EXCEPTION_FLAG, _DEVICE_FAILURE])
        try:
            return bytes([function]) + self._carry_out(function, pdu[1:])
        except _IllegalFunctionError:
            return bytes([function | _EXCEPTION_FLAG, _ILLEGAL_FUNCTION])
        except IndexError:
            return bytes([function | _EXCEPTION_FLAG, _ILLEGAL_ADDRESS])
        except (ValueError, struct.error):
            return bytes([function | _EXCEPTION_FLAG, _ILLEGAL_VALUE])

    def _carry_out(self, function: int, data: bytes) -> bytes:
        """Return the answer's data; raises what `_answer` tells as exception 1, 2 or 3."""
        device = self._device
        if function in {_WRITE_COIL, _WRITE_WORD}:
            address, value = struct.unpack(">HH", data)
            if function == _WRITE_WORD:
                device.write_words(address, [value])
            elif value in {_COIL_ON, _COIL_OFF}:
                device.write_coils(address, [value == _COIL_ON])
            else:
                raise ValueError(value)
            return data
        if function not in _MOST:
            raise _IllegalFunctionError(function)
        address, count = struct.unpack(">HH", data[:4])
        if not 0 < count <= _MOST[function]:
            raise ValueError(count)
        if function in {_WRITE_WORDS, _WRITE_COILS}:
            size = 2 * count if function == _WRITE_WORDS else (count + 7) // 8
            if len(data) != 5 + size or data[4] != size:
                raise ValueError(len(data))
            if function == _WRITE_WORDS:
                device.write_words(address, list(struct.unpack(f">{count}H", data[5:])))
            else:
                device.write_coils(address, [bool(data[5 + i // 8] >> i % 8 & 1) for i in range(count)])
            return data[:4]
        if len(data) != 4:  # noqa: PLR2004 - address, count
            raise ValueError(len(data))
        if function == _READ_WORDS:
            words = device.read_words(address, count)
            return struct.pack(f">B{count}H", 2 * count, *words)
        bits = device.read_coils(address, count) if function == _READ_COILS else device.read_inputs(address, count)
        packed = sum(bit << i for i, bit in enumerate(bits)).to_bytes((count + 7) // 8, "little")
        return bytes([len(packed)]) + packed


class _IllegalFunctionError(Exception):
    """The server does not have this function."""
