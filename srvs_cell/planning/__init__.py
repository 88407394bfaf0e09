"""Planning: goal rules, fewest moves, shortest travel, checked plan."""

from srvs_cell.planning.arm import ArmParameters
from srvs_cell.planning.buffers import Workspace
from srvs_cell.planning.carrying import Carry, turned, turned_deg
from srvs_cell.planning.explain import explain, what_would_help
from srvs_cell.planning.hand import Approach, HandMotion
from srvs_cell.planning.kept_places import KeptPlaces
from srvs_cell.planning.legs import LegTops
from srvs_cell.planning.parameters import FingerGeometry, PlanningParameters, SearchLimits
from srvs_cell.planning.picture import plan_svg
from srvs_cell.planning.planner import has_plan, plan, plan_to_json
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
from srvs_cell.planning.relocation import CellGoal, CellMove, CellPlan, plan_relocation
from srvs_cell.planning.rules import (
    Choice,
    ElementChange,
    HeightOrder,
    NominalPlace,
    PositionCorrection,
    Rule,
    Standing,
    TaughtPlace,
    make_rule,
    taught_places,
)
from srvs_cell.planning.table import TableProblem, footprint_centroid_mm, table_problem, why_not_taken
from srvs_cell.planning.validator import validate
from srvs_cell.planning.view import View

__all__ = [
    "Approach",
    "ArmParameters",
    "AssignGoal",
    "Carry",
    "CellGoal",
    "CellMove",
    "CellPlan",
    "Choice",
    "Disc",
    "ElementChange",
    "FingerGeometry",
    "FingerGrip",
    "Footprint",
    "HandMotion",
    "HeightOrder",
    "KeptPlaces",
    "LegTops",
    "NominalPlace",
    "Obstacle",
    "PlanningParameters",
    "Polygon",
    "PositionCorrection",
    "Problem",
    "ProblemObject",
    "RankGoal",
    "Rectangle",
    "Rule",
    "SearchLimits",
    "Standing",
    "TableProblem",
    "TaughtPlace",
    "View",
    "Workspace",
    "explain",
    "footprint_centroid_mm",
    "has_plan",
    "make_rule",
    "plan",
    "plan_relocation",
    "plan_svg",
    "plan_to_json",
    "read_problems",
    "table_problem",
    "taught_places",
    "turned",
    "turned_deg",
    "validate",
    "what_would_help",
    "why_not_taken",
]
