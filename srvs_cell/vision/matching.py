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

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.scene import Plane
    from srvs_cell.vision.parameters import MatchingParameters

    _Mask = NDArray[np.bool_]
    _Numbers = NDArray[np.intp]

_DARKEST = 1e-6
"""Keeps the ratio of two black planes defined: it is 1."""
_ALIKE = 0.03
"""Match functions that differ by less tell nothing: the noise, and the light on two sides of a table, differ more."""
_NEAR_PX = 150.0
"""Matches within this distance have a say in each other's disparity."""
_STEEPEST = 0.2
"""Neighbours on one surface differ in disparity by less than this share of their distance."""
_MANY = 2
_FAR = 4
"""A match without alternative falls where it crosses at least `_MANY` with `_FAR` times its support: a thing in front
of a surface crosses few, for its centre lies nearer to theirs than its disparity to theirs only when it is small."""


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
    return find_matches(left, right, disparity_range_px, parameters).pairs


@dataclass(frozen=True)
class Matching:
    """What the rule found.

    Attributes:
        pairs: by ascending left id.
        ambiguous: ids of left planes with several partners that nothing tells apart, or whose match crossed others.
    """

    pairs: tuple[PlanePair, ...] = ()
    ambiguous: tuple[int, ...] = ()


def find_matches(
    left: Sequence[Plane],
    right: Sequence[Plane],
    disparity_range_px: tuple[float, float],
    parameters: MatchingParameters,
) -> Matching:
    """Match as `match_planes`, and tell which planes stay ambiguous."""
    if not left or not right:
        return Matching()
    candidate, difference = _candidates(left, right, disparity_range_px, parameters)
    bright_left = np.maximum([plane.brightness for plane in left], _DARKEST)[:, None]
    bright_right = np.maximum([plane.brightness for plane in right], _DARKEST)[None, :]
    score = np.minimum(bright_left, bright_right) / np.maximum(bright_left, bright_right)
    running = score if parameters.maxima is Maxima.ALL_PLANES else np.where(candidate, score, -np.inf)
    best = (score == running.max(axis=1, keepdims=True)) & (score == running.max(axis=0, keepdims=True))
    eligible = candidate & (score > parameters.match_threshold)
    accepted = eligible & best
    ranked = np.where(accepted, difference, np.inf)
    of_left, of_right = ranked.argmin(axis=1), ranked.argmin(axis=0)
    rows = np.flatnonzero(accepted[np.arange(len(left)), of_left] & (of_right[of_left] == np.arange(len(left))))
    columns = of_left[rows]
    unsure = np.zeros(rows.size, dtype=np.bool_)
    if parameters.ordered and rows.size:
        rivals = eligible & (score > score.max(axis=1, where=eligible, initial=0.0)[:, None] - _ALIKE)
        unsure = _fooled(left, right, (rows, columns), eligible, rivals)
    return Matching(
        tuple(
            PlanePair(left[row].id, right[column].id, float(score[row, column]))
            for row, column in zip(rows[~unsure].tolist(), columns[~unsure].tolist(), strict=True)
        ),
        tuple(left[row].id for row in rows[unsure].tolist()),
    )


def _fooled(
    left: Sequence[Plane],
    right: Sequence[Plane],
    matched: tuple[_Numbers, _Numbers],
    eligible: _Mask,
    rivals: _Mask,
) -> _Mask:
    """Return which matches cross better ones, or have rivals that the matches around them favour no less.

    Args:
        left: all planes of the left image.
        right: all planes of the right image.
        matched: numbers of the left and the right plane of each match, shape (K,) each.
        eligible: pairs inside the gates, shape (N, M).
        rivals: those of them that are about as alike as each left plane's best.
    """
    rows, columns = matched
    centres_left, centres_right = (np.array([plane.centre_px for plane in planes]) for planes in (left, right))
    x_left, y_left = centres_left[rows].T
    x_right = centres_right[columns, 0]
    disparity = x_left - x_right
    distance = np.hypot(x_left[:, None] - x_left, y_left[:, None] - y_left)
    near = (distance < _NEAR_PX) & (distance > 0.0)
    support = np.count_nonzero(near & (np.abs(disparity[:, None] - disparity) < _STEEPEST * distance), axis=1)
    top, height = np.array([(left[row].box_px[1], left[row].box_px[3]) for row in rows.tolist()]).T
    common = (top[:, None] < top + height) & (top < (top + height)[:, None])
    crossing = common & ((x_left[:, None] - x_left) * (x_right[:, None] - x_right) < 0.0)
    several = (np.count_nonzero(eligible[rows], axis=1) > 1) | (np.count_nonzero(eligible[:, columns], axis=0) > 1)
    outdone = (crossing & (support[:, None] < support)).any(axis=1)
    far_outdone = np.count_nonzero(crossing & (_FAR * support[:, None] < support), axis=1)
    unsure: _Mask = np.where(several, outdone, far_outdone >= _MANY)
    for k in np.flatnonzero(np.count_nonzero(rivals[rows], axis=1) > 1).tolist():
        others = np.flatnonzero(rivals[rows[k]])
        around = np.flatnonzero(near[k])
        shift = x_left[k] - centres_right[others, 0]
        agreeing = np.abs(shift[:, None] - disparity[around]) < _STEEPEST * distance[k, around]
        count = np.count_nonzero(agreeing, axis=1)
        unsure[k] |= bool((count[others != columns[k]] >= count[others == columns[k]].sum()).any())
    return unsure


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
