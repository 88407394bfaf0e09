"""Programs of the guest, and waiting."""

from __future__ import annotations

import subprocess
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

_POLL_S = 0.1
_PROGRAM_S = 400.0


def run(*command: str, check: bool = True) -> str:
    """Run a program and return what it printed, stdout and stderr.

    Raises:
        RuntimeError: its exit code was not 0, where ``check`` is set; names command and output.
    """
    done = subprocess.run(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=_PROGRAM_S, check=False
    )
    if check and done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}: {done.stdout.strip()}")
    return done.stdout.strip()


def wait_until(what: str, reached: Callable[[], bool], timeout_s: float) -> float:
    """Wait until ``reached`` says so; return after how many seconds.

    Raises:
        TimeoutError: it was not within ``timeout_s``; names ``what``.
    """
    started_s = time.monotonic()
    while not reached():
        if time.monotonic() - started_s > timeout_s:
            raise TimeoutError(f"not within {timeout_s:.0f} s: {what}")
        time.sleep(_POLL_S)
    return time.monotonic() - started_s
