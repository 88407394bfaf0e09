"""Record the conversations anew: ``python -m tests.drivers.recordings.record``."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from tests.drivers.fanuc.bench import bench
from tests.drivers.fanuc.rmi_bench import rmi_bench
from tests.drivers.recordings.conversation import FOLDER, WIRES, Said, make, take_part, with_port

if TYPE_CHECKING:
    from tests.drivers.stepped import SteppedTime


class Tee:
    """Stands between driver and double and keeps what they say."""

    def __init__(self, time: SteppedTime, ports: list[int]) -> None:
        self.said: list[Said] = []
        self.doors: list[int] = []
        self._time, self._ports = time, ports

    async def open(self) -> list[asyncio.Server]:
        servers = []
        for connection in range(len(self._ports)):

            async def take(
                reader: asyncio.StreamReader, writer: asyncio.StreamWriter, connection: int = connection
            ) -> None:
                there = await asyncio.open_connection("127.0.0.1", self._ports[connection])
                await asyncio.gather(
                    self._pass(reader, there[1], ">", connection), self._pass(there[0], writer, "<", connection)
                )

            servers.append(await asyncio.start_server(take, "127.0.0.1", 0))
        self.doors = [server.sockets[0].getsockname()[1] for server in servers]
        return servers

    async def _pass(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, speaker: str, connection: int
    ) -> None:
        while data := await reader.read(65536):
            pieces = [line + b"\r\n" for line in data.split(b"\r\n")[:-1]] if len(self._ports) > 1 else [data]
            for piece in pieces:
                self.said.append(Said(self._time.now_s(), speaker, connection, with_port(piece, 16002)))
                writer.write(with_port(piece, self.doors[-1]))
        writer.close()


async def record(wire: str) -> None:
    """Record one wire."""
    async with bench() if wire == "modbus" else rmi_bench() as b:
        ports = [b.port] if wire == "modbus" else [b.port, getattr(b.controller.server, "session_port", 0)]
        tee = Tee(b.time, ports)
        servers = await tee.open()
        arm = make(wire, tee.doors[0], b.clock)
        busy = b.clock.busy
        b.clock.busy = lambda: busy() or (arm._wire.busy if wire == "modbus" else arm._session.busy)  # type: ignore[union-attr]
        await take_part(arm)
        await asyncio.sleep(0.2)
        for server in servers:
            server.close()
        text = "".join(said.line(wire) + "\n" for said in tee.said)
        (FOLDER / f"{wire}.txt").write_text(text, encoding="ascii")


if __name__ == "__main__":
    for name in WIRES:
        asyncio.run(record(name))
