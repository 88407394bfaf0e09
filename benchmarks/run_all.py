"""Every benchmark whose figures are in docs/benchmarks.md, one after the other: ``make bench``.

Those that need the shared data look in $SRVS_DATA, or in ../shared/data beside the repository.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
SCRIPTS: tuple[tuple[str, ...], ...] = (
    ("plan_problems.py",),
    ("plan_scale.py",),
    ("perceive_middlebury.py",),
    ("perceive_chessboard.py",),
    ("perceive_rendered.py",),
    ("switches.py",),
    ("alignment_bound.py",),
    ("planes_against_lines.py",),
    ("perception_time.py",),
    ("growth.py",),
    ("daemon_cost.py",),
    ("demo_seeds.py", "--workers", "2"),
)


def main() -> None:
    """Run the scripts; go on after one that fails, and say so in the end."""
    failed = []
    for name, *arguments in SCRIPTS:
        print(f"\n== {name}", flush=True)
        if subprocess.run([sys.executable, str(HERE / name), *arguments], check=False).returncode:
            failed.append(name)
    sys.exit(f"failed: {', '.join(failed)}" if failed else 0)


if __name__ == "__main__":
    main()
