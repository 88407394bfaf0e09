"""Let a fault of the table strike a running cell, and hold what comes of it against the table."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from tests.drivers.faults.cell import WireCell, wire_cell
from tests.drivers.faults.strikes import STRIKES, mend
from tests.drivers.faults.table import UNKNOWN, Ending, Fault

if TYPE_CHECKING:
    from pathlib import Path

_NOTHING_LEFT_TO_DO = {"Stopped", "Held"}
_MET_BY_THE_MONITOR = {"CONNECTION_LOST", "CONNECTION_TIMEOUT", "PROTOCOL_ERROR", "ROBOT_FAULT"}
"""Who reads the arm's status between two readings of the move may meet the same fault, and say so, too."""


async def judge(wire: str, fault: Fault, ending: Ending, folder: Path) -> None:
    """Run one row of the table on ``modbus``, ``rmi``, ``karel`` (TCP) or ``karel_serial``."""
    async with asyncio.timeout(100.0), wire_cell(wire, folder) as c:
        await _reach(c, fault.when)
        commanded, warned = c.motions, set(c.cell.alarms)
        await STRIKES[fault.strike](c)
        if ending.alarm is not None:
            await c.cell.reaches(ending.state)
        await c.settled()
        await _hold_against(c, ending, commanded, warned)
        mend(c)
        if ending.alarm is None:
            assert c.motions > commanded, "the job has not gone on"
            return
        begun = c.motions
        await c.recovered()
        assert c.motions == begun, "something moved that nobody started"
        assert c.cell.state in _NOTHING_LEFT_TO_DO, c.cell.alarms


async def _reach(c: WireCell, when: str) -> None:
    await c.reachable()
    if when == "idle":
        await c.cell.to_idle()
        await c.quiet()
    elif when == "suspended":
        c.point.world.blocks.clear()
        await c.cell.start()
        await c.cell.reaches("Suspended")
        await c.quiet()
    else:
        await c.cell.start()
        await c.until_moving(when)


async def _hold_against(c: WireCell, ending: Ending, commanded: int, warned: set[str]) -> None:
    snapshot = c.cell.unit.snapshot()
    alarms = [name for name in c.cell.alarms if name not in warned]
    if ending.alarm is None:
        assert (alarms, c.cell.state) == ([], ending.state)
        motions = await c.cell.journal.motions()
        assert {motion["outcome"] for motion in motions[1:]} <= {"done", "opened", "holding"}
        return
    assert ending.alarm in alarms, snapshot["alarms"]
    assert set(alarms) <= {ending.alarm, *_MET_BY_THE_MONITOR}, snapshot["alarms"]
    assert c.cell.state == ending.state
    assert snapshot["gripper"]["knowledge"] == ending.gripper
    assert c.motions == commanded, "something was commanded after the fault"
    assert not c.point.moving
    if ending.move != "-":
        outcome = await c.last_motion()
        assert (UNKNOWN if outcome is None else outcome) == ending.move
