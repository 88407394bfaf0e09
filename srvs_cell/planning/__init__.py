"""Planning: goal rules, fewest moves, shortest travel, checked plan."""

from srvs_cell.planning.parameters import FingerGeometry, PlanningParameters, SearchLimits
from srvs_cell.planning.planner import plan, plan_to_json
from srvs_cell.planning.problem import (
    AssignGoal,
    Disc,
    FingerGrip,
    Footprint,
    Obstacle,
    Polygon,
    Problem,
    ProblemObject,
    RankGoal,
    Rectangle,
    read_problems,
)
from srvs_cell.planning.validator import validate

__all__ = [
    "AssignGoal",
    "Disc",
    "FingerGeometry",
    "FingerGrip",
    "Footprint",
    "Obstacle",
    "PlanningParameters",
    "Polygon",
    "Problem",
    "ProblemObject",
    "RankGoal",
    "Rectangle",
    "SearchLimits",
    "plan",
    "plan_to_json",
    "read_problems",
    "validate",
]
