"""How much room a grasp has beside what else stands on the table."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.recognition.grasping import PAD_MM

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.scene import Grasp, Workpiece

_FAR_MM = 5000.0
"""No arm reaches so far."""


def with_clearances(workpieces: Sequence[Workpiece], table_z_mm: float) -> list[Workpiece]:
    """Return workpieces whose grasps say how far the nearest neighbour of their jaws is.

    Which of its grasps a part is taken by stays the planner's choice: it knows the fingers, and which neighbours will
    have left by then.

    Args:
        workpieces: all that stands there.
        table_z_mm: height of the table, base frame.
    """
    told = []
    for workpiece in workpieces:
        if workpiece.grasp is not None:
            neighbours = [other for other in workpieces if other is not workpiece]
            first, *further = (
                replace(grasp, clearance_mm=_clearance_mm(grasp, neighbours, table_z_mm))
                for grasp in workpiece.grasp.choices
            )
            workpiece = replace(workpiece, grasp=replace(first, others=tuple(further)))  # noqa: PLW2901
        told.append(workpiece)
    return told


def _clearance_mm(grasp: Grasp, neighbours: Sequence[Workpiece], table_z_mm: float) -> float | None:
    """Return the least distance from a gripped wall to a neighbour above the finger tips, or None without one."""
    x_mm, y_mm, tip_z_mm = grasp.position_mm
    closing_rad = np.deg2rad(grasp.yaw_deg)
    closing = np.array([np.cos(closing_rad), np.sin(closing_rad)])
    axes = np.stack([closing, (-closing[1], closing[0])], axis=1)
    wall_mm = grasp.opening_mm / 2.0
    pad = np.array([(wall_mm, -PAD_MM), (_FAR_MM, -PAD_MM), (_FAR_MM, PAD_MM), (wall_mm, PAD_MM)], dtype=np.float32)
    nearest_mm = []
    for other in neighbours:
        if table_z_mm + other.height_mm <= tip_z_mm:
            continue
        outline = ((other.footprint_mm - (x_mm, y_mm)) @ axes).astype(np.float32)
        for before_pad in (outline, -outline):
            shared_mm2, met = cv2.intersectConvexConvex(pad, before_pad)
            if shared_mm2 > 0.0:
                nearest_mm.append(max(0.0, float(met.reshape(-1, 2)[:, 0].min()) - wall_mm))
    return min(nearest_mm, default=None)
