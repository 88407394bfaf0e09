"""Step 9, beyond the paper: places for planes of the left image that found no partner.

Texture, print, a sliver of side face or a weak edge can split or merge a plane in one image only; its partner then has
other parameters and the paper's rule finds none. Such a plane is looked for in the right image by its grey values: the
region with a band around it is moved along the row, and the disparity of the best correlation gives it a place.
Recognition verifies it by its edges in both images.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.scene import PlaneMatch
from srvs_cell.vision.lateral_stereo import surfaces_from_matches

if TYPE_CHECKING:
    from collections.abc import Collection

    from srvs_cell.geometry import Array
    from srvs_cell.scene import Plane, PlaneImage, Surface
    from srvs_cell.vision.rectification import RectifiedRig

NO_PLANE = 0
"""``PlaneMatch.right`` of a plane found again by its grey values: no plane of the right image is its partner."""
_BAND_PX = 3
_MAX_PIXELS = 1500
_MIN_CORRELATION = 0.7
_MIN_VARIANCE = 1e-6
_MARGIN_PX = 3.0
_SIGMA_PX = 0.5
_UP = np.array([0.0, 0.0, 1.0])


def recover_surfaces(
    left: PlaneImage,
    right: PlaneImage,
    matched: Collection[int],
    rig: RectifiedRig,
    height_range_mm: tuple[float, float],
    size_range_mm: tuple[float, float],
) -> tuple[Surface, ...]:
    """Give unmatched planes of the left image a place.

    Args:
        left: planes of the rectified left image.
        right: the rectified right image; its planes are not used.
        matched: left planes that have a partner.
        rig: the rectified cameras.
        height_range_mm: least and greatest height of a face in the base frame: table and highest part.
        size_range_mm: least and greatest extent of a face.

    Returns:
        Surfaces, taken as level; their match has `NO_PLANE` on the right.
    """
    matches = []
    grey_left, grey_right = (cv2.GaussianBlur(image.grey.astype(np.float32), (0, 0), 1.0) for image in (left, right))
    low, high = (np.array(rig.plane_disparity(_UP, z_mm)) for z_mm in height_range_mm)
    for plane in left.planes:
        if plane.id in matched or not _possible(plane, rig, float(high @ (*plane.centre_px, 1.0)), size_range_mm):
            continue
        span = (float(low @ (*plane.centre_px, 1.0)) - _MARGIN_PX, float(high @ (*plane.centre_px, 1.0)) + _MARGIN_PX)
        found = _best_disparity(left, plane, np.asarray(grey_left), np.asarray(grey_right), span)
        if found is not None:
            disparity, correlation = found
            level = _level_plane(rig, plane, disparity)
            matches.append(PlaneMatch(plane.id, NO_PLANE, correlation, disparity, level, _SIGMA_PX))
    return surfaces_from_matches(left, matches, rig)


def _possible(plane: Plane, rig: RectifiedRig, disparity_px: float, size_range_mm: tuple[float, float]) -> bool:
    """Whether a region, at the least distance it may have, is as large as a face."""
    if disparity_px <= 0.0:
        return False
    mm_per_px = rig.baseline_mm / disparity_px
    _, _, width, height = plane.box_px
    least, most = size_range_mm
    return max(width, height) * mm_per_px <= most and np.sqrt(plane.area_px) * mm_per_px >= least / 2.0


def _level_plane(rig: RectifiedRig, plane: Plane, disparity_px: float) -> tuple[float, float, float]:
    """Return the disparity plane of the level surface that has a disparity at a plane's centre."""
    x, y = plane.centre_px
    centre = rig.points_mm(np.array([x]), np.array([y]), np.array([disparity_px]))[0]
    return rig.plane_disparity(_UP, float(centre[2]))


def _best_disparity(
    left: PlaneImage, plane: Plane, grey_left: Array, grey_right: Array, span_px: tuple[float, float]
) -> tuple[float, float] | None:
    """Return the disparity at which the region's grey values correlate best, and the correlation."""
    rows, columns = _pixels(left, plane)
    disparities = np.arange(int(np.floor(span_px[0])), int(np.ceil(span_px[1])) + 1)
    if columns.size == 0 or disparities.size < 3:  # noqa: PLR2004 - a maximum has two neighbours
        return None
    template = grey_left[rows, columns]
    template = template - template.mean()
    moved = columns[None, :] - disparities[:, None]
    inside = (moved >= 0).all(axis=1) & (moved < grey_right.shape[1]).all(axis=1)
    values = grey_right[rows[None, :], np.clip(moved, 0, grey_right.shape[1] - 1)]
    values = values - values.mean(axis=1, keepdims=True)
    power = np.maximum((values**2).mean(axis=1) * (template**2).mean(), _MIN_VARIANCE)
    correlation = np.where(inside, (values * template).mean(axis=1) / np.sqrt(power), -1.0)
    best = int(correlation.argmax())
    if correlation[best] < _MIN_CORRELATION or best in {0, disparities.size - 1}:
        return None
    before, at, after = (float(value) for value in correlation[best - 1 : best + 2])
    curvature = before - 2.0 * at + after
    shift = 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0
    return float(disparities[best]) + float(np.clip(shift, -0.5, 0.5)), at


def _pixels(left: PlaneImage, plane: Plane) -> tuple[np.ndarray[tuple[int], np.dtype[np.intp]], ...]:
    """Return rows and columns of a region with a band around it, thinned to a bounded number."""
    x, y, width, height = plane.box_px
    top, side = max(0, y - _BAND_PX), max(0, x - _BAND_PX)
    mask = left.labels[top : y + height + _BAND_PX, side : x + width + _BAND_PX] == plane.id
    size = 2 * _BAND_PX + 1
    grown = cv2.dilate(mask.astype(np.uint8), np.ones((size, size), np.uint8))
    rows, columns = np.nonzero(grown)
    step = max(1, rows.size // _MAX_PIXELS)
    return rows[::step] + top, columns[::step] + side
