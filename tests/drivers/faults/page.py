"""Write docs/reference/faults.md: ``python -m tests.drivers.faults.page``."""

from __future__ import annotations

from pathlib import Path

from srvs_cell.alarms import Alarm
from tests.drivers.faults.table import KAREL, KAREL_SERIAL, TABLE, UNKNOWN, Ending, Fault

PAGE = Path(__file__).parents[3] / "docs" / "reference" / "faults.md"

_HEAD = """# What a fault ends in
<!-- Made by `python -m tests.drivers.faults.page` from tests/drivers/faults/table.py; edit that. -->

Each row is a test: a whole cell (unit, journal, steps, gripper on the robot's inputs and outputs) on the real driver
and its wire to a controller double; the fault strikes in the job's step that is named. *Move* is what the journal
holds of the move under way, *gripper* what the cell knows of it. Where the outcome is unknown,
`resolve gripper empty|holding` comes first; then `clear` and `reset`. In every row the test also checks that nothing
moves after the fault has been dealt with: not by itself, and not by resolve and clear. CONNECTION_LOST,
CONNECTION_TIMEOUT or ROBOT_FAULT may come beside the alarm that is named, from whoever reads the arm's status at the
same time. A job that goes on (no alarm) needs nobody.

| fault | strikes in | Modbus TCP | RMI | KAREL over TCP | KAREL over RS-232 | note |
|---|---|---|---|---|---|---|
"""


def page() -> str:
    """Return the page."""
    rows = [
        f"| {fault.title} | {fault.when} | {_ending(fault.modbus)} | {_ending(fault.rmi)} "
        f"| {_ending(KAREL[fault.strike, fault.when])} | {_over_serial(fault)} | {fault.note} |"
        for fault in TABLE
    ]
    return _HEAD + "\n".join(rows) + "\n"


def _over_serial(fault: Fault) -> str:
    row = fault.strike, fault.when
    ending = KAREL_SERIAL[row]
    return "as over TCP" if ending is not None and ending == KAREL[row] else _ending(ending)


def _ending(ending: Ending | None) -> str:
    if ending is None:
        return "does not exist"
    if ending.alarm is None:
        return "no alarm, the job goes on"
    move = "" if ending.move == "-" else f"; move {ending.move}"
    gripper = "what the gripper holds is unknown" if ending.gripper == UNKNOWN else f"gripper {ending.gripper}"
    return f"{Alarm[ending.alarm].code} {ending.alarm}, {ending.state}{move}; {gripper}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
