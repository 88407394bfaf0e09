"""Step 6: region growing between the tracked edges.

Growing begins where the edges are far: the core of a region is what a circle that fits between the edges can reach,
large circles first. All cores then grow at once, the far places before the near ones and the edge pixels last, so that
two cores meet at the neck between them: in the gap of an edge, or in the middle of a face that has a waist. Which of
the two it is, the border tells: regions are joined where most of their common border lies on no edge and their
brightness is alike. A gap therefore does not let one plane leak into another.
"""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.vision.parameters import PlaneParameters

_LEVELS_PX = (24.0, 16.0, 11.0, 8.0, 5.0, 3.0, 2.0, 1.0, 0.5)
"""The circle's radii; the last level gives every closed region a core, however narrow."""
_MAX_LABEL = 65535
_MEETING_STEPS = 40
_NONE = np.zeros(1)
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
    distance = cv2.distanceTransform((usable & ~edges).astype(np.uint8), cv2.DIST_L2, 3)
    labels = grow_between_edges(np.asarray(distance, dtype=np.float32))
    labels = _grow(labels, usable, _EDGE_STEPS)
    return join_regions(grey, labels.astype(np.int32), edges, parameters)


def grow_between_edges(distance_px: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Return the regions that grow from their cores until they meet each other or an edge.

    Args:
        distance_px: distance to the nearest edge, 0 on it, shape (H, W).

    Returns:
        Labels 1 and up, uint16, shape (H, W), 0 on edges. Regions beyond the 65535th are left out.
    """
    labels = np.zeros(distance_px.shape, dtype=np.uint16)
    # one pixel of every region: growth keeps a region connected, so that it lies in one component of what is in reach
    seeds = np.zeros(0, dtype=np.intp)
    for radius_px in _LEVELS_PX:
        reach = distance_px >= radius_px
        count, found = cv2.connectedComponents(reach.view(np.uint8), connectivity=4)
        components = np.asarray(found).ravel()
        held_by = components[seeds]
        held = np.bincount(held_by, minlength=count)
        # a component is a new region, or the rest of the one region that it holds, or is shared by several
        label = np.zeros(count, dtype=np.uint16)
        label[held_by] = np.arange(1, seeds.size + 1)
        label[held > 1] = 0
        fresh = np.flatnonzero(held == 0)
        fresh = fresh[fresh > 0][: _MAX_LABEL - seeds.size]
        label[fresh] = np.arange(seeds.size + 1, seeds.size + 1 + fresh.size)
        free = np.flatnonzero(reach & (labels == 0))
        owner = components[free]
        labels.ravel()[free] = label[owner]
        some_pixel = np.zeros(count, dtype=np.intp)
        some_pixel[owner] = free
        seeds = np.concatenate([seeds, some_pixel[fresh]])
        labels = _grow(labels, reach, _MEETING_STEPS)
    return labels


def _grow(labels: NDArray[np.uint16], reach: NDArray[np.bool_], steps: int) -> NDArray[np.uint16]:
    """Return the labels after growth by so many pixels into what is in reach and has none.

    A pixel with neighbours of several labels takes the highest. Only the front is looked at: a pixel can be reached
    only from one that was reached in the step before.
    """
    width = labels.shape[1] + 2
    grown = np.pad(labels, 1)
    wanted = np.pad(reach & (labels == 0), 1)
    part, missing = grown.ravel(), wanted.ravel()
    beside = np.array([[-width], [-1], [1], [width]])
    writer = np.empty(part.size, dtype=np.intp)
    pixels = np.flatnonzero(missing)
    front = pixels[part[pixels + beside].any(axis=0)]
    for _ in range(steps):
        if not front.size:
            break
        around = front + beside
        part[front] = part[around].max(axis=0)
        missing[front] = False
        following = around.ravel()
        following = following[missing[following]]
        # a pixel beside several of the front is met several times: the one that wrote its number last stays
        writer[following] = np.arange(following.size)
        front = following[writer[following] == np.arange(following.size)]
    return np.ascontiguousarray(grown[1:-1, 1:-1])


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
    area = np.bincount(labels.ravel(), minlength=count).astype(np.float64)
    total = np.bincount(labels.ravel(), weights=grey.ravel(), minlength=count)
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
    return np.array([_root(parent, label) for label in range(count)], dtype=np.int32)[labels]


def _root(parent: list[int], label: int) -> int:
    while parent[label] != label:
        label = parent[label]
    return label


def _borders(labels: NDArray[np.int32], edges: NDArray[np.bool_], count: int) -> list[tuple[int, int, int, int]]:
    """Return (region, region, length, length off the edges) of every common border, in pixel sides."""
    near = cv2.dilate(edges.astype(np.uint8), _NEAR_EDGE) > 0
    keys, opens = [], []
    for here, there, near_here, near_there in (
        (labels[:, :-1], labels[:, 1:], near[:, :-1], near[:, 1:]),
        (labels[:-1], labels[1:], near[:-1], near[1:]),
    ):
        border = (here != there) & (here > 0) & (there > 0)
        one, other = here[border].astype(np.int64), there[border].astype(np.int64)
        keys.append(np.minimum(one, other) * count + np.maximum(one, other))
        opens.append(~(near_here[border] | near_there[border]))
    pairs, inverse = np.unique(np.concatenate(keys), return_inverse=True)
    length = np.bincount(inverse, minlength=pairs.size)
    open_length = np.bincount(inverse, weights=np.concatenate(opens), minlength=pairs.size).astype(np.int64)
    return list(
        zip((pairs // count).tolist(), (pairs % count).tolist(), length.tolist(), open_length.tolist(), strict=True)
    )
