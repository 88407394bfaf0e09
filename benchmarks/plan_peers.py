"""Our planner beside OR-Tools CP-SAT and the textbook's plan: ``make bench-plan-peers``.

Least travel: objects that change places through one buffer place. CP-SAT gets the walk of the free place, step by step,
with the fewest moves given. Fewest moves: crowded discs with buffer places outside. CP-SAT gets the usual order model:
who is picked when, who stands at its goal when, who is buffered. One thread each, CP-SAT with a time limit.
"""

from __future__ import annotations

import statistics
import time
from itertools import product

from ortools.sat.python import cp_model

from benchmarks.plan_scale import crowded, one_after_another, permutation, start_and_target
from srvs_cell.planning import Problem, plan
from srvs_cell.planning.clearance import conflict_table
from srvs_cell.planning.detours import cycles_between
from srvs_cell.planning.travel import distances, travel_mm

LIMIT_S = 20.0
SEEDS = range(3)
UNIT_PER_MM = 1000


def main() -> None:
    """Print the tables."""
    print("least travel, one buffer     ours: median s, proven   CP-SAT: median s, proven, ours/its   textbook/ours")
    for count in (5, 6, 8, 10):
        rows = [travel_row(permutation(count, seed)) for seed in SEEDS]
        show(count, rows)
    print("\nfewest moves, density 0.4    ours: median s, proven   CP-SAT: median s, proven, ours - its")
    for count in (20, 50, 100):
        rows = [moves_row(crowded(count, seed)) for seed in SEEDS]
        show(count, rows)


def show(count: int, rows: list[tuple[float, bool, float, bool, float | None, float | None]]) -> None:
    """Print one line of a table."""
    ours_s, ours, its_s, its, against, textbook = zip(*rows, strict=True)
    compared = [value for value in against if value is not None]
    beside = [value for value in textbook if value is not None]
    print(
        f"  n = {count:3} {statistics.median(ours_s):26.3f} {sum(ours):3} / {len(rows)} "
        f"{statistics.median(its_s):18.2f} {sum(its):3} / {len(rows)}   {[round(value, 4) for value in compared]} "
        f"  {[round(value, 3) for value in beside]}",
        flush=True,
    )


def travel_row(problem: Problem) -> tuple[float, bool, float, bool, float | None, float | None]:
    """Return seconds and proof of both, our travel against CP-SAT's, and the textbook's against ours."""
    began = time.perf_counter()
    answer = plan(problem)
    ours_s = time.perf_counter() - began
    (start, target), legs = start_and_target(problem), distances(problem)
    cycles = cycles_between(start, target)
    if not cycles:
        return ours_s, answer.travel_proven, 0.0, True, None, None
    usual_mm = travel_mm(one_after_another(cycles, len(start), start, legs), legs)
    its_s, its_mm, proven = solve(walk_model(problem, len(answer.moves)))
    return (
        ours_s,
        answer.travel_proven,
        its_s,
        proven,
        None if its_mm is None else answer.travel_mm / (its_mm / UNIT_PER_MM),
        usual_mm / answer.travel_mm,
    )


def moves_row(problem: Problem) -> tuple[float, bool, float, bool, float | None, float | None]:
    """Return seconds and proof of both, and by how many moves ours is longer."""
    began = time.perf_counter()
    answer = plan(problem)
    ours_s = time.perf_counter() - began
    its_s, buffered, proven = solve(order_model(problem))
    more = None if buffered is None else len(answer.moves) - (len(problem.objects) + buffered)
    return ours_s, answer.moves_proven, its_s, proven, more, None


def solve(model: cp_model.CpModel) -> tuple[float, float | None, bool]:
    """Return seconds, the objective of what was found, and whether it is proven."""
    solver = cp_model.CpSolver()
    solver.parameters.max_time_in_seconds = LIMIT_S
    solver.parameters.num_workers = 1
    began = time.perf_counter()
    status = solver.solve(model)
    found = status in {cp_model.OPTIMAL, cp_model.FEASIBLE}
    return time.perf_counter() - began, solver.objective_value if found else None, status == cp_model.OPTIMAL


def walk_model(problem: Problem, moves: int) -> cp_model.CpModel:
    """Return the walk of the free place: where it stands after each move, and what stands on every place by then."""
    model = cp_model.CpModel()
    start, target = start_and_target(problem)
    count, legs = len(problem.places), distances(problem)
    buffer = count - 1
    holds = [*start, buffer]
    wanted = {place: item for item, place in enumerate(target)}
    hole = [[model.new_bool_var("") for _ in range(count)] for _ in range(moves + 1)]
    stands = [[[model.new_bool_var("") for _ in range(count)] for _ in range(count)] for _ in range(moves + 1)]
    for step, row in enumerate(hole):
        model.add_exactly_one(row)
        for place in range(count):
            model.add_exactly_one(stands[step][place])
            # The hole is the "object" with the last number.
            model.add(stands[step][place][buffer] == row[place])
    for place in range(count):
        model.add(stands[0][place][holds.index(place) if place != buffer else buffer] == 1)
        model.add(stands[moves][place][wanted.get(place, buffer)] == 1)
    cost = []
    for step in range(moves):
        for place in range(count):
            model.add_bool_or([~hole[step][place], ~hole[step + 1][place]])
            still = [~hole[step][place], ~hole[step + 1][place]]
            for item in range(count - 1):
                model.add(stands[step][place][item] == stands[step + 1][place][item]).only_enforce_if(still)
        for hole_at, origin in product(range(count), repeat=2):
            if hole_at == origin:
                continue
            moved = model.new_bool_var("")
            model.add_bool_or([~hole[step][hole_at], ~hole[step + 1][origin], moved])
            cost.append(round(UNIT_PER_MM * legs.between_mm[hole_at][origin]) * moved)
            for item in range(count - 1):
                model.add(stands[step + 1][hole_at][item] == stands[step][origin][item]).only_enforce_if(moved)
            if step + 1 < moves:
                empty = model.new_bool_var("")
                model.add_bool_or([~hole[step][hole_at], ~hole[step + 2][origin], empty])
                cost.append(round(UNIT_PER_MM * legs.between_mm[hole_at][origin]) * empty)
    for place in range(count):
        # The first object comes from the hole's second place, the last one goes to its last but one.
        cost.append(round(UNIT_PER_MM * legs.home_mm[place]) * hole[1][place])
        cost.append(round(UNIT_PER_MM * legs.home_mm[place]) * hole[moves - 1][place])
    model.minimize(sum(cost))
    return model


def order_model(problem: Problem) -> cp_model.CpModel:
    """Return who is picked when and who stands at its goal when; an object whose goal is free goes there at once."""
    model = cp_model.CpModel()
    table = conflict_table(problem)
    start, target = start_and_target(problem)
    count = len(start)
    picked = [model.new_int_var(0, 2 * count, "") for _ in start]
    placed = [model.new_int_var(0, 2 * count, "") for _ in start]
    buffered = [model.new_bool_var("") for _ in start]
    for item in range(count):
        model.add(placed[item] == picked[item]).only_enforce_if(~buffered[item])
        model.add(placed[item] > picked[item]).only_enforce_if(buffered[item])
        for other in range(count):
            if other != item and table.blocked_by[item][target[item]] & table.bit(other, start[other]):
                model.add(placed[item] > picked[other])
    model.minimize(sum(buffered))
    return model


if __name__ == "__main__":
    main()
