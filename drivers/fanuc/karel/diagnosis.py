"""What keeps the arm from working over the KAREL line protocol: greets, reads, hangs up.

A greeting ends what a program that has died may have left under way; one that lives holds the wire, so that nobody else
is heard.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

from drivers.fanuc.diagnosis import Conditions, judge, not_connected
from drivers.fanuc.karel import judgement, messages
from drivers.fanuc.karel.link import make_link
from drivers.fanuc.karel.session import LineSession
from drivers.fanuc.registers import UopOutput
from srvs_cell.alarms import Alarm
from srvs_cell.ports import Finding, PortError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.fanuc.karel.config import FanucKarelConfig
    from srvs_cell.ports import Clock

_SERVERS: Final = (
    "Start srvstcp (Ethernet) or srvsser (RS-232) on the robot; compare port, or device and baud, with the config."
)
_LOAD: Final = "Load and start the KAREL programs of this release: docs/reference/karel-protocol.md."
_REMEDIES: Final = {
    Alarm.CONNECTION_REFUSED: _SERVERS,
    Alarm.CONNECTION_TIMEOUT: _SERVERS,
    Alarm.PROTOCOL_ERROR: _SERVERS,
    Alarm.PROTOCOL_VERSION: _LOAD,
}


async def diagnose_karel(config: FanucKarelConfig, clock: Clock) -> list[Finding]:
    """Look at carrier, program and robot; each only where what comes before it is all right."""
    session = LineSession(make_link(config), config.timeout_s, config.read_tries)
    try:
        await session.open()
    except PortError as error:
        remedy = _REMEDIES.get(error.alarm)
        return [not_connected(error) if remedy is None else Finding.failed("connection", error, remedy)]
    findings = [Finding.fine("connection", f"{session.address}, KAREL line protocol")]
    try:
        status = messages.read_status(await session.read("STAT"))
        conditions = Conditions(remote=UopOutput.CMDENBL in status.uop)
        findings += judge(judgement.robot_status(status, clock.now_s()), conditions)
        busy = judgement.moving(status)
        move = Finding.fine("last move", f"move {status.move}, {status.state.name.lower()}")
        findings.append(move if busy is None else Finding.failed("last move", busy))
    except PortError as error:
        findings.append(Finding.failed("reading", error))
    finally:
        session.close()
        await asyncio.sleep(0)  # the socket is closed in the loop's next turn; the robot takes one client at a time
    return findings


async def peek_inputs_karel(config: FanucKarelConfig, numbers: Sequence[int]) -> tuple[bool, ...]:
    """Read DI[number] of each in a conversation of its own."""
    session = LineSession(make_link(config), config.timeout_s, config.read_tries)
    await session.open()
    try:
        return tuple([messages.read_signal("RDIN", await session.read("RDIN", number)) for number in numbers])
    finally:
        session.close()
        await asyncio.sleep(0)
