"""Step 11b: the grey values across the outline of a face, and what a model of them expects.

Across the border of a top face the grey value goes from that of the face to that of its side face, as far as this is
seen, and on to that of what lies behind. The width of the visible side face follows from the face's height over the
table, so that a sliver of a pixel is told from the face itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.special import ndtr

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.outlines import Borders, Outlines
    from srvs_cell.vision.rectification import RectifiedRig

GROUPS = 12
"""Stretches of an outline that have grey levels of their own: three of a rectangle's side, two of a hexagon's."""
LEVELS = 5
"""Levels of a stretch: face and background in the left image, the same in the right one, side face in both."""
USUAL_BLUR_PX = 0.85
_OFFSETS_PX = np.arange(-4.0, 3.5, 1.0, dtype=np.float32)
"""Where a profile is read, outwards from the border. Farther out the edge of a shadow would often be met."""
_SEEN = 3
LEVELS_SEEN = ((0, 1, 4), (2, 3, 4))
"""Which of the levels the left and the right image show: face, background, side face."""
_MIN_SIGMA = 0.5
_SPARSE = 4
"""Every so many rows are enough for a median of the whole picture."""
_MAD = 1.4826
_BEND = float(np.sqrt(6.0))
"""Standard deviation of a second difference over that of its values."""
_PEAK = 1.0 / float(np.sqrt(2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class Pictures:
    """Both rectified images as the fit needs them.

    Attributes:
        images: left and right, float32, shape (H, W).
        noise: standard deviation of the grey values.
        blur_px: standard deviation of the picture of a sharp border: lens, pixel and rectification.
    """

    images: tuple[NDArray[np.float32], NDArray[np.float32]]
    noise: float
    blur_px: float = USUAL_BLUR_PX

    @classmethod
    def of(cls, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Pictures:
        """Take two rectified images and measure their noise by second differences along the rows."""
        images = (left.astype(np.float32), right.astype(np.float32))
        sparse = (image[::_SPARSE] for image in images)
        bends = [np.abs(rows[:, :-2] - 2.0 * rows[:, 1:-1] + rows[:, 2:]) for rows in sparse]
        noise = max(float(np.median(bend)) * _MAD / _BEND for bend in bends)
        return cls(images, max(noise, _MIN_SIGMA))


@dataclass(frozen=True, eq=False)
class Profiles:
    """The profiles of B faces: T grey values across the outline at each of N samples in both images.

    The samples are G stretches of as many each. Each image shows three grey levels of a stretch, `LEVELS_SEEN`. Values
    are float32: twice as many pass at a time.

    Attributes:
        grey: what was seen, shape (2, B, T, N).
        weights: 0 outside of the image; less than 1 where samples lie closer than a pixel, shape (2, B, T, N).
        by_level: what the model expects, by each of the three grey levels, shape (3, 2, B, T, N).
        slopes: how that changes with the border's place, grey values per pixel outwards, the same shape.
        by_parameter: how far the border at each sample moves outwards with the face's seven parameters, pixels, shape
            (2, B, 7, N).
    """

    grey: NDArray[np.float32]
    weights: NDArray[np.float32]
    by_level: NDArray[np.float32]
    slopes: NDArray[np.float32]
    by_parameter: Array


def read_profiles(
    outlines: Outlines, borders: Borders, pictures: Pictures, rig: RectifiedRig, table_z_mm: float, blur_px: float
) -> Profiles:
    """Read the profiles of faces in both images and predict them.

    Args:
        outlines: the faces, with a multiple of twelve samples each and as many on each side.
        borders: the same as the cameras see them; all in front.
        pictures: the rectified images.
        rig: the rectified cameras.
        table_z_mm: height of the table, base frame: there the side faces end.
        blur_px: width of the model's borders, one standard deviation.
    """
    x, y, normal_x, normal_y = (
        part.astype(np.float32)[:, :, None, :]
        for part in (borders.x_px, borders.y_px, borders.normal_x, borders.normal_y)
    )
    offsets = _OFFSETS_PX[:, None]
    places_x, places_y = x + normal_x * offsets, y + normal_y * offsets
    height, width = pictures.images[0].shape
    grey = np.empty(places_x.shape, dtype=np.float32)
    flat = (places_x.shape[1], -1)
    for eye, image in enumerate(pictures.images):
        read = cv2.remap(
            image,
            places_x[eye].reshape(flat),
            places_y[eye].reshape(flat),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        grey[eye] = read.reshape(grey[eye].shape)
    inside = (places_x >= 0.0) & (places_x <= width - 1.0) & (places_y >= 0.0) & (places_y <= height - 1.0)
    spacing_px = np.median(np.hypot(np.diff(x), np.diff(y)), axis=-1, keepdims=True)
    # as much of the side face shows as its foot lies outside of the face
    feet_x, feet_y = outlines.feet_px(rig, table_z_mm)
    out_px = (feet_x - borders.x_px) * borders.normal_x + (feet_y - borders.y_px) * borders.normal_y
    side_px = np.maximum(out_px, 0.0).astype(np.float32)[:, :, None, :]
    border, end = offsets / np.float32(blur_px), (offsets - side_px) / np.float32(blur_px)
    beyond_border, beyond_end = ndtr(border), ndtr(end)
    peak = np.float32(_PEAK / blur_px)
    peak_border, peak_end = peak * np.exp(-0.5 * border**2), peak * np.exp(-0.5 * end**2)
    by_level, slopes = (np.empty((_SEEN, *grey.shape), dtype=np.float32) for _ in range(2))
    by_level[0], by_level[1], by_level[2] = 1.0 - beyond_border, beyond_end, beyond_border - beyond_end
    slopes[0], slopes[1], slopes[2] = peak_border, -peak_end, peak_end - peak_border
    return Profiles(grey, inside * np.minimum(spacing_px, np.float32(1.0)), by_level, slopes, borders.by_parameter)
