"""Step 11d, beyond the paper: pieces of the left image that may be the face which an outline of what rises is of.

Such an outline encloses side faces and the parallax too, or only the high part of a face. A piece of one grey, a plane
that was found, or a circle of edges in it has the face's own outline, whatever its height is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.scene import PlaneImage
    from srvs_cell.vision.rectification import RectifiedRig

_MARGIN_PX = 3
_SMOOTHING_PX = 1.2
_BLACK = 4.0
"""Grey value below which contrast is noise: keeps the logarithm from blowing it up."""
_BINS = 48
_MIN_PIECE_PX = 150
_MIN_SOLIDITY = 0.85
_SHARED = 0.3
"""Share of the smaller one that a plane and an outline have in common."""
_SPARE = 1.5
"""A plane with shadow or side faces is larger than its face; one that is larger than this times a face is table."""
_LEAST_PX = 1.0
"""Least disparity of the table: farther away there is no part."""
_UP = np.array([0.0, 0.0, 1.0])
_ACCUMULATOR = 1.5
_EDGE_GRADIENT = 60.0
"""Upper threshold of Canny's edges in the window, its grey values spread to 0 to 255."""
_ROUNDNESS = 0.6
_LEAST_RADIUS_PX = 8
_APART_PX = 12
_MOST_CIRCLES = 2
_CIRCLE_CORNERS = 24


def face_pieces(image: NDArray[np.float32], outline: Array, planes: Sequence[NDArray[np.float32]]) -> list[Array]:
    """Return outlines of what may be a face inside or at an outline, convex, each of shape (N, 2).

    Args:
        image: the left image.
        outline: convex, of what rises in it, shape (K, 2).
        planes: hulls of its planes, see `plane_hulls`.
    """
    polygon = outline.astype(np.float32)
    return [*grey_pieces(image, outline), *_planes_at(planes, polygon), *round_pieces(image, outline)]


def plane_hulls(
    left: PlaneImage, rig: RectifiedRig, table_z_mm: float, max_size_mm: float
) -> list[NDArray[np.float32]]:
    """Return the convex hulls of the planes of the left image that are no larger than a face, each of shape (N, 2)."""
    hulls = []
    table = rig.plane_disparity(_UP, table_z_mm)
    for plane in left.planes:
        x, y, width, height = plane.box_px
        mm_per_px = rig.baseline_mm / max(float(np.dot(table, (*plane.centre_px, 1.0))), _LEAST_PX)
        if plane.area_px < _MIN_PIECE_PX or max(width, height) * mm_per_px > _SPARE * max_size_mm:
            continue
        mask = (left.labels[y : y + height, x : x + width] == plane.id).astype(np.uint8)
        contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE, offset=(x, y))
        hulls.append(np.asarray(cv2.convexHull(np.concatenate(contours)).reshape(-1, 2), dtype=np.float32))
    return hulls


def _planes_at(hulls: Sequence[NDArray[np.float32]], polygon: NDArray[np.float32]) -> list[Array]:
    """Return the hulls that share a good part of the smaller one with a polygon.

    Of a wedge that runs out on the table only the high part rises: its plane reaches far beyond.
    """
    found = []
    for hull in hulls:
        shared, _ = cv2.intersectConvexConvex(hull, polygon)
        if shared > _SHARED * min(cv2.contourArea(hull), cv2.contourArea(polygon)):
            found.append(hull.astype(np.float64))
    return found


def grey_pieces(image: NDArray[np.float32], outline: Array) -> list[Array]:
    """Return solid pieces of one grey inside an outline, each a convex outline in the image, shape (N, 2).

    The grey values inside the outline have a few modes: face, side faces, shadow, table. A face keeps its grey where
    its border is too faint to close an edge.
    """
    low = np.maximum(np.floor(outline.min(axis=0)).astype(int) - _MARGIN_PX, 0)
    high = np.ceil(outline.max(axis=0)).astype(int) + _MARGIN_PX + 1
    window = cv2.GaussianBlur(image[low[1] : high[1], low[0] : high[0]], (0, 0), _SMOOTHING_PX)
    inside = np.zeros(window.shape, dtype=np.uint8)
    cv2.fillConvexPoly(inside, np.rint(outline - low).astype(np.int32), 1)
    grown = cv2.dilate(inside, np.ones((_MARGIN_PX, _MARGIN_PX), np.uint8)) > 0
    levels = np.log(window + _BLACK)
    values = levels[grown]
    if values.size < _MIN_PIECE_PX:
        return []
    counts, borders = np.histogram(values, bins=_BINS)
    smooth = cv2.GaussianBlur(counts.astype(np.float32)[None], (0, 0), 1.0)[0]
    valleys = [
        (borders[k] + borders[k + 1]) / 2.0
        for k in range(1, _BINS - 1)
        if smooth[k] <= smooth[k - 1] and smooth[k] < smooth[k + 1]
    ]
    modes = np.digitize(levels, valleys)
    pieces = []
    for mode in range(len(valleys) + 1):
        mask = ((modes == mode) & grown).astype(np.uint8)
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        for contour in contours:
            hull = cv2.convexHull(contour)
            area = cv2.contourArea(hull)
            if area >= _MIN_PIECE_PX and cv2.contourArea(contour) >= _MIN_SOLIDITY * area:
                pieces.append(hull.reshape(-1, 2).astype(np.float64) + low)
    return pieces


def round_pieces(image: NDArray[np.float32], outline: Array) -> list[Array]:
    """Return the circles of edges inside an outline, as polygons in the image, each of shape (24, 2).

    A cylinder with a label, or of the table's grey, has no piece of one grey; its border is round all the same. A
    circle that is seen obliquely is round enough to begin with.
    """
    low = np.maximum(np.floor(outline.min(axis=0)).astype(int) - _MARGIN_PX, 0)
    high = np.ceil(outline.max(axis=0)).astype(int) + _MARGIN_PX + 1
    window = cv2.GaussianBlur(image[low[1] : high[1], low[0] : high[0]], (0, 0), _SMOOTHING_PX)
    spread = cv2.normalize(window, np.empty_like(window), 0.0, 255.0, cv2.NORM_MINMAX).astype(np.uint8)
    found = cv2.HoughCircles(
        spread,
        cv2.HOUGH_GRADIENT_ALT,
        _ACCUMULATOR,
        _APART_PX,
        param1=_EDGE_GRADIENT,
        param2=_ROUNDNESS,
        minRadius=_LEAST_RADIUS_PX,
        maxRadius=min(window.shape) // 2,
    )
    if found is None:
        return []
    turn = np.linspace(0.0, 2.0 * np.pi, _CIRCLE_CORNERS, endpoint=False)
    rays = np.column_stack([np.cos(turn), np.sin(turn)])
    return [low + (x, y) + radius * rays for x, y, radius in found[0, :_MOST_CIRCLES, :3]]
