"""The simulated workpieces: cuboid, cylinder, wedge and hexagonal prism."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.geometry import axis_rotation

if TYPE_CHECKING:
    from srvs_cell.geometry import Array

CUBOID, CYLINDER, WEDGE, PRISM = "cuboid", "cylinder", "wedge", "prism"
KINDS = (CUBOID, CYLINDER, WEDGE, PRISM)
_CIRCLE_POINTS = 32
_FLATS_PER_CORNERS = np.sqrt(3.0) / 2.0


@dataclass(frozen=True, kw_only=True)
class Part:
    """A workpiece as it was put on the table.

    Its own frame has the origin at the footprint's centre on the bottom, z up, x along the long side (prism: along a
    corner).

    Attributes:
        kind: cuboid, cylinder, wedge or prism.
        length_mm, width_mm: footprint along x and y; a cylinder's diameter twice; a prism's size across corners and
            across flats.
        height_mm: highest point above the bottom.
        low_height_mm: a wedge's height at its low side (at +x); otherwise the height.
        x_mm, y_mm, yaw_deg: where it stands, base frame.
        albedo: reflectance of its faces.
        label: whether its top is printed.
    """

    kind: str
    length_mm: float
    width_mm: float
    height_mm: float
    low_height_mm: float
    x_mm: float
    y_mm: float
    yaw_deg: float
    albedo: float
    label: bool

    @property
    def top_centre_mm(self) -> Array:
        """Centre of the top (wedge: inclined) face in the part's own frame, shape (3,)."""
        return np.array([0.0, 0.0, (self.height_mm + self.low_height_mm) / 2.0])

    @property
    def grip_width_mm(self) -> float:
        """Distance of the walls between which the part is meant to be gripped."""
        return self.width_mm

    @property
    def grip_yaw_deg(self) -> float:
        """Direction of the jaws' closing motion for those walls, base frame."""
        return self.yaw_deg + 90.0

    def outline_mm(self) -> Array:
        """Return the footprint in the part's own frame, shape (N, 2), counter-clockwise."""
        half_length, half_width = self.length_mm / 2.0, self.width_mm / 2.0
        if self.kind in {CUBOID, WEDGE}:
            corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            return np.array(corners) * (half_length, half_width)
        count = _CIRCLE_POINTS if self.kind == CYLINDER else 6
        angle = np.arange(count) * 2.0 * np.pi / count
        return half_length * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def footprint_mm(self) -> Array:
        """Return the footprint about the part's place, turned by its yaw but not moved, shape (N, 2)."""
        return self.outline_mm() @ axis_rotation("z", self.yaw_deg)[:2, :2].T

    def vertices_mm(self) -> Array:
        """Return the corners of a part with flat faces in its own frame, shape (N, 3)."""
        outline = self.outline_mm()
        share = (outline[:, 0] / self.length_mm) + 0.5
        top = self.height_mm + share * (self.low_height_mm - self.height_mm)
        bottom = np.column_stack([outline, np.zeros(len(outline))])
        return np.vstack([bottom, np.column_stack([outline, top])])


def prism_across_flats_mm(across_corners_mm: float) -> float:
    """Return a regular hexagon's size across flats."""
    return float(across_corners_mm * _FLATS_PER_CORNERS)
