"""Straight line matching after McIntosh and Mutch (CVGIP 43, 1988): the paper's baseline, a reconstruction.

The text of McIntosh and Mutch was not at hand. The paper says of it: eight parameters a line, a match function,
thresholds, and that only lines which match mutually are matched; a later user of the method (N. Butler, ISPRS XXIX,
1992) says the same. Those are kept; the rest is ours and modelled on the paper's own rule for planes, which it says is
based on this one:

- Two lines are a candidate pair where the epipolar constraint allows it: their rows overlap, and x_L - x_R on the
  shared rows lies in the range of disparities. This uses two of the eight parameters, the midpoint's x and y.
- The match function is the weighted mean of the similarities of the other six: min / max for length, contrast, width,
  steepness and brightness; for the orientation 1 less the difference over the greatest difference allowed.
- A pair matches where it is the best of both its lines among the candidates and exceeds the match threshold.

The disparity of a matched pair is measured at the rows of the left line's ends: d = x_L - x_R(y), with x_R where the
right line, prolonged if need be, crosses that row. A line that makes the angle a with the rows crosses them at a point
that is uncertain by sigma / sin(a): this is the inaccuracy that the paper names for lines displaced in a direction
similar to their own. Below `near_horizontal_deg` the crossing is worth less than the lines' ends: these are compared.

The defaults were chosen in the baseline's favour on the very pictures it is judged by (docs/benchmarks.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as checked_dataclass

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.line_support import LineImage

_LEAST = 1e-6
"""Keeps the ratio of two values that are both zero defined: it is 1."""
_WEIGHT = Field(ge=0.0, le=1.0, description="weight of this parameter's similarity")
_TURN_DEG = 360.0
_BAND_LINES = 128


@checked_dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid"))
class LineMatchingParameters:
    """Gates, weights and threshold of the match function."""

    max_row_distance_px: Annotated[
        float, Field(ge=0.0, le=100.0, description="rows may miss each other by so much: the epipolar tolerance")
    ] = 3.0
    min_row_overlap: Annotated[
        float, Field(ge=0.0, le=1.0, description="least shared rows, of the rows of the shorter line")
    ] = 0.5
    max_column_margin_px: Annotated[
        float, Field(ge=0.0, le=1000.0, description="added to the disparity range for the maximum column distance")
    ] = 4.0
    max_orientation_difference_deg: Annotated[
        float, Field(gt=0.0, le=90.0, description="lines that differ by more are no candidates")
    ] = 20.0
    near_horizontal_deg: Annotated[
        float, Field(ge=0.1, le=45.0, description="a line that is less inclined to the rows does not cross them")
    ] = 10.0
    weight_orientation: Annotated[float, _WEIGHT] = 1.0
    weight_length: Annotated[float, _WEIGHT] = 1.0
    weight_contrast: Annotated[float, _WEIGHT] = 1.0
    weight_width: Annotated[float, _WEIGHT] = 1.0
    weight_steepness: Annotated[float, _WEIGHT] = 1.0
    weight_brightness: Annotated[float, _WEIGHT] = 1.0
    match_threshold: Annotated[float, Field(ge=0.0, le=1.0, description="least value of the match function")] = 0.8


@dataclass(frozen=True, eq=False)
class LineMatches:
    """Matched lines; match i has row i of every array, by ascending left line.

    Attributes:
        left, right: numbers of the lines in their `LineImage`, from 0, shape (M,).
        score: the match function's value, 0 to 1, shape (M,).
        disparity_ends_px: at the left line's start and end, shape (M, 2); between them it is linear.
        near_horizontal: bool, shape (M,): the disparity comes from the lines' ends, not from the rows they cross.
    """

    left: NDArray[np.intp]
    right: NDArray[np.intp]
    score: Array
    disparity_ends_px: Array
    near_horizontal: NDArray[np.bool_]

    def __len__(self) -> int:
        """Return the number of matches."""
        return len(self.left)


def match_lines(
    left: LineImage, right: LineImage, disparity_range_px: tuple[float, float], parameters: LineMatchingParameters
) -> LineMatches:
    """Match the lines of two rectified images.

    Args:
        left: lines of the left image.
        right: lines of the right image.
        disparity_range_px: least and greatest disparity.
        parameters: gates, weights and threshold.
    """
    of_left, of_right = candidates(left, right, disparity_range_px, parameters)
    score = match_function(left, right, of_left, of_right, parameters)
    chosen = np.flatnonzero(score > parameters.match_threshold)
    chosen = chosen[_mutual_best(of_left[chosen], of_right[chosen], score[chosen])]
    of_left, of_right, score = of_left[chosen], of_right[chosen], score[chosen]
    flat = near_horizontal(left, of_left, parameters) | near_horizontal(right, of_right, parameters)
    ends = np.column_stack(
        [
            _disparity_at(points[of_left], partner[of_right], (right, of_right), flat)
            for points, partner in ((left.start_px, right.start_px), (left.end_px, right.end_px))
        ]
    )
    low, high = disparity_range_px
    margin = parameters.max_column_margin_px
    # what has no positive disparity is not in front of the cameras
    possible = ((ends > max(low - margin, 0.0)) & (ends < high + margin)).all(axis=1)
    return LineMatches(of_left[possible], of_right[possible], score[possible], ends[possible], flat[possible])


def candidates(
    left: LineImage, right: LineImage, disparity_range_px: tuple[float, float], parameters: LineMatchingParameters
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the pairs of lines that the epipolar constraint and the orientation allow, as two arrays of numbers."""
    low_left, high_left = _rows(left)
    low_right, high_right = _rows(right)
    found_left, found_right = [np.zeros(0, dtype=np.intp)], [np.zeros(0, dtype=np.intp)]
    # bands of lines that lie at about the same height: each is held only against what shares its rows
    downwards = np.argsort(low_left, kind="stable")
    for first in range(0, len(left), _BAND_LINES):
        band = downwards[first : first + _BAND_LINES]
        near = np.flatnonzero(
            (high_right >= low_left[band].min() - parameters.max_row_distance_px)
            & (low_right <= high_left[band].max() + parameters.max_row_distance_px)
        )
        shared = np.minimum(high_left[band, None], high_right[near]) - np.maximum(low_left[band, None], low_right[near])
        shorter = np.minimum((high_left - low_left)[band, None], (high_right - low_right)[near])
        turn = np.abs(left.orientation_deg[band, None] - right.orientation_deg[near])
        rows, columns = np.nonzero(
            (shared >= parameters.min_row_overlap * shorter - parameters.max_row_distance_px)
            & (np.minimum(turn, _TURN_DEG - turn) < parameters.max_orientation_difference_deg)
        )
        found_left.append(band[rows])
        found_right.append(near[columns])
    of_left, of_right = np.concatenate(found_left), np.concatenate(found_right)
    row = 0.5 * (
        np.minimum(high_left[of_left], high_right[of_right]) + np.maximum(low_left[of_left], low_right[of_right])
    )
    flat = near_horizontal(left, of_left, parameters) | near_horizontal(right, of_right, parameters)
    by_rows = _crossing(left, of_left, row, flat) - _crossing(right, of_right, row, flat)
    low, high = disparity_range_px
    margin = parameters.max_column_margin_px
    possible = (by_rows > low - margin) & (by_rows < high + margin)
    of_left, of_right = of_left[possible], of_right[possible]
    order = np.lexsort((of_right, of_left))
    return of_left[order], of_right[order]


def match_function(
    left: LineImage,
    right: LineImage,
    of_left: NDArray[np.intp],
    of_right: NDArray[np.intp],
    parameters: LineMatchingParameters,
) -> Array:
    """Return the weighted mean similarity, 0 to 1, of pairs of lines that differ little enough in orientation."""
    turn = np.abs(left.orientation_deg[of_left] - right.orientation_deg[of_right])
    turn = np.minimum(turn, _TURN_DEG - turn)
    total = parameters.weight_orientation * (1.0 - turn / parameters.max_orientation_difference_deg)
    weights = parameters.weight_orientation
    for name, weight in (
        ("length_px", parameters.weight_length),
        ("contrast", parameters.weight_contrast),
        ("width_px", parameters.weight_width),
        ("steepness", parameters.weight_steepness),
        ("brightness", parameters.weight_brightness),
    ):
        values_left = np.maximum(getattr(left, name)[of_left], _LEAST)
        values_right = np.maximum(getattr(right, name)[of_right], _LEAST)
        total = total + weight * np.minimum(values_left, values_right) / np.maximum(values_left, values_right)
        weights += weight
    return np.asarray(total / max(weights, _LEAST), dtype=np.float64)


def _mutual_best(of_left: NDArray[np.intp], of_right: NDArray[np.intp], score: Array) -> NDArray[np.intp]:
    """Return which pairs are the best of both their lines; of equals the first."""
    if not score.size:
        return np.zeros(0, dtype=np.intp)
    best_left, best_right = np.zeros(int(of_left.max()) + 1), np.zeros(int(of_right.max()) + 1)
    np.maximum.at(best_left, of_left, score)
    np.maximum.at(best_right, of_right, score)
    best = np.flatnonzero((score == best_left[of_left]) & (score == best_right[of_right]))
    best = best[np.unique(of_left[best], return_index=True)[1]]
    return np.sort(best[np.unique(of_right[best], return_index=True)[1]])


def near_horizontal(
    lines: LineImage, chosen: NDArray[np.intp], parameters: LineMatchingParameters
) -> NDArray[np.bool_]:
    """Return which of the chosen lines hardly cross the rows."""
    rise = np.abs(lines.end_px[chosen, 1] - lines.start_px[chosen, 1])
    return np.asarray(rise < np.sin(np.deg2rad(parameters.near_horizontal_deg)) * lines.length_px[chosen])


def _rows(lines: LineImage) -> tuple[Array, Array]:
    """Return the least and greatest row of each line."""
    return np.minimum(lines.start_px[:, 1], lines.end_px[:, 1]), np.maximum(lines.start_px[:, 1], lines.end_px[:, 1])


def _crossing(lines: LineImage, chosen: NDArray[np.intp], row: Array, flat: NDArray[np.bool_]) -> Array:
    """Return where each chosen line crosses a row; the midpoint's x where it does not."""
    start, span = lines.start_px[chosen], lines.end_px[chosen] - lines.start_px[chosen]
    rise = np.where(flat, 1.0, span[:, 1])
    return np.where(flat, lines.centre_px[chosen, 0], start[:, 0] + (row - start[:, 1]) * span[:, 0] / rise)


def _disparity_at(
    points: Array, partner: Array, right: tuple[LineImage, NDArray[np.intp]], flat: NDArray[np.bool_]
) -> Array:
    """Return the disparity at points of the left lines; where flat, against the right lines' corresponding ends."""
    crossing = _crossing(*right, points[:, 1], flat)
    return points[:, 0] - np.where(flat, partner[:, 0], crossing)
