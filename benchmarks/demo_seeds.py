"""Whole simulated jobs over many seeds: share that succeed, position error, moves against the minimum, time.

python benchmarks/demo_seeds.py [--seeds 20] [--objects 3 5 8] [--workers 1] [--json OUT]
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

_TIMEOUT_S = 600


def run_demo(objects: int, seed: int) -> dict[str, Any]:
    """Run one demo and return its JSON with the exit code and the wall time."""
    started_s = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="srvs-") as out:
        done = subprocess.run(
            [
                sys.executable,
                "-m",
                "srvs_cell.cli.main",
                "demo",
                "--objects",
                str(objects),
                "--seed",
                str(seed),
                "--out",
                str(Path(out) / "demo"),
                "--json",
            ],
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
    try:
        result = json.loads(done.stdout)
    except json.JSONDecodeError:
        result = {"success": False, "reasons": [done.stderr.strip()[-300:]]}
    return {
        **result,
        "objects": objects,
        "seed": seed,
        "exit_code": done.returncode,
        "wall_s": time.monotonic() - started_s,
    }


def summary(objects: int, results: list[dict[str, Any]]) -> str:
    """Return a row of the table."""
    good = [r for r in results if r["success"] and r["exit_code"] == 0]
    errors = [r["position_error_mm"] for r in results if r.get("position_error_mm", {}).get("mean") is not None]
    placed = [r["placement_error_mm"] for r in good]
    times_s = [r["job_time_s"] for r in good if r["job_time_s"] is not None]  # none where nothing had to be moved
    least = [r for r in good if r["moves_done"] == r["moves_least"]]
    return (
        f"| {objects} | {len(good)} / {len(results)} "
        f"| {np.mean([e['mean'] for e in errors]):.2f} | {max(e['max'] for e in errors):.2f} "
        f"| {np.mean([e['mean'] for e in placed]):.2f} | {max(e['max'] for e in placed):.2f} "
        f"| {len(least)} / {len(good)} | {np.median(times_s):.0f} "
        f"| {np.median([r['wall_s'] for r in results]):.0f} |"
        if times_s and errors
        else f"| {objects} | {len(good)} / {len(results)} | no figures |"
    )


def main() -> None:
    """Print the table, and the failures to stderr."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--objects", type=int, nargs="+", default=[3, 5, 8])
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    every: list[dict[str, Any]] = []
    print(
        "| objects | succeed | position error mean mm | max mm | placement error mean mm | max mm "
        "| fewest moves | job s (median) | wall s (median) |\n|---|---|---|---|---|---|---|---|---|"
    )
    for objects in options.objects:
        with ThreadPoolExecutor(options.workers) as pool:
            results = list(pool.map(lambda seed, n=objects: run_demo(n, seed), range(options.seeds)))
        print(summary(objects, results), flush=True)
        every += results
        failed = [result for result in results if not result["success"] or result["exit_code"]]
        for result in failed:
            print(f"objects {objects} seed {result['seed']}: {result.get('reasons')}", file=sys.stderr, flush=True)
    if options.json:
        options.json.write_text(json.dumps(every, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
