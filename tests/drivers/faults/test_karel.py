"""The fault table on the KAREL line protocol, over TCP and over a serial line."""

from pathlib import Path

import pytest

from tests.drivers.faults.judge import judge
from tests.drivers.faults.table import KAREL, KAREL_SERIAL, TABLE, Ending, Fault

ROWS = [
    pytest.param(wire, fault, ending, id=f"{wire}: {fault.title}")
    for wire, endings in (("karel", KAREL), ("karel_serial", KAREL_SERIAL))
    for fault in TABLE
    if (ending := endings.get((fault.strike, fault.when))) is not None
]


@pytest.mark.parametrize(("wire", "fault", "ending"), ROWS)
async def test_fault(wire: str, fault: Fault, ending: Ending, tmp_path: Path) -> None:
    await judge(wire, fault, ending, tmp_path)
