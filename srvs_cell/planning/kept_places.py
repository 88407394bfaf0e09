"""The places that a job is about, kept while it plans anew: where a part waits for the moment is none of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linear_sum_assignment

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.scene import Point2


@dataclass(frozen=True)
class KeptPlaces:
    """Places of the job and how far from one a part still stands on it.

    Attributes:
        points_mm: the places.
        tolerance_mm: distance at which a part counts as standing on a place.
    """

    points_mm: tuple[Point2, ...]
    tolerance_mm: float

    def compare(self, standing_mm: Sequence[Point2]) -> tuple[list[bool], tuple[Point2, ...]]:
        """Return of each standing point whether it is on a place, and the places on which nothing stands."""
        distance_mm = np.array([[math.dist(point, place) for place in self.points_mm] for point in standing_mm])
        distance_mm = distance_mm.reshape(len(standing_mm), len(self.points_mm))
        rows, columns = linear_sum_assignment(np.minimum(distance_mm, 2.0 * self.tolerance_mm))
        pairs = [(i, j) for i, j in zip(rows, columns, strict=True) if distance_mm[i, j] <= self.tolerance_mm]
        on_place, taken = {int(i) for i, _ in pairs}, {int(j) for _, j in pairs}
        vacant = tuple(place for j, place in enumerate(self.points_mm) if j not in taken)
        return [i in on_place for i in range(len(standing_mm))], vacant
