"""Write the reference pages that are made from tables in the code: ``python docs/generate.py``.

tests/test_docs.py checks that the pages in the repository are what this would write.
"""

from __future__ import annotations

from pathlib import Path

from srvs_cell.alarms import Alarm
from srvs_cell.cell.packml import COMMANDS, MODE_STATES, STATE_COMPLETE, Command, Mode, State, target_state

HERE = Path(__file__).parent
GENERATED = "<!-- Made by docs/generate.py from the tables in the code; edit those. -->"


def alarms_page() -> str:
    """Return docs/reference/alarms.md."""
    lines = [
        "# Alarms",
        GENERATED,
        "",
        (
            "1xxx communication and devices, 2xxx robot and gripper, 3xxx camera and vision, 4xxx planning, 5xxx cell "
            "and operator, 6xxx configuration and files. The reaction is what happens when the recovery policy has "
            "nothing milder."
        ),
        "",
        "| code | name | severity | reaction | cause | remedy |",
        "|---|---|---|---|---|---|",
    ]
    for alarm in Alarm:
        row = alarm.value
        lines.append(
            f"| {row.code} | {alarm.name} | {row.severity.value} | {row.reaction.value} | {row.cause} | {row.remedy} |"
        )
    return "\n".join(lines) + "\n"


def packml_page() -> str:
    """Return docs/reference/packml.md."""
    lines = [
        "# States, commands and modes",
        GENERATED,
        "",
        (
            "ISA-TR88.00.02 (PackML). The cell powers up in Aborted: nothing is known of the hardware until an "
            "operator clears."
        ),
        "",
        "## States",
        "",
        "| number | state | goes by itself to |",
        "|---|---|---|",
    ]
    for state in State:
        after = STATE_COMPLETE.get(state)
        lines.append(f"| {state.value} | {state.title} | {after.title if after else ''} |")
    lines += [
        "",
        "## Commands",
        "",
        "A cell of the table is the state that the command leads to; an empty cell is refused.",
        "",
        "| state | " + " | ".join(f"{command.title} ({command.value})" for command in Command) + " |",
        "|---" * (len(COMMANDS) + 1) + "|",
    ]
    for state in State:
        targets = [target_state(state, command) for command in Command]
        lines.append(f"| {state.title} | " + " | ".join(target.title if target else "" for target in targets) + " |")
    lines += ["", "## Modes", "", "| number | mode | states that it lacks |", "|---|---|---|"]
    for mode in Mode:
        missing = ", ".join(state.title for state in State if state not in MODE_STATES[mode]) or "none"
        lines.append(f"| {mode.value} | {mode.title} | {missing} |")
    return "\n".join(lines) + "\n"


PAGES = {"reference/alarms.md": alarms_page, "reference/packml.md": packml_page}


def main() -> None:
    """Write every generated page."""
    for name, page in PAGES.items():
        (HERE / name).write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
