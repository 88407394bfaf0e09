"""Step 10: linear interpolation between the ends of a plane's rows, and the disparity plane behind it.

In every row that a matched plane has in both images, the row's left end in one image corresponds to the left end in
the other, the right end to the right end; pixels between correspond linearly. Over all rows the ends of one flat face
lie on one disparity plane d = a x + b y + c, which a robust least squares fit finds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg.lapack import dgesv

from srvs_cell.vision.runs import RowRuns

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.scene import DisparityPlane, Plane
    from srvs_cell.vision.parameters import InterpolationParameters

_SEARCH_PX = 2
"""The grey values' steepest place is sought so far to either side of a row's end."""
_ITERATIONS = 6
_SLOPE_SIGMA = 0.1
"""Slopes beyond this are rare (about 60 degrees at half a metre): a narrow plane's slope is held towards 0."""
_LEAST_SIGMA_PX = 0.02
_SAMPLE_SIGMA_PX = 0.5
"""What one row's end is worth before the residuals are known."""
_MAD_TO_SIGMA = 1.4826
_LEAST_WEIGHT = 1e-3


@dataclass(frozen=True, eq=False)
class RowEnds:
    """The ends of the rows of every plane of one image.

    Attributes:
        first, last: x of the first and last pixel, shape (planes + 1, H); NaN where the plane has no such row.
        first_weight, last_weight: how well each end tells x: the share of the gradient that runs along the row; 0 for
            an end at the border of the image.
    """

    first: Array
    last: Array
    first_weight: Array
    last_weight: Array


def find_row_ends(
    image: NDArray[np.float32],
    labels: NDArray[np.int32],
    count: int,
    parameters: InterpolationParameters,
    valid: NDArray[np.bool_] | None = None,
) -> RowEnds:
    """Find the ends of the rows of every plane.

    Args:
        image: smoothed grey values, float32, shape (H, W).
        labels: plane ids, int32, shape (H, W).
        count: the number of planes.
        parameters: whether ends are measured to a part of a pixel.
        valid: pixels that belong to the image; all where None.
    """
    height, width = labels.shape
    runs = RowRuns.of(labels)
    key = runs.label * height + runs.row
    low = np.full((count + 1) * height, width)
    high = np.full((count + 1) * height, -1)
    np.minimum.at(low, key, runs.first)
    np.maximum.at(high, key, runs.last)
    # what belongs to no plane has no ends
    high[:height] = -1
    present = np.flatnonzero(high >= 0)
    row = present % height
    inside = np.zeros((height, width + 2), dtype=np.bool_)
    inside[:, 1:-1] = True if valid is None else valid
    ends = []
    for columns_at, outward in ((low[present], -1), (high[present], 1)):
        # the border lies between the end's pixel and its outer neighbour
        position, weight = _steepest(image, row, columns_at + 0.5 * outward, sub_pixel=parameters.sub_pixel)
        weight = np.where(inside[row, columns_at + 1 + outward], weight, 0.0)
        for values in (position, weight):
            table = np.full((count + 1) * height, np.nan)
            table[present] = values
            ends.append(table.reshape(count + 1, height))
    return RowEnds(ends[0], ends[2], ends[1], ends[3])


def _steepest(image: NDArray[np.float32], rows: NDArray[np.int64], x: Array, *, sub_pixel: bool) -> tuple[Array, Array]:
    """Return where the grey values near (x, row) are steepest along the row, and the share of the gradient along it."""
    height, width = image.shape
    steps = np.arange(-_SEARCH_PX - 1, _SEARCH_PX + 2)
    # positions between pixels: x = k + 0.5, measured by the difference of pixels k + 1 and k
    left = np.floor(x).astype(np.int64)[:, None] + steps[None, :]
    left = np.clip(left, 0, width - 2)
    flat, place = image.ravel(), rows[:, None] * width + left
    along = flat[place + 1] - flat[place]
    strength = np.abs(along)
    peak = 1 + np.argmax(strength[:, 1:-1], axis=1)
    number = np.arange(rows.size)
    before, at, after = strength[number, peak - 1], strength[number, peak], strength[number, peak + 1]
    column = left[number, peak]
    across = 0.5 * (image[np.minimum(rows + 1, height - 1), column] - image[np.maximum(rows - 1, 0), column])
    weight = at**2 / np.maximum(at**2 + across**2, np.finfo(np.float32).tiny)
    if not sub_pixel:
        return x, weight
    curvature = before - 2.0 * at + after
    offset = np.where(curvature < 0.0, 0.5 * (before - after) / np.where(curvature < 0.0, curvature, 1.0), 0.0)
    return column + 0.5 + np.clip(offset, -0.5, 0.5), weight


def fit_disparity_plane(
    left_id: int, right_id: int, left: RowEnds, right: RowEnds, parameters: InterpolationParameters
) -> tuple[DisparityPlane, float] | None:
    """Fit the disparity plane of one match to the ends of its rows.

    Returns:
        (a, b, c), and the standard deviation of the disparity at the middle of the ends, pixels; None where the planes
        share no row whose ends can be seen.
    """
    rows, x, disparity, weight = [], [], [], []
    for ends_left, ends_right, weight_left, weight_right in (
        (left.first[left_id], right.first[right_id], left.first_weight[left_id], right.first_weight[right_id]),
        (left.last[left_id], right.last[right_id], left.last_weight[left_id], right.last_weight[right_id]),
    ):
        both = np.flatnonzero(np.fmin(weight_left, weight_right) > _LEAST_WEIGHT)
        both = both[np.isfinite(ends_left[both] + ends_right[both])]
        rows.append(both)
        x.append(ends_left[both])
        disparity.append(ends_left[both] - ends_right[both])
        weight.append(np.minimum(weight_left[both], weight_right[both]))
    y = np.concatenate(rows).astype(np.float64)
    if not y.size:
        return None
    return robust_plane(np.concatenate(x), y, np.concatenate(disparity), np.concatenate(weight), parameters)


def robust_plane(
    x: Array, y: Array, disparity: Array, weight: Array, parameters: InterpolationParameters
) -> tuple[DisparityPlane, float]:
    """Fit d = a x + b y + c by reweighted least squares, slopes held towards 0; returns as `fit_disparity_plane`."""
    mass = float(weight.sum())
    middle_x, middle_y = float(weight @ x) / mass, float(weight @ y) / mass
    design = np.stack([x - middle_x, y - middle_y, np.ones_like(x)])
    held = (_SAMPLE_SIGMA_PX / _SLOPE_SIGMA) ** 2
    prior = np.diag([held, held, 0.0])
    order = np.argsort(disparity)
    share = np.cumsum(weight[order])
    solution = np.array([0.0, 0.0, disparity[order][np.searchsorted(share, 0.5 * share[-1])]])
    residual = disparity - solution[2]
    limit = max(parameters.max_residual_px, _MAD_TO_SIGMA * _median(np.abs(residual)))
    effective = weight
    for _ in range(_ITERATIONS):
        # Tukey's weights forget what lies beyond the limit, which narrows to that of the parameters
        effective = weight * np.maximum(1.0 - (residual / (3.0 * limit)) ** 2, 0.0) ** 2
        weighted = design * effective
        if effective.sum() <= _LEAST_WEIGHT:
            break
        _, _, solution, _ = dgesv(weighted @ design.T + prior, weighted @ disparity)
        residual = disparity - solution @ design
        limit = max(parameters.max_residual_px / 2.0, limit / 2.0)
    total = float(effective.sum())
    if total > _LEAST_WEIGHT:
        spread = float(np.sqrt(effective @ residual**2 / total))
        sigma = max(_LEAST_SIGMA_PX, spread / np.sqrt(max(total / 4.0, 1.0)))
    else:
        sigma = float(parameters.max_residual_px)
    a, b, level = (float(value) for value in solution)
    return (a, b, level - a * middle_x - b * middle_y), sigma


def _median(values: Array) -> float:
    """Return the middle value; of an even number the mean of the two."""
    middle = values.size // 2
    if values.size % 2:
        return float(np.partition(values, middle)[middle])
    low, high = np.partition(values, (middle - 1, middle))[middle - 1 : middle + 1]
    return float(low + high) / 2.0


def disparity_at(plane: DisparityPlane, x: ArrayLike, y: ArrayLike) -> Array:
    """Return a x + b y + c."""
    a, b, c = plane
    return np.asarray(a * np.asarray(x) + b * np.asarray(y) + c, dtype=np.float64)


def fill_plane(
    disparity_px: NDArray[np.float32], labels: NDArray[np.int32], plane: Plane, fitted: DisparityPlane
) -> None:
    """Write a plane's disparities into the dense map, in place."""
    x, y, width, height = plane.box_px
    window = (slice(y, y + height), slice(x, x + width))
    inside = labels[window] == plane.id
    columns, rows = np.arange(x, x + width), np.arange(y, y + height)
    np.copyto(disparity_px[window], disparity_at(fitted, columns, rows[:, None]), where=inside, casting="same_kind")


def fill_rows(
    disparity_px: NDArray[np.float32],
    labels: NDArray[np.int32],
    pair: tuple[Plane, Plane],
    ends: tuple[RowEnds, RowEnds],
    possible_px: tuple[float, float],
) -> None:
    """Write the paper's row by row interpolation into the dense map, in place.

    A pixel at a share t between its row's ends in the left plane corresponds to the place at the share t between the
    ends in the right one.

    Args:
        disparity_px: float32, shape (H, W).
        labels: plane ids of the left image.
        pair: the left and the right plane.
        ends: row ends of the left and of the right image.
        possible_px: least and greatest disparity; the matching's column gate, held against each pixel. Beyond it, or
            at 0 and less, nothing can be: the row's ends are not those of one face, and the pixel stays unknown.
    """
    (left, right), (ends_left, ends_right) = pair, ends
    x, y, width, height = left.box_px
    window = (slice(y, y + height), slice(x, x + width))
    rows, columns = np.nonzero(labels[window] == left.id)
    rows, columns = rows + y, columns + x
    first, last = ends_left.first[left.id][rows], ends_left.last[left.id][rows]
    share = (columns - first) / np.maximum(last - first, 1.0)
    matched = ends_right.first[right.id][rows] * (1.0 - share) + ends_right.last[right.id][rows] * share
    found = columns - matched
    least, greatest = possible_px
    disparity_px[rows, columns] = np.where((found > 0.0) & (found >= least) & (found <= greatest), found, np.nan)
