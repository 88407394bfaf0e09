"""Step 11b: the shadows that parts throw on the table in the light of one lamp.

A part is what lies between a top face and its foot on the table. It is convex, so that the foot and its shadow together
are the convex hull of the foot and of the top face's picture on the table, seen from the lamp.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.faces.face import Figure, unit_corners

if TYPE_CHECKING:
    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces.outlines import Borders, Outlines
    from srvs_cell.vision.rectification import RectifiedRig

_LEAST_SHARE = 0.2
"""No part comes nearer to the lamp than this share of its height over the table."""
_MOST_NEARNESS = 1.0 / 400.0
"""No lamp stands lower than this over the table, one over millimetres."""
_LEAST_NEARNESS = 1e-6
"""A lamp that is farther away than a kilometre need not be told from one that is."""
_ALONG = 1e-3
"""A side that is so nearly along a ray does not end it."""
_CIRCLE_CORNERS = 36
"""Of the polygon that stands for a circle: its shadow ends within a fraction of a pixel of the circle's."""
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class Lamp:
    """Where the light comes from that throws the shadows.

    Attributes:
        centre_mm: the place on the table that the lean is told for, base frame x and y.
        lean: horizontal way of the lamp from the centre over its height, x and y; the light falls the other way.
        nearness_per_mm: one over the height of the lamp over the table; 0: so far away that all light is parallel.
        table_z_mm: height of the table, base frame.
        shade: what is left of the table's brightness where the lamp does not reach; 1 where that was not measured.
    """

    centre_mm: tuple[float, float]
    lean: tuple[float, float]
    nearness_per_mm: float
    table_z_mm: float
    shade: float = 1.0

    @property
    def place_mm(self) -> Array:
        """Where the lamp is, base frame, shape (3,); where all light is parallel very far away."""
        height_mm = 1.0 / max(self.nearness_per_mm, _LEAST_NEARNESS)
        way_mm = np.array([*self.lean, 1.0]) * height_mm
        return np.asarray(way_mm + np.array([*self.centre_mm, self.table_z_mm]))

    def shadows_mm(self, points_mm: Array) -> Array:
        """Return where on the table the shadows of points fall: (..., 3, N) becomes (..., 2, N), base frame."""
        _, way, rise_mm = self._ways(points_mm)
        shadows: Array = points_mm[..., :2, :] + way * rise_mm
        return shadows

    def changes_mm(self, points_mm: Array) -> tuple[Array, Array]:
        """Return how shadows of points move with the lean, shape (..., 1, N), and with the nearness, (..., 2, N)."""
        from_centre, way, rise_mm = self._ways(points_mm)
        return -rise_mm, rise_mm * (from_centre + rise_mm * way)

    def moved(self, step: Array) -> Lamp:
        """Return the lamp with its lean and nearness changed by a step, shape (3,)."""
        lean = (self.lean[0] + float(step[0]), self.lean[1] + float(step[1]))
        nearness = min(max(self.nearness_per_mm + float(step[2]), 0.0), _MOST_NEARNESS)
        return replace(self, lean=lean, nearness_per_mm=nearness)

    def _ways(self, points_mm: Array) -> tuple[Array, Array, Array]:
        """Return points' ways from the centre, the light's way there, and their heights as the lamp magnifies them."""
        height_mm = points_mm[..., 2:, :] - self.table_z_mm
        from_centre = points_mm[..., :2, :] - np.array(self.centre_mm)[:, None]
        way = self.nearness_per_mm * from_centre - np.array(self.lean)[:, None]
        return from_centre, way, height_mm / np.maximum(1.0 - self.nearness_per_mm * height_mm, _LEAST_SHARE)


def reach_px(outlines: Outlines, borders: Borders, rig: RectifiedRig, lamp: Lamp) -> Array:
    """Return how far outside of outlines shadows are seen to reach, straight across the borders, shape (2, B, N).

    It is less than the distance of the foot where there is no shadow, give or take what a circle is less than the
    polygon that stands for it; negative where the part hides foot and shadow.

    Args:
        outlines: top faces.
        borders: the same as the cameras see them.
        rig: the rectified cameras.
        lamp: what throws the shadows.
    """
    reach = np.zeros(borders.spacing_px.shape)
    for figure in set(outlines.figures):
        of_figure = [one is figure for one in outlines.figures]
        some = slice(None) if all(of_figure) else np.flatnonzero(of_figure)
        tops = outlines.points_mm(_corners(figure))[some]
        on_table = np.concatenate([tops[:, :2], lamp.shadows_mm(tops)], axis=2)
        flat = np.stack([on_table[:, 0], on_table[:, 1], np.full_like(on_table[:, 0], lamp.table_z_mm)], axis=1)
        seen = rig.projections[:, None, :, :3] @ flat + rig.projections[:, None, :, 3:]
        hull = seen[:, :, :2] / seen[:, :, 2:]
        feet, shadows = hull[..., : tops.shape[2]], hull[..., tops.shape[2] :]
        # the hull's sides: those of the foot, those of the shadow, which a circle shares, and two along the light
        sides = [_along(feet, figure)] if figure is Figure.CIRCLE else [_along(feet, figure), _along(shadows, figure)]
        along = np.concatenate([*sides, _outermost(feet, shadows)], axis=3)
        # counter-clockwise from above is clockwise in a picture whose y axis points down
        across = np.stack([-along[:, :, 1], along[:, :, 0]], axis=3)
        across /= np.maximum(np.hypot(across[..., :1], across[..., 1:]), _TINY)
        limit = (across @ hull).max(axis=3)
        near = across.astype(np.float32)
        room = limit[..., None].astype(np.float32) - near @ borders.points_px[:, some].astype(np.float32)
        speed = near @ borders.normals[:, some].astype(np.float32)
        ends = np.full_like(room, np.inf)
        np.divide(room, speed, out=ends, where=speed > _ALONG)
        reach[:, some] = ends.min(axis=2)
    return reach


@lru_cache(maxsize=3)
def _corners(figure: Figure) -> Array:
    """Return the corners of a figure in its unit square, homogeneous (u, v, 1), shape (3, K)."""
    corners = unit_corners(figure)
    if figure is Figure.CIRCLE:
        turn = np.arange(_CIRCLE_CORNERS) * (2.0 * np.pi / _CIRCLE_CORNERS)
        corners = np.column_stack([np.cos(turn), np.sin(turn)])
    return np.column_stack([corners, np.ones(len(corners))]).T


def _outermost(feet: Array, shadows: Array) -> Array:
    """Return the ways from feet to shadows of the corners that lie outermost on either side, there and back."""
    ways = shadows - feet
    mean = ways.mean(axis=-1, keepdims=True)
    aside = feet[:, :, 0] * mean[:, :, 1] - feet[:, :, 1] * mean[:, :, 0]
    outermost = np.stack([aside.argmin(axis=-1), aside.argmax(axis=-1)], axis=-1)[:, :, None]
    two = np.take_along_axis(ways, outermost, axis=-1)
    return np.concatenate([two, -two], axis=-1)


def _along(corners: Array, figure: Figure) -> Array:
    """Return the directions of the sides of polygons, last axis; those of a circle at its corners."""
    number = np.arange(corners.shape[-1])
    before = corners.take(number - 1, axis=-1) if figure is Figure.CIRCLE else corners
    # the first one comes after the last one
    directions: Array = corners.take(number + 1, axis=-1, mode="wrap") - before
    return directions
