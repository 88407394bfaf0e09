"""Step 6: region growing between the tracked edges.

Growing begins where the edges are far: the core of a region is what a circle that fits between the edges can reach,
large circles first. All cores then grow at once, the far places before the near ones and the edge pixels last, so that
two cores meet at the neck between them: in the gap of an edge, or in the middle of a face that has a waist. Which of
the two it is, the border tells: regions are joined where most of their common border lies on no edge and their
brightness is alike. A gap therefore does not let one plane leak into another.

Pixels that the same circles reach form runs along the rows. What is connected, and so belongs to one core, is found
among the runs; single pixels are looked at only where cores meet.
"""

from __future__ import annotations

import heapq
import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.runs import RowRuns, joined

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.vision.parameters import PlaneParameters

_LEVELS_PX = (24.0, 16.0, 11.0, 8.0, 5.0, 3.0, 2.0, 1.0, 0.5)
"""The circle's radii; the last level gives every closed region a core, however narrow."""
_REACHED_BY = np.sum(np.arange(256) >= 2.0 * np.array(_LEVELS_PX)[:, None], axis=0).astype(np.uint8)
"""The number of circles that reach a pixel, by its distance to the nearest edge in half pixels."""
_CUT_OFF = -0.499
_OPEN, _WAITING = -1, -2
"""Instead of a label: a pixel that may get one, and, from here down, one that gets it in the next step."""
_MEETING_STEPS = 40
_EDGE_STEPS = 3
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
    usable = np.ones(grey.shape, dtype=np.bool_) if valid is None else valid
    free = (usable & ~edges).view(np.uint8)
    labels = grow_between_edges(np.asarray(cv2.distanceTransform(free, cv2.DIST_L2, 3), dtype=np.float32))
    _grow(labels, np.flatnonzero(_framed(usable.view(np.uint8)) & (labels == 0)), _EDGE_STEPS)
    return join_regions(grey, np.ascontiguousarray(labels[1:-1, 1:-1]), edges, parameters)


def grow_between_edges(distance_px: NDArray[np.float32]) -> NDArray[np.int32]:
    """Return the regions that grow from their cores until they meet each other or an edge.

    Args:
        distance_px: distance to the nearest edge, 0 on it, shape (H, W).

    Returns:
        Labels 1 and up, int32, in a frame of one pixel, shape (H + 2, W + 2); 0 on edges and frame.
    """
    runs = _LevelRuns.of(distance_px)
    label_of_run = _cores(runs)
    labels = runs.painted(label_of_run)
    order, counts = _highest_first(np.where(label_of_run == 0, runs.level, 0))
    shared = order[: counts[-1]]
    pixels = runs.pixels(shared)
    bounds = np.concatenate([[0], np.cumsum(runs.length[shared])])[counts]
    left = np.zeros(0, dtype=np.intp)
    for first, last in itertools.pairwise(bounds.tolist()):
        left = _grow(labels, np.concatenate([left, pixels[first:last]]), _MEETING_STEPS)
    return labels


def _framed(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.copyMakeBorder(image, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=(0,)), dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class _LevelRuns:
    """Runs of pixels off the edges that the same circles reach, in the flat image with a frame of one pixel.

    Attributes:
        shape: of the framed image.
        level: how many of the circles reach each run, shape (runs,).
        begin: the run's first pixel.
        length: of the run.
        one, other: numbers of the runs of each pair of neighbours, shape (pairs,).
    """

    shape: tuple[int, int]
    level: NDArray[np.uint8]
    begin: NDArray[np.intp]
    length: NDArray[np.intp]
    one: NDArray[np.intp]
    other: NDArray[np.intp]

    @classmethod
    def of(cls, distance_px: NDArray[np.float32]) -> _LevelRuns:
        """Find the runs and their 4-neighbours."""
        # rounded half a unit lower: cut off
        halves = cv2.convertScaleAbs(distance_px, alpha=2.0, beta=_CUT_OFF)
        framed = _framed(np.asarray(cv2.LUT(halves, _REACHED_BY), dtype=np.uint8))
        flat, width = framed.ravel(), framed.shape[1]
        begin = np.append(0, np.flatnonzero(flat[1:] != flat[:-1]) + 1)
        length = np.diff(begin, append=flat.size)
        level = flat[begin]
        run = np.flatnonzero(level)
        # where two runs of neighbouring rows meet, one of them begins
        of_pixel = np.repeat(np.arange(begin.size, dtype=np.int32), length)
        one = np.concatenate([run, run, run])
        other = np.concatenate([run - 1, of_pixel[begin[run] - width], of_pixel[begin[run] + width]])
        return cls((framed.shape[0], width), level, begin, length, one, other)

    def painted(self, label: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return the framed image with each run's label on its pixels."""
        return np.repeat(label, self.length).reshape(self.shape)

    def pixels(self, runs: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the numbers of the pixels of some runs in the flat framed image."""
        length = self.length[runs]
        return np.asarray(np.arange(length.sum()) + np.repeat(self.begin[runs] - np.cumsum(length) + length, length))


def _cores(runs: _LevelRuns) -> NDArray[np.int32]:
    """Return the label of each run that belongs to one region alone, 0 for those that several regions share."""
    # high levels first: what a circle reaches is at the front of the list, what was reached before too
    order, reached = _highest_first(runs.level)
    rank = np.empty(order.size, dtype=np.intp)
    rank[order] = np.arange(order.size)
    pairs, paired = _highest_first(np.minimum(runs.level[runs.one], runs.level[runs.other]))
    one, other = rank[runs.one[pairs]], rank[runs.other[pairs]]
    label_of_run = np.zeros(order.size, dtype=np.int32)
    group = np.zeros(order.size, dtype=np.intp)
    group_of_region = np.zeros(0, dtype=np.intp)
    groups = 0
    for before, now, first, last in zip(reached, reached[1:], paired, paired[1:], strict=False):
        group[before:now] = np.arange(groups, groups + now - before)
        root = joined(np.arange(groups + now - before), group[one[first:last]], group[other[first:last]])
        lowest = root == np.arange(root.size)
        renumbered = (np.cumsum(lowest) - 1)[root]
        group[:now] = renumbered[group[:now]]
        group_of_region = renumbered[group_of_region]
        is_new = np.flatnonzero(lowest) >= groups
        groups = is_new.size
        # a group of runs is a new region, or the rest of the one region that it holds, or is shared by several
        held = np.bincount(group_of_region, minlength=groups)
        fresh = np.flatnonzero(is_new & (held == 0))
        group_of_region = np.concatenate([group_of_region, fresh])
        label = np.zeros(groups, dtype=np.int32)
        label[group_of_region] = np.arange(1, group_of_region.size + 1)
        label[held > 1] = 0
        label_of_run[order[before:now]] = label[group[before:now]]
    return label_of_run


def _highest_first(level: NDArray[np.uint8]) -> tuple[NDArray[np.intp], list[int]]:
    """Return an order of falling level, and how many are of more than each level, from the highest down to 0."""
    counts = np.bincount(level, minlength=len(_LEVELS_PX) + 1)
    return np.argsort(len(_LEVELS_PX) - level, kind="stable"), [0, *np.cumsum(counts[:0:-1]).tolist()]


def _grow(labels: NDArray[np.int32], pixels: NDArray[np.intp], steps: int) -> NDArray[np.intp]:
    """Grow the labels by so many pixels into those that have none, in place.

    A pixel with neighbours of several labels takes the highest. Only the front is looked at: a pixel can be reached
    only from one that was reached in the step before.

    Args:
        labels: in a frame of one pixel.
        pixels: numbers in the flat image of the pixels to grow into, shape (N,).
        steps: how far.

    Returns:
        The pixels that were not reached.
    """
    if not pixels.size:
        return pixels
    label, width = labels.ravel(), labels.shape[1]
    beside = np.array([[-width], [-1], [1], [width]])
    front = pixels[(label.take(pixels + beside) > 0).any(axis=0)]
    if not front.size:
        return pixels
    label[pixels] = _OPEN
    label[front] = _WAITING
    for _ in range(steps):
        around = front + beside
        met = label.take(around)
        label[front] = met.max(axis=0)
        following = around[met == _OPEN]
        if not following.size:
            break
        # a pixel beside several of the front is met several times: the one that wrote its number last stays
        number = np.arange(_WAITING, _WAITING - following.size, -1, dtype=np.int32)
        label[following] = number
        front = following[label.take(following) == number]
    missed = pixels[label.take(pixels) < 0]
    label[missed] = 0
    return np.asarray(missed)


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
    count = int(labels.max()) + 1
    runs = RowRuns.of(labels)
    area = np.bincount(runs.label, weights=runs.length, minlength=count)
    total = np.bincount(runs.label, weights=runs.sums(grey), minlength=count)
    borders = _borders(labels, edges, count)
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


def _borders(labels: NDArray[np.int32], edges: NDArray[np.bool_], count: int) -> list[tuple[int, int, int, int]]:
    """Return (region, region, length, length off the edges) of every common border, in pixel sides."""
    near = np.asarray(cv2.dilate(edges.view(np.uint8), _NEAR_EDGE)).ravel()
    flat, width = labels.ravel(), labels.shape[1]
    keys, opens = [], []
    for step, differs in ((1, labels[:, 1:] != labels[:, :-1]), (width, labels[1:] != labels[:-1])):
        row, column = np.divmod(np.flatnonzero(differs), differs.shape[1])
        here = row * width + column
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
