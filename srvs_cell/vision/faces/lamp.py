"""Step 11b, beyond the paper: where the lamp stands, told by the shadows that well known parts throw on the table.

One lamp that is brighter than the rest throws shadows with sharp borders. The shadow of a top face's outline is its
picture on the table, seen from the lamp: the lamp stands where these pictures fall on edges of the left image, dark
within. The light's lean is searched on a small picture, then all that is to be known of the lamp follows by
Gauss-Newton. Where too few edges are met nothing is said. Where nearly all are the lamp is certain; whether another one
explains what is seen beside the faces is for `srvs_cell.vision.faces.profile_fit.measure_lamp` to tell.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from srvs_cell.vision.faces.edge_fit import EdgeField
from srvs_cell.vision.faces.outlines import Outlines
from srvs_cell.vision.faces.shadows import Lamp

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces.face import Face
    from srvs_cell.vision.rectification import RectifiedRig

_USUAL_NEARNESS, _NEARNESS_SIGMA = 1.0 / 1500.0, 1.0 / 1500.0
"""Lamps hang from less than a metre to any height over the table, one over millimetres."""
_LEAST_LEAN, _MOST_LEAN, _LEANS = 0.1, 0.9, 33
"""What is searched, the more finely the less it is: light that falls more steeply throws hardly a shadow."""
_APART = 0.1
_STARTS = 6
_SHRUNK = 2
"""So many times smaller is the picture that is searched."""
_SEARCH_SAMPLES, _SAMPLES = 12, 24
_CLEAR = 4.0
"""Grey values per pixel of the small picture: a clearer edge counts no more."""
_FEW_SAMPLES = 3.0
"""So many samples without an edge are added, so that few do not win by chance."""
_SCHEDULE = ((8, 4.0), (6, 3.0), (4, 1.5), (3, 0.7), (3, 0.5), (3, 0.5))
"""Half width of the search for edges and scale of the robust weight in each iteration, pixels."""
_LEAST_GRADIENT, _MOST_GRADIENT = 1.0, 8.0
"""Grey values per pixel: a weaker edge is none, a stronger one no likelier."""
_EDGE_PX = 0.5
"""Standard deviation of a shadow's edge, to weigh it against the usual nearness."""
_DAMPING = 1.0
_LEAST_REACH_MM = 2.0
"""A shadow that reaches less far from the part may not be told from the foot of the part."""
_MET_PX = 1.0
_LEAST_MET, _LEAST_SHARE = 3, 0.4
"""So many samples, and this share of those that could, must meet an edge: whether it is a lamp more is to tell."""
_MANY_MET, _CERTAIN_SHARE = 8, 0.94
"""Where so many do there is no other place, whatever faces that may be wrong make of it."""
_CLEAR_OF_EDGE_PX = 3.0
_DARKEST = 0.05
_FLAT = 1e-9


@dataclass(frozen=True)
class FoundLamps:
    """Where a lamp may stand that throws the shadows of parts.

    Attributes:
        certain: where nearly all edges of shadows are met that could be; None where there is no such place.
        likely: places that are told by some edges, the clearest shadows first; not asked for where one is certain.
    """

    certain: Lamp | None
    likely: tuple[Lamp, ...] = ()


def find_lamps(
    faces: Sequence[Face], field: EdgeField, grey: NDArray[np.uint8], rig: RectifiedRig, table_z_mm: float
) -> FoundLamps:
    """Return where a lamp may stand that throws the shadows of parts.

    Args:
        faces: well known top faces of parts that stand on the table.
        field: gradient of the rectified left image.
        grey: the rectified left image, uint8, shape (H, W).
        rig: the rectified cameras.
        table_z_mm: height of the table, base frame.
    """
    if not faces:
        return FoundLamps(None)
    likely = []
    rims = _Rims.of(faces, rig, table_z_mm, grey.shape, _SAMPLES)
    for start in _starts(faces, grey, rig, table_z_mm):
        lamp, met, possible = _refined(start, rims, field)
        if met >= max(_MANY_MET, _CERTAIN_SHARE * possible):
            return FoundLamps(lamp)
        if met >= max(_LEAST_MET, _LEAST_SHARE * possible):
            likely.append(lamp)
    return FoundLamps(None, tuple(likely))


@dataclass(frozen=True, eq=False)
class _Rims:
    """Outlines of F top faces, N samples each, and how the left camera sees the table.

    Attributes:
        points_mm: the samples, base frame, shape (F, 3, N).
        outwards: horizontal unit normals that point away from the parts, shape (F, 2, N).
        table: from the table, (x, y, 1) in millimetres, to homogeneous pixels, 3x3.
        covered: where the parts themselves are seen, uint8, shape (H, W) over `_SHRUNK`.
    """

    points_mm: Array
    outwards: Array
    table: Array
    covered: NDArray[np.uint8]

    @classmethod
    def of(
        cls, faces: Sequence[Face], rig: RectifiedRig, table_z_mm: float, shape: tuple[int, ...], samples: int
    ) -> _Rims:
        """Sample top faces; ``shape``: of the image."""
        outlines = Outlines.of(faces, [False] * len(faces), samples, equal_sides=True)
        points = outlines.points_mm()
        on_table = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, table_z_mm], [0.0, 0.0, 1.0]])
        feet = np.concatenate([points[:, :2], np.full_like(points[:, :1], table_z_mm)], axis=1)
        x, y, _ = rig.project_px(np.swapaxes(np.concatenate([points, feet], axis=2), 1, 2))
        covered = np.zeros((shape[0] // _SHRUNK, shape[1] // _SHRUNK), dtype=np.uint8)
        for part in _shrunk(np.stack([x, y], axis=2)):
            hull = cv2.convexHull(part.astype(np.float32))
            cv2.fillConvexPoly(covered, np.rint(hull).astype(np.int32), 1)
        return cls(points, outlines.normals_mm(), rig.projections[0] @ on_table, covered)

    def seen(self, places_mm: Array) -> tuple[Array, Array]:
        """Return pixels of places on the table, (..., 2, N), and their derivatives by the place, (..., 2, 2, N)."""
        seen = self.table[:, :2] @ places_mm + self.table[:, 2:]
        depth = seen[..., 2:, :]
        pixels: Array = seen[..., :2, :] / depth
        slopes = (self.table[:2, :2, None] - pixels[..., None, :] * self.table[2, :2, None]) / depth[..., None, :]
        return pixels, slopes

    def across(self, slopes: Array) -> Array:
        """Return the unit normals of the shadows' borders in the image, (..., 2, N); ``slopes``: of the places."""
        across = (slopes * self.outwards[:, None]).sum(axis=-2)
        normals: Array = across / np.hypot(across[..., :1, :], across[..., 1:, :])
        return normals

    def visible(self, pixels: Array) -> NDArray[np.bool_]:
        """Return which pixels, (..., 2, N), are in the image and not covered by a part."""
        height, width = self.covered.shape
        column, row = np.moveaxis(np.rint(_shrunk(pixels)).astype(np.intp), -2, 0)
        inside = (column > 0) & (column < width - 1) & (row > 0) & (row < height - 1)
        covered = self.covered[np.where(inside, row, 0), np.where(inside, column, 0)]
        return np.asarray(inside & (covered == 0))


def _shrunk(pixels: NDArray[Any]) -> NDArray[Any]:
    """Return where pixels are in the small picture."""
    return pixels / _SHRUNK + (0.5 / _SHRUNK - 0.5)


@lru_cache(maxsize=1)
def _leans() -> Array:
    """Return the leans that are searched, shape (L, 2)."""
    steps = np.linspace(-1.0, 1.0, _LEANS)
    leans = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    leans *= _MOST_LEAN * np.abs(leans)
    size = np.hypot(*leans.T)
    searched: Array = leans[(size >= _LEAST_LEAN) & (size <= _MOST_LEAN)]
    return searched


def _starts(faces: Sequence[Face], grey: NDArray[np.uint8], rig: RectifiedRig, table_z_mm: float) -> list[Lamp]:
    """Return a few lamps whose shadows have the clearest borders, at the usual height."""
    rims = _Rims.of(faces, rig, table_z_mm, grey.shape, _SEARCH_SAMPLES)
    small = cv2.resize(grey, rims.covered.shape[::-1], interpolation=cv2.INTER_AREA)
    # slopes, and where no part is
    slopes = np.dstack([EdgeField.of(np.asarray(small, dtype=np.uint8)).gradient, rims.covered == 0])
    leans = _leans()
    centre = rims.points_mm[:, :2].mean(axis=(0, 2))
    steep = Lamp((float(centre[0]), float(centre[1])), (0.0, 0.0), _USUAL_NEARNESS, table_z_mm)
    by_lean, _ = steep.changes_mm(rims.points_mm)
    # homogeneous pixels are linear in the lean: (x, y, 1) @ (3, 3 F N)
    linear = np.stack(
        [
            *(rims.table[:, axis, None] * by_lean for axis in range(2)),
            rims.table[:, :2] @ steep.shadows_mm(rims.points_mm) + rims.table[:, 2:],
        ]
    )
    seen = np.column_stack([leans, np.ones(len(leans))]) @ linear.transpose(0, 2, 1, 3).reshape(3, -1)
    x, y, depth = seen.astype(np.float32).reshape(len(leans), 3, -1).transpose(1, 0, 2)
    place_x, place_y = _shrunk(x / depth), _shrunk(y / depth)
    met = cv2.remap(slopes, place_x, place_y, cv2.INTER_LINEAR)
    across = rims.across(rims.seen(rims.points_mm[:, :2])[1]).transpose(0, 2, 1).reshape(-1, 2).astype(np.float32)
    brighter = met[..., 0] * across[:, 0] + met[..., 1] * across[:, 1]
    # the border of a shadow is where the outline faces away from the lamp
    away = -(leans / np.hypot(*leans.T)[:, None]) @ rims.outwards.transpose(1, 0, 2).reshape(2, -1)
    weight = np.maximum(away, 0.0).astype(np.float32) * met[..., 2]
    total = (weight * np.minimum(np.maximum(brighter, -_CLEAR), _CLEAR)).sum(axis=1)
    score = total / (weight.sum(axis=1) + _FEW_SAMPLES)
    starts: list[Lamp] = []
    for number in np.argsort(-score):
        x, y = leans[number]
        if all(np.hypot(x - lamp.lean[0], y - lamp.lean[1]) > _APART for lamp in starts):
            starts.append(replace(steep, lean=(float(x), float(y))))
        if len(starts) == _STARTS:
            break
    return starts


def _refined(lamp: Lamp, rims: _Rims, field: EdgeField) -> tuple[Lamp, int, int]:
    """Return a lamp whose shadows fall on edges, how many samples meet one, and how many could."""
    prior = (_EDGE_PX / _NEARNESS_SIGMA) ** 2
    for half_width_px, scale_px in _SCHEDULE:
        shadows = lamp.shadows_mm(rims.points_mm)
        pixels, slopes = rims.seen(shadows)
        across = rims.across(slopes)
        distance, there = _edges(field, pixels, across, half_width_px)
        away = ((shadows - rims.points_mm[:, :2]) * rims.outwards).sum(axis=1) > _LEAST_REACH_MM
        possible = away & rims.visible(pixels)
        there &= possible
        moved = (across[:, :, None] * slopes).sum(axis=1)
        by_lean, by_nearness = lamp.changes_mm(rims.points_mm)
        rows = np.concatenate([moved * by_lean, (moved * by_nearness).sum(axis=1, keepdims=True)], axis=1)
        rows = rows.transpose(1, 0, 2).reshape(3, -1)
        weighted = rows * (there / (1.0 + (distance / scale_px) ** 2) ** 2).reshape(-1)
        normal = weighted @ rows.T + np.diag([_DAMPING, _DAMPING, prior])
        vector = weighted @ distance.reshape(-1)
        vector[2] += prior * (_USUAL_NEARNESS - lamp.nearness_per_mm)
        lamp = lamp.moved(np.linalg.solve(normal, vector))
    met = there & (np.abs(distance) < _MET_PX)
    shade = _shade(field, pixels + across * distance[:, None], across, met)
    return replace(lamp, shade=shade), int(np.count_nonzero(met)), int(np.count_nonzero(possible))


def _shade(field: EdgeField, edges: Array, across: Array, met: NDArray[np.bool_]) -> float:
    """Return what is left of the table's brightness within the shadows whose edges were met."""
    if not met.any():
        return 1.0
    levels = []
    for step_px in (-_CLEAR_OF_EDGE_PX, _CLEAR_OF_EDGE_PX):
        x, y = (edges + step_px * across).astype(np.float32).transpose(1, 0, 2)
        levels.append(cv2.remap(field.smooth, x, y, cv2.INTER_LINEAR)[met])
    within, outside = levels
    return float(np.clip(np.median(within / np.maximum(outside, 1.0)), _DARKEST, 1.0))


def _edges(field: EdgeField, pixels: Array, across: Array, half_width_px: int) -> tuple[Array, NDArray[np.bool_]]:
    """Return the distance along normals, each (F, 2, N), to where it grows brighter, and whether it does, (F, N)."""
    offsets = np.arange(-half_width_px - 1, half_width_px + 2, dtype=np.float32)
    slope = field.along_normals(pixels, across, offsets)
    before, inner, after = slope[:-2], slope[1:-1], slope[2:]
    peak = (inner >= before) & (inner > after) & (inner > _LEAST_GRADIENT)
    nearness = np.exp(-0.5 * (offsets[1:-1] / half_width_px) ** 2)[:, None, None]
    likelihood = peak * np.minimum(inner, _MOST_GRADIENT) * nearness
    best = likelihood.argmax(axis=0)[None]
    low, high, next_low = (np.take_along_axis(each, best, axis=0)[0] for each in (before, inner, after))
    shift = 0.5 * (low - next_low) / np.minimum(low - 2.0 * high + next_low, -_FLAT)
    distance = offsets[1:-1][best[0]] + np.minimum(np.maximum(shift, -0.5), 0.5)
    return np.asarray(distance, dtype=np.float64), likelihood.max(axis=0) > 0.0
