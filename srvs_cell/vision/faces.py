"""Step 11a: the flat figures that top faces are: rectangle, circle and regular hexagon over the table."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array

HEXAGON_RATIO = float(np.cos(np.pi / 6.0))
"""Across flats over across corners."""
_CORNER_SHARE = 0.1
"""Share of a side left out at either end: there the neighbouring side's edge is met."""
_CIRCLE_CORNERS = 24
_HEXAGON_CORNERS = 6
_MIN_SIZE_MM = 3.0
_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


class Figure(StrEnum):
    """The outline of a top face."""

    RECTANGLE = "rectangle"
    CIRCLE = "circle"
    HEXAGON = "hexagon"


@dataclass(frozen=True)
class Face:
    """A flat figure over the table.

    Attributes:
        figure: its outline seen from above.
        x_mm: centre, base frame.
        y_mm: centre, base frame.
        z_mm: height of the centre, base frame.
        angle_rad: direction of the length (a hexagon: of one corner), from base x towards base y.
        length_mm: along that direction, seen from above (a circle: diameter; a hexagon: across corners).
        width_mm: across (a circle: diameter; a hexagon: across flats).
        slope_u: rise per millimetre along the length.
        slope_v: rise per millimetre along the width.
    """

    figure: Figure
    x_mm: float
    y_mm: float
    z_mm: float
    angle_rad: float
    length_mm: float
    width_mm: float
    slope_u: float = 0.0
    slope_v: float = 0.0

    @property
    def inclination_deg(self) -> float:
        """Angle between the face and the horizontal."""
        return float(np.rad2deg(np.arctan(np.hypot(self.slope_u, self.slope_v))))

    @property
    def highest_mm(self) -> float:
        """Height of the highest corner, base frame."""
        return float(self.corners_mm()[:, 2].max())

    def corners_mm(self) -> Array:
        """Return the outline's corners (a circle: 24 points), (N, 3), base frame, counter-clockwise from above."""
        return self.place(_unit_corners(self.figure))

    def side_lengths_mm(self) -> Array:
        """Return the length of each side; a circle has one side."""
        if self.figure is Figure.CIRCLE:
            return np.array([np.pi * self.length_mm])
        corners = self.corners_mm()
        return np.asarray(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1))

    def unit_outline(self, counts: NDArray[np.int_]) -> tuple[Array, Array]:
        """Return points of the outline and tangents in the figure's own unit square [-1, 1], each shape (N, 2).

        Args:
            counts: number of points on each side; a circle has one side.
        """
        if self.figure is Figure.CIRCLE:
            turn = np.arange(counts[0]) * (2.0 * np.pi / counts[0])
            points = np.column_stack([np.cos(turn), np.sin(turn)])
            return points, np.column_stack([-points[:, 1], points[:, 0]])
        corners = _unit_corners(self.figure)
        pieces, tangents = [], []
        for start, end, count in zip(corners, np.roll(corners, -1, axis=0), counts, strict=True):
            share = np.linspace(_CORNER_SHARE, 1.0 - _CORNER_SHARE, count)[:, None]
            pieces.append(start + share * (end - start))
            tangents.append(np.broadcast_to(end - start, (count, 2)))
        return np.concatenate(pieces), np.concatenate(tangents)

    def place(self, unit: Array) -> Array:
        """Return points of the unit square, shape (N, 2), as points of the face, shape (N, 3), base frame."""
        placed: Array = self.turn(unit) + np.array([self.x_mm, self.y_mm, self.z_mm])
        return placed

    def turn(self, unit: Array) -> Array:
        """Return vectors of the unit square, shape (N, 2), as vectors of the face, shape (N, 3), base frame."""
        u, v = unit[:, 0] * self.length_mm / 2.0, unit[:, 1] * self._height_mm / 2.0
        cos, sin = np.cos(self.angle_rad), np.sin(self.angle_rad)
        return np.column_stack([cos * u - sin * v, sin * u + cos * v, self.slope_u * u + self.slope_v * v])

    def quarter_turned(self) -> Face:
        """Return the same rectangle with length and width exchanged."""
        # the new length runs along the old width, the new width against the old length
        return replace(
            self,
            angle_rad=self.angle_rad + np.pi / 2.0,
            length_mm=self.width_mm,
            width_mm=self.length_mm,
            slope_u=self.slope_v,
            slope_v=-self.slope_u,
        )

    def parameters(self, *, inclined: bool) -> Array:
        """Return the free parameters: x, y, z, length and, as the figure has them, angle, width, slope along u.

        Only one slope is free: the inclined face of a wedge rises along one of its sides.
        """
        common = [self.x_mm, self.y_mm, self.z_mm, self.length_mm]
        if self.figure is Figure.CIRCLE:
            return np.array(common)
        if self.figure is Figure.HEXAGON:
            return np.array([*common, self.angle_rad])
        slopes = [self.slope_u] if inclined else []
        return np.array([*common, self.angle_rad, self.width_mm, *slopes])

    def with_parameters(self, values: Array) -> Face:
        """Return the face with other free parameters, in the order of `parameters`."""
        x_mm, y_mm, z_mm, length_mm, *rest = (float(value) for value in values)
        length_mm = max(length_mm, _MIN_SIZE_MM)
        if self.figure is Figure.CIRCLE:
            return Face(self.figure, x_mm, y_mm, z_mm, 0.0, length_mm, length_mm)
        if self.figure is Figure.HEXAGON:
            return Face(self.figure, x_mm, y_mm, z_mm, rest[0], length_mm, length_mm * HEXAGON_RATIO)
        angle_rad, width_mm, *slopes = rest
        return Face(self.figure, x_mm, y_mm, z_mm, angle_rad, length_mm, max(width_mm, _MIN_SIZE_MM), *slopes)

    def derivatives(self, unit: Array, *, inclined: bool) -> Array:
        """Return the derivative of `place` by each of `parameters`, shape (P, N, 3)."""
        count = len(unit)
        cos, sin = np.cos(self.angle_rad), np.sin(self.angle_rad)
        along = np.array([cos, sin, self.slope_u])
        across = np.array([-sin, cos, self.slope_v])
        columns = [np.broadcast_to(axis, (count, 3)) for axis in np.eye(3)]
        by_length = unit[:, :1] / 2.0 * along
        by_width = unit[:, 1:] / 2.0 * across
        if self.figure is not Figure.RECTANGLE:
            by_length = by_length + by_width
        columns.append(by_length)
        if self.figure is not Figure.CIRCLE:
            placed = self.turn(unit)
            columns.append(np.column_stack([-placed[:, 1], placed[:, 0], np.zeros(count)]))
        if self.figure is Figure.RECTANGLE:
            columns.append(by_width)
            if inclined:
                up = np.array([0.0, 0.0, 1.0])
                columns.append(unit[:, :1] * self.length_mm / 2.0 * up)
        return np.stack(columns)

    @property
    def _height_mm(self) -> float:
        """Millimetres that the unit square's second axis spans: a hexagon's unit is its circumscribed circle."""
        return self.width_mm if self.figure is Figure.RECTANGLE else self.length_mm


def _unit_corners(figure: Figure) -> Array:
    if figure is Figure.RECTANGLE:
        return _SQUARE
    count = _HEXAGON_CORNERS if figure is Figure.HEXAGON else _CIRCLE_CORNERS
    turn = np.arange(count) * (2.0 * np.pi / count)
    return np.column_stack([np.cos(turn), np.sin(turn)])
