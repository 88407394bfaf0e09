"""KAREL line protocol: carrier, line buffer and driver of ours on PyPI fanex's simulated robot, another line server."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

from drivers.fanuc.karel import DRIVER
from drivers.fanuc.karel.lines import LineBuffer
from drivers.fanuc.tcp_link import TcpLink
from srvs_cell.alarms import Alarm
from srvs_cell.ports import DriverContext, PortError
from tests.peers.bench import Judgement, free_ports, running, wall_clock
from tests.peers.rmi import environment

if TYPE_CHECKING:
    from pathlib import Path

WIRE: Final = "KAREL over TCP, driver"
BANNER: Final = b"0:success"
SAID: Final = {b"ping": b"0:pong", b"setreg:1:5": BANNER, b"getreg:1": b"0:5", b"nope": b"1:unknown-command"}
"""FANEX's commands and what it answers; its lines end with LF."""


def fanex(folder: Path) -> Judgement:
    """Let the framing of our driver talk FANEX, and the driver itself find out that it is not our program."""
    python = environment(folder)
    (port,) = free_ports(1)
    command = [str(python), "-u", str(python.with_name("fanex-sim")), "--host", "127.0.0.1", "--port", str(port)]
    with running([*command, "--allow-motion", "--move-seconds", "0.5"]):
        refused = asyncio.run(_talk(port))
    assert refused.alarm is Alarm.PROTOCOL_ERROR
    assert "not the program of srvs_cell" in refused.detail, refused.detail
    result = (
        "carrier and line buffer carry its commands, ended by CR LF or LF: every answer whole; "
        f"the driver refuses it with the reason: {refused.alarm.name}, not the program of srvs_cell; nothing moves"
    )
    return Judgement(WIRE, "PyPI fanex 0.1.0, fanex-sim, a server of another protocol", result, True)


async def _talk(port: int) -> PortError:
    lines: asyncio.Queue[bytes] = asyncio.Queue()
    buffer, link = LineBuffer(), TcpLink("127.0.0.1", port, 5.0)

    def take(data: bytes) -> None:
        for line in buffer.feed(data):
            lines.put_nowait(line)

    async with asyncio.timeout(30.0):
        await link.open(take, lambda _: None)
        assert await lines.get() == BANNER
        for end in (b"\r\n", b"\n"):
            for said, answer in SAID.items():
                link.send(said + end)
                assert await lines.get() == answer, said
        link.close()
        config = DRIVER.config_model.model_validate({"tcp": {"host": "127.0.0.1", "port": port}})
        arm = DRIVER.factory(config, DriverContext(wall_clock()))
        try:
            await arm.connect()
        except PortError as error:
            return error
        finally:
            await arm.disconnect()
    raise AssertionError("the driver has connected to another protocol")
