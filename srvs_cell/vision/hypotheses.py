"""The few disparity planes that together explain a pair of pictures.

Every matched region has a plane, and most of them are the same few surfaces', more or less well known. On a coarse
grid of pixels each candidate's photometric cost is looked up; then planes are chosen one by one, each time the one
that explains most of what those before do not, until the next would explain too little. This greedy choice is within
1 - 1/e of the best one, for the gain is submodular (Nemhauser, Wolsey and Fisher 1978); it draws nothing at random.
The chosen planes are aligned where they explain best, and the choice is made anew among them and their better selves.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.photometric import PhotometricCost
from srvs_cell.vision.refinement import GreyPair, align_plane

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.scene import DisparityPlane, PlaneImage, PlaneMatch
    from srvs_cell.vision.parameters import GroupingParameters, RefinementParameters

_COARSE_PIXELS = 10_000
"""The coarse grid has about so many."""
_WINDOW = (5, 5)
"""Costs are averaged over so many coarse pixels: one pixel alone tells no plane from another."""
_UNEXPLAINED = 0.5
_LARGEST = 48
_ROUNDS = 2
LEAST_SLOPE = 1.0
"""Grey values per pixel along the row; where there is less, a pixel tells nothing of the disparity."""
_FINE, _FINEST = 256.0, 65535.0
"""Slopes are compared in parts of a grey value per pixel, as whole numbers of 16 bits."""
_FLAT_SLOPE = 0.3
"""A surface whose disparity changes by more per pixel is none that a camera sees well."""


@dataclass(frozen=True)
class Hypothesis:
    """A disparity plane and how well it is known.

    Attributes:
        plane: (a, b, c).
        sigma_px: standard deviation of the disparity in the middle of its pixels.
    """

    plane: DisparityPlane
    sigma_px: float


def find_surfaces(
    left: PlaneImage,
    right: PlaneImage,
    matches: Sequence[PlaneMatch],
    sloping: tuple[NDArray[np.intp], NDArray[np.float32]],
    pair: GreyPair,
    parameters: tuple[GroupingParameters, RefinementParameters],
) -> list[Hypothesis]:
    """Return the planes that explain the pair, the one that explains most first.

    Args:
        left: planes of the left image.
        right: the right image.
        matches: matched regions with their disparity planes; the largest are candidates.
        sloping: numbers in the flat left image, ascending, and slopes of the pixels that tell something.
        pair: the images prepared for the alignment.
        parameters: of the grouping and of the alignment.
    """
    limits, refinement = parameters
    largest = sorted(matches, key=lambda match: -left.planes[match.left - 1].area_px)[:_LARGEST]
    candidates = [
        Hypothesis(match.disparity_plane, max(match.disparity_sigma_px, limits.max_step_px))
        for match in largest
        if max(abs(match.disparity_plane[0]), abs(match.disparity_plane[1])) < _FLAT_SLOPE
    ]
    if not candidates:
        return []
    step_px = max(1, round(np.sqrt(left.grey.size / _COARSE_PIXELS)))
    cost = PhotometricCost.of(left.grey, right.grey, step_px)
    steepest = steepest_pixels(*sloping, left.grey.shape, step_px)
    height, width = steepest.shape
    costs = _coarse(cost, candidates)
    for _ in range(_ROUNDS):
        chosen = choose_planes(costs, limits.min_share)
        candidates, costs = [candidates[k] for k in chosen], costs[chosen]
        if not candidates:
            return []
        owner = np.argmin(costs, axis=0)[:height, :width]
        aligned = []
        for number, candidate in enumerate(candidates):
            rows, columns = np.divmod(steepest[(owner == number) & (steepest >= 0)], left.grey.shape[1])
            better = align_plane(pair, rows, columns, candidate.plane, refinement)
            if better is not None:
                aligned.append(Hypothesis(better.plane, better.sigma_px))
        candidates += aligned
        costs = np.concatenate([costs, _coarse(cost, aligned)])
    return [candidates[k] for k in choose_planes(costs, limits.min_share)]


def steepest_pixels(
    pixels: NDArray[np.intp], slope: NDArray[np.float32], shape: tuple[int, ...], cell_px: int
) -> NDArray[np.intp]:
    """Return the number of the pixel with the steepest slope in each whole cell, -1 where there is none, shape (h, w).

    Args:
        pixels: numbers in the flat image.
        slope: of each of them.
        shape: of the image.
        cell_px: side of a cell.
    """
    height, width = (length // cell_px for length in shape)
    row = pixels // shape[1]
    cell = row // cell_px * (width + 1) + (pixels - row * shape[1]) // cell_px
    steepest = np.full((height + 1) * (width + 1), -1, dtype=np.intp)
    # the steepest of a cell is written last
    rising = np.argsort(np.minimum(np.abs(slope) * _FINE, _FINEST).astype(np.uint16), kind="stable")
    steepest[cell[rising]] = pixels[rising]
    return steepest.reshape(height + 1, width + 1)[:height, :width]


def _coarse(cost: PhotometricCost, candidates: Sequence[Hypothesis]) -> NDArray[np.float32]:
    """Return the candidates' costs averaged over a small window, shape (K, h, w)."""
    costs = cost.of_planes([candidate.plane for candidate in candidates])
    for each in costs:
        cv2.boxFilter(each, -1, _WINDOW, dst=each)
    return costs


def choose_planes(costs: NDArray[np.float32], min_share: float) -> list[int]:
    """Return the numbers of the planes that together explain the pixels, the one with the largest gain first.

    Args:
        costs: of each plane at each pixel, 0 to 1, shape (K, ...).
        min_share: what a plane must lower the mean cost by to be chosen.
    """
    lowest = np.full(costs.shape[1:], _UNEXPLAINED, dtype=np.float32)
    # gains only fall while planes are chosen: an old gain is a bound, and few are ever counted again
    queue = [(-_gain(lowest, cost), k) for k, cost in enumerate(costs)]
    heapq.heapify(queue)
    chosen: list[int] = []
    while queue:
        _, k = heapq.heappop(queue)
        gain = _gain(lowest, costs[k])
        if queue and gain < -queue[0][0]:
            heapq.heappush(queue, (-gain, k))
        elif gain < min_share:
            break
        else:
            chosen.append(k)
            np.minimum(lowest, costs[k], out=lowest)
    return chosen


def _gain(lowest: NDArray[np.float32], cost: NDArray[np.float32]) -> float:
    return float(np.maximum(lowest - cost, 0.0).mean())
