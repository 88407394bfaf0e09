"""Plan every problem of a file and compare with its proven optimum.

Usage: python benchmarks/plan_problems.py [PROBLEMS.json]; without a file, planning/problems.json beside $SRVS_DATA, or
../shared/planning/problems.json beside the repository.
Prints a row per family: problems, solved or proven infeasible, agreeing with the optimum in moves, in travel (0.01 mm),
plans that the validator accepts, and the processor time per problem (reading, planning, validating) in milliseconds.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from srvs_cell.planning import Problem, plan, validate
from srvs_cell.scene import PlanStatus

TRAVEL_TOLERANCE_MM = 0.01


@dataclass
class Tally:
    """Counts and times of one family."""

    problems: int = 0
    decided: int = 0
    moves_agree: int = 0
    travel_agrees: int = 0
    valid: int = 0
    times_ms: list[float] = field(default_factory=list)


def main() -> None:
    """Run the benchmark."""
    data = os.environ.get("SRVS_DATA")
    shared = Path(data).parent if data else Path(__file__).resolve().parents[2] / "shared"
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else shared / "planning" / "problems.json"
    tallies: dict[str, Tally] = {}
    for instance in json.loads(path.read_text(encoding="utf-8"))["instances"]:
        measure(instance, tallies.setdefault(instance["family"], Tally()))
    print(
        f"{'family':12} {'problems':>8} {'decided':>8} {'moves =':>8} {'travel =':>8} {'valid':>6} "
        f"{'median ms':>10} {'worst ms':>9}"
    )
    for family, tally in tallies.items():
        print(
            f"{family:12} {tally.problems:8} {tally.decided:8} {tally.moves_agree:8} {tally.travel_agrees:8} "
            f"{tally.valid:6} {statistics.median(tally.times_ms):10.1f} {max(tally.times_ms):9.1f}"
        )


def measure(instance: dict[str, Any], tally: Tally) -> None:
    """Plan one problem and count how it compares."""
    optimal = instance.pop("optimal")
    began = time.process_time()
    problem = Problem.from_mapping(instance, instance["id"])
    answer = plan(problem)
    infeasible = answer.status is PlanStatus.INFEASIBLE
    valid = infeasible or not validate(problem, answer.moves)
    tally.times_ms.append((time.process_time() - began) * 1e3)
    same = answer.status == optimal["status"]
    tally.problems += 1
    tally.decided += answer.status is not PlanStatus.NOT_PROVEN
    tally.moves_agree += same and (infeasible or len(answer.moves) == optimal["moves"])
    tally.travel_agrees += same and (infeasible or abs(answer.travel_mm - optimal["travel_mm"]) <= TRAVEL_TOLERANCE_MM)
    tally.valid += valid


if __name__ == "__main__":
    main()
