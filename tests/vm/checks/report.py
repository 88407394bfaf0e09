"""One line for each check: whether it held, how long it took, the figure that it measured."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


class Report:
    """Runs checks and counts them.

    Attributes:
        passed, failed: how many.
    """

    def __init__(self) -> None:
        self.passed = 0
        self.failed = 0

    def check(self, name: str, measure: Callable[[], str]) -> bool:
        """Run ``measure``, which returns its figure or raises; tell whether it held."""
        started_s = time.monotonic()
        try:
            held, figure = True, measure()
        except Exception as error:  # noqa: BLE001 - whatever a check ends with is its result
            held, figure = False, f"{type(error).__name__}: {error}"
        self.passed += held
        self.failed += not held
        took_s = time.monotonic() - started_s
        say(f"{'ok' if held else 'FAILED':6} {took_s:5.1f} s  {name}: {figure}")
        return held


def say(line: str) -> None:
    """Print a line at once: somebody watches."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
