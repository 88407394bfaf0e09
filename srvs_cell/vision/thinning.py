"""Step 4: thinning to lines one pixel wide (Zhang and Suen, CACM 27(3), 1984).

The neighbourhood of a pixel is a number of eight bits, so that both sub-passes are look-up tables.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_NEIGHBOUR_BITS = np.array([[128, 1, 2], [64, 0, 4], [32, 16, 8]], dtype=np.float32)
"""Bit of each neighbour: p2 (north) is bit 0, then clockwise to p9."""
_CODES = 256
_MIN_NEIGHBOURS, _MAX_NEIGHBOURS = 2, 6


def _tables() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return, for both sub-passes, 1 where a pixel with that neighbourhood is deleted."""
    codes = np.arange(_CODES)
    p = [(codes >> bit) & 1 for bit in range(8)]
    neighbours = sum(p)
    transitions = sum((1 - p[k]) * p[(k + 1) % 8] for k in range(8))
    removable = (neighbours >= _MIN_NEIGHBOURS) & (neighbours <= _MAX_NEIGHBOURS) & (transitions == 1)
    north, east, south, west = p[0], p[2], p[4], p[6]
    first = removable & (north * east * south == 0) & (east * south * west == 0)
    second = removable & (north * east * west == 0) & (north * south * west == 0)
    return first.astype(np.uint8), second.astype(np.uint8)


_FIRST, _SECOND = _tables()


def thin(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the skeleton of a mask, bool, shape (H, W); connectedness is kept."""
    image = mask.astype(np.uint8)
    changed = True
    while changed:
        changed = False
        for table in (_FIRST, _SECOND):
            code = cv2.filter2D(image, cv2.CV_8U, _NEIGHBOUR_BITS, borderType=cv2.BORDER_CONSTANT)
            deleted = cv2.bitwise_and(cv2.LUT(code, table), image)
            if cv2.countNonZero(deleted):
                image = np.asarray(cv2.subtract(image, deleted), dtype=np.uint8)
                changed = True
    return np.asarray(image > 0)
