"""Step 11a: many figures at once, sampled along their outlines, as both cameras see them.

All figures of a batch have the same number of samples and the same seven parameters (x, y, z, length, angle, width,
slope along the length), some of which are held: whatever is done to one is one array operation for all. Coordinates
and cameras come first in the arrays' shapes and samples last, so that each operation runs along many samples.
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
_NEAREST_MM = 1.0
_TINY = float(np.finfo(float).tiny)
_LENGTH, _ANGLE, _WIDTH, _SLOPE = 3, 4, 5, 6
"""Places of the parameters behind x, y and z."""


@dataclass(frozen=True, eq=False)
class Borders:
    """Outlines as both rectified cameras see them: B figures with N samples; first axis: left and right image.

    Attributes:
        x_px, y_px: the samples, shape (2, B, N).
        normal_x, normal_y: unit normals that point away from the figures' middles, the same shape.
        by_parameter: how far the outline moves outwards at each sample with each of the figure's seven parameters, 0
            for those that are held, pixels, shape (2, B, 7, N).
        in_front: whether all of a figure is in front of the cameras and finite, shape (B,).
    """

    x_px: Array
    y_px: Array
    normal_x: Array
    normal_y: Array
    by_parameter: Array
    in_front: NDArray[np.bool_]

    def only(self, kept: NDArray[np.intp]) -> Borders:
        """Return some of the figures by their numbers."""
        return Borders(
            self.x_px[:, kept],
            self.y_px[:, kept],
            self.normal_x[:, kept],
            self.normal_y[:, kept],
            self.by_parameter[:, kept],
            self.in_front[kept],
        )


@dataclass(frozen=True, eq=False)
class Outlines:
    """A batch of B figures, each sampled at N points of its outline.

    Attributes:
        figures: what each is.
        values: x, y, z, length, angle, width and slope along the length of each, shape (B, 7).
        free: which of them may change, bool, shape (B, 7).
        unit: the samples in the figure's own unit square [-1, 1], shape (2, B, N).
        tangents: the outline's direction there, shape (2, B, N).
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
        unit, tangents = (np.ascontiguousarray(np.moveaxis(one, -1, 0)) for one in (unit, tangents))
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
            self.unit[:, kept],
            self.tangents[:, kept],
            self.first[kept],
            self.last[kept],
        )

    def moved(self, steps: Array) -> Outlines:
        """Return the figures with their parameters changed by steps, shape (B, 7); no size falls below 3 mm."""
        values = self.values + np.where(self.free, steps, 0.0)
        values[:, [_LENGTH, _WIDTH]] = np.maximum(values[:, [_LENGTH, _WIDTH]], _MIN_SIZE_MM)
        return replace(self, values=values)

    def points_mm(self) -> Array:
        """Return the samples in the base frame, shape (3, B, N)."""
        return self._turned(self.unit) + self.values[:, :3].T[..., None]

    def seen(self, rig: RectifiedRig) -> Borders:
        """Return the outlines as the cameras see them."""
        rotation = rig.camera_T_base.rotation
        figures, samples = self.unit.shape[1:]
        camera = _mapped(rotation, self.points_mm()) + rig.camera_T_base.translation_mm[:, None, None]
        in_front = np.isfinite(camera[2]).all(axis=1) & (camera[2].min(axis=1) > _NEAREST_MM)
        depth = np.maximum(camera[2], _NEAREST_MM)
        # both cameras differ in x alone
        right = np.array([0.0, rig.baseline_mm])[:, None, None]
        x, y = (camera[0] - right) / depth, np.broadcast_to(camera[1] / depth, (2, figures, samples))
        along = _mapped(rotation, self._turned(self.tangents))
        flow_x, flow_y = along[0] - x * along[2], along[1] - y * along[2]
        length = np.maximum(np.hypot(flow_x, flow_y), _TINY)
        normal_x, normal_y = flow_y / length, -flow_x / length
        outwards = (x - x.mean(axis=-1, keepdims=True)) * normal_x + (y - y.mean(axis=-1, keepdims=True)) * normal_y
        turn = np.where(outwards < 0.0, -1.0, 1.0)
        normal_x, normal_y = turn * normal_x, turn * normal_y
        # how a pixel moves along the normal when its point moves, as a linear function in the base frame
        scale = rig.f_px / depth
        covectors = np.stack([scale * normal_x, scale * normal_y, -scale * (normal_x * x + normal_y * y)])
        by_parameter = self.change(_mapped(rotation.T, covectors))
        return Borders(rig.f_px * x + rig.cx_px, rig.f_px * y + rig.cy_px, normal_x, normal_y, by_parameter, in_front)

    def feet_px(self, rig: RectifiedRig, table_z_mm: float) -> tuple[Array, Array]:
        """Return where both cameras see the points of the table under the samples, x and y of shape (2, B, N)."""
        feet = self.points_mm()
        feet[2] = table_z_mm
        camera = _mapped(rig.camera_T_base.rotation, feet) + rig.camera_T_base.translation_mm[:, None, None]
        scale = rig.f_px / np.maximum(camera[2], _NEAREST_MM)
        x, y = (camera[axis] * scale + centre for axis, centre in ((0, rig.cx_px), (1, rig.cy_px)))
        return np.stack([x, x - rig.baseline_mm * scale]), np.broadcast_to(y, (2, *y.shape))

    def change(self, covectors: Array) -> Array:
        """Return how linear functions of the samples' places change with the parameters.

        Args:
            covectors: of each sample in each of K pictures, base frame, shape (3, K, B, N).

        Returns:
            Derivatives by the seven parameters, 0 for those that are held, shape (K, B, 7, N).
        """
        cos, sin = np.cos(self.values[:, _ANGLE, None]), np.sin(self.values[:, _ANGLE, None])
        g_x, g_y, g_z = covectors
        half_u, half_v = self.unit / 2.0
        along = cos * g_x + sin * g_y
        across = cos * g_y - sin * g_x
        u_mm, v_mm = self._sides_mm(self.unit)
        by_width = half_v * across
        by_length = half_u * (along + self.values[:, _SLOPE, None] * g_z)
        changes = np.empty((*g_x.shape[:-1], self.values.shape[1], g_x.shape[-1]))
        changes[..., 0, :], changes[..., 1, :], changes[..., 2, :] = covectors
        # a figure that is no rectangle grows in both directions with its length
        changes[..., _LENGTH, :] = by_length + np.where(self._is_rectangle, 0.0, by_width)
        changes[..., _ANGLE, :] = u_mm * across - v_mm * along
        changes[..., _WIDTH, :] = by_width
        changes[..., _SLOPE, :] = u_mm * g_z
        changes *= self.free[:, :, None]
        return changes

    @property
    def _is_rectangle(self) -> NDArray[np.bool_]:
        return np.array([figure is Figure.RECTANGLE for figure in self.figures])[:, None]

    def _sides_mm(self, unit: Array) -> tuple[Array, Array]:
        """Return vectors of the unit square in millimetres along the length and across, each of shape (B, N)."""
        length = self.values[:, _LENGTH, None] / 2.0
        across = np.where(self._is_rectangle, self.values[:, _WIDTH, None] / 2.0, length)
        return unit[0] * length, unit[1] * across

    def _turned(self, unit: Array) -> Array:
        """Return vectors of the unit square as vectors of the base frame, shape (3, B, N)."""
        u, v = self._sides_mm(unit)
        cos, sin = np.cos(self.values[:, _ANGLE, None]), np.sin(self.values[:, _ANGLE, None])
        return np.stack([cos * u - sin * v, sin * u + cos * v, self.values[:, _SLOPE, None] * u])


def newton_steps(normal_matrices: Array, gradients: Array, damping: float) -> tuple[Array, Array]:
    """Return damped Gauss-Newton steps of B figures and the inverses of their normal matrices.

    Args:
        normal_matrices: shape (B, 7, 7); what is held has neither row nor column.
        gradients: shape (B, 7).
        damping: what is added to the diagonal of each matrix when its parameters are scaled to 1.

    Returns:
        Steps, shape (B, 7), and inverses, shape (B, 7, 7).
    """
    diagonal = np.einsum("bii->bi", normal_matrices)
    norm = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    # what is held has no row: 1 on the diagonal keeps the inverse of the rest
    added = np.where(diagonal > 0.0, damping, 1.0)[:, :, None] * np.eye(diagonal.shape[1])
    inverses = np.linalg.inv(normal_matrices / (norm[:, :, None] * norm[:, None, :]) + added)
    inverses /= norm[:, :, None] * norm[:, None, :]
    return (inverses @ gradients[..., None])[..., 0], inverses


def _mapped(matrix: Array, vectors: Array) -> Array:
    """Return a 3x3 matrix applied to vectors of shape (3, ...)."""
    mapped: Array = (matrix @ vectors.reshape(3, -1)).reshape(vectors.shape)
    return mapped


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
