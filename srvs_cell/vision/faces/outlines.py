"""Step 11a: many figures at once, sampled along their outlines, as both cameras see them.

All figures of a batch have the same number of samples and the same seven parameters (x, y, z, length, angle, width,
slope along the length), some of which are held: whatever is done to one is one array operation for all. A sample is
(u, v, 1) in its figure's plane; one 3x3 matrix leads from there to homogeneous pixels of a camera (Hartley and
Zisserman 2004, 8.1), and its derivatives by the parameters are matrices like it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.faces.face import HEXAGON_RATIO, Face, Figure, unit_corners

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
_SAMPLES_AT_ONCE = 3072
_TINY = float(np.finfo(float).tiny)
_LENGTH, _ANGLE, _WIDTH, _SLOPE = 3, 4, 5, 6
"""Places of the parameters behind x, y and z."""
_PLACE = np.arange(3)
_OF_PLACE = np.eye(7, 3)


@dataclass(frozen=True, eq=False)
class Borders:
    """Outlines as both rectified cameras see them: B figures with N samples; first axis: left and right image.

    Attributes:
        points_px: the samples, x and y, shape (2, B, 2, N).
        normals: unit normals that point away from the figures' middles, x and y, the same shape.
        spacing_px: distance from each sample to the next one of its side, shape (2, B, N).
        depth_mm: distance of the samples from the cameras' plane, shape (2, B, N).
        by_parameter: how far the outline moves outwards at each sample with each of the figure's seven parameters, 0
            for those that are held, pixels, shape (2, B, 7, N).
        in_front: whether all of a figure is in front of the cameras and finite, shape (B,).
    """

    points_px: Array
    normals: Array
    spacing_px: Array
    depth_mm: Array
    by_parameter: Array
    in_front: NDArray[np.bool_]

    def only(self, kept: NDArray[np.intp]) -> Borders:
        """Return some of the figures by their numbers."""
        return Borders(
            self.points_px[:, kept],
            self.normals[:, kept],
            self.spacing_px[:, kept],
            self.depth_mm[:, kept],
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
        unit: the samples in the figure's own unit square [-1, 1], homogeneous (u, v, 1), shape (B, 3, N).
        ways: from there to the next sample, counter-clockwise from above, (u, v, 0), shape (B, 3, N).
        last: whether a sample is the last of its side, bool, shape (B, N).
    """

    figures: tuple[Figure, ...]
    values: Array
    free: NDArray[np.bool_]
    unit: Array
    ways: Array
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
        unit, ways, last = (np.stack(parts) for parts in zip(*sampled, strict=True))
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
        return cls(tuple(face.figure for face in faces), values, free, unit, ways, last)

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
            self.ways[kept],
            self.last[kept],
        )

    def moved(self, steps: Array) -> Outlines:
        """Return the figures with their parameters changed by steps, shape (B, 7); no size falls below 3 mm."""
        values = self.values + np.where(self.free, steps, 0.0)
        values[:, [_LENGTH, _WIDTH]] = np.maximum(values[:, [_LENGTH, _WIDTH]], _MIN_SIZE_MM)
        return replace(self, values=values)

    def room_above(self, z_mm: float) -> tuple[Array, Array]:
        """Return how far each figure's lowest corner is above a height, and how that changes with the parameters.

        The low side of a wedge may lie on the table, where it has next to no border of its own; but it is never below.
        Figures that are held level have room enough.

        Returns:
            Millimetres, shape (B,), and derivatives, shape (B, 7).
        """
        inclined = self.free[:, _SLOPE]
        half_mm, slope = self.values[:, _LENGTH] / 2.0, self.values[:, _SLOPE]
        by_parameter = np.zeros_like(self.values)
        by_parameter[:, 2], by_parameter[:, _LENGTH] = 1.0, -np.abs(slope) / 2.0
        by_parameter[:, _SLOPE] = -np.sign(slope) * half_mm
        room_mm = np.where(inclined, self.values[:, 2] - np.abs(slope) * half_mm - z_mm, np.inf)
        return room_mm, by_parameter * inclined[:, None]

    def points_mm(self, unit: Array | None = None) -> Array:
        """Return the samples, or other points (u, v, 1) of the unit square, in the base frame, shape (B, 3, N)."""
        points: Array = self._placements()[:, :3] @ (self.unit if unit is None else unit)
        return points

    def seen(self, rig: RectifiedRig) -> Borders:
        """Return the outlines as the cameras see them."""
        placements = self._placements()
        planes = rig.projections[:, None] @ placements
        seen, flow = planes @ self.unit, planes @ self.ways
        in_front = np.all(seen[0, :, 2] > _NEAREST_MM, axis=1)
        depth = np.maximum(seen[:, :, 2:], _NEAREST_MM)
        points = seen[:, :, :2] / depth
        flow = flow[:, :, :2] - points * flow[:, :, 2:]
        length = np.maximum(np.hypot(flow[:, :, :1], flow[:, :, 1:]), _TINY)
        # counter-clockwise from above is clockwise in a picture whose y axis points down
        normals = flow[:, :, ::-1] / np.copysign(length, np.linalg.det(planes)[..., None, None])
        normals[:, :, 1] *= -1.0
        # how a pixel moves along the normal when its homogeneous coordinates change
        covectors = np.empty(seen.shape)
        covectors[:, :, :2] = normals
        covectors[:, :, 2] = -normals[:, :, 0] * points[:, :, 0] - normals[:, :, 1] * points[:, :, 1]
        covectors /= depth
        by_element = (covectors[:, :, :, None] * self.unit[:, None]).reshape(*seen.shape[:2], 9, -1)
        changes = rig.projections[:, None, None, :, :3] @ self._changes(placements)
        by_parameter = changes.reshape(*seen.shape[:2], -1, 9) @ by_element
        return Borders(points, normals, (length / depth)[:, :, 0], depth[:, :, 0], by_parameter, in_front)

    def normals_mm(self) -> Array:
        """Return the horizontal unit normals that point away from the figures, base frame x and y, shape (B, 2, N)."""
        along = (self._placements()[:, :3] @ self.ways)[:, :2]
        normals: Array = along[:, ::-1] / np.maximum(np.hypot(along[:, :1], along[:, 1:]), _TINY)
        normals[:, 1] *= -1.0
        return normals

    def side_px(self, borders: Borders, rig: RectifiedRig, table_z_mm: float) -> Array:
        """Return how far outside of the border the table's points under the samples are seen, shape (2, B, N).

        Args:
            borders: these outlines as the cameras see them.
            rig: the rectified cameras.
            table_z_mm: height of the table, base frame.
        """
        rise = (self.values[:, _SLOPE] * self.values[:, _LENGTH] / 2.0)[:, None] * self.unit[:, 0]
        drop = rise + (self.values[:, 2, None] - table_z_mm)
        # pixels move by height as depth allows, and depth grows on the way down
        deeper = borders.depth_mm - drop * rig.projections[0, 2, 2]
        side: Array = -borders.by_parameter[:, :, 2] * drop * borders.depth_mm / np.maximum(deeper, _NEAREST_MM)
        return side

    def _placements(self) -> Array:
        """Return the matrices from the figures' planes to the base frame, homogeneous, shape (B, 4, 3)."""
        length, angle, width, slope = self.values[:, _LENGTH:].T
        # a figure that is no rectangle is as wide as long
        half, across = length / 2.0, np.where(self.free[:, _WIDTH], width, length) / 2.0
        cos, sin = np.cos(angle), np.sin(angle)
        placements = np.zeros((len(half), 4, 3))
        placements[:, 0, 0], placements[:, 1, 0], placements[:, 2, 0] = cos * half, sin * half, slope * half
        placements[:, 0, 1], placements[:, 1, 1] = -sin * across, cos * across
        placements[:, :3, 2] = self.values[:, :3]
        placements[:, 3, 2] = 1.0
        return placements

    def _changes(self, placements: Array) -> Array:
        """Return the derivatives of the placements by the seven parameters, 0 for what is held, (B, 7, 3, 3)."""
        rectangle, length = self.free[:, _WIDTH, None], self.values[:, _LENGTH, None]
        across = placements[:, :3, 1] / np.where(rectangle, self.values[:, _WIDTH, None], length)
        changes = np.zeros((*self.values.shape, 3, 3))
        changes[:, _PLACE, _PLACE, 2] = 1.0
        changes[:, _LENGTH, :, 0] = placements[:, :3, 0] / length
        changes[:, _LENGTH, :, 1] = np.where(rectangle, 0.0, across)
        changes[:, _ANGLE, 0, :2] = -placements[:, 1, :2]
        changes[:, _ANGLE, 1, :2] = placements[:, 0, :2]
        changes[:, _WIDTH, :, 1] = across
        changes[:, _SLOPE, 2, 0] = length[:, 0] / 2.0
        changes *= self.free[:, :, None, None]
        return changes


def batches(starts: int, samples: int) -> list[slice]:
    """Return which of many outlines are fitted together: what is read along them stays in the processor's cache."""
    size = max(1, _SAMPLES_AT_ONCE // samples)
    return [slice(first, first + size) for first in range(0, starts, size)]


def newton_steps(
    normal_matrices: Array, gradients: Array, damping: float, room: tuple[Array, Array] | None = None
) -> tuple[Array, Array]:
    """Return damped Gauss-Newton steps of B figures and the covariances of their places.

    A step that leaves the room is replaced by the likeliest one that does not.

    Args:
        normal_matrices: shape (B, 7, 7); what is held has neither row nor column.
        gradients: shape (B, 7).
        damping: what is added to the diagonal of each matrix when its parameters are scaled to 1.
        room: see `Outlines.room_above`; None for no limit.

    Returns:
        Steps, shape (B, 7), and of x, y and z the inverses of the normal matrices, shape (B, 3, 3).
    """
    diagonal = np.einsum("bii->bi", normal_matrices)
    # what is held has no row: 1 on the diagonal keeps the inverse of the rest
    there = diagonal > 0.0
    norm = np.sqrt(np.where(there, diagonal, 1.0))[:, :, None]
    scaled = normal_matrices / (norm * np.swapaxes(norm, 1, 2))
    np.einsum("bii->bi", scaled)[...] += np.where(there, damping, 1.0)
    sides = np.zeros((*gradients.shape, 5))
    sides[:, :, 0], sides[:, :, 1:4] = gradients, _OF_PLACE
    if room is not None:
        sides[:, :, 4] = room[1]
    solved = np.linalg.solve(scaled, sides / norm) / norm
    steps, covariances = solved[:, :, 0], solved[:, :3, 1:4]
    if room is not None:
        room_mm, by_parameter = room
        lacking_mm = np.maximum(-room_mm - (by_parameter * steps).sum(axis=1), 0.0)
        likeliest = solved[:, :, 4]
        gained = np.maximum((by_parameter * likeliest).sum(axis=1), _TINY)
        steps = steps + (lacking_mm / gained)[:, None] * likeliest
    return steps, covariances


@lru_cache(maxsize=256)
def _sample(figure: Figure, counts: tuple[int, ...]) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return samples and ways to the next ones, both homogeneous, (3, N), and which end a side."""
    if figure is Figure.CIRCLE:
        (samples,) = counts
        turn = np.arange(samples) * (2.0 * np.pi / samples)
        cos, sin = np.cos(turn), np.sin(turn)
        points, along = np.stack([cos, sin, np.ones(samples)]), np.stack([-sin, cos, np.zeros(samples)])
        return points, along * (2.0 * np.pi / samples), np.arange(samples) == samples - 1
    corners = unit_corners(figure)
    pieces, ways, last = [], [], []
    for start, end, count in zip(corners, np.roll(corners, -1, axis=0), counts, strict=True):
        share = np.linspace(_CORNER_SHARE, 1.0 - _CORNER_SHARE, count)[:, None]
        pieces.append(start + share * (end - start))
        ways.append(np.broadcast_to((1.0 - 2.0 * _CORNER_SHARE) / (count - 1) * (end - start), (count, 2)))
        last.append(np.arange(count) == count - 1)
    count = sum(counts)
    points = np.vstack([np.concatenate(pieces).T, np.ones(count)])
    directions = np.vstack([np.concatenate(ways).T, np.zeros(count)])
    return points, directions, np.concatenate(last)


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
