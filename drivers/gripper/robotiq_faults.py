"""What the gripper's fault codes mean and what to do about each (2F-85 & 2F-140 instruction manual, gFLT). Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Fault:
    """One row of the table.

    Attributes:
        cause: what the gripper says.
        remedy: what a person does about it.
        ends_activation: the gripper must be activated anew, which moves the fingers; what they hold is not known.
        passes: it tells of the past and does not keep the gripper from acting.
    """

    cause: str
    remedy: str
    ends_activation: bool = False
    passes: bool = False


_ANEW: Final = "take the part out of the fingers, then clear and reset: the gripper is activated anew."

_ROWS: Final = {
    0x05: Fault("An action was asked for before the activation was complete.", "Clear and reset the cell."),
    0x07: Fault("The gripper is not activated.", f"It has lost its power or was reset: {_ANEW}"),
    0x08: Fault(
        "It is hotter than 85 °C inside.",
        "Let it cool below 80 °C: fewer or gentler grips, less force, more air; then clear and reset.",
    ),
    0x09: Fault("It was not talked to for a second.", "None needed: it says so once.", passes=True),
    0x0A: Fault(
        "Its supply voltage is too low.",
        f"Check supply (24 V), cable and the tool connector's current limit; {_ANEW}",
        ends_activation=True,
    ),
    0x0B: Fault(
        "It releases what it holds by itself (automatic release).",
        f"Somebody else has commanded it; wait, then {_ANEW}",
        ends_activation=True,
    ),
    0x0C: Fault(
        "It has an internal fault.",
        "Cycle its power; if the fault comes back, have the gripper serviced.",
        ends_activation=True,
    ),
    0x0D: Fault(
        "The activation has failed.",
        "Nothing may be between or beside the fingers while they open and close: free them, then clear and reset.",
        ends_activation=True,
    ),
    0x0E: Fault(
        "Its motor has drawn too much current.",
        f"Look for a jam; lower force_n or speed_mm_s in the config; {_ANEW}",
        ends_activation=True,
    ),
    0x0F: Fault(
        "It has released what it held (automatic release).",
        f"Somebody else has commanded it; {_ANEW}",
        ends_activation=True,
    ),
}

_UNLISTED: Final = Fault(
    "The manual does not list this fault.",
    f"Read the LED and the manual of this firmware; {_ANEW}",
    ends_activation=True,
)


def fault_of(code: int) -> Fault | None:
    """Return the row of a fault code, one for all where it is not listed; None for 0, no fault."""
    return None if code == 0 else _ROWS.get(code, _UNLISTED)


def describe(code: int) -> str:
    """Return code, cause and remedy for people."""
    row = fault_of(code)
    return "no fault" if row is None else f"fault 0x{code:02X}: {row.cause} {row.remedy}"
