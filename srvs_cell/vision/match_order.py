"""Step 8, beyond the paper: which matches equals may have fooled.

Opaque things keep their order along a row, unless one stands well in front of the other, and neighbours on a surface
have about the same disparity. A match that crosses better ones, or has a rival that the matches around it favour no
less, is ambiguous.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.near_pairs import near_pairs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.scene import Plane
    from srvs_cell.vision.near_pairs import Numbers

    _Mask = NDArray[np.bool_]

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
_ROUNDING_PX = 1.0


@dataclass(frozen=True, eq=False)
class EligiblePairs:
    """Pairs inside the gates whose match function exceeds the threshold.

    Attributes:
        rows, columns: numbers of the left plane, ascending, and of the right one, shape (P,) each.
        score: the match function, shape (P,).
    """

    rows: Numbers
    columns: Numbers
    score: Array

    def rivals(self, planes: int) -> EligiblePairs:
        """Return those that are about as alike as the best of their left plane; ``planes``: number of left planes."""
        best = np.zeros(planes)
        np.maximum.at(best, self.rows, self.score)
        alike = self.score > best[self.rows] - _ALIKE
        return EligiblePairs(self.rows[alike], self.columns[alike], self.score[alike])


@dataclass(frozen=True, eq=False)
class _Matches:
    """K matches: places of their left planes, and their disparities, shape (K,) each."""

    x_px: Array
    y_px: Array
    disparity_px: Array


@dataclass(frozen=True, eq=False)
class _Neighbours:
    """Pairs of matches that have a say in each other: numbers, the first ascending, and distances, shape (Q,) each."""

    first: Numbers
    second: Numbers
    distance_px: Array


def fooled(
    left: Sequence[Plane], right: Sequence[Plane], matched: tuple[Numbers, Numbers], eligible: EligiblePairs
) -> _Mask:
    """Return which matches cross better ones, or have rivals that the matches around them favour no less.

    Args:
        left: all planes of the left image.
        right: all planes of the right image.
        matched: numbers of the left and the right plane of each match, shape (K,) each.
        eligible: which other partners the planes might have had.

    Returns:
        bool, shape (K,).
    """
    rows, columns = matched
    centres_left, centres_right = (np.array([plane.centre_px for plane in planes]) for planes in (left, right))
    x_left, y_left = centres_left[rows].T
    matches = _Matches(x_left, y_left, x_left - centres_right[columns, 0])
    near = _neighbours(matches)
    agreeing = (
        np.abs(matches.disparity_px[near.first] - matches.disparity_px[near.second]) < _STEEPEST * near.distance_px
    )
    support = np.bincount(near.first[agreeing], minlength=rows.size)
    crossing, crossed = _crossings([left[row] for row in rows.tolist()], x_left, centres_right[columns, 0])
    outdone = np.bincount(crossing[support[crossing] < support[crossed]], minlength=rows.size) > 0
    far_outdone = np.bincount(crossing[_FAR * support[crossing] < support[crossed]], minlength=rows.size)
    several = (np.bincount(eligible.rows, minlength=len(left))[rows] > 1) | (
        np.bincount(eligible.columns, minlength=len(right))[columns] > 1
    )
    unsure: _Mask = np.where(several, outdone, far_outdone >= _MANY)
    unsure |= _rivalled(matched, matches, near, eligible.rivals(len(left)), centres_right[:, 0])
    return unsure


def _neighbours(matches: _Matches) -> _Neighbours:
    first, second = near_pairs(matches.y_px, matches.y_px, _NEAR_PX + _ROUNDING_PX, _NEAR_PX + _ROUNDING_PX)
    distance = np.hypot(matches.x_px[first] - matches.x_px[second], matches.y_px[first] - matches.y_px[second])
    near = (distance < _NEAR_PX) & (distance > 0.0)
    return _Neighbours(first[near], second[near], distance[near])


def _crossings(planes: Sequence[Plane], x_left_px: Array, x_right_px: Array) -> tuple[Numbers, Numbers]:
    """Return the pairs of matches on common rows whose order in the right image is not that in the left one."""
    top = np.array([plane.box_px[1] for plane in planes])
    bottom = top + [plane.box_px[3] for plane in planes]
    first, second = near_pairs(top, top, (bottom - top).max(), bottom - top)
    common = (top[first] < bottom[second]) & (top[second] < bottom[first])
    first, second = first[common], second[common]
    turned = (x_left_px[first] - x_left_px[second]) * (x_right_px[first] - x_right_px[second]) < 0.0
    return first[turned], second[turned]


def _rivalled(
    matched: tuple[Numbers, Numbers],
    matches: _Matches,
    near: _Neighbours,
    rivals: EligiblePairs,
    x_right_px: Array,
) -> _Mask:
    """Return which matches have a rival whose disparity no fewer of the matches around agree with."""
    rows, columns = matched
    unsure = np.zeros(rows.size, dtype=np.bool_)
    begin, end = (np.searchsorted(rivals.rows, rows, side=side) for side in ("left", "right"))
    for k in np.flatnonzero(end - begin > 1).tolist():
        others = rivals.columns[begin[k] : end[k]]
        around = slice(*np.searchsorted(near.first, (k, k + 1)))
        shift = matches.x_px[k] - x_right_px[others]
        apart = np.abs(shift[:, None] - matches.disparity_px[near.second[around]])
        count = np.count_nonzero(apart < _STEEPEST * near.distance_px[around], axis=1)
        own = others == columns[k]
        unsure[k] = bool((count[~own] >= count[own].sum()).any())
    return unsure
