"""Step 3: the paper's filter, which cuts peaks and fills holes near the edges.

A peak (a pixel or two sticking out of an edge region) makes a spur when the edge is thinned, a hole makes a loop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.vision.parameters import FilterParameters

_NEIGHBOURS = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], dtype=np.float32)


def filter_edges(mask: NDArray[np.bool_], parameters: FilterParameters) -> NDArray[np.bool_]:
    """Return the edge mask, bool, shape (H, W), without peaks and holes."""
    edges = mask.astype(np.uint8)
    for _ in range(parameters.passes):
        around = cv2.filter2D(edges, cv2.CV_8U, _NEIGHBOURS, borderType=cv2.BORDER_CONSTANT)
        filled = (around >= parameters.hole_neighbours) | ((edges > 0) & (around > parameters.peak_neighbours))
        edges = filled.astype(np.uint8)
    return np.asarray(edges > 0)
