"""Step 11i: how bright a face is in the left image."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.rectification import RectifiedRig

_MARGIN_PX = 3
"""What is left out along the outline: the blur of the edge, and what a slightly wrong outline adds."""
_INNER = np.ones((2 * _MARGIN_PX + 1, 2 * _MARGIN_PX + 1), np.uint8)


def face_brightness(outline_mm: Array, grey: NDArray[np.uint8], rig: RectifiedRig) -> float | None:
    """Return the grey value of a face in the left image, 0 to 255.

    It is the median, which neither print nor a neighbour that hides a corner of the face changes much.

    Args:
        outline_mm: the face's outline where calibration and poses see it, uncorrected, base frame, shape (N, 3).
        grey: the rectified left image, shape (H, W).
        rig: the rectified cameras.

    Returns:
        None where nothing of the face is in the picture, or it is too small for anything to be left inside its margin.
    """
    x, y, _ = rig.project_px(outline_mm)
    corners = np.rint(np.column_stack([x, y])).astype(np.int32)
    height, width = grey.shape
    left, top = np.clip(corners.min(axis=0), 0, (width, height))
    right, bottom = np.clip(corners.max(axis=0) + 1, 0, (width, height))
    if left >= right or top >= bottom:
        return None
    inside = np.zeros((bottom - top, right - left), np.uint8)
    cv2.fillPoly(inside, [corners - (left, top)], 1)
    inner = cv2.erode(inside, _INNER, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    return float(np.median(grey[top:bottom, left:right][inner])) if inner.any() else None
