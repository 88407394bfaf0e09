"""Step 4: thinning to lines one pixel wide (Zhang and Suen, CACM 27(3), 1984).

The neighbourhood of a pixel is a number of eight bits, so that both sub-passes are look-up tables. The numbers are
found once for the whole image; then only the pixels that are left are looked at, and a pixel that goes takes its bit
from its neighbours' numbers.
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
_NEIGHBOURS = tuple(
    (row - 1, column - 1, int(_NEIGHBOUR_BITS[row, column]))
    for row in range(3)
    for column in range(3)
    if _NEIGHBOUR_BITS[row, column]
)
"""Row and column offset of each neighbour, and its bit."""
_MIN_NEIGHBOURS, _MAX_NEIGHBOURS = 2, 6


def _tables() -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return, for both sub-passes, True where a pixel with that neighbourhood is deleted."""
    codes = np.arange(_CODES)
    p = [(codes >> bit) & 1 for bit in range(8)]
    neighbours = sum(p)
    transitions = sum((1 - p[k]) * p[(k + 1) % 8] for k in range(8))
    removable = (neighbours >= _MIN_NEIGHBOURS) & (neighbours <= _MAX_NEIGHBOURS) & (transitions == 1)
    north, east, south, west = p[0], p[2], p[4], p[6]
    first = removable & (north * east * south == 0) & (east * south * west == 0)
    second = removable & (north * east * west == 0) & (north * south * west == 0)
    return first, second


_FIRST, _SECOND = _tables()


def thin(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the skeleton of a mask, bool, shape (H, W); connectedness is kept."""
    # a frame of one pixel makes every neighbour's index valid
    framed = cv2.copyMakeBorder(mask.view(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=(0,))
    image, width = np.asarray(framed, dtype=np.uint8).view(np.bool_), framed.shape[1]
    codes = cv2.filter2D(framed, cv2.CV_8U, _NEIGHBOUR_BITS, borderType=cv2.BORDER_CONSTANT)
    code = np.asarray(codes, dtype=np.uint8).ravel()
    left = np.flatnonzero(image)
    before = left.size + 1
    while left.size < before:
        before = left.size
        for table in (_FIRST, _SECOND):
            goes = table[code[left]]
            gone = left[goes]
            left = left[~goes]
            image.ravel()[gone] = False
            for d_row, d_column, bit in _NEIGHBOURS:
                code[gone - (d_row * width + d_column)] &= _CODES - 1 - bit
    return np.ascontiguousarray(image[1:-1, 1:-1])
