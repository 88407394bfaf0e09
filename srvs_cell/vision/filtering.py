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

_WINDOW_PX = (3, 3)


def filter_edges(mask: NDArray[np.bool_], parameters: FilterParameters) -> NDArray[np.bool_]:
    """Return the edge mask, bool, shape (H, W), without peaks and holes."""
    edges = mask
    for _ in range(parameters.passes):
        own = edges.view(np.uint8)
        around = cv2.boxFilter(own, cv2.CV_8U, _WINDOW_PX, normalize=False, borderType=cv2.BORDER_CONSTANT) - own
        edges = (around >= parameters.hole_neighbours) | (edges & (around > parameters.peak_neighbours))
    return np.asarray(edges)
