"""One Modbus TCP connection to the controller, with every failure named.

Time-outs here are real time: they bound the wire, not the work of the robot.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException

from drivers.fanuc.connection import why_not_connected
from srvs_cell.alarms import Alarm
from srvs_cell.ports import NotConnectedError, PortError

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from pymodbus.pdu import ModbusPDU


_READ_OUTPUTS, _READ_INPUTS, _READ_WORDS, _WRITE_OUTPUT, _WRITE_WORDS = 1, 2, 3, 5, 16
"""Function codes."""


class ModbusWire:
    """Reads and writes words, inputs and outputs; numbers are 1-based as on the pendant.

    Never re-sends: a request that gets no answer in time is reported, and what became of it is the caller's to judge.
    """

    def __init__(self, host: str, port: int, unit_id: int, timeout_s: float) -> None:
        self.address = f"{host}:{port} unit {unit_id}"
        self._host, self._port, self._unit_id, self._timeout_s = host, port, unit_id, timeout_s
        self._client: AsyncModbusTcpClient | None = None
        self._outstanding = 0
        self._turn = asyncio.Lock()

    @property
    def busy(self) -> bool:
        """Whether an answer is being waited for."""
        return self._outstanding > 0

    async def connect(self) -> None:
        """Open the connection; raises `NotConnectedError` that says why it cannot be opened."""
        client = AsyncModbusTcpClient(
            self._host,
            port=self._port,
            timeout=self._timeout_s,
            retries=0,
            reconnect_delay=0,
            trace_connect=self._note_connection,
        )
        with why_not_connected(self.address, self._host, self._port, self._timeout_s):
            # pymodbus's own connect() turns every reason into False; this is the call that it makes inside.
            await asyncio.wait_for(client.ctx.call_create(), self._timeout_s)
        self._client = client

    def close(self) -> None:
        """Close the connection, if there is one."""
        if self._client is not None:
            self._client.close()
            self._end_waiting()
            self._client = None

    async def read_words(self, word: int, count: int) -> list[int]:
        """Read ``count`` words from %R``word`` on (FC03)."""
        reply = await self._transact(
            _READ_WORDS,
            f"reading {count} words from %R{word}",
            lambda client: client.read_holding_registers(word - 1, count=count, device_id=self._unit_id),
        )
        if len(reply.registers) != count:
            raise PortError(
                Alarm.PROTOCOL_ERROR, f"{self.address}: asked for {count} words, got {len(reply.registers)}."
            )
        return list(reply.registers)

    async def write_words(self, word: int, values: list[int]) -> None:
        """Write words from %R``word`` on (FC16)."""
        what = f"writing {len(values)} words to %R{word}"
        reply = await self._transact(
            _WRITE_WORDS,
            what,
            lambda client: client.write_registers(word - 1, values, device_id=self._unit_id),
        )
        if (reply.address, reply.count) != (word - 1, len(values)):
            raise self._another(what)

    async def read_input(self, number: int) -> bool:
        """Read DI[number] (FC02)."""
        reply = await self._transact(
            _READ_INPUTS,
            f"reading DI[{number}]",
            lambda client: client.read_discrete_inputs(number - 1, count=1, device_id=self._unit_id),
        )
        return self._first_bit(reply)

    async def read_output(self, number: int) -> bool:
        """Read DO[number] back (FC01)."""
        reply = await self._transact(
            _READ_OUTPUTS,
            f"reading DO[{number}]",
            lambda client: client.read_coils(number - 1, count=1, device_id=self._unit_id),
        )
        return self._first_bit(reply)

    async def write_output(self, number: int, *, on: bool) -> None:
        """Write DO[number] (FC05)."""
        what = f"writing DO[{number}]"
        reply = await self._transact(
            _WRITE_OUTPUT,
            what,
            lambda client: client.write_coil(number - 1, on, device_id=self._unit_id),
        )
        if (reply.address, reply.bits[:1]) != (number - 1, [on]):
            raise self._another(what)

    def _first_bit(self, reply: ModbusPDU) -> bool:
        if not reply.bits:
            raise PortError(Alarm.PROTOCOL_ERROR, f"{self.address}: an answer without the bit that was asked for.")
        return bool(reply.bits[0])

    def _note_connection(self, connected: bool) -> None:
        if not connected:
            self._end_waiting()

    def _end_waiting(self) -> None:
        """End the request that is out on a connection that has gone; pymodbus would let it wait for its time-out."""
        if self._client is not None and self._turn.locked():
            waiting = self._client.ctx.response_future
            if not waiting.done():
                waiting.set_exception(ConnectionException("the connection has gone"))
                waiting.exception()  # whoever waited may have been cancelled

    async def _transact(
        self, function: int, what: str, request: Callable[[AsyncModbusTcpClient], Awaitable[ModbusPDU]]
    ) -> ModbusPDU:
        """Send one request, when the one before it has ended, and return its answer; pymodbus matches them by id."""
        task = asyncio.current_task()
        cancelled_before = task.cancelling() if task is not None else 0
        self._outstanding += 1
        try:
            async with self._turn:
                reply = await self._answer(what, request)
        finally:
            self._outstanding -= 1
        if task is not None and task.cancelling() > cancelled_before:
            raise asyncio.CancelledError  # Python 3.11's wait_for loses a cancellation that comes with the answer
        if reply.isError():
            raise PortError(
                Alarm.PROTOCOL_ERROR,
                f"{self.address}: {what}: the controller answers Modbus exception {reply.exception_code}.",
            )
        if reply.function_code != function:
            raise self._another(what)
        return reply

    def _another(self, what: str) -> PortError:
        return PortError(Alarm.PROTOCOL_ERROR, f"{self.address}: {what}: the answer is to another request.")

    async def _answer(self, what: str, request: Callable[[AsyncModbusTcpClient], Awaitable[ModbusPDU]]) -> ModbusPDU:
        client = self._client
        if client is None or not client.connected:
            raise NotConnectedError(Alarm.CONNECTION_LOST, f"{self.address}: {what}: not connected.")
        try:
            return await request(client)
        except (ModbusException, OSError) as error:
            if client.connected:
                raise NotConnectedError(
                    Alarm.CONNECTION_TIMEOUT, f"{self.address}: {what}: no usable answer within {self._timeout_s} s."
                ) from error
            raise NotConnectedError(
                Alarm.CONNECTION_LOST, f"{self.address}: {what}: the connection was cut."
            ) from error
