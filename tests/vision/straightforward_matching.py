"""The matching rule pair by pair, as its text reads: what the fast one is held against."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.matching import Matching, PlanePair
from srvs_cell.vision.parameters import Maxima

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.scene import Plane
    from srvs_cell.vision.parameters import MatchingParameters

Pair = tuple[int, int]
SHAPE = ("area_px", "short_cut_px", "long_cut_px", "perimeter_px")


def straightforward(
    left: Sequence[Plane], right: Sequence[Plane], disparity_range_px: tuple[float, float], limits: MatchingParameters
) -> Matching:
    """Match planes by looking at all pairs."""
    if not left or not right:
        return Matching()
    every = [(i, j) for i in range(len(left)) for j in range(len(right))]
    candidates = [(i, j) for i, j in every if _passes(left[i], right[j], disparity_range_px, limits)]
    running = every if limits.maxima is Maxima.ALL_PLANES else candidates
    score = {(i, j): _score(left[i], right[j]) for i, j in every}
    eligible = [pair for pair in candidates if score[pair] > limits.match_threshold]
    best = [
        (i, j)
        for i, j in eligible
        if score[i, j] == max(score[pair] for pair in running if pair[0] == i)
        and score[i, j] == max(score[pair] for pair in running if pair[1] == j)
    ]
    matched = [
        (i, j)
        for i, j in best
        if (i, j) == min((pair for pair in best if pair[0] == i), key=lambda pair: _difference(left, right, pair))
        and (i, j) == min((pair for pair in best if pair[1] == j), key=lambda pair: _difference(left, right, pair))
    ]
    unsure = [pair for pair in matched if limits.ordered and _fooled(left, right, pair, matched, eligible, score)]
    return Matching(
        tuple(PlanePair(left[i].id, right[j].id, score[i, j]) for i, j in matched if (i, j) not in unsure),
        tuple(left[i].id for i, _ in unsure),
    )


def _score(plane: Plane, other: Plane) -> float:
    bright, other_bright = max(plane.brightness, 1e-6), max(other.brightness, 1e-6)
    return min(bright, other_bright) / max(bright, other_bright)


def _weights(limits: MatchingParameters) -> tuple[float, ...]:
    return limits.weight_area, limits.weight_short_cut, limits.weight_long_cut, limits.weight_perimeter


def _passes(plane: Plane, other: Plane, disparity_range_px: tuple[float, float], limits: MatchingParameters) -> bool:
    shift = plane.centre_px[0] - other.centre_px[0]
    low, high = disparity_range_px
    margin = limits.max_column_margin_px
    near = abs(plane.centre_px[1] - other.centre_px[1]) < limits.max_row_distance_px and low - margin < shift
    return (
        near
        and shift < high + margin
        and all(
            max(getattr(plane, name), getattr(other, name)) - min(getattr(plane, name), getattr(other, name))
            < min(getattr(plane, name), getattr(other, name)) * weight
            for name, weight in zip(SHAPE, _weights(limits), strict=True)
        )
    )


def _difference(left: Sequence[Plane], right: Sequence[Plane], pair: Pair) -> float:
    total = 0.0
    for name in SHAPE:
        values = getattr(left[pair[0]], name), getattr(right[pair[1]], name)
        total += (max(values) - min(values)) / max(min(values), 1e-6)
    return total


def _fooled(
    left: Sequence[Plane],
    right: Sequence[Plane],
    pair: Pair,
    matched: list[Pair],
    eligible: list[Pair],
    score: dict[Pair, float],
) -> bool:
    def shift(one: Pair) -> float:
        return left[one[0]].centre_px[0] - right[one[1]].centre_px[0]

    def distance(one: Pair, other: Pair) -> float:
        (x, y), (other_x, other_y) = left[one[0]].centre_px, left[other[0]].centre_px
        return float(np.hypot(x - other_x, y - other_y))

    def agreeing(one: Pair) -> int:
        return sum(
            0.0 < distance(one, other) < 150.0 and abs(shift(one) - shift(other)) < 0.2 * distance(one, other)
            for other in matched
        )

    def crosses(one: Pair, other: Pair) -> bool:
        top, other_top = left[one[0]].box_px[1], left[other[0]].box_px[1]
        common = top < other_top + left[other[0]].box_px[3] and other_top < top + left[one[0]].box_px[3]
        before = left[one[0]].centre_px[0] - left[other[0]].centre_px[0]
        return common and before * (right[one[1]].centre_px[0] - right[other[1]].centre_px[0]) < 0.0

    support = agreeing(pair)
    crossed = [agreeing(other) for other in matched if crosses(pair, other)]
    alone = all(sum(one[side] == pair[side] for one in eligible) == 1 for side in (0, 1))
    outdone = sum(4 * support < other for other in crossed) >= 2 if alone else any(support < one for one in crossed)
    mine = [one for one in eligible if one[0] == pair[0]]
    greatest = max(score[one] for one in mine)
    rivals = [one for one in mine if score[one] > greatest - 0.03]
    own = agreeing(pair) if pair in rivals else 0
    return outdone or any(agreeing(rival) >= own for rival in rivals if rival != pair)
