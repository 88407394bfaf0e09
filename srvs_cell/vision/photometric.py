"""How well a disparity plane explains each pixel: the grey values and their slopes of both images, compared.

The right image is looked up where the plane puts the pixel. As Birchfield and Tomasi (PAMI 20, 1998) have it, a value
agrees where it lies between those that the right image takes within half a pixel, so that neither the interpolation
nor a shift of a part of a pixel makes a sharp texture look wrong. Differences are bounded: a pixel that is hidden, or
that shines, tells little.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.scene import DisparityPlane

    Image = NDArray[np.float32]

_GREY_LIMIT = 8.0
_SLOPE_LIMIT = 6.0
_SOBEL_SCALE = 0.125
_UNSEEN = 0.5
"""Cost where a plane leads out of the right image: half of the greatest."""


@dataclass(frozen=True, eq=False)
class PhotometricCost:
    """Two rectified images, prepared for looking up many planes at every ``step_px``-th pixel of every such row.

    Attributes:
        left, left_x: those pixels of the left image and its slope along the rows there, float32, shape (h, w).
        right: least and greatest value, least and greatest slope of the right image within half a pixel of each pixel
            along those rows, float32, shape (h, W, 4).
        step_px: the step.
    """

    left: Image
    left_x: Image
    right: Image
    step_px: int

    @classmethod
    def of(cls, left: NDArray[np.uint8], right: NDArray[np.uint8], step_px: int = 1) -> PhotometricCost:
        """Prepare two grey images, uint8, shape (H, W)."""
        chosen = slice(step_px // 2, None, step_px)
        rows = (right[chosen].astype(np.float32), np.ascontiguousarray(row_slope(right)[chosen]))
        within = cv2.merge([bound for row in rows for bound in _envelope(row)])
        slope = np.ascontiguousarray(row_slope(left)[chosen, chosen])
        return cls(left[chosen, chosen].astype(np.float32), slope, np.asarray(within, dtype=np.float32), step_px)

    def of_planes(self, planes: Sequence[DisparityPlane]) -> Image:
        """Return the cost of planes, 0 to 1, shape (K, h, w)."""
        height, width = self.left.shape
        first, last = self.step_px // 2, self.right.shape[1] - 1.0
        x = (first + self.step_px * np.arange(width, dtype=np.float32))[None, :]
        y = (first + self.step_px * np.arange(height, dtype=np.float32))[:, None]
        rows = np.repeat(np.arange(height, dtype=np.float32)[:, None], width, axis=1)
        costs = np.empty((len(planes), height, width), dtype=np.float32)
        for number, (a, b, c) in enumerate(planes):
            seen = np.float32(1.0 - a) * x - (np.float32(b) * y + np.float32(c))
            found = cv2.split(np.asarray(cv2.remap(self.right, seen, rows, cv2.INTER_LINEAR), dtype=np.float32))
            low, high, low_x, high_x = (np.asarray(channel, dtype=np.float32) for channel in found)
            costs[number] = _beyond(self.left, low, high, _GREY_LIMIT)
            costs[number] += _beyond(self.left_x, low_x, high_x, _SLOPE_LIMIT)
            costs[number][(seen < 0.0) | (seen > last)] = _UNSEEN
        return costs


def row_slope(image: NDArray[np.uint8]) -> Image:
    """Return the slope along the rows, grey values per pixel, float32, shape (H, W)."""
    return np.asarray(cv2.Sobel(image, cv2.CV_32F, 1, 0, scale=_SOBEL_SCALE), dtype=np.float32)


def _beyond(value: Image, low: Image, high: Image, limit: float) -> Image:
    """Return how far values lie beyond their interval, in halves of the limit: 0 to 0.5."""
    distance = np.maximum(cv2.subtract(value, high), cv2.subtract(low, value))
    return np.asarray(np.clip(distance, 0.0, limit, out=distance) * np.float32(0.5 / limit))


def _envelope(image: Image) -> tuple[Image, Image]:
    """Return the least and the greatest value within half a pixel along the row."""
    halfway = cv2.filter2D(image, cv2.CV_32F, np.array([[0.5, 0.5, 0.0]]), borderType=cv2.BORDER_REPLICATE)
    after = np.hstack([halfway[:, 1:], image[:, -1:]])
    low, high = cv2.min(halfway, after), cv2.max(halfway, after)
    return np.asarray(cv2.min(low, image)), np.asarray(cv2.max(high, image))
