"""What a recorded conversation is, who took part in it, and how it is played to either side.

A line of a recording is the simulated time, who speaks (``>`` the driver, ``<`` the controller) on which connection,
and the bytes: as hexadecimal digits for Modbus, as text for RMI, whose packets are lines. The port that RMI names is
another one each time and stands as 16002.
"""

from __future__ import annotations

import asyncio
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from drivers.fanuc.modbus import FanucModbusArm, FanucModbusConfig
from srvs_cell.geometry import Xyzwpr
from tests.drivers.fanuc.bench import HOME
from tests.drivers.fanuc.rmi_bench import make_arm

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from drivers.fanuc.rmi import FanucRmiArm
    from tests.drivers.stepped import SteppedClock

FOLDER: Final = Path(__file__).parent
WIRES: Final = ("modbus", "rmi")
TARGET: Final = Xyzwpr(504.0, 0.0, 402.0, 180.0, 0.0, 10.0)
_PORT: Final = re.compile(rb'"PortNumber": 16002\b|"PortNumber": \d{4,5}(?=[^"]*"MajorVersion)')


@dataclass(frozen=True)
class Said:
    """A piece of the conversation.

    Attributes:
        time_s: simulated time.
        speaker: ``>`` the driver, ``<`` the controller.
        connection: 0 or, for RMI's session, 1.
        data: the bytes.
    """

    time_s: float
    speaker: str
    connection: int
    data: bytes

    def line(self, wire: str) -> str:
        """Return it as it is recorded."""
        text = self.data.hex() if wire == "modbus" else self.data.decode("ascii").removesuffix("\r\n")
        return f"{self.time_s!r} {self.speaker}{self.connection} {text}"


def read(wire: str) -> list[Said]:
    """Read a recording."""
    said = []
    for line in (FOLDER / f"{wire}.txt").read_text(encoding="ascii").splitlines():
        time_s, who, text = line.split(" ", 2)
        data = bytes.fromhex(text) if wire == "modbus" else text.encode("ascii") + b"\r\n"
        said.append(Said(float(time_s), who[0], int(who[1]), data))
    return said


def with_port(data: bytes, port: int) -> bytes:
    """Return RMI's reply to the connection with this port in it; anything else as it is."""
    return _PORT.sub(b'"PortNumber": %d' % port, data)


def make(wire: str, port: int, clock: SteppedClock) -> FanucModbusArm | FanucRmiArm:
    """Return the driver of a wire."""
    if wire == "rmi":
        return make_arm(clock, port=port, timeout_s=10.0)
    return FanucModbusArm(FanucModbusConfig(port=port, timeout_s=10.0), clock)


async def take_part(arm: FanucModbusArm | FanucRmiArm) -> None:
    """What the driver does in the conversation."""
    await arm.connect()
    assert (await arm.status()).pose == HOME
    await arm.activate()
    await arm.write_output(5, on=True)
    assert not await arm.read_input(1)
    assert await arm.move_linear(TARGET, 20.0) == TARGET
    assert await arm.move_joint(replace(TARGET, y_mm=5.0), 5.0) == replace(TARGET, y_mm=5.0)
    await arm.disconnect()


class Scripted:
    """A controller that says what a recording says, byte by byte, and hears whether the driver does, too."""

    def __init__(self, wire: str, clock: SteppedClock) -> None:
        self._clock = clock
        self._script = read(wire)
        self._heard: dict[int, asyncio.StreamReader] = {}
        self._speaks: dict[int, asyncio.StreamWriter] = {}
        self._came = asyncio.Condition()
        self.session_port = 0

    def door(self, connection: int) -> Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]:
        """Return what takes a connection."""

        async def take(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            async with self._came:
                self._heard[connection], self._speaks[connection] = reader, writer
                self._came.notify_all()

        return take

    async def play(self) -> None:
        """Go through the recording."""
        for said in self._script:
            async with self._came:
                await self._came.wait_for(lambda connection=said.connection: connection in self._heard)  # type: ignore[misc]
            if said.speaker == ">":
                heard = await self._heard[said.connection].readexactly(len(said.data))
                assert heard == said.data, f"at {said.time_s}"
                continue
            if self._clock.now_s() < said.time_s:
                await self._clock.sleep(said.time_s - self._clock.now_s())
            for byte in with_port(said.data, self.session_port):
                self._speaks[said.connection].write(bytes([byte]))
                await self._speaks[said.connection].drain()
        for writer in self._speaks.values():
            writer.close()
