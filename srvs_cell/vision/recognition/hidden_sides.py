"""Step 11f, beyond the paper: how far a top face may go on where a higher part hides its side or throws a shadow on it.

There the pictures show the higher part's border, or that of its shadow, in place of the face's own. A figure that was
fitted to it is too small, however well it fits. But from the higher part, the cameras and the lamp follows how far the
face may go on: to where it would be seen again, or to the higher part's wall.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.faces.face import SIDES, Figure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces.face import Face
    from srvs_cell.vision.faces.shadows import Lamp
    from srvs_cell.vision.recognition.tops import Top
    from srvs_cell.vision.rectification import RectifiedRig

_ALONG = np.linspace(-0.8, 0.8, 9)
"""Where on a side it is asked what hides it, half the side's length."""
_STEP_MM = 0.5
_MOST_MM = 40.0
"""No part hides more of one that is beside it."""
_SLACK_MM = 1.5
"""Within this of a side that is not the face's own what is hidden begins."""
_UNIFORM = 12.0
"""Square of a range over the variance of what may lie anywhere in it."""
_TINY = 1e-9


def with_hidden_sides(tops: Sequence[Top], rig: RectifiedRig, lamp: Lamp | None) -> list[Top]:
    """Return tops, those of which a side is hidden as large as they likely are, and no surer than that is known.

    Args:
        tops: all that stand there.
        rig: the rectified cameras.
        lamp: what throws the shadows; None where that is not known.
    """
    left_mm = rig.base_T_camera.translation_mm
    eyes_mm = np.stack([left_mm, left_mm + rig.baseline_mm * rig.base_T_camera.rotation[:, 0]])
    lamp_mm = None if lamp is None else lamp.place_mm
    solids = [_Solid.under(top.fit.face) for top in tops]
    whole = []
    for top in tops:
        higher = [
            solid for solid, other in zip(solids, tops, strict=True) if other is not top and _may_hide(other, top)
        ]
        if top.fit.face.figure is Figure.RECTANGLE and higher:
            whole.append(_as_large_as_likely(top, hidden_mm(top.fit.face, higher, eyes_mm, lamp_mm)))
        else:
            whole.append(top)
    return whole


def _may_hide(other: Top, top: Top) -> bool:
    """Whether a part is higher than some of another one's top face, and near."""
    face, before = top.fit.face, other.fit.face
    reach_mm = (np.hypot(face.length_mm, face.width_mm) + np.hypot(before.length_mm, before.width_mm)) / 2.0
    apart_mm = np.hypot(face.x_mm - before.x_mm, face.y_mm - before.y_mm)
    return bool(before.highest_mm > face.lowest_mm and apart_mm < reach_mm + _MOST_MM)


@dataclass(frozen=True, eq=False)
class _Solid:
    """What stands under a top face: points p with normals @ p <= offsets; normals (K, 3), offsets (K,)."""

    normals: Array
    offsets: Array

    @classmethod
    def under(cls, face: Face) -> _Solid:
        """Return the part whose top face it is; it has no floor."""
        corners = face.corners_mm()
        along = np.roll(corners, -1, axis=0) - corners
        walls = np.column_stack([along[:, 1], -along[:, 0], np.zeros(len(along))])
        walls /= np.maximum(np.linalg.norm(walls, axis=1, keepdims=True), _TINY)
        top = face.normal()
        return cls(
            np.vstack([walls, top]),
            np.append((walls * corners).sum(axis=1), top @ (face.x_mm, face.y_mm, face.z_mm)),
        )

    def holds(self, points_mm: Array) -> NDArray[np.bool_]:
        """Return which points, shape (..., 3), are in the part."""
        return np.asarray((points_mm @ self.normals.T <= self.offsets).all(axis=-1))

    def hides(self, points_mm: Array, eye_mm: Array) -> NDArray[np.bool_]:
        """Return which points, shape (..., 3), outside of the part are hidden from an eye (Cyrus and Beck 1978)."""
        beyond = points_mm @ self.normals.T - self.offsets
        rate = eye_mm @ self.normals.T - self.offsets - beyond
        # along a wall a way never enters, or it is within from the beginning
        rate = np.where(np.abs(rate) < _TINY, -_TINY, rate)
        ends = -beyond / rate
        enters = np.where(rate < 0.0, ends, -np.inf).max(axis=-1)
        leaves = np.where(rate > 0.0, ends, np.inf).min(axis=-1)
        return np.asarray((enters > 0.0) & (enters < np.minimum(leaves, 1.0)))


def hidden_mm(face: Face, higher: Sequence[_Solid], eyes_mm: Array, lamp_mm: Array | None) -> Array:
    """Return how far a rectangle may go on behind higher parts at each of its sides, shape (4,), 0 where it does not.

    Args:
        face: a rectangle; its sides are `SIDES`.
        higher: the parts.
        eyes_mm: where the cameras are, base frame, shape (2, 3).
        lamp_mm: where the lamp is, shape (3,); None where that is not known.
    """

    def unseen(beyond_mm: Array) -> NDArray[np.bool_]:
        """Return what is not seen so far outside of the sides, (N,): by each camera, side and place, (2, 4, 9, N)."""
        places = np.stack([face.beside(side, beyond_mm, _ALONG) for side in SIDES]).swapaxes(1, 2)
        free = ~np.any([solid.holds(places) for solid in higher], axis=0)
        dark = False if lamp_mm is None else _hidden(places, higher, lamp_mm)
        return np.stack([free & (dark | _hidden(places, higher, eye_mm)) for eye_mm in eyes_mm])

    inside, outside = np.moveaxis(unseen(np.array([-_SLACK_MM, _SLACK_MM])), -1, 0)
    begins = outside & ~inside
    if np.all(np.median(begins, axis=-1) == 0.0):
        return np.zeros(len(SIDES))
    hidden = unseen(np.arange(_SLACK_MM, _MOST_MM, _STEP_MM))
    # up to the first place that is seen, or where the part is that hides
    steps = np.where(hidden.all(axis=-1), hidden.shape[-1], np.argmin(hidden, axis=-1))
    furthest: Array = np.median(begins * (_SLACK_MM + steps * _STEP_MM), axis=-1).max(axis=0)
    return furthest


def _hidden(places_mm: Array, solids: Sequence[_Solid], from_mm: Array) -> NDArray[np.bool_]:
    """Return which places, shape (..., 3), any of the solids hides from a point."""
    return np.asarray(np.any([solid.hides(places_mm, from_mm) for solid in solids], axis=0))


def _as_large_as_likely(top: Top, hidden: Array) -> Top:
    """Return a rectangle whose sides may each be anywhere up to so far out, millimetres: its mean and its spread."""
    face, covariance_mm2 = top.fit.face, top.fit.covariance_mm2
    for side, most_mm in zip(SIDES, hidden, strict=True):
        moved_mm = _centre(face.stretched(side, float(most_mm))) - _centre(face)
        covariance_mm2 = covariance_mm2 + np.outer(moved_mm, moved_mm) / _UNIFORM
        face = face.stretched(side, float(most_mm) / 2.0)
    return replace(top, fit=replace(top.fit, face=face, covariance_mm2=covariance_mm2))


def _centre(face: Face) -> Array:
    return np.array([face.x_mm, face.y_mm, face.z_mm])
