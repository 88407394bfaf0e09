"""Step 11d, beyond the paper: the faces that two straight borders in space span.

Where a top has the grey of its shadow or of a side face no region has its outline, and what rises encloses its side
faces too. But some of its borders show in both images. Two of them, opposite or at a corner, are a face's two sides:
its place, size, attitude and height, to a millimetre or two, before anything is fitted.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.faces.face import HEXAGON_RATIO, Face, Figure, same_place
from srvs_cell.vision.recognition.ledges import LEAST_RISE, LEAST_SIDE_MM, MOST_SIDE_MM, SAME_MM, STEEPEST

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.recognition.ledges import Ledges
    from srvs_cell.vision.rectification import RectifiedRig

_SQUARE_DEG = 8.0
"""Sides are parallel or square to each other within this."""
_SAME_HEIGHT_MM = 5.0
"""Sides of a level face, or those that meet at a corner, differ less in height."""
_LEAST_SHARED = 0.4
"""Share of the shorter one of opposite borders that lies beside the other one."""
_GAP_SHARE = 0.35
"""Share of a side that may be missing at a corner."""
_COVERED = 0.4
"""Share of the smaller one that a face and the outline of what rises there have in common."""
_MOST_FACES = 15
"""Print has lines enough to span more: those of the longest borders are enough."""


def spanned_faces(
    ledges: Ledges, outlines_px: Iterable[Array], rig: RectifiedRig, known: Sequence[Face] = ()
) -> list[Face]:
    """Return the different faces over outlines of the left image that two of the ledges span.

    Args:
        ledges: borders in space.
        outlines_px: convex outlines of what rises, each of shape (N, 2); of a wedge it encloses the high part alone.
        rig: the rectified cameras.
        known: faces that were returned before: they are left out.
    """
    found = list(known)
    for outline_px in outlines_px:
        faces = _over(outline_px.astype(np.float32), ledges, rig)
        found += [face for face in faces if not any(same_place(face, other, SAME_MM) for other in found)]
    return found[len(known) :]


def _over(outline: NDArray[np.float32], ledges: Ledges, rig: RectifiedRig) -> list[Face]:
    """Return the spanned faces over one outline, those of the longest borders first."""
    faces: list[Face] = []
    for longer, shorter in _pairs(ledges, outline):
        for face in _span(longer, shorter):
            if _covers(face, outline, rig) and not any(same_place(face, known, SAME_MM) for known in faces):
                faces.append(face)
        if len(faces) >= _MOST_FACES:
            break
    return faces


def _pairs(ledges: Ledges, outline: NDArray[np.float32]) -> list[tuple[Array, Array]]:
    """Return pairs of ledges that may be sides of one face, at least one of them at the outline; the longest first."""
    run = ledges.ends_mm[:, 1] - ledges.ends_mm[:, 0]
    length_mm = np.linalg.norm(run, axis=1)
    direction_deg = np.rad2deg(np.arctan2(run[:, 1], run[:, 0]))
    turned_deg = (direction_deg[:, None] - direction_deg + 45.0) % 90.0 - 45.0
    middle_mm = ledges.ends_mm.mean(axis=1)
    apart_mm = np.linalg.norm(middle_mm[:, None] - middle_mm, axis=2)
    related = (np.abs(turned_deg) < _SQUARE_DEG) & (apart_mm < MOST_SIDE_MM)
    at_outline = ledges.at_outline(outline)
    first, second = np.nonzero(np.triu(related & (at_outline[:, None] | at_outline), 1))
    pairs = sorted(
        (sorted(pair, key=lambda row: -length_mm[row]) for pair in zip(first, second, strict=True)),
        key=lambda pair: -length_mm[pair].sum(),
    )
    return [(ledges.ends_mm[longer], ledges.ends_mm[shorter]) for longer, shorter in pairs]


def _covers(face: Face, outline: NDArray[np.float32], rig: RectifiedRig) -> bool:
    """Whether a face and an outline share a good part of the smaller one."""
    x, y, _ = rig.project_px(face.corners_mm())
    seen = cv2.convexHull(np.column_stack([x, y]).astype(np.float32))
    shared, _ = cv2.intersectConvexConvex(seen, outline)
    return bool(shared > _COVERED * min(cv2.contourArea(seen), cv2.contourArea(outline)))


def _span(longer: Array, shorter: Array) -> list[Face]:
    """Return the faces that two borders, ends in the base frame, each of shape (2, 3), have as sides."""
    run = longer[1] - longer[0]
    angle_rad = float(np.arctan2(run[1], run[0]))
    along = run[:2] / np.linalg.norm(run[:2])
    axes = np.array([along, (-along[1], along[0])])
    one, other = (np.column_stack([ends[:, :2] @ axes.T, ends[:, 2]]) for ends in (longer, shorter))
    both = np.concatenate([one, other])[:, :2]
    size, middle = np.ptp(both, axis=0), (both.min(axis=0) + both.max(axis=0)) / 2.0
    if size.min() < LEAST_SIDE_MM:
        return []
    turned = np.abs(other[1] - other[0])
    opposite = bool(turned[0] > turned[1])
    faces = []
    for tilt in _opposite(one, other) if opposite else _at_corner(one, other, size):
        if np.abs(tilt).max() > STEEPEST:
            continue
        z_mm = float(np.mean([side[2] + tilt @ (middle - side[:2]) for side in (one.mean(axis=0), other.mean(axis=0))]))
        x_mm, y_mm = (float(value) for value in middle @ axes)
        length_mm, width_mm = (float(value) for value in size)
        face = Face(Figure.RECTANGLE, x_mm, y_mm, z_mm, angle_rad, length_mm, width_mm)
        # what rises along its width rises along its length after a quarter turn
        faces.append(
            replace(face, slope_u=tilt[0]) if tilt[1] == 0.0 else replace(face.quarter_turned(), slope_u=tilt[1])
        )
        if opposite and not tilt.any():
            across_corners_mm = width_mm / HEXAGON_RATIO
            faces.append(replace(face, figure=Figure.HEXAGON, length_mm=across_corners_mm))
    return faces


def _opposite(one: Array, other: Array) -> list[Array]:
    """Return how a face may rise along u and v whose opposite sides run along u; sides (u, v, z), shape (2, 3)."""
    starts, ends = (np.sort(np.stack([one[:, 0], other[:, 0]]), axis=1)[:, end] for end in (0, 1))
    if ends.min() - starts.max() < _LEAST_SHARED * (ends - starts).min():
        return []
    rises = [_rise(side, 0) for side in (one, other)]
    apart = other.mean(axis=0) - one.mean(axis=0)
    same_height = abs(apart[2]) < _SAME_HEIGHT_MM
    if rises[0] == rises[1] == 0.0:
        across = float(apart[2] / apart[1])
        level = [np.zeros(2)] if same_height else []
        return [*level, np.array([0.0, across])] if abs(across) > LEAST_RISE else level
    sloped = 0.0 not in rises
    return [np.array([sum(rises) / 2.0, 0.0])] if sloped and same_height else []


def _at_corner(one: Array, other: Array, size: Array) -> list[Array]:
    """Return the same where one side runs along u, the other along v, and they meet at a corner of the face."""
    tilt = np.array([_rise(one, 0), _rise(other, 1)])
    place, other_place = one.mean(axis=0), other.mean(axis=0)
    missing = np.array([np.abs(one[:, 0] - other_place[0]).min(), np.abs(other[:, 1] - place[1]).min()])
    step_mm = other_place[2] - place[2] - tilt @ (other_place[:2] - place[:2])
    meets = (missing < _GAP_SHARE * size).all() and abs(step_mm) < _SAME_HEIGHT_MM
    return [tilt] if meets and not tilt.all() else []


def _rise(side: Array, axis: int) -> float:
    """Return how much a side rises per millimetre of its way along an axis: 0 where it is level."""
    return float((side[1, 2] - side[0, 2]) / (side[1, axis] - side[0, axis]))
