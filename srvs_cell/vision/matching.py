"""Step 8: plane matching by the paper's rule.

Two planes are a candidate pair where their centres are no farther apart than the maximum row and column distance and
where, for area, short cut, long cut and perimeter, DIFF_i(L, R) < DIFF_TH_i(L, R) = min(L, R) w_i. The match function
is the ratio of their brightness, MF = min / max. A pair matches where its MF is the greatest of its left plane (MAX_L)
and of its right plane (MAX_R) and exceeds the match threshold.

The text takes the maxima over *all* planes, so that a plane elsewhere in the image of just the same brightness takes
the place of the right one, which then finds no partner. `Maxima.ADMISSIBLE` takes them over the candidates. "MF = MAX"
is a mutual arg-max; where several planes have the same greatest MF, the candidate with the least sum of relative
differences DIFF_i / min_i wins, then the one with the lowest id.

Rows are epipolar lines, so that a plane has few others on its rows: only pairs inside the maximum row distance are
ever formed, and the time grows with their number, not with that of all pairs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.match_order import EligiblePairs, fooled
from srvs_cell.vision.near_pairs import near_pairs
from srvs_cell.vision.parameters import Maxima

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.scene import Plane
    from srvs_cell.vision.near_pairs import Numbers
    from srvs_cell.vision.parameters import MatchingParameters

_DARKEST = 1e-6
"""Keeps the ratio of two black planes defined: it is 1."""
_ROUNDING_PX = 1.0
"""What is looked at beyond the maximum row distance, before the exact gate."""


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


@dataclass(frozen=True, eq=False)
class _Candidates:
    """The pairs that pass the gates: numbers of left and right plane, and the sum of relative differences, (P,)."""

    rows: Numbers
    columns: Numbers
    difference: Array


def find_matches(
    left: Sequence[Plane],
    right: Sequence[Plane],
    disparity_range_px: tuple[float, float],
    parameters: MatchingParameters,
) -> Matching:
    """Match as `match_planes`, and tell which planes stay ambiguous."""
    if not left or not right:
        return Matching()
    candidates = _candidates(left, right, disparity_range_px, parameters)
    rows, columns = candidates.rows, candidates.columns
    bright_left, bright_right = (
        np.maximum([plane.brightness for plane in planes], _DARKEST) for planes in (left, right)
    )
    score = _ratio(bright_left[rows], bright_right[columns])
    if parameters.maxima is Maxima.ALL_PLANES:
        greatest_left, greatest_right = _greatest(bright_left, bright_right), _greatest(bright_right, bright_left)
    else:
        greatest_left, greatest_right = np.zeros(len(left)), np.zeros(len(right))
        np.maximum.at(greatest_left, rows, score)
        np.maximum.at(greatest_right, columns, score)
    eligible = score > parameters.match_threshold
    accepted = np.flatnonzero(eligible & (score == greatest_left[rows]) & (score == greatest_right[columns]))
    matched = _mutual(candidates, accepted)
    unsure = np.zeros(matched.size, dtype=np.bool_)
    if parameters.ordered and matched.size:
        pairs = EligiblePairs(rows[eligible], columns[eligible], score[eligible])
        unsure = fooled(left, right, (rows[matched], columns[matched]), pairs)
    return Matching(
        tuple(
            PlanePair(left[rows[pair]].id, right[columns[pair]].id, float(score[pair]))
            for pair in matched[~unsure].tolist()
        ),
        tuple(left[row].id for row in rows[matched[unsure]].tolist()),
    )


def _ratio(brightness: Array, other: Array) -> Array:
    """Return the match function MF."""
    ratio: Array = np.minimum(brightness, other) / np.maximum(brightness, other)
    return ratio


def _greatest(brightness: Array, others: Array) -> Array:
    """Return the greatest MF of each plane with any other: with its neighbours in the order of brightness."""
    ordered = np.sort(others)
    above = np.minimum(np.searchsorted(ordered, brightness), ordered.size - 1)
    below = np.maximum(above - 1, 0)
    return np.maximum(_ratio(brightness, ordered[above]), _ratio(brightness, ordered[below]))


def _mutual(candidates: _Candidates, accepted: Numbers) -> Numbers:
    """Return which accepted pairs have the least difference of their left and of their right plane, by ascending left.

    Of equal differences the lowest number of the other image's plane wins.
    """
    rows, columns, difference = (
        values[accepted] for values in (candidates.rows, candidates.columns, candidates.difference)
    )
    best = np.ones(accepted.size, dtype=np.bool_)
    for own, other in ((rows, columns), (columns, rows)):
        order = np.lexsort((other, difference, own))
        first = np.ones(accepted.size, dtype=np.bool_)
        first[1:] = own[order][1:] != own[order][:-1]
        best[order] &= first
    matched: Numbers = accepted[best]
    return matched


def _candidates(
    left: Sequence[Plane],
    right: Sequence[Plane],
    disparity_range_px: tuple[float, float],
    parameters: MatchingParameters,
) -> _Candidates:
    """Return the pairs that pass the gates."""
    centres_left = np.array([plane.centre_px for plane in left])
    centres_right = np.array([plane.centre_px for plane in right])
    reach_px = parameters.max_row_distance_px + _ROUNDING_PX
    rows, columns = near_pairs(centres_left[:, 1], centres_right[:, 1], reach_px, reach_px)
    shift = centres_left[rows] - centres_right[columns]
    low, high = disparity_range_px
    margin = parameters.max_column_margin_px
    inside: NDArray[np.bool_] = (
        (np.abs(shift[:, 1]) < parameters.max_row_distance_px)
        & (shift[:, 0] > low - margin)
        & (shift[:, 0] < high + margin)
    )
    rows, columns = rows[inside], columns[inside]
    passed = np.ones(rows.size, dtype=np.bool_)
    total = np.zeros(rows.size)
    weights = {
        "area_px": parameters.weight_area,
        "short_cut_px": parameters.weight_short_cut,
        "long_cut_px": parameters.weight_long_cut,
        "perimeter_px": parameters.weight_perimeter,
    }
    for name, weight in weights.items():
        values_left = np.array([getattr(plane, name) for plane in left])[rows]
        values_right = np.array([getattr(plane, name) for plane in right])[columns]
        least = np.minimum(values_left, values_right)
        difference = np.maximum(values_left, values_right) - least
        passed &= difference < least * weight
        total += difference / np.maximum(least, _DARKEST)
    return _Candidates(rows[passed], columns[passed], total[passed])
