"""Beyond the paper: what rises over the table, by plane and parallax (Irani and Anandan 1996).

The right image is laid over the left one by the table's plane, corrected by what the table itself showed. Whatever
lies on the table falls on itself, shadows and print included; the borders of what stands on it are doubled by their
parallax and leave a difference. So a shadow can be told from a face, and what no face explains does not stay unseen.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.median import median
from srvs_cell.vision.runs import joined, runs_of, touching_runs

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cv2.typing import MatLike
    from numpy.typing import ArrayLike, NDArray

    from srvs_cell.calibration import TableReference
    from srvs_cell.geometry import Array
    from srvs_cell.vision.rectification import RectifiedPair
    from srvs_cell.vision.refinement import GreyPair

    Mask = NDArray[np.bool_]

_UP = np.array([0.0, 0.0, 1.0])
_SPARSE = 3
"""Every so many pixels are enough for a median of the whole picture."""
_MAD = 1.4826
_CELL_PX = 32
"""What the table showed varies slowly: it is computed once for a square of this side."""
_STRIDE = 12
"""Every so many pixels are enough for what the lens does to the whole picture."""
_DEGREE = 3
_CALM = 4.0
"""A difference of more than so many times the median one is of what rises."""
_CALM_ROUNDS = 4
_LEAST_CALM = 0.05
"""Where less of the picture is calm, what the lens does is not known."""
_LEAST_SPREAD = 0.05
_RIDGE = 1.0
"""Squared grey values: next to nothing, but where all is black no share is told."""
_WINDOW_PX = 5
_NOISE_FACTOR = 4.5
"""Mean squared difference of a window over the noise's, from which on it is no noise."""
_SLACK_PX = 0.25
"""Displacement of the table's own picture that is not counted as parallax."""
_SOBEL = 8.0
_MIN_AREA_PX = 40
_MIN_OUTLINE_PX = 600.0
"""Less than the outline of the least part, doubled, at the camera's usual distance."""
_JOIN_PX = 7
_SEAM_PX = 11
"""What reaches no farther out of an explained polygon than half of this is its seam."""
_THIN_PX = 3
"""What rises and is narrower is no part of its own."""
_MOSTLY = 0.5
"""What is explained to a larger share is a part's surroundings, not another one between two borders."""
_MIN_ROWS = 0.6
"""Share of the rows of the shorter one that the left and the right border of one face have in common.

The border of a wedge rises where the wedge is high.
"""


@dataclass(frozen=True, eq=False)
class Relief:
    """What differs where the right image is laid over the left one by the table's plane.

    Attributes:
        rises: where the difference is neither noise nor a small displacement of the table's picture, shape (H, W).
        noise: standard deviation of the difference, grey values.
        valid: where both images saw.
    """

    rises: Mask
    noise: float
    valid: Mask


def measure_relief(
    pair: RectifiedPair, smoothed: GreyPair, table_z_mm: float, reference: TableReference | None
) -> Relief:
    """Lay the right image over the left one by the table's plane and find what rises.

    Args:
        pair: rectified images.
        smoothed: the same, smoothed.
        table_z_mm: height of the table, base frame.
        reference: what the table showed of calibration and poses.
    """
    left, right = smoothed.left, smoothed.right
    map_x, map_y = _laid_by_table(pair, table_z_mm, reference)
    laid = cv2.remap(right, map_x, map_y, cv2.INTER_LINEAR)
    seen_left, seen_right = pair.well_inside
    laid_right = cv2.remap(seen_right, map_x, map_y, cv2.INTER_NEAREST, borderValue=0)
    valid = np.asarray(cv2.bitwise_and(seen_left, laid_right), dtype=np.uint8).view(np.bool_)
    difference = _as_float(cv2.subtract(left, laid, dst=laid))
    difference -= _vignetting(left, difference, valid)
    difference *= valid
    sampled = np.abs(difference[::_SPARSE, ::_SPARSE][valid[::_SPARSE, ::_SPARSE]])
    noise = max(_MAD * median(sampled), _LEAST_SPREAD) if sampled.size else 1.0
    # the energy that neither the noise nor a small displacement of the table's picture explains
    energy: NDArray[np.float32] = np.square(difference, out=difference)
    slope = np.empty_like(left)
    for order in ((1, 0), (0, 1)):
        cv2.Sobel(left, cv2.CV_32F, *order, dst=slope, ksize=3, scale=_SLACK_PX / _SOBEL)
        energy -= np.square(slope, out=slope)
    rises = _as_float(cv2.blur(energy, (_WINDOW_PX, _WINDOW_PX), dst=slope)) > _NOISE_FACTOR * noise**2
    rises &= valid
    return Relief(rises, noise, valid)


def _laid_by_table(
    pair: RectifiedPair, table_z_mm: float, reference: TableReference | None
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return where the right image shows what the left one shows of the table, x and y, shape (H, W) each."""
    height, width = pair.left.shape
    # cells' middles, one cell beyond the image on either side: between them the map is linear
    across, down = (_CELL_PX * (np.arange(-1, -(-size // _CELL_PX) + 1) + 0.5) - 0.5 for size in (width, height))
    x, y = np.meshgrid(across, down)
    a, b, c = pair.rig.plane_disparity(_UP, table_z_mm)
    disparity = a * x + b * y + c
    seen_x, seen_y = x - disparity, y
    if reference is not None:
        u, v = (part @ reference.expected_field for part in reference.basis(x, y, disparity))
        seen_x, seen_y = seen_x - u, seen_y + v
    size = (_CELL_PX * across.size, _CELL_PX * down.size)
    map_x, map_y = (
        np.asarray(cv2.resize(_as_float(seen), size), dtype=np.float32)[_CELL_PX:, _CELL_PX:][:height, :width]
        for seen in (seen_x, seen_y)
    )
    return map_x, map_y


def _vignetting(left: NDArray[np.float32], difference: NDArray[np.float32], valid: Mask) -> NDArray[np.float32]:
    """Return the difference of the table's own pictures: the lens darkens the two differently.

    A share of the grey value that is a cubic polynomial of the place, fitted to what is no part: there it fails.
    """
    sparse = np.s_[::_STRIDE, ::_STRIDE]
    grey, seen, there = left[sparse].astype(np.float64), difference[sparse].ravel(), valid[sparse].ravel()
    rows, columns = grey.shape
    x, y = np.linspace(-1.0, 1.0, columns), np.linspace(-1.0, 1.0, rows)[:, None]
    places = np.stack([(x**i * y**j).ravel() for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)])
    by_place = places * grey.ravel()
    used, share = there, np.zeros(len(places))
    for _ in range(_CALM_ROUNDS):
        if np.count_nonzero(used) <= _LEAST_CALM * used.size:
            break
        counted = by_place * used
        share = np.asarray(np.linalg.solve(counted @ by_place.T + _RIDGE * np.eye(len(places)), counted @ seen))
        misfit = np.abs(seen - share @ by_place)
        used = np.asarray(there & (misfit <= _CALM * max(median(misfit[used]), _LEAST_SPREAD)))
    height, width = left.shape
    lens = cv2.resize(_as_float((share @ places).reshape(rows, columns)), (width, height))
    return _as_float(cv2.multiply(lens, left, dst=lens))


def _as_float(values: ArrayLike) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32)


def unexplained(relief: Relief, explained: Iterable[Array]) -> NDArray[np.uint8]:
    """Return where something rises, one pixel grown, outside of polygons of the left image: 1, else 0."""
    rising = relief.rises.astype(np.uint8)
    for polygon in explained:
        cv2.fillPoly(rising, [np.rint(polygon).astype(np.int32)], 0)
    return np.asarray(cv2.dilate(rising, np.ones((3, 3), np.uint8)), dtype=np.uint8)


def rising_share(rising: NDArray[np.uint8], outline: NDArray[np.float32]) -> float:
    """Return how much of an outline, shape (N, 2), lies where something rises."""
    corners = np.rint(outline).astype(np.int32)
    left, top, width, height = cv2.boundingRect(corners)
    left, top, right, bottom = max(left, 0), max(top, 0), max(left + width, 0), max(top + height, 0)
    window = rising[top:bottom, left:right]
    if not window.size:
        return 0.0
    line = np.zeros(window.shape, dtype=np.uint8)
    cv2.polylines(line, [corners - (left, top)], isClosed=True, color=1)
    # where no pixel of the line lies in the image the mean is 0
    return cv2.mean(window, line)[0]


def risen(relief: Relief, explained: Iterable[Array]) -> list[int]:
    """Return how many rising pixels each polygon of the left image explains that none before it does."""
    left = relief.rises.astype(np.uint8)
    counts = []
    for polygon in explained:
        before = int(left.sum())
        cv2.fillPoly(left, [np.rint(polygon).astype(np.int32)], 0)
        counts.append(before - int(left.sum()))
    return counts


def rising_outlines(relief: Relief, explained: Iterable[Array], min_area_px: int | None = None) -> list[Array]:
    """Return convex outlines of what rises and is not explained, pixels of the left image, each of shape (N, 2).

    The outline of a face is doubled by its parallax: what is returned encloses both. Where only the left and the
    right border of a face show (its upper and lower border run along the baseline), they are taken together.

    Args:
        relief: what rises.
        explained: polygons in the left image whose insides are explained.
        min_area_px: pieces of fewer rising pixels are left out, and only pieces that are too small by themselves
            are taken together; None for pieces that may be the border of a face.
    """
    inside = np.zeros(relief.rises.shape, dtype=np.uint8)
    for polygon in explained:
        cv2.fillPoly(inside, [np.rint(polygon).astype(np.int32)], 1)
    beside = np.asarray(cv2.dilate(inside, np.ones((_SEAM_PX, _SEAM_PX), np.uint8)), dtype=np.uint8)
    mask = cv2.bitwise_and(relief.rises.view(np.uint8), cv2.bitwise_not(inside))
    if min_area_px is not None:
        # seams beside what is explained would make one outline of pieces that are far apart
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((_THIN_PX, _THIN_PX), np.uint8))
    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((_JOIN_PX, _JOIN_PX), np.uint8))
    pieces = _pieces(np.asarray(closed, dtype=np.uint8), beside, min_area_px or _MIN_AREA_PX)
    hulls = [cv2.convexHull(piece.outline) for piece in pieces]
    small = [cv2.contourArea(hull) < _MIN_OUTLINE_PX for hull in hulls]
    borders = [piece for piece, alone in zip(pieces, small, strict=True) if alone or min_area_px is None]
    between = [
        cv2.convexHull(np.concatenate([one.outline, other.outline]))
        for one, other in combinations(borders, 2)
        if one.beside(other)
    ]
    hulls += between if min_area_px is None else [hull for hull in between if _share(inside, hull) < _MOSTLY]
    return [hull.reshape(-1, 2).astype(np.float64) for hull in hulls if cv2.contourArea(hull) >= _MIN_OUTLINE_PX]


def _share(mask: NDArray[np.uint8], hull: MatLike) -> float:
    """Return how much of a convex outline's inside a mask covers."""
    corners = np.rint(hull).astype(np.int32)
    left, top, width, height = cv2.boundingRect(corners)
    within = np.zeros((height, width), dtype=np.uint8)
    cv2.fillConvexPoly(within, corners - (left, top), 1)
    return cv2.mean(mask[top : top + height, left : left + width], within)[0]


@dataclass(frozen=True, eq=False)
class _Piece:
    """One connected piece of what rises: the ends of its rows, shape (N, 2), and its box (left, top, right, bottom)."""

    outline: NDArray[np.float32]
    box: tuple[int, int, int, int]

    def beside(self, other: _Piece) -> bool:
        """Whether the two may be the left and the right border of one face."""
        shared = min(self.box[3], other.box[3]) - max(self.box[1], other.box[1])
        rows = min(self.box[3] - self.box[1], other.box[3] - other.box[1])
        apart = max(self.box[0], other.box[0]) - min(self.box[2], other.box[2])
        return shared >= _MIN_ROWS * rows and apart > 0


def _pieces(rising: NDArray[np.uint8], beside: NDArray[np.uint8], min_area_px: int) -> list[_Piece]:
    """Return the connected pieces of a mask that are large enough, and outside of another mask too.

    Args:
        rising: 1 where something rises, shape (H, W). It is little: its runs are looked at, not its pixels.
        beside: 1 near what is explained, shape (H, W).
        min_area_px: least number of a piece's pixels.
    """
    # a column that holds nothing parts the rows
    framed, explained = (
        np.asarray(cv2.copyMakeBorder(each, 0, 0, 0, 1, cv2.BORDER_CONSTANT, value=(0,)), dtype=np.uint8)
        for each in (rising, beside)
    )
    pixels = np.flatnonzero(framed.view(np.bool_))
    begin = runs_of(pixels, np.zeros(max(pixels.size - 1, 0), dtype=np.bool_))
    length = np.diff(begin, append=pixels.size)
    width = framed.shape[1]
    first, last = pixels[begin], pixels[begin] + length - 1
    root = joined(np.arange(begin.size), *touching_runs(first, last, width))
    outside = np.add.reduceat(explained.ravel()[pixels] == 0, begin, dtype=np.intp)
    area, seen = (np.bincount(root, weights=counts, minlength=begin.size) for counts in (length, outside))
    pieces = []
    for number in np.flatnonzero((area >= min_area_px) & (seen >= _MIN_AREA_PX)).tolist():
        member = root == number
        ends = np.concatenate([first[member], last[member]])
        row, column = np.divmod(ends, width)
        box = (int(column.min()), int(row.min()), int(column.max()) + 1, int(row.max()) + 1)
        pieces.append(_Piece(np.column_stack([column, row]).astype(np.float32), box))
    return pieces
