"""The simulated cell as a child process, found by its entry point: the product never imports it.

``python -m srvs_cell.cli.simulator NAME ARGUMENTS...`` is the child itself.
"""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
import threading
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any

from srvs_cell.alarms import Alarm, AlarmError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

ENTRY_POINT_GROUP = "srvs_cell.simulators"
DEFAULT_SIMULATOR = "mujoco"
_START_TIMEOUT_S = 60.0
_STOP_TIMEOUT_S = 10.0
_SHOWN_LOG_LINES = 12


def start_simulator(
    arguments: Sequence[str], log_path: Path | None = None, *, timeout_s: float = _START_TIMEOUT_S
) -> tuple[subprocess.Popen[str], dict[str, Any]]:
    """Start the installed simulator and wait until it listens.

    It ends with this process, whatever ends this process.

    Args:
        arguments: the simulator's own command line.
        log_path: file for its log; None: this process's stderr.
        timeout_s: longest wait for its JSON line.

    Returns:
        The process, and what it says on its first line: what listens where.

    Raises:
        AlarmError: SIMULATION_FAILED with the last lines of its log.
    """
    command = [sys.executable, "-m", __name__, DEFAULT_SIMULATOR, *arguments]
    log = None if log_path is None else log_path.open("w", encoding="utf-8")
    try:
        process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True
        )
    finally:
        if log is not None:
            log.close()
    try:
        line = _first_line(process, timeout_s)
        return process, json.loads(line)
    except (ValueError, TimeoutError) as error:
        stop_simulator(process)
        raise simulator_failure(process, log_path) from error
    except BaseException:
        stop_simulator(process)
        raise


def stop_simulator(process: subprocess.Popen[str], timeout_s: float = _STOP_TIMEOUT_S) -> int:
    """End the simulator, gently first, and return its exit code."""
    if process.stdin is not None:
        process.stdin.close()
    process.terminate()
    try:
        return process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()
    finally:
        if process.stdout is not None:
            process.stdout.close()


def simulator_failure(process: subprocess.Popen[str], log_path: Path | None = None) -> AlarmError:
    """Return the alarm of a simulator that did not start or ended early."""
    ended = "is still running" if process.poll() is None else f"ended with code {process.returncode}"
    if log_path is None:
        return AlarmError(Alarm.SIMULATION_FAILED, f"The simulator {ended}; its log is on stderr.")
    tail = log_path.read_text(encoding="utf-8", errors="replace").splitlines()[-_SHOWN_LOG_LINES:]
    return AlarmError(Alarm.SIMULATION_FAILED, f"The simulator {ended}; {log_path} ends:\n" + "\n".join(tail) + "\n")


def _first_line(process: subprocess.Popen[str], timeout_s: float) -> str:
    if process.stdout is None:
        raise ValueError("the simulator's stdout is not a pipe")
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        if not selector.select(timeout_s):
            raise TimeoutError
    return process.stdout.readline()


def _run_child(name: str, arguments: list[str]) -> int:
    """Run a simulator in this process until it ends, or until the process that started us is gone."""
    found = entry_points(group=ENTRY_POINT_GROUP, name=name)
    if not found:
        raise AlarmError(Alarm.SIMULATION_FAILED, f"No simulator is installed under the name {name!r}.")
    threading.Thread(target=_end_with_parent, name="parent-watch", daemon=True).start()
    code: int = next(iter(found)).load()(arguments)
    return code


def _end_with_parent() -> None:
    sys.stdin.read()  # returns when the parent's end of the pipe closes
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    sys.exit(_run_child(sys.argv[1], sys.argv[2:]))
