"""The fault table on Modbus TCP."""

from pathlib import Path

import pytest

from tests.drivers.faults.judge import judge
from tests.drivers.faults.table import TABLE, Ending, Fault

ROWS = [pytest.param(fault, fault.modbus, id=fault.title) for fault in TABLE if fault.modbus is not None]


@pytest.mark.parametrize(("fault", "ending"), ROWS)
async def test_fault(fault: Fault, ending: Ending, tmp_path: Path) -> None:
    await judge("modbus", fault, ending, tmp_path)
