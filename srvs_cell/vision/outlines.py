"""Step 11a: many figures at once, sampled along their outlines, with the derivatives that fitting needs.

All figures of a batch have the same number of samples and the same seven parameters (x, y, z, length, angle, width,
slope along the length), some of which are held: whatever is done to one is one array operation for all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.faces import HEXAGON_RATIO, Face, Figure, unit_corners

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.rectification import RectifiedRig

_CORNER_SHARE = 0.1
"""Share of a side left out at either end: there the neighbouring side's edge is met."""
_MIN_SIZE_MM = 3.0
_SIDE_SAMPLES_MIN = 6
_LENGTH, _ANGLE, _WIDTH, _SLOPE = 3, 4, 5, 6
"""Places of the parameters behind x, y and z."""


@dataclass(frozen=True, eq=False)
class Outlines:
    """A batch of B figures, each sampled at N points of its outline.

    Attributes:
        figures: what each is.
        values: x, y, z, length, angle, width and slope along the length of each, shape (B, 7).
        free: which of them may change, bool, shape (B, 7).
        unit: the samples in the figure's own unit square [-1, 1], shape (B, N, 2).
        tangents: the outline's direction there, shape (B, N, 2).
        first, last: whether a sample is the first or last of its side, bool, shape (B, N).
    """

    figures: tuple[Figure, ...]
    values: Array
    free: NDArray[np.bool_]
    unit: Array
    tangents: Array
    first: NDArray[np.bool_]
    last: NDArray[np.bool_]

    @classmethod
    def of(
        cls, faces: Sequence[Face], inclined: Sequence[bool], samples: int, *, equal_sides: bool = False
    ) -> Outlines:
        """Sample faces.

        Args:
            faces: at least one; without a slope across.
            inclined: whether the slope along the length of each is free; only a rectangle's can be.
            samples: number of samples on each outline, a multiple of 12.
            equal_sides: whether each side has as many samples, instead of as many as its length asks for.
        """
        sampled = [_sample(face.figure, _counts(face, samples, equal_sides=equal_sides)) for face in faces]
        unit, tangents, first, last = (np.stack(parts) for parts in zip(*sampled, strict=True))
        values = np.array(
            [
                (face.x_mm, face.y_mm, face.z_mm, face.length_mm, face.angle_rad, face.width_mm, face.slope_u)
                for face in faces
            ]
        )
        free = np.ones(values.shape, dtype=np.bool_)
        rectangle = np.array([face.figure is Figure.RECTANGLE for face in faces])
        free[:, _ANGLE] = [face.figure is not Figure.CIRCLE for face in faces]
        free[:, _WIDTH] = rectangle
        free[:, _SLOPE] = rectangle & np.array(inclined)
        return cls(tuple(face.figure for face in faces), values, free, unit, tangents, first, last)

    def faces(self) -> list[Face]:
        """Return the figures as faces."""
        return [
            _face(figure, *(float(value) for value in row))
            for figure, row in zip(self.figures, self.values, strict=True)
        ]

    def only(self, kept: NDArray[np.intp]) -> Outlines:
        """Return some of the figures by their numbers."""
        return Outlines(
            tuple(self.figures[number] for number in kept),
            self.values[kept],
            self.free[kept],
            self.unit[kept],
            self.tangents[kept],
            self.first[kept],
            self.last[kept],
        )

    def moved(self, steps: Array) -> Outlines:
        """Return the figures with their parameters changed by steps, shape (B, 7); no size falls below 3 mm."""
        values = self.values + np.where(self.free, steps, 0.0)
        values[:, [_LENGTH, _WIDTH]] = np.maximum(values[:, [_LENGTH, _WIDTH]], _MIN_SIZE_MM)
        return replace(self, values=values)

    def points_mm(self, share: float = 1.0) -> Array:
        """Return the samples, drawn towards the centre by a share, in the base frame, shape (B, N, 3)."""
        return self._turned(self.unit) * share + self.values[:, None, :3]

    def directions_mm(self) -> Array:
        """Return the outline's direction at the samples, base frame, shape (B, N, 3)."""
        return self._turned(self.tangents)

    def change(self, covectors: Array) -> Array:
        """Return how linear functions of the samples' places change with the parameters.

        Args:
            covectors: of each sample, base frame, shape (B, N, 3).

        Returns:
            Derivatives by the seven parameters, 0 for those that are held, shape (B, N, 7).
        """
        cos, sin = np.cos(self.values[:, _ANGLE, None]), np.sin(self.values[:, _ANGLE, None])
        slope, u, v = self.values[:, _SLOPE, None], self.unit[..., 0], self.unit[..., 1]
        g_x, g_y, g_z = covectors[..., 0], covectors[..., 1], covectors[..., 2]
        by_length = u / 2.0 * (cos * g_x + sin * g_y + slope * g_z)
        by_width = v / 2.0 * (cos * g_y - sin * g_x)
        is_rectangle = self._is_rectangle[:, None]
        turned = self._turned(self.unit)
        columns = (
            g_x,
            g_y,
            g_z,
            by_length + np.where(is_rectangle, 0.0, by_width),
            turned[..., 0] * g_y - turned[..., 1] * g_x,
            by_width,
            u * self.values[:, _LENGTH, None] / 2.0 * g_z,
        )
        return np.asarray(np.stack(columns, axis=-1) * self.free[:, None, :], dtype=np.float64)

    @property
    def _is_rectangle(self) -> NDArray[np.bool_]:
        return np.array([figure is Figure.RECTANGLE for figure in self.figures])

    def _turned(self, unit: Array) -> Array:
        """Return vectors of the unit square as vectors of the base frame."""
        length = self.values[:, _LENGTH, None]
        across = np.where(self._is_rectangle[:, None], self.values[:, _WIDTH, None], length)
        cos, sin = np.cos(self.values[:, _ANGLE, None]), np.sin(self.values[:, _ANGLE, None])
        u, v = unit[..., 0] * length / 2.0, unit[..., 1] * across / 2.0
        return np.stack([cos * u - sin * v, sin * u + cos * v, self.values[:, _SLOPE, None] * u], axis=-1)


def in_front(outlines: Outlines, rig: RectifiedRig) -> NDArray[np.bool_]:
    """Whether all of each outline is in front of the cameras and finite, shape (B,)."""
    depth = rig.camera_T_base.apply(outlines.points_mm())[..., 2]
    return np.asarray(np.isfinite(depth).all(axis=1) & (depth.min(axis=1) > 1.0), dtype=np.bool_)


def outward_normals(along: Array, pixels: Array) -> Array:
    """Return the unit normals of outlines that point away from their middles.

    Args:
        along: direction of the outlines in the image, shape (B, N, 2).
        pixels: their samples, the same shape.
    """
    normals = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), np.finfo(float).tiny)
    inward = ((pixels - pixels.mean(axis=1, keepdims=True)) * normals).sum(axis=-1, keepdims=True) < 0.0
    return np.where(inward, -normals, normals)


@lru_cache(maxsize=256)
def _sample(figure: Figure, counts: tuple[int, ...]) -> tuple[Array, Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return samples and directions of an outline in its unit square, and which are the first and last of a side."""
    if figure is Figure.CIRCLE:
        (samples,) = counts
        turn = np.arange(samples) * (2.0 * np.pi / samples)
        points = np.column_stack([np.cos(turn), np.sin(turn)])
        number = np.arange(samples)
        return points, np.column_stack([-points[:, 1], points[:, 0]]), number == 0, number == samples - 1
    corners = unit_corners(figure)
    pieces, tangents, first, last = [], [], [], []
    for start, end, count in zip(corners, np.roll(corners, -1, axis=0), counts, strict=True):
        share = np.linspace(_CORNER_SHARE, 1.0 - _CORNER_SHARE, count)[:, None]
        pieces.append(start + share * (end - start))
        tangents.append(np.broadcast_to(end - start, (count, 2)))
        number = np.arange(count)
        first.append(number == 0)
        last.append(number == count - 1)
    return np.concatenate(pieces), np.concatenate(tangents), np.concatenate(first), np.concatenate(last)


def _counts(face: Face, samples: int, *, equal_sides: bool) -> tuple[int, ...]:
    """Return the number of samples on each side: a rectangle's by their lengths."""
    if face.figure is Figure.CIRCLE:
        return (samples,)
    if face.figure is Figure.HEXAGON:
        sides = len(unit_corners(face.figure))
        return (samples // sides,) * sides
    if equal_sides:
        sides = len(unit_corners(face.figure))
        return (samples // sides,) * sides
    half = samples // 2
    along = round(half * face.length_mm / max(face.length_mm + face.width_mm, _MIN_SIZE_MM))
    along = min(max(along, _SIDE_SAMPLES_MIN), half - _SIDE_SAMPLES_MIN)
    return along, half - along, along, half - along


def _face(
    figure: Figure,
    x_mm: float,
    y_mm: float,
    z_mm: float,
    length_mm: float,
    angle_rad: float,
    width_mm: float,
    slope_u: float,
) -> Face:
    across_mm = {Figure.RECTANGLE: width_mm, Figure.CIRCLE: length_mm, Figure.HEXAGON: length_mm * HEXAGON_RATIO}
    return Face(figure, x_mm, y_mm, z_mm, angle_rad, length_mm, across_mm[figure], slope_u)
