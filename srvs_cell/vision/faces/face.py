"""Step 11a: the flat figures that top faces are: rectangle, circle and regular hexagon over the table."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from srvs_cell.geometry import Array

HEXAGON_RATIO = float(np.cos(np.pi / 6.0))
"""Across flats over across corners."""
_SHARED_PLACE = 0.4
"""Share of the smaller footprint that measuring errors never let two neighbours share."""
_CIRCLE_CORNERS = 24
_HEXAGON_CORNERS = 6
_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


SIDES = ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0))
"""A rectangle's: axis (0 along the length, 1 across it) and which end of it."""


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
    def rise_deg(self) -> float | None:
        """Direction in which the face rises, from base x towards base y, 0 to 360; None where it is level."""
        if self.slope_u == self.slope_v == 0.0:
            return None
        return float(np.rad2deg(self.angle_rad + np.arctan2(self.slope_v, self.slope_u))) % 360.0

    @property
    def highest_mm(self) -> float:
        """Height of the highest corner, base frame."""
        return float(self.corners_mm()[:, 2].max())

    @property
    def lowest_mm(self) -> float:
        """Height of the lowest corner, base frame."""
        return float(self.corners_mm()[:, 2].min())

    def normal(self) -> Array:
        """Return the unit normal, shape (3,), base frame, upwards."""
        cos, sin = np.cos(self.angle_rad), np.sin(self.angle_rad)
        rise_x = self.slope_u * cos - self.slope_v * sin
        rise_y = self.slope_u * sin + self.slope_v * cos
        upwards = np.array([-rise_x, -rise_y, 1.0])
        return np.asarray(upwards / np.linalg.norm(upwards))

    def height_at_mm(self, x_mm: float, y_mm: float) -> float:
        """Return the height, base frame, of the face's plane over a point of the table."""
        cos, sin = np.cos(self.angle_rad), np.sin(self.angle_rad)
        along = cos * (x_mm - self.x_mm) + sin * (y_mm - self.y_mm)
        across = cos * (y_mm - self.y_mm) - sin * (x_mm - self.x_mm)
        return float(self.z_mm + self.slope_u * along + self.slope_v * across)

    def corners_mm(self) -> Array:
        """Return the outline's corners (a circle: 24 points), (N, 3), base frame, counter-clockwise from above."""
        return self._corners_mm

    @cached_property
    def _corners_mm(self) -> Array:
        corners = self.place(unit_corners(self.figure))
        corners.flags.writeable = False
        return corners

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

    def beside(self, side: tuple[int, float], offsets_mm: Array, along: Array) -> Array:
        """Return points of a rectangle's plane beside one of its sides, base frame, shape (N, K, 3).

        Args:
            side: one of `SIDES`.
            offsets_mm: how far outwards, shape (N,).
            along: where along the side, -1 to 1, shape (K,).
        """
        axis, end = side
        unit = np.empty((offsets_mm.size, along.size, 2))
        unit[..., axis] = end * (1.0 + 2.0 * offsets_mm[:, None] / (self.length_mm, self.width_mm)[axis])
        unit[..., 1 - axis] = along
        return self.place(unit.reshape(-1, 2)).reshape(offsets_mm.size, along.size, 3)

    def stretched(self, side: tuple[int, float], shift_mm: float) -> Face:
        """Return a rectangle with one of its `SIDES` moved outwards in its plane."""
        axis, end = side
        size_mm = (self.length_mm, self.width_mm)[axis]
        centre = np.zeros((1, 2))
        centre[0, axis] = end * shift_mm / size_mm
        x_mm, y_mm, z_mm = (float(value) for value in self.place(centre)[0])
        moved = replace(self, x_mm=x_mm, y_mm=y_mm, z_mm=z_mm)
        if axis == 0:
            return replace(moved, length_mm=size_mm + shift_mm)
        return replace(moved, width_mm=size_mm + shift_mm)

    @property
    def _height_mm(self) -> float:
        """Millimetres that the unit square's second axis spans: a hexagon's unit is its circumscribed circle."""
        return self.width_mm if self.figure is Figure.RECTANGLE else self.length_mm


def same_place(face: Face, other: Face, tolerance_mm: float) -> bool:
    """Whether two faces are one figure, level or inclined, whose centres and sizes differ by no more than this."""
    if face.figure is not other.figure or (face.slope_u == 0.0) != (other.slope_u == 0.0):
        return False
    apart_mm = math.dist((face.x_mm, face.y_mm, face.z_mm), (other.x_mm, other.y_mm, other.z_mm))
    sizes, others = (sorted((one.length_mm, one.width_mm)) for one in (face, other))
    return max(apart_mm, *(abs(size - of_other) for size, of_other in zip(sizes, others, strict=True))) <= tolerance_mm


def share_place(face: Face, other: Face) -> bool:
    """Whether two faces stand over one place, so that they cannot both be right."""
    outline, standing = (one.corners_mm()[:, :2].astype(np.float32) for one in (face, other))
    shared_mm2, _ = cv2.intersectConvexConvex(outline, standing)
    return bool(shared_mm2 > _SHARED_PLACE * min(cv2.contourArea(outline), cv2.contourArea(standing)))


def inclined_faces(rectangle: Face, slope: float) -> list[Face]:
    """Return a level rectangle inclined along each of its sides, upwards and downwards, by a rise per millimetre."""
    faces = []
    for _ in _SQUARE:
        faces.append(replace(rectangle, slope_u=slope))
        rectangle = rectangle.quarter_turned()
    return faces


@lru_cache(maxsize=3)
def unit_corners(figure: Figure) -> Array:
    """Return a figure's corners (a circle: 24 points) in its unit square [-1, 1], counter-clockwise, (N, 2)."""
    if figure is Figure.RECTANGLE:
        return _SQUARE
    count = _HEXAGON_CORNERS if figure is Figure.HEXAGON else _CIRCLE_CORNERS
    turn = np.arange(count) * (2.0 * np.pi / count)
    return np.column_stack([np.cos(turn), np.sin(turn)])
