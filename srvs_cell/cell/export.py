"""The unit's values as plain JSON: what `Unit.snapshot`, the run folder and the journal hold."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from srvs_cell.planning import CellPlan
    from srvs_cell.ports import RobotStatus
    from srvs_cell.scene import Workpiece

Json = dict[str, Any]


def workpiece_json(workpiece: Workpiece) -> Json:
    """Return a workpiece with the keys of ``perceive --json``, and its grasp."""
    grasp = workpiece.grasp
    return {
        "id": workpiece.id,
        "kind": workpiece.kind,
        "position_mm": _rounded(workpiece.position_mm),
        "height_mm": round(workpiece.height_mm, 3),
        "yaw_deg": None if workpiece.yaw_deg is None else round(workpiece.yaw_deg, 3),
        "rise_deg": None if workpiece.rise_deg is None else round(workpiece.rise_deg, 3),
        "size_mm": _rounded(workpiece.size_mm),
        "brightness": workpiece.brightness,
        "covariance_mm2": [_rounded(row) for row in workpiece.covariance_mm2],
        "footprint_mm": [_rounded(point) for point in workpiece.footprint_mm],
        "surfaces": list(workpiece.surfaces),
        "grasp": None
        if grasp is None
        else {
            "position_mm": _rounded(grasp.position_mm),
            "yaw_deg": round(grasp.yaw_deg, 3),
            "opening_mm": round(grasp.opening_mm, 3),
        },
        "grasp_refusal": workpiece.grasp_refusal,
    }


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


def _rounded(values: Any) -> list[float]:
    return [round(float(value), 4) for value in values]
