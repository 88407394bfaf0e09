"""Step 5: tracking. Thin edges are followed to their ends; short ones are dropped, open ends are prolonged.

A region that shall be closed must have a closed border. An edge that fades ends in an open end; from there the
tracker goes on in the edge's direction and, where it meets another edge within the greatest gap, draws the missing
piece.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.vision.parameters import TrackingParameters

_DIRECTION_STEPS = 6
"""An open end's direction is taken from so many pixels of its edge."""
_FIRST_STEP = 2
"""The first pixel ahead of an end is free by definition; the meeting begins at the second."""
_NEIGHBOURS = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], dtype=np.float32)
_OFFSETS = np.array([[-1, 0], [0, 1], [1, 0], [0, -1], [-1, -1], [-1, 1], [1, 1], [1, -1]])


def track_edges(thinned: NDArray[np.bool_], parameters: TrackingParameters) -> NDArray[np.bool_]:
    """Return the tracked edges of a thinned edge image, bool, shape (H, W)."""
    edges = drop_short_chains(thinned, parameters.min_chain_px)
    if parameters.max_gap_px == 0:
        return edges
    ends, directions = open_ends(edges)
    return prolong(edges, ends, directions, parameters.max_gap_px)


def drop_short_chains(thinned: NDArray[np.bool_], min_chain_px: int) -> NDArray[np.bool_]:
    """Return the edges without connected chains of fewer pixels than ``min_chain_px``."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(thinned.astype(np.uint8), connectivity=8)
    long_enough = np.asarray(stats[:, cv2.CC_STAT_AREA] >= min_chain_px)
    long_enough[0] = False
    return np.asarray(long_enough[labels])


def open_ends(edges: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Follow every edge back from its open ends.

    Returns:
        Ends as (row, column), shape (N, 2), and the unit direction in which each would go on, shape (N, 2).
    """
    image = edges.astype(np.uint8)
    around = cv2.filter2D(image, cv2.CV_8U, _NEIGHBOURS, borderType=cv2.BORDER_CONSTANT)
    ends = np.argwhere(edges & (around == 1))
    framed = np.pad(edges, 1)
    here = ends + 1
    visited = [here]
    for _ in range(_DIRECTION_STEPS):
        following = here
        found = np.zeros(len(ends), dtype=np.bool_)
        for offset in _OFFSETS:
            candidate = here + offset
            inside = (candidate >= 0).all(axis=1) & (candidate < framed.shape).all(axis=1)
            candidate = np.where(inside[:, None], candidate, here)
            free = ~found & framed[candidate[:, 0], candidate[:, 1]]
            for earlier in visited:
                free &= (candidate != earlier).any(axis=1)
            following = np.where(free[:, None], candidate, following)
            found |= free
        here = following
        visited.append(here)
    direction = (ends + 1 - here).astype(np.float64)
    length = np.linalg.norm(direction, axis=1)
    # a chain of one pixel has no direction
    directed = length > 0.0
    return ends[directed], direction[directed] / length[directed, None]


def prolong(
    edges: NDArray[np.bool_], ends: NDArray[np.intp], directions: NDArray[np.float64], max_gap_px: int
) -> NDArray[np.bool_]:
    """Return the edges with each open end prolonged to the first edge, or image border, within ``max_gap_px``."""
    result = edges.copy()
    if not len(ends):
        return result
    steps = np.arange(1, max_gap_px + 2)
    path = np.rint(ends[:, None, :] + steps[None, :, None] * directions[:, None, :]).astype(np.intp)
    height, width = edges.shape
    outside = (path < 0).any(axis=2) | (path[..., 0] >= height) | (path[..., 1] >= width)
    rows, columns = np.clip(path[..., 0], 0, height - 1), np.clip(path[..., 1], 0, width - 1)
    # a diagonal step may pass between two pixels of an edge, so that an edge beside the path is met too
    thick = cv2.dilate(edges.astype(np.uint8), np.ones((2, 2), np.uint8)) > 0
    met = thick[rows, columns] | outside
    met[:, : _FIRST_STEP - 1] = False
    meets = met.any(axis=1)
    drawn = meets[:, None] & (steps[None, :] <= (np.argmax(met, axis=1) + 1)[:, None])
    result[rows[drawn], columns[drawn]] = True
    return result
