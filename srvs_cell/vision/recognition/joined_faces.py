"""Step 11d, beyond the paper: one face in two lights.

The shadow of a taller neighbour, or a printed band, cuts a top face into two rectangles that fit as well as any face.
Parts that stand beside each other are hardly as high as each other and flush at both ends besides: what is, is one
face, unless both are of one size, like parts in a row.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.faces.face import Face, Figure

if TYPE_CHECKING:
    from collections.abc import Sequence

_FLUSH_MM = 2.0
"""Sides of one face run on into each other within this."""
_SAME_HEIGHT_MM = 3.0
_TURNED = float(np.sin(np.deg2rad(5.0)))
"""Sides of one face are parallel or square to each other within this."""


def joined_faces(faces: Sequence[Face]) -> list[tuple[int, int, Face]]:
    """Return the pairs of faces, by their numbers, that may be one rectangle, and that rectangle."""
    pairs = [(one, other, _joined(faces[one], faces[other])) for one, other in combinations(range(len(faces)), 2)]
    return [(one, other, face) for one, other, face in pairs if face is not None]


def _joined(face: Face, other: Face) -> Face | None:
    """Return the rectangle that two rectangles of one plane fill, None where they are no halves of one."""
    if {face.figure, other.figure} != {Figure.RECTANGLE}:
        return None
    if abs(face.height_at_mm(other.x_mm, other.y_mm) - other.z_mm) > _SAME_HEIGHT_MM:
        return None
    if abs(np.sin(2.0 * (face.angle_rad - other.angle_rad))) > 2.0 * _TURNED:
        return None
    along = np.array([np.cos(face.angle_rad), np.sin(face.angle_rad)])
    axes = np.array([along, (-along[1], along[0])])
    own, others = ((one.corners_mm()[:, :2] - (face.x_mm, face.y_mm)) @ axes.T for one in (face, other))
    low, high = (np.stack([reach(one, axis=0) for one in (own, others)]) for reach in (np.min, np.max))
    flush = (np.abs(low[0] - low[1]) < _FLUSH_MM) & (np.abs(high[0] - high[1]) < _FLUSH_MM)
    # along one axis they are flush, along the other one begins where the other ends
    meet = np.abs(np.max(low, axis=0) - np.min(high, axis=0)) < _FLUSH_MM
    sizes = high - low
    across = np.flatnonzero(flush & meet[::-1])
    if across.size != 1 or np.abs(sizes[0] - sizes[1]).max() < _FLUSH_MM:
        return None
    low, high = low.min(axis=0), high.max(axis=0)
    x_mm, y_mm = (float(value) for value in (low + high) / 2.0 @ axes + (face.x_mm, face.y_mm))
    length_mm, width_mm = (float(value) for value in high - low)
    z_mm = face.height_at_mm(x_mm, y_mm)
    return replace(face, x_mm=x_mm, y_mm=y_mm, z_mm=z_mm, length_mm=length_mm, width_mm=width_mm)
