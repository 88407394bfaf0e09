"""How a parallel gripper takes a recognised workpiece from above, or why it cannot."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Self

import cv2
import numpy as np
from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass

from srvs_cell.geometry import wrap_angle_deg
from srvs_cell.scene import Grasp
from srvs_cell.vision.faces.face import Figure
from srvs_cell.vision.limit_pairs import check_pairs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces.face import Face

_HALF_TURN_DEG = 180.0
_ROUND_TURNS_DEG = (0.0, 90.0, 45.0, 135.0)
"""A round part may be gripped from any side: these leave room beside a neighbour wherever it stands."""
_FLAT_NORMALS_DEG = (30.0, 90.0, 150.0)
"""From a hexagon's corner to the middles of its flats."""
_LEVEL_SLOPE = 0.05
"""A face that rises more is gripped in one way only: its other two walls are of different heights."""
PAD_MM = 8.0
"""Half the width of a finger's pad: as far beside its middle it meets a wall, too."""
_SEAM_MM = 2.0
"""A wall this far from a pad is met: measured outlines do not fit their common rectangle exactly."""


@dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid"))
class GraspParameters:
    """What the gripper can take and how it takes it."""

    depth_mm: Annotated[
        float, Field(gt=0.0, le=200.0, description="how far the finger tips reach below the top of the gripped walls")
    ] = 12.0
    clearance_mm: Annotated[
        float, Field(ge=0.0, le=100.0, description="least height of the finger tips above the table")
    ] = 3.0
    min_wall_mm: Annotated[
        float, Field(gt=0.0, le=200.0, description="least height of wall between the finger tips and its upper edge")
    ] = 3.0
    min_opening_mm: Annotated[float, Field(ge=0.0, le=1000.0, description="least opening of the closed jaws")] = 0.0
    max_opening_mm: Annotated[
        float, Field(gt=0.0, le=1000.0, description="widest part that fits between the open jaws")
    ] = 80.0
    tolerance_mm: Annotated[
        float, Field(gt=0.0, le=100.0, description="how far off in x or y a grasp may be and still hold")
    ] = 4.0
    sigmas: Annotated[
        float, Field(gt=0.0, le=10.0, description="how many standard deviations of the position must fit the tolerance")
    ] = 2.0

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        check_pairs(self, ("min_opening_mm", "max_opening_mm"))
        return self


def plan_grasp(
    face: Face, covariance_mm2: Array, table_z_mm: float, parameters: GraspParameters
) -> tuple[Grasp | None, str]:
    """Return the grasp of a workpiece by its top face, or None and the reason.

    The jaws close along the short side; on an inclined face across the slope, where both walls are of one height, and
    along it only where the part is too wide across.

    Args:
        face: the top face, base frame.
        covariance_mm2: 3x3 of its centre.
        table_z_mm: height of the table.
        parameters: what the gripper can take.
    """
    grasp, refusal = _grasp((face.x_mm, face.y_mm), _choices(face, table_z_mm), covariance_mm2, table_z_mm, parameters)
    if grasp is not None and max(abs(face.slope_u), abs(face.slope_v)) > _LEVEL_SLOPE:
        grasp = replace(grasp, others=())
    return grasp, refusal


def plan_joint_grasp(
    body: Face, faces: Sequence[Face], covariance_mm2: Array, table_z_mm: float, parameters: GraspParameters
) -> tuple[Grasp | None, str]:
    """Return the grasp of an object of several top faces, or None and the reason.

    The jaws close over the middle of the whole, along its short side if they can. What they hold is as high as the
    lowest face that the finger pads meet.

    Args:
        body: the rectangle around all faces, seen from above.
        faces: the top faces, base frame.
        covariance_mm2: 3x3 of the body's centre.
        table_z_mm: height of the table.
        parameters: what the gripper can take.
    """
    angle_deg = float(np.rad2deg(body.angle_rad))
    choices = [
        (angle_deg + 90.0, body.width_mm, _wall_mm(body.quarter_turned(), faces, table_z_mm)),
        (angle_deg, body.length_mm, _wall_mm(body, faces, table_z_mm)),
    ]
    return _grasp((body.x_mm, body.y_mm), choices, covariance_mm2, table_z_mm, parameters)


def _wall_mm(body: Face, faces: Sequence[Face], table_z_mm: float) -> float:
    """Return the height of the lowest wall that pads at both ends of a body's length meet; 0 where there is none."""
    half = min(1.0, 2.0 * PAD_MM / body.width_mm)
    pads = body.place(np.array([(end, across) for end in (-1.0, 1.0) for across in (-half, 0.0, half)]))
    heights = []
    for x_mm, y_mm, _ in pads:
        met = [face.height_at_mm(x_mm, y_mm) - table_z_mm for face in faces if _reaches(face, x_mm, y_mm)]
        heights.append(min(met, default=0.0))
    return min(heights)


def _reaches(face: Face, x_mm: float, y_mm: float) -> bool:
    outline = (face.corners_mm()[:, :2] - (x_mm, y_mm)).astype(np.float32)
    return cv2.pointPolygonTest(outline, (0.0, 0.0), measureDist=True) >= -_SEAM_MM


def _grasp(
    centre_mm: tuple[float, float],
    choices: Sequence[tuple[float, float, float]],
    covariance_mm2: Array,
    table_z_mm: float,
    parameters: GraspParameters,
) -> tuple[Grasp | None, str]:
    """Return the first choice that the gripper can take, with the others, or None and every reason.

    Choices are as of `_choices`.
    """
    sigma_mm = float(np.sqrt(np.linalg.eigvalsh(covariance_mm2[:2, :2]).max()))
    if parameters.sigmas * sigma_mm > parameters.tolerance_mm:
        return None, (
            f"position uncertain: {parameters.sigmas:g} sigma are {parameters.sigmas * sigma_mm:.1f} mm, "
            f"the grasp allows {parameters.tolerance_mm:g} mm"
        )
    refusals, grasps = [], []
    for yaw_deg, opening_mm, wall_mm in choices:
        refusal = _refusal(opening_mm, wall_mm, parameters)
        if refusal:
            refusals.append(refusal)
            continue
        tip_z_mm = max(table_z_mm + parameters.clearance_mm, table_z_mm + wall_mm - parameters.depth_mm)
        closing_deg = wrap_angle_deg(yaw_deg, _HALF_TURN_DEG) % _HALF_TURN_DEG
        grasps.append(Grasp((*centre_mm, tip_z_mm), closing_deg, opening_mm))
    if not grasps:
        return None, "; ".join(refusals)
    return replace(grasps[0], others=tuple(grasps[1:])), ""


def _choices(face: Face, table_z_mm: float) -> list[tuple[float, float, float]]:
    """Return (yaw of the closing motion, opening, height of the lower of both gripped walls), the best first."""
    angle_deg = float(np.rad2deg(face.angle_rad))
    height_mm = face.z_mm - table_z_mm
    if face.figure is Figure.CIRCLE:
        return [(turn_deg, face.length_mm, height_mm) for turn_deg in _ROUND_TURNS_DEG]
    if face.figure is Figure.HEXAGON:
        return [(angle_deg + normal_deg, face.width_mm, height_mm) for normal_deg in _FLAT_NORMALS_DEG]
    # a wall that rises along its length is gripped by its middle, at the centre's height
    across = (angle_deg + 90.0, face.width_mm, height_mm - abs(face.slope_v) * face.width_mm / 2.0)
    along = (angle_deg, face.length_mm, height_mm - abs(face.slope_u) * face.length_mm / 2.0)
    return [along, across] if abs(face.slope_v) > abs(face.slope_u) else [across, along]


def _refusal(opening_mm: float, wall_mm: float, parameters: GraspParameters) -> str:
    if opening_mm > parameters.max_opening_mm:
        return f"too wide: {opening_mm:.1f} mm, the gripper opens {parameters.max_opening_mm:g} mm"
    if opening_mm < parameters.min_opening_mm:
        return f"too narrow: {opening_mm:.1f} mm, the gripper closes to {parameters.min_opening_mm:g} mm"
    least_mm = parameters.clearance_mm + parameters.min_wall_mm
    if wall_mm < least_mm:
        return f"too low: the gripped wall is {wall_mm:.1f} mm high, at least {least_mm:g} mm are needed"
    return ""
