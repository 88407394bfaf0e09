"""What the daemon costs: wall time of ``srvs-cell status``, resident memory idle and after a job.

python benchmarks/daemon_cost.py
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from srvs_cell.cli.demo_run import work_through
from srvs_cell.cli.simulated_cell import SimulatedCell, SimulationOptions, simulated_cell

_RUNS = 9


def status_seconds(cell: SimulatedCell) -> list[float]:
    """Return the wall time of several ``srvs-cell status`` as an operator would run it."""
    command = [str(Path(sys.executable).parent / "srvs-cell"), "status", "--socket", str(cell.daemon.socket_path)]
    times = []
    for _ in range(_RUNS):
        started_s = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        times.append(time.perf_counter() - started_s)
    return times


def resident_mib(cell: SimulatedCell) -> float:
    """Return the daemon's resident memory now."""
    if cell.daemon.process is None:
        raise RuntimeError("the daemon is not running")
    for line in Path(f"/proc/{cell.daemon.process.pid}/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    raise RuntimeError("no VmRSS")


def main() -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory(prefix="srvs-") as folder:
        with simulated_cell(SimulationOptions(objects=3), Path(folder)) as cell:
            times = status_seconds(cell)
            idle_mib = resident_mib(cell)
            state = work_through(cell.client, lambda _: None)["state"]
            worked_mib = resident_mib(cell)
        python = [sys.executable, "-c", "pass"]
        bare = []
        for _ in range(_RUNS):
            started_s = time.perf_counter()
            subprocess.run(python, check=True)
            bare.append(time.perf_counter() - started_s)
    print("| what | median | max |\n|---|---|---|")
    print(f"| srvs-cell status, wall s | {statistics.median(times):.2f} | {max(times):.2f} |")
    print(f"| python -c pass, wall s | {statistics.median(bare):.3f} | {max(bare):.3f} |")
    print(f"| daemon resident MiB, aborted | {idle_mib:.0f} | |")
    print(f"| daemon resident MiB, after a job of 3 parts ({state}) | {worked_mib:.0f} | |")


if __name__ == "__main__":
    main()
