"""One Modbus RTU connection over a serial port, with every failure named.

Time-outs here are real time: they bound the wire, not the work of the fingers.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
from typing import TYPE_CHECKING, Final

from pymodbus.client import AsyncModbusSerialClient
from pymodbus.exceptions import ModbusException

from srvs_cell.alarms import Alarm
from srvs_cell.ports import NotConnectedError, PortError

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator

    from pymodbus.pdu import ModbusPDU

_READ_INPUTS, _WRITE_WORDS = 4, 16

_REASONS: Final = {
    errno.ENOENT: "no such device: unplugged, or the path is another one",
    errno.ENODEV: "no such device: unplugged",
    errno.ENXIO: "no such device: unplugged",
    errno.EACCES: "no permission: add the daemon's user to the group that owns it (dialout)",
    errno.EPERM: "no permission: add the daemon's user to the group that owns it (dialout)",
    errno.EBUSY: "in use by another program",
    errno.EAGAIN: "in use by another program",
}


@contextlib.contextmanager
def why_not_opened(port: str) -> Iterator[None]:
    """Turn what opening a serial port raises into a `NotConnectedError` DEVICE_UNAVAILABLE that says why."""
    try:
        yield
    except OSError as error:  # pyserial's SerialException is one
        reason = _REASONS.get(error.errno or 0, f"it cannot be used as a serial port ({error.strerror or error})")
        raise NotConnectedError(Alarm.DEVICE_UNAVAILABLE, f"{port}: {reason}.") from error


class SerialWire:
    """Reads and writes words of one device.

    Never re-sends. An answer of Modbus RTU does not say which request it belongs to, so that after a silence the next
    answer may be the last one, come late: the first failure closes the port, and opening it again begins afresh.
    """

    def __init__(self, port: str, baud_rate: int, device_id: int, timeout_s: float) -> None:
        self.address = f"{port} device {device_id}"
        self.lost: PortError | None = None
        self._port, self._baud_rate, self._device_id, self._timeout_s = port, baud_rate, device_id, timeout_s
        self._client: AsyncModbusSerialClient | None = None
        self._turn = asyncio.Lock()
        self._outstanding = 0

    @property
    def busy(self) -> bool:
        """Whether an answer is being waited for."""
        return self._outstanding > 0

    @property
    def open(self) -> bool:
        """Whether the port is open."""
        return self._client is not None and self._client.connected

    async def connect(self) -> None:
        """Open the port, 8 data bits, no parity, 1 stop bit; raises `NotConnectedError` that says why it cannot be."""
        self.close()
        client = AsyncModbusSerialClient(
            self._port, baudrate=self._baud_rate, timeout=self._timeout_s, retries=0, reconnect_delay=0
        )
        with why_not_opened(self._port):
            # pymodbus's own connect() turns every reason into False; this is what it does inside.
            client.ctx.transport, _ = await client.ctx.call_create()
        self._client, self.lost = client, None

    def close(self) -> None:
        """Close the port, if it is open."""
        if self._client is not None:
            self._client.close()
            self._client = None

    async def read_inputs(self, first: int, count: int) -> list[int]:
        """Read ``count`` input registers (FC04)."""
        what = f"reading {count} words from 0x{first:04X}"
        reply = await self._transact(
            what, lambda client: client.read_input_registers(first, count=count, device_id=self._device_id)
        )
        if (reply.function_code, len(reply.registers)) != (_READ_INPUTS, count):
            raise self._give_up(_other_answer(what, reply))
        return list(reply.registers)

    async def write_words(self, first: int, values: list[int]) -> None:
        """Write holding registers (FC16)."""
        what = f"writing {len(values)} words to 0x{first:04X}"
        reply = await self._transact(
            what, lambda client: client.write_registers(first, values, device_id=self._device_id)
        )
        if (reply.function_code, reply.address, reply.count) != (_WRITE_WORDS, first, len(values)):
            raise self._give_up(_other_answer(what, reply))

    async def _transact(
        self, what: str, request: Callable[[AsyncModbusSerialClient], Awaitable[ModbusPDU]]
    ) -> ModbusPDU:
        """Send one request and return its answer; it comes to its end also where its asker is cancelled.

        An answer that nobody waits for would be taken for the next one's.
        """
        exchange = asyncio.create_task(self._exchange(what, request))
        exchange.add_done_callback(_look_at)
        return await asyncio.shield(exchange)

    async def _exchange(
        self, what: str, request: Callable[[AsyncModbusSerialClient], Awaitable[ModbusPDU]]
    ) -> ModbusPDU:
        self._outstanding += 1
        try:
            async with self._turn:
                client = self._client
                if client is None or not client.connected:
                    raise self.not_connected(what)
                try:
                    reply = await request(client)
                except (ModbusException, OSError) as error:
                    if self.open:
                        detail = f"{what}: no usable answer within {self._timeout_s} s."
                        raise self._give_up(NotConnectedError(Alarm.CONNECTION_TIMEOUT, detail)) from error
                    detail = f"{what}: the serial port has gone."
                    raise self._give_up(NotConnectedError(Alarm.CONNECTION_LOST, detail)) from error
        finally:
            self._outstanding -= 1
        if reply.isError():
            code = reply.exception_code
            raise PortError(
                Alarm.PROTOCOL_ERROR, f"{self.address}: {what}: the device answers Modbus exception {code}."
            )
        return reply

    def not_connected(self, what: str) -> NotConnectedError:
        """Return the error of a wire that is not there, with the reason why it was given up.

        Args:
            what: what cannot be done or known without it.
        """
        if self.lost is not None:
            return NotConnectedError(self.lost.alarm, f"{self.address}: the port was given up: {self.lost.detail}")
        return NotConnectedError(Alarm.CONNECTION_LOST, f"{self.address}: {what}: not connected.")

    def _give_up(self, error: PortError) -> PortError:
        """Close the port; return the error with the address."""
        self.close()
        self.lost = error
        return type(error)(error.alarm, f"{self.address}: {error.detail}")


def _other_answer(what: str, reply: ModbusPDU) -> PortError:
    return PortError(Alarm.PROTOCOL_ERROR, f"{what}: the answer is another one's: {reply}.")


def _look_at(task: asyncio.Task[ModbusPDU]) -> None:
    """Take note of an error that may have nobody to raise to any more."""
    if not task.cancelled():
        task.exception()
