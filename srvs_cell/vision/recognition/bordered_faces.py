"""Step 11d, beyond the paper: the faces that one straight border in space and the outline of what rises enclose.

Where a top has nearly the table's grey, or its shadow's, only one of its sides may show as a line in both images. That
gives the face's height, its attitude and one side; how far it reaches tells the outline of what rises, from which the
height takes the parallax away.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.faces.face import Face, Figure, same_place
from srvs_cell.vision.recognition.ledges import LEAST_SIDE_MM, MOST_SIDE_MM, SAME_MM
from srvs_cell.vision.recognition.rising_faces import without_parallax

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from srvs_cell.geometry import Array
    from srvs_cell.vision.recognition.ledges import Ledges
    from srvs_cell.vision.rectification import RectifiedRig

_LEAST_MM = 12.0
"""A shorter line may be anything."""
_MOST_BORDERS = 4
"""So many of the longest borders of an outline are tried."""


def bordered_faces(
    ledges: Ledges, outlines_px: Iterable[Array], rig: RectifiedRig, table_z_mm: float, known: Sequence[Face] = ()
) -> list[Face]:
    """Return the different level rectangles that have a level ledge as a side and reach to the end of an outline.

    Args:
        ledges: borders in space.
        outlines_px: convex outlines of what rises, in the left image, each of shape (N, 2).
        rig: the rectified cameras.
        table_z_mm: height of the table, base frame.
        known: faces that were returned before, or that two borders span: they are left out.
    """
    found = list(known)
    for outline_px in outlines_px:
        for ends_mm in _longest(ledges, outline_px):
            inside_mm = without_parallax(outline_px, rig, float(ends_mm[0, 2]), table_z_mm)
            faces = [] if inside_mm is None else _reaching(ends_mm, inside_mm)
            found += [face for face in faces if not any(same_place(face, other, SAME_MM) for other in found)]
    return found[len(known) :]


def _longest(ledges: Ledges, outline_px: Array) -> list[Array]:
    """Return the ends of the longest level ledges at an outline, each of shape (2, 3)."""
    run = ledges.ends_mm[:, 1] - ledges.ends_mm[:, 0]
    length_mm = np.linalg.norm(run, axis=1)
    level = (run[:, 2] == 0.0) & (length_mm > _LEAST_MM)
    there = np.flatnonzero(level & ledges.at_outline(outline_px.astype(np.float32)))
    return list(ledges.ends_mm[there[np.argsort(-length_mm[there])[:_MOST_BORDERS]]])


def _reaching(ends_mm: Array, inside_mm: Array) -> list[Face]:
    """Return rectangles beside a border, ends of shape (2, 3), that reach to the end of an outline, shape (N, 2).

    The border may be a piece of its side: the side may be as long as the outline, too.
    """
    run = (ends_mm[1] - ends_mm[0])[:2]
    length_mm = float(np.linalg.norm(run))
    along = run / length_mm
    axes = np.array([along, (-along[1], along[0])])
    middle = ends_mm.mean(axis=0)[:2]
    u, v = ((inside_mm - middle) @ axes.T).T
    # the outline lies on the side of the border to which it reaches farther
    across = float(v.max()) if v.max() > -v.min() else float(v.min())
    faces = []
    for low, high in ((-length_mm / 2.0, length_mm / 2.0), (float(u.min()), float(u.max()))):
        if min(high - low, abs(across)) > LEAST_SIDE_MM and max(high - low, abs(across)) < MOST_SIDE_MM:
            x_mm, y_mm = (float(value) for value in middle + ((low + high) / 2.0, across / 2.0) @ axes)
            angle_rad = float(np.arctan2(along[1], along[0]))
            faces.append(Face(Figure.RECTANGLE, x_mm, y_mm, float(ends_mm[0, 2]), angle_rad, high - low, abs(across)))
    return faces
