"""What the vision does not know for sure, as room that has to stay free.

A gap counts where it is wider than three standard deviations of the two positions that make it. Footprints are grown
by what the configured clearance does not already hold, fingers by all of it: they need no clearance otherwise.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.planning.clearance import minkowski_sum
from srvs_cell.planning.problem import Polygon
from srvs_cell.scene import UNKNOWN_KIND

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.planning.problem import FingerGrip
    from srvs_cell.scene import Workpiece

SIGMAS = 3.0
_ORDER_SIGMAS = 2.0
"""So well the order of two heights is to be known, as a grasp's place is."""
_SIDES = 8


def sigma_mm(workpiece: Workpiece) -> float:
    """Return the standard deviation of a workpiece's position on the table, in its worst direction.

    A covariance that is not finite says nothing here; the cell grips no such workpiece.
    """
    if not np.all(np.isfinite(workpiece.covariance_mm2)):
        return 0.0
    worst_mm2 = float(np.linalg.eigvalsh(workpiece.covariance_mm2[:2, :2])[-1])
    return math.sqrt(max(worst_mm2, 0.0))


def top_mm(workpiece: Workpiece, unknown_height_mm: float) -> float:
    """Return a height above the table that a workpiece certainly does not exceed: three sigma above its own.

    A part of unknown shape may rise where nothing was seen of it: it is taken for ``unknown_height_mm`` at least.
    """
    variance_mm2 = float(workpiece.covariance_mm2[2, 2])
    sigma = math.sqrt(max(variance_mm2, 0.0)) if math.isfinite(variance_mm2) else 0.0
    top = workpiece.height_mm + SIGMAS * sigma
    return max(top, unknown_height_mm) if workpiece.kind == UNKNOWN_KIND else top


def unordered(workpieces: Sequence[Workpiece], tolerance_mm: float) -> list[tuple[Workpiece, Workpiece, float]]:
    """Return pairs of which either may be the higher one by more than a tolerance, as far as the vision knows.

    Each with two standard deviations of the difference of their heights, mm. Pairs that are nearly equal and well
    known are none: they may stand in either order.
    """
    pairs = []
    for one, other in combinations(workpieces, 2):
        variance_mm2 = float(one.covariance_mm2[2, 2] + other.covariance_mm2[2, 2])
        doubt_mm = _ORDER_SIGMAS * math.sqrt(max(variance_mm2, 0.0)) if math.isfinite(variance_mm2) else math.inf
        if doubt_mm > abs(one.height_mm - other.height_mm) + tolerance_mm:
            pairs.append((one, other, doubt_mm))
    return pairs


def footprint_growth_mm(workpiece: Workpiece, clearance_mm: float) -> float:
    """Return by how much a footprint grows; two of them with the clearance between hold three sigma of both."""
    return max(0.0, SIGMAS * sigma_mm(workpiece) - clearance_mm / 2.0)


def grown(polygon: Polygon, growth_mm: float) -> Polygon:
    """Return a convex polygon grown outwards by at least a length, and at most 9 % more at corners."""
    if growth_mm <= 0.0:
        return polygon
    angles = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    octagon = np.column_stack([np.cos(angles), np.sin(angles)]) * growth_mm / math.cos(math.pi / _SIDES)
    corners = minkowski_sum(np.array(polygon.vertices_mm), octagon)
    return Polygon(tuple((float(x), float(y)) for x, y in corners))


def finger_growth_mm(workpiece: Workpiece, others: Sequence[Workpiece]) -> float:
    """Return by how much fingers grow: three sigma of the workpiece and of the least certain other together."""
    worst_mm = max((sigma_mm(other) for other in others if other.id != workpiece.id), default=0.0)
    return SIGMAS * math.hypot(sigma_mm(workpiece), worst_mm)


def wider(grip: FingerGrip, growth_mm: float) -> FingerGrip:
    """Return the room of the hand grown to all sides but the one that closes on the workpiece."""
    palm = grip.palm
    if palm is not None:
        palm = replace(
            palm, half_along_mm=palm.half_along_mm + growth_mm, half_across_mm=palm.half_across_mm + growth_mm
        )
    return replace(grip, thick_mm=grip.thick_mm + growth_mm, width_mm=grip.width_mm + 2.0 * growth_mm, palm=palm)
