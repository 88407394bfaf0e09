"""How a workpiece is carried: its footprint's centroid from one point to another, and turned about it."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from srvs_cell.geometry import wrap_angle_deg

if TYPE_CHECKING:
    from srvs_cell.scene import Grasp, Point2, Workpiece

_HALF_TURN_DEG, _QUARTER_DEG = 180.0, 90.0
_OBLONG = 1.2
"""Length over width from which on long and short side are not mistaken for each other."""


@dataclass(frozen=True)
class Carry:
    """Where a workpiece came from and where it went.

    Attributes:
        from_mm, to_mm: x and y of its footprint's centroid before and after.
        turn_deg: by how much it was turned about that, from base x towards base y.
    """

    from_mm: Point2
    to_mm: Point2
    turn_deg: float = 0.0

    def then(self, following: Carry) -> Carry:
        """Return both, one after the other, as one."""
        return Carry(self.from_mm, following.to_mm, self.turn_deg + following.turn_deg)

    def point(self, point_mm: Point2) -> Point2:
        """Return where a point of the workpiece went."""
        arm = complex(point_mm[0] - self.from_mm[0], point_mm[1] - self.from_mm[1])
        turned = arm * cmath.rect(1.0, math.radians(self.turn_deg))
        return self.to_mm[0] + turned.real, self.to_mm[1] + turned.imag

    def grasp(self, grasp: Grasp) -> Grasp:
        """Return a grasp of the workpiece where it is now; the others are left out."""
        x_mm, y_mm, z_mm = grasp.position_mm
        position_mm = (*self.point((x_mm, y_mm)), z_mm)
        return replace(grasp, position_mm=position_mm, yaw_deg=grasp.yaw_deg + self.turn_deg, others=())


def yaw_period_deg(*sightings: Workpiece) -> float:
    """Return the turn after which a part looks the same: half of one, or a quarter where its sides are nearly equal.

    Args:
        sightings: of one part; each must tell long and short side apart.
    """
    oblong = all(part.size_mm[0] > _OBLONG * part.size_mm[1] for part in sightings)
    return _HALF_TURN_DEG if oblong else _QUARTER_DEG


def turn_to_deg(workpiece: Workpiece, yaw_deg: float) -> float:
    """Return the least turn that gives a workpiece a yaw, as far as its shape has one; 0 for cylinder and prism."""
    if workpiece.yaw_deg is None:
        return 0.0
    return wrap_angle_deg(yaw_deg - workpiece.yaw_deg, yaw_period_deg(workpiece))
