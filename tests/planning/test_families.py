"""The problems with proven optima: moves exactly, travel within 0.01 mm, every plan accepted by the validator."""

from typing import Any

import pytest

from srvs_cell.planning import Problem, plan, validate
from srvs_cell.scene import Move
from tests.planning.problems import instances

FAMILIES = {
    "perm": 81,
    "ties": 53,
    "ties_chain": 20,
    "dense_disc": 30,
    "dense_rect": 20,
    "dense_free": 24,
    "gripper": 28,
    "obstacle": 16,
    "unreachable": 24,
    "correction": 26,
    "replace": 20,
}


@pytest.mark.parametrize(("family", "size"), FAMILIES.items())
def test_every_problem_of_the_family_has_its_proven_optimum(family: str, size: int) -> None:
    chosen = [instance for instance in instances() if instance["family"] == family]
    assert len(chosen) == size
    wrong = [line for line in map(_disagreement, chosen) if line]
    assert not wrong, "\n".join(wrong)


def _disagreement(instance: dict[str, Any]) -> str:
    """Return what differs from the proven optimum; the planner is not shown the optimum."""
    optimal = instance["optimal"]
    name = instance["id"]
    problem = Problem.from_mapping({key: value for key, value in instance.items() if key != "optimal"}, name)
    answer = plan(problem)
    if answer.status != optimal["status"]:
        return f"{name}: {answer.status}, proven is {optimal['status']}"
    if answer.status == "infeasible":
        return "" if answer.reasons else f"{name}: infeasible without a reason"
    if len(answer.moves) != optimal["moves"] or abs(answer.travel_mm - optimal["travel_mm"]) > 0.01:
        return f"{name}: {len(answer.moves)} moves, {answer.travel_mm} mm, proven is {optimal}"
    refusals = validate(problem, answer.moves) + validate(problem, [Move(*step) for step in optimal["plan"]])
    return f"{name}: {refusals}" if refusals else ""
