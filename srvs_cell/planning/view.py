"""Where a part can be seen by the looks that check it. What the cameras see is told from outside."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from srvs_cell.planning.clearance import corners_mm

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.planning.problem import ProblemObject


class View(Protocol):
    """What the cameras see."""

    def sees(self, points_mm: Array, *, from_aside: bool) -> NDArray[np.bool_]:
        """Tell of points (..., 3), x and y in the base frame and height above the table, whether all pictures do.

        Args:
            points_mm: the points.
            from_aside: also those of a look that is repeated from aside.
        """


def in_view(item: ProblemObject, points_mm: Array, view: View, *, from_aside: bool) -> NDArray[np.bool_]:
    """Return, per point (C, 2), whether the whole of an object that stands there is seen: foot and top."""
    corners = points_mm[:, None, :] + corners_mm(item.footprint)
    heights = [np.full((*corners.shape[:2], 1), height_mm) for height_mm in (0.0, item.top_mm)]
    solid = np.concatenate([np.concatenate([corners, height], axis=-1) for height in heights], axis=1)
    seen: NDArray[np.bool_] = np.all(view.sees(solid, from_aside=from_aside), axis=1)
    return seen
