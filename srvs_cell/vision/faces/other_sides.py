"""Step 11d, beyond the paper: what a rectangle that fits badly may be instead.

The foot of a side face, the edge of a shadow and a frame of print run parallel to the sides of a top face, a few
pixels beside them. A rectangle that was fitted to such a line has another height or size than the face. Here the
lines beside each side are found; each makes another rectangle, to be fitted and judged like the first. So does the
slope that a level one may have, and the level one that a slanted one may be. A slanted one that ends over the table may
go down to it: there the border of a wedge without a step is often not to be seen.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.faces.face import SIDES, Face, Figure, inclined_faces

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces.edge_fit import EdgeField
    from srvs_cell.vision.rectification import RectifiedRig

_OFFSETS_PX = np.arange(-20.0, 20.5, 0.5)
_LEAST_PX = 1.5
"""A line nearer to a side than this is the side."""
_ALONG = np.linspace(-0.7, 0.7, 32)
"""Where on a side, -1 to 1, the picture is read: near its ends the neighbouring side's line is met."""
_LINES_OF_SIDE = 2
_SLOPE = 0.3
"""Rise per millimetre from which all the slopes that parts have are within reach."""
_LEAST_STEP_MM = 3.0
"""A slanted face that ends lower over the table ends where it meets it, give or take what is wrong with its height."""
_MOST_LONGER = 1.0
"""No face goes down to the table by more than its own length."""
_LEAST_LEFT = 0.3
"""No side moves so far inwards that less of the rectangle is left."""


def other_rectangles(
    face: Face, field: EdgeField, rig: RectifiedRig, table_z_mm: float, min_gradient: float
) -> list[Face]:
    """Return what a rectangle may be instead: with one side elsewhere, or inclined where it is level.

    Args:
        face: other figures than rectangles have no alternative.
        field: gradient of the rectified left image.
        rig: the rectified cameras.
        table_z_mm: height of the table, base frame.
        min_gradient: least gradient of a line, grey values per pixel.
    """
    if face.figure is not Figure.RECTANGLE:
        return []
    offsets_mm = _OFFSETS_PX * float(rig.base_T_camera.translation_mm[2] - face.z_mm) / rig.f_px
    if face.slope_u == 0.0:
        found = inclined_faces(face, _SLOPE)
    else:
        found = [replace(face, slope_u=0.0), *_down_to_table(face, table_z_mm)]
    for side in SIDES:
        size_mm = (face.length_mm, face.width_mm)[side[0]]
        beside = face.beside(side, offsets_mm, _ALONG).reshape(-1, 3)
        shifts_mm = offsets_mm[_lines(beside, field, rig, min_gradient)]
        found += [face.stretched(side, float(shift)) for shift in shifts_mm if size_mm + shift > _LEAST_LEFT * size_mm]
    return found


def _down_to_table(face: Face, table_z_mm: float) -> list[Face]:
    """Return a slanted rectangle that ends where its plane meets the table; nothing where it does so about itself."""
    step_mm = face.lowest_mm - table_z_mm
    longer_mm = step_mm / abs(face.slope_u)
    if step_mm < _LEAST_STEP_MM or longer_mm > _MOST_LONGER * face.length_mm:
        return []
    return [face.stretched((0, -float(np.sign(face.slope_u))), longer_mm)]


def _lines(points_mm: Array, field: EdgeField, rig: RectifiedRig, min_gradient: float) -> NDArray[np.intp]:
    """Return the numbers of the offsets at which the strongest lines run, shape (N,).

    Args:
        points_mm: points beside a side, by offset and place along it, base frame, shape (offsets x places, 3).
        field: gradient of the left image.
        rig: the rectified cameras.
        min_gradient: least gradient of a line.
    """
    x, y, _ = rig.project_px(points_mm)
    last = _ALONG.size - 1
    along_x, along_y = x[last] - x[0], y[last] - y[0]
    length = np.hypot(along_x, along_y)
    points_px = np.stack([x, y])[None]
    across = np.broadcast_to(np.array([[along_y], [-along_x]]) / length, points_px.shape)
    slopes = field.along_normals(points_px, across, np.zeros(1, dtype=np.float32))
    # what does not run along most of the side, like print, has no say in the median
    line = np.abs(np.median(slopes.reshape(_OFFSETS_PX.size, _ALONG.size), axis=1))
    peak = np.zeros(line.shape, dtype=np.bool_)
    peak[1:-1] = (line[1:-1] >= line[:-2]) & (line[1:-1] > line[2:])
    there = np.flatnonzero(peak & (line >= min_gradient) & (np.abs(_OFFSETS_PX) >= _LEAST_PX))
    return there[np.argsort(-line[there])[:_LINES_OF_SIDE]]
