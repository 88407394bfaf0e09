"""A recorded conversation, replayed byte by byte against both of its sides."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from srvs_cell.ports import Lifecycle
from tests.drivers.fanuc.bench import HOME, TARGET
from tests.drivers.fanuc.karel_bench import make_arm
from tests.drivers.fanuc.karel_conversation import Conversation
from tests.drivers.stepped import SteppedClock, SteppedTime

if TYPE_CHECKING:
    from srvs_cell.geometry import Xyzwpr

RECORDED = r"""
> \r\n
> >1,HELO,4301*16825\r\n
< <1,OK,4301,0*6533\r\n
> >2,STAT*57049\r\n
< <2,OK,0,0,0,1,3,100,1,1,0,500000,0,400000,180000,0,0*57578\r\n
> >3,STAT*58586\r\n
< <3,OK,0,0,0,1,3,100,1,1,0,500000,0,400000,180000,0,0*5355\r\n
> >4,ENBL*39616\r\n
< <4,OK*27703\r\n
> >5,STAT*61660\r\n
< <5,OK,0,0,0,1,3,100,1,1,0,500000,0,400000,180000,0,0*31469\r\n
> >6,MOVL,600000,0,400000,180000,0,0,200000*25663\r\n
< <6,OK*29753\r\n
> >7,STAT*64734\r\n
< <7,OK,1,0,6,1,7,100,1,1,0,500000,0,400000,180000,0,0*42234\r\n
+ 0.2
> >8,STAT*991\r\n
< <8,OK,1,0,6,1,7,100,1,1,0,510000,0,400000,180000,0,0*61692\r\n
+ 0.2
> >9,STAT*2528\r\n
< <9,OK,1,0,6,1,7,100,1,1,0,550000,0,400000,180000,0,0*34818\r\n
+ 0.2
> >10,STAT*26889\r\n
< <10,OK,1,0,6,1,7,100,1,1,0,590000,0,400000,180000,0,0*23086\r\n
+ 0.2
> >11,STAT*28426\r\n
< <11,OK,2,0,6,1,3,100,1,1,0,600000,0,400000,180000,0,0*23332\r\n
> >12,STAT*29963\r\n
< <12,OK,2,0,6,1,3,100,1,1,0,600000,0,400000,180000,0,0*36389\r\n
> >13,QUIT*34323\r\n
< <13,OK*39527\r\n
"""
"""Between driver and double: what goes to the robot (>), what comes from it (<), and seconds that pass (+)."""


def _recorded() -> list[tuple[str, bytes]]:
    rows = [row.split(" ", 1) for row in RECORDED.strip().splitlines() if row.strip()]
    return [(way, text.replace("\\r", "\r").replace("\\n", "\n").encode()) for way, text in rows]


def test_the_robots_program_says_its_part() -> None:
    c = Conversation()
    said: list[bytes] = []
    for way, text in _recorded():
        if way == "+":
            c.pass_s(float(text))
        elif way == ">":
            said += [answer for byte in text for answer in c.send(bytes([byte]))]
        else:
            assert said.pop(0) == text
    assert not said


async def _play(arm_says: list[bytes], answers: list[bytes], pieces: int) -> Xyzwpr:
    """Play the robot from the record, so many bytes at a time; return where the move is said to end."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n")
        for expected, answer in zip(arm_says, answers, strict=True):
            assert await reader.readuntil(b"\r\n") == expected
            for at in range(0, len(answer), pieces):
                writer.write(answer[at : at + pieces])
                await writer.drain()
                await asyncio.sleep(0)
        writer.close()
        await writer.wait_closed()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    clock = SteppedClock(SteppedTime())
    arm = make_arm(clock, "tcp", str(server.sockets[0].getsockname()[1]), timeout_s=10.0)
    clock.busy = lambda: arm._session.busy
    arm._session._sequence = 0
    arm._beat = lambda: asyncio.sleep(0)  # type: ignore[method-assign]
    try:
        await arm.connect()
        await arm.activate()
        return await arm.move_linear(TARGET, 200.0)
    finally:
        await arm.disconnect()
        assert arm.lifecycle is Lifecycle.DISCONNECTED
        server.close()
        await server.wait_closed()


@pytest.mark.parametrize("pieces", [1, 7, 1000])
async def test_the_driver_says_its_part(pieces: int) -> None:
    lines = [text for way, text in _recorded() if way == ">" and text.strip()]
    answers = [text for way, text in _recorded() if way == "<"]
    assert await _play(lines, answers, pieces) == TARGET == replace(HOME, x_mm=600.0)
