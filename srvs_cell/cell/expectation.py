"""Where every workpiece should stand by now, against what a look has really seen. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linear_sum_assignment

from srvs_cell.planning import footprint_centroid_mm, turned, turned_deg

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from srvs_cell.config import ToleranceParameters
    from srvs_cell.geometry import Array
    from srvs_cell.planning import Carry, CellPlan
    from srvs_cell.scene import Point2, Workpiece

_SAME_POINT_MM = 1e-6
_NO_PAIR_MM = 1e6
_BIN_MM = 50.0
"""Nearer than this to a bin's point a part lies in the bin, however it fell."""


@dataclass(frozen=True)
class Expected:
    """A workpiece, its yaw and rise as they should be by now, and where its footprint's centroid should be.

    In a bin it need not be seen.
    """

    workpiece: Workpiece
    point_mm: Point2
    in_bin: bool = False


@dataclass(frozen=True)
class Comparison:
    """What a look says of what was expected.

    Attributes:
        errors_mm: per expected workpiece, how far from its point it is seen; None where it is not seen there.
        changes: what is not as expected, one line for each part; empty where all is.
        added_mm: where parts stand that nobody expected.
    """

    errors_mm: dict[int, float | None]
    changes: tuple[str, ...]
    added_mm: tuple[Point2, ...]


def expected_now(plan: CellPlan, workpieces: Sequence[Workpiece], carried: Mapping[int, Carry]) -> tuple[Expected, ...]:
    """Return where everything should stand that the plan was made from, after the moves that were carried out.

    Args:
        plan: the plan.
        workpieces: what was perceived before it.
        carried: how each workpiece has been carried since.
    """
    bins_mm = [goal.point_mm for goal in plan.goals if not goal.visible]
    found = []
    for workpiece in workpieces:
        point_mm, part = footprint_centroid_mm(workpiece.footprint_mm), workpiece
        if workpiece.id in carried:
            carry = carried[workpiece.id]
            point_mm, part = carry.to_mm, turned(workpiece, carry.turn_deg)
        in_bin = any(math.dist(point_mm, bin_mm) < _SAME_POINT_MM for bin_mm in bins_mm)
        found.append(Expected(part, point_mm, in_bin))
    return tuple(found)


def compare(expected: Sequence[Expected], seen: Sequence[Workpiece], tolerance: ToleranceParameters) -> Comparison:
    """Compare what is seen with what is expected.

    A workpiece stands as expected where one of its height is seen within ``verify_mm`` of its point, not turned by more
    than ``verify_deg``. Of the others, those of equal height are taken for the same one, moved. Heights are compared in
    the middle of the top face: there a face is known best, also where its slope was misjudged.
    """
    points_mm = [footprint_centroid_mm(workpiece.footprint_mm) for workpiece in seen]
    shape = (len(expected), len(seen))
    distance_mm = np.array([[math.dist(each.point_mm, point) for point in points_mm] for each in expected])
    off_deg = np.array([[abs(turned_deg(each.workpiece, other)) for other in seen] for each in expected])
    higher_mm = np.array(
        [[other.position_mm[2] - each.workpiece.position_mm[2] for other in seen] for each in expected]
    )
    distance_mm, off_deg = distance_mm.reshape(shape), off_deg.reshape(shape)
    alike = np.abs(higher_mm.reshape(shape)) <= tolerance.verify_height_mm
    here = (distance_mm <= tolerance.verify_mm) & (off_deg <= tolerance.verify_deg)
    standing = _pairs(distance_mm, alike & here)
    missed = [i for i, each in enumerate(expected) if i not in standing and not each.in_bin]
    bins_mm = [each.point_mm for each in expected if each.in_bin]
    strange = [
        j
        for j, point_mm in enumerate(points_mm)
        if j not in standing.values() and not any(math.dist(point_mm, bin_mm) < _BIN_MM for bin_mm in bins_mm)
    ]
    moved = _pairs(distance_mm[np.ix_(missed, strange)], alike[np.ix_(missed, strange)])
    changes = []
    for row, i in enumerate(missed):
        where = f"workpiece {expected[i].workpiece.id} ({expected[i].workpiece.kind})"
        if row not in moved:
            changes.append(f"{where} is not seen at {_text(expected[i].point_mm)} or anywhere else")
            continue
        j = strange[moved[row]]
        how = f"{distance_mm[i, j]:.1f} mm from {_text(expected[i].point_mm)}, at {_text(points_mm[j])}"
        also = f", turned by {off_deg[i, j]:.0f} deg" if off_deg[i, j] > tolerance.verify_deg else ""
        changes.append(f"{where} is {how}{also}")
    added = [j for column, j in enumerate(strange) if column not in moved.values()]
    changes += [f"a {seen[j].kind} part stands at {_text(points_mm[j])} that was not there" for j in added]
    return Comparison(
        {
            each.workpiece.id: round(float(distance_mm[i, standing[i]]), 3) if i in standing else None
            for i, each in enumerate(expected)
        },
        tuple(changes),
        tuple(points_mm[j] for j in added),
    )


def _pairs(distance_mm: Array, allowed: NDArray[np.bool_]) -> dict[int, int]:
    """Return row -> column of the allowed pairs with the least sum of distances."""
    cost_mm = np.where(allowed, distance_mm, _NO_PAIR_MM)
    rows, columns = linear_sum_assignment(cost_mm)
    return {int(i): int(j) for i, j in zip(rows, columns, strict=True) if allowed[i, j]}


def _text(point_mm: Point2) -> str:
    return f"({point_mm[0]:.1f}, {point_mm[1]:.1f})"
