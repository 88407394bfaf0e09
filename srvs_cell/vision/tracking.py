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
    _, labels = cv2.connectedComponents(thinned.view(np.uint8), connectivity=8)
    pixels = np.flatnonzero(thinned)
    chain = np.asarray(labels).ravel()[pixels]
    kept = thinned.copy()
    kept.ravel()[pixels] = (np.bincount(chain) >= min_chain_px)[chain]
    return kept


def open_ends(edges: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Follow every edge back from its open ends.

    Returns:
        Ends as (row, column), shape (N, 2), and the unit direction in which each would go on, shape (N, 2).
    """
    # a frame of one pixel makes every neighbour's index valid
    framed = cv2.copyMakeBorder(edges.view(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=(0,))
    width, edge = framed.shape[1], np.asarray(framed, dtype=np.uint8).view(np.bool_).ravel()
    beside = (_OFFSETS @ (width, 1))[:, None]
    pixels = np.flatnonzero(edge)
    ends = pixels[np.count_nonzero(edge[pixels + beside], axis=0) == 1]
    number = np.arange(ends.size)
    here = ends
    visited = [here]
    for _ in range(_DIRECTION_STEPS):
        around = here + beside
        free = edge[around]
        for earlier in visited:
            free &= around != earlier
        here = np.where(free.any(axis=0), around[np.argmax(free, axis=0), number], here)
        visited.append(here)
    place, back = (np.column_stack(np.divmod(each, width)) - 1 for each in (ends, here))
    direction = (place - back).astype(np.float64)
    length = np.linalg.norm(direction, axis=1)
    # a chain of one pixel has no direction
    directed = length > 0.0
    return place[directed], direction[directed] / length[directed, None]


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
    thick = np.asarray(cv2.dilate(edges.view(np.uint8), np.ones((2, 2), np.uint8)), dtype=np.uint8).view(np.bool_)
    met = thick[rows, columns] | outside
    met[:, : _FIRST_STEP - 1] = False
    meets = met.any(axis=1)
    drawn = meets[:, None] & (steps[None, :] <= (np.argmax(met, axis=1) + 1)[:, None])
    result[rows[drawn], columns[drawn]] = True
    return result
