"""The fault table on the KAREL line protocol."""

from pathlib import Path

import pytest

from tests.drivers.faults.judge import judge
from tests.drivers.faults.table import KAREL, TABLE, Ending, Fault

ROWS = [
    pytest.param(fault, ending, id=fault.title)
    for fault in TABLE
    if (ending := KAREL[fault.strike, fault.when]) is not None
]


@pytest.mark.parametrize(("fault", "ending"), ROWS)
async def test_fault(fault: Fault, ending: Ending, tmp_path: Path) -> None:
    await judge("karel", fault, ending, tmp_path)
