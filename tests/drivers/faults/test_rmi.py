"""The fault table on RMI."""

from pathlib import Path

import pytest

from tests.drivers.faults.judge import judge
from tests.drivers.faults.table import TABLE, Ending, Fault

ROWS = [pytest.param(fault, fault.rmi, id=fault.title) for fault in TABLE if fault.rmi is not None]


@pytest.mark.parametrize(("fault", "ending"), ROWS)
async def test_fault(fault: Fault, ending: Ending, tmp_path: Path) -> None:
    await judge("rmi", fault, ending, tmp_path)
