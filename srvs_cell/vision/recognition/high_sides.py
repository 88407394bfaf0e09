"""Step 11d, beyond the paper: wedges of which only the high side rises.

Where a wedge is low its border falls almost on itself when the right image is laid over the left one by the table. What
rises is one strip, the border of its high side, and encloses no face. The plane beside the strip has the face's own
outline: which of its sides rises tells how the wedge stands; several heights are tried.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.recognition.face_pieces import plane_hulls
from srvs_cell.vision.recognition.rising_faces import laid_on, surrounding_rectangle
from srvs_cell.vision.recognition.tops import explained_polygons
from srvs_cell.vision.relief import rising_share, unexplained

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.vision.faces.face import Face
    from srvs_cell.vision.recognition.evidence import Evidence
    from srvs_cell.vision.recognition.tops import Top
    from srvs_cell.vision.rectification import RectifiedRig
    from srvs_cell.vision.relief import Relief

_LEAST_SHARE = 0.12
"""Share of a plane's outline that rises at least: half of one side of four."""
_SIDE_SHARE = 0.5
"""Share of a high side that rises at least."""
_ALONG = np.linspace(-0.8, 0.8, 17)
"""Where a side is looked at, -1 to 1: near its ends the neighbouring one may rise."""
_HEIGHTS = 8
"""Of the high side, each more than the one before by the same factor: a low wedge is the likelier one."""
_LOW_SHARES = (0.0, 0.5)
"""Height of the low side over that of the high one."""
_SIDES = 4


def high_sided_wedges(known: Sequence[Top], relief: Relief, evidence: Evidence) -> list[Face]:
    """Return inclined rectangles over planes of the left image of which one side rises, to begin fits at.

    Args:
        known: tops; what rises because of them tells no other one.
        relief: what rises over the table.
        evidence: the images.
    """
    rig, table_z_mm = evidence.rig, evidence.table_z_mm
    rising = unexplained(relief, explained_polygons(list(known), rig, table_z_mm))
    return [
        wedge
        for hull in plane_hulls(evidence.left, rig, table_z_mm, evidence.limits.max_size_mm)
        if rising_share(rising, hull) >= _LEAST_SHARE
        for wedge in _wedges_over(hull, rising, evidence)
    ]


def _wedges_over(hull: NDArray[np.float32], rising: NDArray[np.uint8], evidence: Evidence) -> list[Face]:
    """Return wedges whose picture a hull of the left image, shape (N, 2), may be, high where its outline rises."""
    limits, table_z_mm = evidence.limits, evidence.table_z_mm
    gentlest, steepest = np.tan(np.deg2rad([limits.min_inclination_deg, limits.max_inclination_deg]))
    wedges = []
    for high_mm in np.geomspace(limits.min_height_mm, limits.max_height_mm, _HEIGHTS).tolist():
        for low_mm in (share * high_mm for share in _LOW_SHARES):
            z_mm = table_z_mm + (low_mm + high_mm) / 2.0
            level = surrounding_rectangle(laid_on(hull.astype(np.float64), evidence.rig, z_mm), z_mm)
            for _ in range(_SIDES):
                level = level.quarter_turned()
                slope = (high_mm - low_mm) / level.length_mm
                if gentlest < slope < steepest and _far_side_share(level, rising, evidence.rig) > _SIDE_SHARE:
                    wedges.append(replace(level, slope_u=slope))
    return wedges


def _far_side_share(rectangle: Face, rising: NDArray[np.uint8], rig: RectifiedRig) -> float:
    """Return how much of the side at the end of a level rectangle's length lies where something rises."""
    x, y, _ = rig.project_px(rectangle.place(np.column_stack([np.ones_like(_ALONG), _ALONG])))
    height, width = rising.shape
    column, row = np.rint(x).astype(np.intp), np.rint(y).astype(np.intp)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    return float(rising[row[inside], column[inside]].sum()) / _ALONG.size
