"""Step 11d, beyond the paper: straight borders in space, by stereo of the lines of both images.

A line of the left image and one of the right image that run alike and share rows may be one border. Their disparity is
linear along the rows and tells the heights of its ends. Nothing is decided here: a line may be in several ledges, and
which of them are borders of a face is seen when the faces that they span are fitted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.edges import EdgeParameters, extract_edges
from srvs_cell.vision.line_support import LineParameters, extract_lines

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.line_support import LineImage
    from srvs_cell.vision.rectification import RectifiedRig

_FAINT = EdgeParameters(noise_factor=2.2, smoothing_px=1.5, min_gradient=0.4)
"""Fainter edges than those that planes grow between: a line too many does no harm here."""
_ALIKE_DEG = 10.0
"""Directions of one border's two pictures differ by less."""
_LEAST_STEEP = float(np.sin(np.deg2rad(10.0)))
"""A line nearer to the base line's direction has no disparity worth the name."""
_LEAST_ROWS = 0.4
"""Share of the rows of the shorter line that both lines have."""
_LEVEL_MM = 6.0
"""Ends of a level border differ less in height: so much is a third of a pixel's disparity."""
# What borders propose has limits of its own, about those of `RecognitionParameters`' defaults; a proposal must pass the
# parameters besides, so that these narrow it, and wider ones do not widen what is proposed.
LEAST_RISE = 0.08
"""Rise per millimetre of what is clearly inclined: five degrees."""
STEEPEST = 1.2
"""Rise per millimetre of the steepest top face: fifty degrees."""
LEAST_SIDE_MM = 5.0
"""A shorter border belongs to no part."""
MOST_SIDE_MM = 160.0
"""No side of a part is longer, and borders that are farther apart belong to different parts."""
SAME_MM = 2.0
"""Two lines of one border tell the same face twice."""
_MARGIN_PX = 6.0
"""A border of a face runs inside the outline of what rises, or along it."""
_LEAST_PX = 1.0
"""Least disparity: what is extrapolated stays in front of the camera."""
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Ledges:
    """Straight borders in the base frame; ledge i has row i of every array.

    Attributes:
        ends_mm: both ends, shape (N, 2, 3); those of a level border are at exactly one height.
        middle_px: midpoint (x, y) in the left image, shape (N, 2).
    """

    ends_mm: Array
    middle_px: Array

    def at_outline(self, outline: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return which run inside a convex outline of the left image, shape (K, 2), or along it; shape (N,)."""
        beside_px = [cv2.pointPolygonTest(outline, (float(x), float(y)), measureDist=True) for x, y in self.middle_px]
        return np.array(beside_px) > -_MARGIN_PX


def find_lines(grey: NDArray[np.uint8]) -> LineImage:
    """Return the straight lines of a rectified image."""
    return extract_lines(grey, extract_edges(grey, _FAINT).mask, _FAINT.smoothing_px, LineParameters())


def find_ledges(
    images: tuple[LineImage, LineImage], rig: RectifiedRig, table_z_mm: float, max_height_mm: float
) -> Ledges:
    """Return the pairs of lines of two rectified images that may be one border above the table.

    Where the measured ends do not tell a level border from a sloping one, both are returned.
    """
    left, right = images
    first, second, rows = _alike(left, right)
    at_left, at_right = _columns(left, first, rows), _columns(right, second, rows)
    disparity = at_left - at_right
    before = (disparity > 0.0).all(axis=0)
    first, rows, at_left, disparity = first[before], rows[:, before], at_left[:, before], disparity[:, before]
    seen_z_mm = np.stack([rig.points_mm(at_left[end], rows[end], disparity[end])[:, 2] for end in (0, 1)])
    z_mm = seen_z_mm.mean(axis=0)
    ends_px = np.stack([left.start_px[first], left.end_px[first]])
    # the disparity is linear along the line: beyond the rows that both lines have it goes on
    per_row = (disparity[1] - disparity[0]) / (rows[1] - rows[0])
    at_ends = np.maximum(disparity[0] + (ends_px[..., 1] - rows[0]) * per_row, _LEAST_PX)
    ends_mm = np.stack([rig.points_mm(ends_px[end, :, 0], ends_px[end, :, 1], at_ends[end]) for end in (0, 1)], axis=1)
    length_mm = np.linalg.norm(ends_mm[:, 1, :2] - ends_mm[:, 0, :2], axis=1)
    height_mm = z_mm - table_z_mm
    there = (length_mm > LEAST_SIDE_MM) & (height_mm > -_LEVEL_MM) & (height_mm < max_height_mm)
    level = np.flatnonzero(there & (np.abs(seen_z_mm[1] - seen_z_mm[0]) < _LEVEL_MM))
    rise = np.abs(ends_mm[:, 1, 2] - ends_mm[:, 0, 2]) / np.maximum(length_mm, LEAST_SIDE_MM)
    sloped = np.flatnonzero(there & (rise > LEAST_RISE) & (rise < STEEPEST))
    levelled = np.stack([_on_level(end[level], z_mm[level], rig) for end in ends_px], axis=1)
    middle_px = left.centre_px[first]
    return Ledges(np.concatenate([levelled, ends_mm[sloped]]), np.concatenate([middle_px[level], middle_px[sloped]]))


def _alike(left: LineImage, right: LineImage) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Return numbers of lines that run alike and share rows, each of shape (N,), and those rows' ends, shape (2, N)."""
    turned_deg = (left.orientation_deg[:, None] - right.orientation_deg + 180.0) % 360.0 - 180.0
    ends = [np.sort(np.stack([image.start_px[:, 1], image.end_px[:, 1]]), axis=0) for image in (left, right)]
    steep = [
        rows[1] - rows[0] > _LEAST_STEEP * image.length_px for rows, image in zip(ends, (left, right), strict=True)
    ]
    top, bottom = np.maximum(ends[0][0][:, None], ends[1][0]), np.minimum(ends[0][1][:, None], ends[1][1])
    shorter = np.minimum((ends[0][1] - ends[0][0])[:, None], ends[1][1] - ends[1][0])
    alike = (np.abs(turned_deg) < _ALIKE_DEG) & (bottom - top > _LEAST_ROWS * shorter)
    first, second = np.nonzero(alike & steep[0][:, None] & steep[1])
    return first, second, np.stack([top[first, second], bottom[first, second]])


def _columns(image: LineImage, chosen: NDArray[np.intp], rows: Array) -> Array:
    """Return x where lines cross rows, shape (2, N)."""
    (x, y), (dx, dy) = image.start_px[chosen].T, (image.end_px - image.start_px)[chosen].T
    crossed: Array = x + (rows - y) * dx / dy
    return crossed


def _on_level(pixels: Array, z_mm: Array, rig: RectifiedRig) -> Array:
    """Return the points of the left image's pixels, shape (N, 2), at heights, shape (N, 3)."""
    a, b, at_zero = rig.plane_disparity(_UP, 0.0)
    x, y = pixels.T
    eye = rig.base_T_camera.translation_mm
    # the ray through a pixel, wherever it meets the level of z = 0, cut at the height
    ray = rig.points_mm(x, y, a * x + b * y + at_zero) - eye
    cut: Array = eye + ray * ((z_mm - eye[2]) / ray[:, 2])[:, None]
    cut[:, 2] = z_mm
    return cut
