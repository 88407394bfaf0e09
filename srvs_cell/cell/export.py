"""The unit's values as plain JSON: what `Unit.snapshot`, the run folder and the journal hold."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from srvs_cell.vision import workpiece_to_json

if TYPE_CHECKING:
    from srvs_cell.planning import CellPlan
    from srvs_cell.ports import RobotStatus
    from srvs_cell.scene import Workpiece

Json = dict[str, Any]
_DECIMALS = 4


def workpiece_json(workpiece: Workpiece) -> Json:
    """Return a workpiece with the keys of ``perceive --json``, rounded."""
    return {key: _shortened(value) for key, value in workpiece_to_json(workpiece).items()}


def plan_list(plan: CellPlan) -> list[list[int]]:
    """Return a plan as the ``plan`` command writes it: ``[[object, from, to], ...]``."""
    return [[move.object, move.from_place, move.to_place] for move in plan.relocation.moves]


def plan_json(plan: CellPlan) -> Json:
    """Return a plan with its proofs, its reasons and its moves in millimetres."""
    relocation = plan.relocation
    return {
        "status": relocation.status.value,
        "plan": plan_list(plan),
        "travel_mm": round(relocation.travel_mm, 3),
        "moves_proven": relocation.moves_proven,
        "travel_proven": relocation.travel_proven,
        "bound_moves": relocation.bound_moves,
        "bound_travel_mm": round(relocation.bound_travel_mm, 3),
        "time_s": None if relocation.time_s is None else round(relocation.time_s, 3),
        "bound_time_s": None if relocation.bound_time_s is None else round(relocation.bound_time_s, 3),
        "reasons": list(relocation.reasons),
        "moves": [
            {
                "workpiece": move.workpiece,
                "grasp": move.grasp,
                "from_mm": _rounded(move.from_mm),
                "to_mm": _rounded(move.to_mm),
                "turn_deg": round(move.turn_deg, 3),
                "tops_mm": _rounded((move.tops.to_pick_mm, move.tops.carried_mm, move.tops.away_mm)),
            }
            for move in plan.moves
        ],
        "goals": [{"workpiece": goal.workpiece, "point_mm": _rounded(goal.point_mm)} for goal in plan.goals],
        "buffers_mm": [_rounded(point) for point in plan.buffers_mm],
    }


def status_json(status: RobotStatus, now_s: float) -> Json:
    """Return the arm's status and its age."""
    return {
        "pose": _rounded(status.pose.as_tuple()),
        "mode": status.mode.value,
        "pendant_enabled": status.pendant_enabled,
        "servo_on": status.servo_on,
        "moving": status.moving,
        "override_percent": status.override_percent,
        "fault": status.fault,
        "user_frame": status.user_frame,
        "user_tool": status.user_tool,
        "session_owner": status.session_owner,
        "status_age_s": round(max(0.0, now_s - status.read_at_s), 3),
    }


def _shortened(value: Any) -> Any:
    """Return a plain value with each of its fractions rounded."""
    if isinstance(value, float):
        return round(float(value), _DECIMALS)
    if isinstance(value, list):
        return [_shortened(one) for one in value]
    if isinstance(value, dict):
        return {key: _shortened(one) for key, one in value.items()}
    return value


def _rounded(values: Any) -> list[float]:
    return [round(float(value), _DECIMALS) for value in values]
