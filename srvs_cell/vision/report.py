"""A perception as the JSON of the command line's contract (design.md section 9)."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from srvs_cell.scene import Grasp, Perception, Plane, PlaneMatch, Workpiece


def perception_to_json(perception: Perception, *, calibrated: bool = True) -> dict[str, Any]:
    """Return planes, matches, workpieces and times as plain values.

    Args:
        perception: what was seen.
        calibrated: whether there are places in millimetres; without, ``workpieces`` is left out.
    """
    report: dict[str, Any] = {
        "planes_left": [_plane(plane) for plane in perception.left.planes],
        "planes_right": [_plane(plane) for plane in perception.right.planes],
        "matches": [_match(match) for match in perception.matches],
        # without numbers: planes_left holds surfaces that were joined since
        "ambiguous_planes": [
            {key: value for key, value in _plane(plane).items() if key != "id"} for plane in perception.ambiguous_planes
        ],
    }
    if calibrated:
        report["workpieces"] = [workpiece_to_json(workpiece) for workpiece in perception.workpieces]
        if perception.table is not None:
            report["table"] = asdict(perception.table)
    report["timings_ms"] = dict(perception.timings_ms)
    return report


def workpiece_to_json(workpiece: Workpiece) -> dict[str, Any]:
    """Return a workpiece with its grasp as plain values; millimetres and degrees in the base frame."""
    grasp = workpiece.grasp
    return {
        "id": workpiece.id,
        "kind": workpiece.kind,
        "position_mm": list(workpiece.position_mm),
        "height_mm": workpiece.height_mm,
        "yaw_deg": workpiece.yaw_deg,
        "rise_deg": workpiece.rise_deg,
        "size_mm": list(workpiece.size_mm),
        "brightness": workpiece.brightness,
        "covariance_mm2": workpiece.covariance_mm2.tolist(),
        "systematic_mm2": None if workpiece.systematic_mm2 is None else workpiece.systematic_mm2.tolist(),
        "footprint_mm": workpiece.footprint_mm.tolist(),
        "surfaces": list(workpiece.surfaces),
        "grasp": None if grasp is None else {**_grasp(grasp), "others": [_grasp(other) for other in grasp.others]},
        "grasp_refusal": workpiece.grasp_refusal,
    }


def _grasp(grasp: Grasp) -> dict[str, Any]:
    return {
        "position_mm": list(grasp.position_mm),
        "yaw_deg": grasp.yaw_deg,
        "opening_mm": grasp.opening_mm,
        "clearance_mm": grasp.clearance_mm,
    }


def _plane(plane: Plane) -> dict[str, Any]:
    return {
        "id": plane.id,
        "centre_px": list(plane.centre_px),
        "area_px": plane.area_px,
        "perimeter_px": plane.perimeter_px,
        "short_cut_px": plane.short_cut_px,
        "long_cut_px": plane.long_cut_px,
        "brightness": plane.brightness,
    }


def _match(match: PlaneMatch) -> dict[str, Any]:
    return {
        "left": match.left,
        "right": match.right,
        "score": match.score,
        "disparity_px": match.disparity_px,
        "disparity_plane": list(match.disparity_plane),
    }
