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
    """Two rectified images, prepared for looking up many planes.

    Attributes:
        left, left_x: the left image and its slope along the rows, float32, shape (H, W).
        right: least and greatest value, least and greatest slope of the right image within half a pixel of each pixel
            along its row, float32, shape (H, W, 4).
    """

    left: Image
    left_x: Image
    right: Image

    @classmethod
    def of(cls, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> PhotometricCost:
        """Prepare two grey images, uint8, shape (H, W)."""
        one, other = left.astype(np.float32), right.astype(np.float32)
        within = cv2.merge([*_envelope(other), *_envelope(_slope(other))])
        return cls(one, _slope(one), np.asarray(within, dtype=np.float32))

    def of_planes(self, planes: Sequence[DisparityPlane], step_px: int = 1) -> Image:
        """Return the cost, 0 to 1, of every ``step_px``-th pixel in every ``step_px``-th row, shape (K, h, w)."""
        height, width = self.left.shape
        first = step_px // 2
        x = np.arange(first, width, step_px, dtype=np.float32)[None, :]
        y = np.arange(first, height, step_px, dtype=np.float32)[:, None]
        rows = np.ascontiguousarray(np.broadcast_to(y, (y.size, x.size)))
        grey, slope = (
            np.ascontiguousarray(image[first::step_px, first::step_px]) for image in (self.left, self.left_x)
        )
        costs = np.empty((len(planes), y.size, x.size), dtype=np.float32)
        for number, (a, b, c) in enumerate(planes):
            seen = np.float32(1.0 - a) * x - (np.float32(b) * y + np.float32(c))
            found = cv2.split(np.asarray(cv2.remap(self.right, seen, rows, cv2.INTER_LINEAR), dtype=np.float32))
            low, high, low_x, high_x = (np.asarray(channel, dtype=np.float32) for channel in found)
            costs[number] = _beyond(grey, low, high, _GREY_LIMIT)
            costs[number] += _beyond(slope, low_x, high_x, _SLOPE_LIMIT)
            costs[number][(seen < 0.0) | (seen > width - 1.0)] = _UNSEEN
        return costs


def _beyond(value: Image, low: Image, high: Image, limit: float) -> Image:
    """Return how far values lie beyond their interval, in halves of the limit: 0 to 0.5."""
    distance = np.maximum(cv2.subtract(value, high), cv2.subtract(low, value))
    return np.asarray(np.clip(distance, 0.0, limit, out=distance) * np.float32(0.5 / limit))


def _slope(image: Image) -> Image:
    return np.asarray(cv2.Sobel(image, cv2.CV_32F, 1, 0, scale=_SOBEL_SCALE), dtype=np.float32)


def _envelope(image: Image) -> tuple[Image, Image]:
    """Return the least and the greatest value within half a pixel along the row."""
    halfway = cv2.filter2D(image, cv2.CV_32F, np.array([[0.5, 0.5, 0.0]]), borderType=cv2.BORDER_REPLICATE)
    after = np.hstack([halfway[:, 1:], image[:, -1:]])
    low, high = cv2.min(halfway, after), cv2.max(halfway, after)
    return np.asarray(cv2.min(low, image)), np.asarray(cv2.max(high, image))
