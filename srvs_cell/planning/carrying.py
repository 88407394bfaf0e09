"""How a workpiece is carried: its footprint's centroid from one point to another, and turned about it."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from srvs_cell.geometry import wrap_angle_deg

if TYPE_CHECKING:
    from srvs_cell.scene import Grasp, Point2, Workpiece

_WHOLE_TURN_DEG, _HALF_TURN_DEG, _QUARTER_DEG = 360.0, 180.0, 90.0
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


def turned_deg(one: Workpiece, other: Workpiece) -> float:
    """Return by how much a sighting of a part is turned against another, as far as its shape tells.

    An inclined top tells all of it. A level one looks the same after half a turn, and after a quarter of one where its
    sides are nearly equal; a part without a yaw looks the same always.
    """
    if one.rise_deg is not None and other.rise_deg is not None:
        return wrap_angle_deg(other.rise_deg - one.rise_deg, _WHOLE_TURN_DEG)
    if one.yaw_deg is None or other.yaw_deg is None:
        return 0.0
    oblong = all(part.size_mm[0] > _OBLONG * part.size_mm[1] for part in (one, other))
    return wrap_angle_deg(other.yaw_deg - one.yaw_deg, _HALF_TURN_DEG if oblong else _QUARTER_DEG)


def turned(workpiece: Workpiece, turn_deg: float) -> Workpiece:
    """Return a workpiece whose yaw and rise are those after a turn; all else is as it was seen."""
    yaw_deg, rise_deg = (
        None if angle_deg is None else angle_deg + turn_deg for angle_deg in (workpiece.yaw_deg, workpiece.rise_deg)
    )
    return replace(workpiece, yaw_deg=yaw_deg, rise_deg=rise_deg)


def turn_to_deg(workpiece: Workpiece, yaw_deg: float) -> float:
    """Return the least turn after which a workpiece stands at a yaw; 0 for cylinder and prism.

    The yaw is that of the long side; of a part with an inclined top it is the direction in which that rises.
    """
    if workpiece.yaw_deg is None:
        return 0.0
    there = replace(workpiece, yaw_deg=yaw_deg, rise_deg=None if workpiece.rise_deg is None else yaw_deg)
    return turned_deg(workpiece, there)
