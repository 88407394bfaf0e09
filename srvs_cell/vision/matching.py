"""Step 8: plane matching by the paper's rule.

Two planes are a candidate pair where their centres are no farther apart than the maximum row and column distance and
where, for area, short cut, long cut and perimeter, DIFF_i(L, R) < DIFF_TH_i(L, R) = min(L, R) w_i. The match function
is the ratio of their brightness, MF = min / max. A pair matches where its MF is the greatest of its left plane (MAX_L)
and of its right plane (MAX_R) and exceeds the match threshold.

The text takes the maxima over *all* planes, so that a plane elsewhere in the image of just the same brightness takes
the place of the right one, which then finds no partner. `Maxima.ADMISSIBLE` takes them over the candidates. "MF = MAX"
is a mutual arg-max; where several planes have the same greatest MF, the candidate with the least sum of relative
differences DIFF_i / min_i wins, then the one with the lowest id.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.parameters import Maxima

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.geometry import Array
    from srvs_cell.scene import Plane
    from srvs_cell.vision.parameters import MatchingParameters

_DARKEST = 1e-6
"""Keeps the ratio of two black planes defined: it is 1."""


@dataclass(frozen=True)
class PlanePair:
    """Two planes that match: their ids and the match function's value."""

    left: int
    right: int
    score: float


def match_planes(
    left: Sequence[Plane],
    right: Sequence[Plane],
    disparity_range_px: tuple[float, float],
    parameters: MatchingParameters,
) -> tuple[PlanePair, ...]:
    """Match the planes of two rectified images.

    Args:
        left: planes of the left image.
        right: planes of the right image.
        disparity_range_px: least and greatest disparity; with the column margin it is the maximum column distance.
        parameters: the paper's thresholds.

    Returns:
        The pairs, by ascending left id.
    """
    if not left or not right:
        return ()
    candidate, difference = _candidates(left, right, disparity_range_px, parameters)
    bright_left = np.maximum([plane.brightness for plane in left], _DARKEST)[:, None]
    bright_right = np.maximum([plane.brightness for plane in right], _DARKEST)[None, :]
    score = np.minimum(bright_left, bright_right) / np.maximum(bright_left, bright_right)
    running = score if parameters.maxima is Maxima.ALL_PLANES else np.where(candidate, score, -np.inf)
    best = (score == running.max(axis=1, keepdims=True)) & (score == running.max(axis=0, keepdims=True))
    accepted = candidate & best & (score > parameters.match_threshold)
    ranked = np.where(accepted, difference, np.inf)
    of_left, of_right = ranked.argmin(axis=1), ranked.argmin(axis=0)
    return tuple(
        PlanePair(left[row].id, right[column].id, float(score[row, column]))
        for row, column in enumerate(of_left.tolist())
        if accepted[row, column] and of_right[column] == row
    )


def _candidates(
    left: Sequence[Plane],
    right: Sequence[Plane],
    disparity_range_px: tuple[float, float],
    parameters: MatchingParameters,
) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.bool_]], Array]:
    """Return which pairs pass the gates, and the sum of their relative differences, both of shape (N, M)."""
    centres_left = np.array([plane.centre_px for plane in left])
    centres_right = np.array([plane.centre_px for plane in right])
    shift = centres_left[:, None, :] - centres_right[None, :, :]
    low, high = disparity_range_px
    margin = parameters.max_column_margin_px
    candidate = (
        (np.abs(shift[..., 1]) < parameters.max_row_distance_px)
        & (shift[..., 0] > low - margin)
        & (shift[..., 0] < high + margin)
    )
    total = np.zeros(candidate.shape)
    weights = {
        "area_px": parameters.weight_area,
        "short_cut_px": parameters.weight_short_cut,
        "long_cut_px": parameters.weight_long_cut,
        "perimeter_px": parameters.weight_perimeter,
    }
    for name, weight in weights.items():
        values_left = np.array([getattr(plane, name) for plane in left])[:, None]
        values_right = np.array([getattr(plane, name) for plane in right])[None, :]
        least = np.minimum(values_left, values_right)
        difference = np.maximum(values_left, values_right) - least
        candidate &= difference < least * weight
        total += difference / np.maximum(least, _DARKEST)
    return candidate, total
