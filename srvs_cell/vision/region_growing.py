"""Step 6: region growing between the tracked edges.

Growing begins where the edges are far: the core of a region is what a circle that fits between the edges can reach,
large circles first. All cores then grow at once, the far places before the near ones and the edge pixels last, so that
two cores meet at the neck between them: in the gap of an edge, or in the middle of a face that has a waist. Which of
the two it is, the border tells: regions are joined where most of their common border lies on no edge and their
brightness is alike. A gap therefore does not let one plane leak into another.

The growing is a watershed (Meyer 1992): OpenCV's floods a picture in the order of the differences between neighbours,
so it is given one in which these differences are the order that is wanted.
"""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.runs import RowRuns

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.vision.parameters import PlaneParameters

_LEVELS_PX = (24.0, 16.0, 11.0, 8.0, 5.0, 3.0, 2.0, 1.0, 0.5)
"""The circle's radii; the last level gives every closed region a core, however narrow."""
_REACHED_BY = np.sum(np.arange(256) >= 2.0 * np.array(_LEVELS_PX)[:, None], axis=0).astype(np.uint8)
"""The number of circles that reach a pixel, by its distance to the nearest edge in half pixels."""
_CUT_OFF = -0.499
_ON_EDGE = len(_LEVELS_PX) + 1
"""When an edge pixel is reached: after all that any circle reaches."""
_FILLINGS = 3
"""The watershed leaves a pixel between regions; what such pixels shut in is a pixel or two wide."""
_ROWS_AT_A_TIME = 32
_NEAR_EDGE = np.ones((3, 3), np.uint8)
_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))


def grow_regions(
    grey: NDArray[np.uint8],
    edges: NDArray[np.bool_],
    parameters: PlaneParameters,
    valid: NDArray[np.bool_] | None = None,
) -> NDArray[np.int32]:
    """Grow regions between edges.

    Args:
        grey: uint8, shape (H, W).
        edges: tracked edges, bool, shape (H, W).
        parameters: bounds of the growing.
        valid: pixels that belong to the image; all where None.

    Returns:
        Labels, int32, shape (H, W), 1 and up; 0 where the image is not valid.
    """
    free = (~edges if valid is None else valid & ~edges).view(np.uint8)
    labels = grow_between_edges(np.asarray(cv2.distanceTransform(free, cv2.DIST_L2, 3), dtype=np.float32))
    if valid is not None:
        labels *= valid
    return join_regions(grey, labels, edges, parameters)


def grow_between_edges(distance_px: NDArray[np.float32]) -> NDArray[np.int32]:
    """Return the regions that grow from their cores until they meet each other.

    Args:
        distance_px: distance to the nearest edge, 0 on it, shape (H, W).

    Returns:
        Labels 1 and up, int32, shape (H, W); 0 everywhere where there are only edges.
    """
    # rounded half a unit lower: cut off
    halves = cv2.convertScaleAbs(distance_px, alpha=2.0, beta=_CUT_OFF)
    reached_by = cv2.LUT(halves, _REACHED_BY)
    # the watershed does not look at the picture's outermost pixels
    level = np.asarray(cv2.copyMakeBorder(reached_by, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=(0,)), dtype=np.uint8)
    labels = np.asarray(cv2.watershed(_in_order(_ON_EDGE - level), _cores(level)), dtype=np.int32)
    label, width = labels.ravel(), labels.shape[1]
    beside = np.array([[-width], [-1], [1], [width]])
    inner = np.flatnonzero(labels[1:-1, 1:-1] <= 0)
    # an inner row is two pixels shorter
    between = inner + 2 * (inner // (width - 2)) + width + 1
    for _ in range(_FILLINGS):
        # what is between several regions is the highest one's
        label[between] = np.maximum(label[between + beside].max(axis=0), 0)
        between = between[label[between] == 0]
    return np.ascontiguousarray(labels[1:-1, 1:-1])


def _cores(level: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Return the labels, 1 and up, of the connected pixels of one level that no pixel of a higher level touches."""
    below = cv2.compare(cv2.dilate(level, _CROSS), level, cv2.CMP_GT)
    # without the pixels that touch a higher level no two levels touch; a plateau that has lost some is no core
    lost = cv2.bitwise_and(level, below)
    tops = cv2.subtract(level, lost)
    count, found = cv2.connectedComponents(tops, connectivity=4)
    label = np.asarray(found, dtype=np.int32)
    beside_lost = cv2.bitwise_and(cv2.compare(cv2.dilate(lost, _CROSS), level, cv2.CMP_EQ), tops)
    is_core = np.ones(count, dtype=np.bool_)
    is_core[0] = False
    is_core[label.ravel()[np.flatnonzero(beside_lost > 0)]] = False
    number = np.cumsum(is_core, dtype=np.int32) * is_core
    # a few rows at a time, for what numpy makes of the labels takes more memory than they do
    for top in range(0, len(label), _ROWS_AT_A_TIME):
        rows = label[top : top + _ROWS_AT_A_TIME]
        np.take(number, rows, out=rows, mode="clip")
    return label


def _in_order(turn: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture in which two neighbours differ by the later turn of the two, uint8, shape (H, W, 3)."""
    odd = turn.copy()
    odd[::2, ::2] = 0
    odd[1::2, 1::2] = 0
    return np.asarray(cv2.merge([odd, turn - odd, odd]), dtype=np.uint8)


def join_regions(
    grey: NDArray[np.uint8], labels: NDArray[np.int32], edges: NDArray[np.bool_], parameters: PlaneParameters
) -> NDArray[np.int32]:
    """Join neighbours whose common border is mostly open, the most open first.

    Args:
        grey: uint8, shape (H, W).
        labels: regions, int32, shape (H, W).
        edges: tracked edges, bool, shape (H, W).
        parameters: how much of a border must be open, and how far the brightness may differ.

    Returns:
        Labels with joined regions under one of their numbers.
    """
    runs = RowRuns.of(labels)
    count = int(runs.label.max()) + 1
    area = np.bincount(runs.label, weights=runs.length, minlength=count)
    total = np.bincount(runs.label, weights=runs.sums(grey), minlength=count)
    borders = _borders(labels, runs, edges)
    parent = list(range(count))
    neighbours: list[dict[int, tuple[int, int]]] = [{} for _ in range(count)]
    queue: list[tuple[float, int, int, int, int]] = []

    def offer(one: int, other: int, length: int, open_length: int) -> None:
        if open_length >= parameters.min_open_share * length:
            heapq.heappush(queue, (-open_length / length, one, other, length, open_length))

    for one, other, length, open_length in borders:
        neighbours[one][other] = neighbours[other][one] = (length, open_length)
        offer(one, other, length, open_length)
    while queue:
        _, one, other, length, open_length = heapq.heappop(queue)
        # an entry is stale once either region was joined or their border has grown
        if neighbours[one].get(other) != (length, open_length) or parent[one] != one or parent[other] != other:
            continue
        difference = abs(total[one] / area[one] - total[other] / area[other])
        small = min(area[one], area[other]) < parameters.min_area_px
        if difference > parameters.max_brightness_step and not small:
            continue
        keep, gone = (one, other) if len(neighbours[one]) >= len(neighbours[other]) else (other, one)
        parent[gone] = keep
        area[keep] += area[gone]
        total[keep] += total[gone]
        for third, (added, added_open) in neighbours[gone].items():
            del neighbours[third][gone]
            if third != keep:
                before, before_open = neighbours[keep].get(third, (0, 0))
                border = (before + added, before_open + added_open)
                neighbours[keep][third] = neighbours[third][keep] = border
                offer(keep, third, *border)
        neighbours[gone] = {}
    return runs.painted(np.array([_root(parent, label) for label in range(count)], dtype=np.int32), labels.shape)


def _root(parent: list[int], label: int) -> int:
    while parent[label] != label:
        label = parent[label]
    return label


def _borders(labels: NDArray[np.int32], runs: RowRuns, edges: NDArray[np.bool_]) -> list[tuple[int, int, int, int]]:
    """Return (region, region, length, length off the edges) of every common border, in pixel sides."""
    near = np.asarray(cv2.dilate(edges.view(np.uint8), _NEAR_EDGE), dtype=np.uint8).ravel()
    flat, width, count = labels.ravel(), labels.shape[1], int(runs.label.max()) + 1
    keys, opens = [], []
    for step, here in ((1, runs.start[runs.first > 0] - 1), (width, np.flatnonzero(flat[width:] != flat[:-width]))):
        one, other = flat[here].astype(np.int64), flat[here + step].astype(np.int64)
        border = (one > 0) & (other > 0)
        keys.append((np.minimum(one, other) * count + np.maximum(one, other))[border])
        opens.append(((near[here] | near[here + step]) == 0)[border])
    pairs, inverse = np.unique(np.concatenate(keys), return_inverse=True)
    length = np.bincount(inverse, minlength=pairs.size)
    open_length = np.bincount(inverse, weights=np.concatenate(opens), minlength=pairs.size).astype(np.int64)
    return list(
        zip((pairs // count).tolist(), (pairs % count).tolist(), length.tolist(), open_length.tolist(), strict=True)
    )
