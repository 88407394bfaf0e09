"""Step 2: edge extraction by line-support regions (Burns, Hanson, Riseman, PAMI 8(4), 1986).

Pixels with a strong gradient are labelled by the gradient's direction in two overlapping partitions of 45 degrees, the
second turned by 22.5 degrees, so that a line whose direction falls on the border of one lies within the other.
Connected pixels of one label are a line-support region. Each pixel votes for the longer of its two regions; a region's
support is the share of its pixels that vote for it, and regions with enough support and length are kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.vision.parameters import EdgeParameters

_PARTITION_DEG = 45.0
_FORWARD_NEIGHBOURS = ((0, 1), (1, -1), (1, 0), (1, 1))
_CENTRE_OFFSET_PX = 0.5
"""A 2x2 mask measures between the pixels."""


@dataclass(frozen=True, eq=False)
class EdgeImage:
    """Line-support regions of one image.

    Attributes:
        mask: bool, shape (H, W): pixels of the regions that were kept.
        gradient: float32, shape (H, W, 2): grey values per pixel along x and y, at (x + 0.5, y + 0.5).
        threshold: least gradient of a strong pixel, grey values per pixel.
    """

    mask: NDArray[np.bool_]
    gradient: NDArray[np.float32]
    threshold: float


def extract_edges(grey: NDArray[np.uint8], parameters: EdgeParameters) -> EdgeImage:
    """Find the line-support regions of a grey image, uint8, shape (H, W)."""
    gradient = gradient_2x2(smooth(grey, parameters.smoothing_px))
    magnitude = np.hypot(gradient[..., 0], gradient[..., 1])
    threshold = strong_gradient(magnitude, parameters)
    rows, columns = np.nonzero(magnitude > threshold)
    mask = np.zeros(grey.shape, dtype=np.bool_)
    if rows.size:
        direction_deg = np.rad2deg(np.arctan2(gradient[rows, columns, 1], gradient[rows, columns, 0])) % 360.0
        strength = np.asarray(magnitude[rows, columns] / threshold, dtype=np.float32)
        kept = supported(rows, columns, direction_deg, strength, grey.shape, parameters)
        mask[rows[kept], columns[kept]] = True
    return EdgeImage(mask, gradient, threshold)


def smooth(grey: NDArray[np.uint8], sigma_px: float) -> NDArray[np.float32]:
    """Return the image after a Gaussian, float32."""
    image = grey.astype(np.float32)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), dtype=np.float32) if sigma_px > 0.0 else image


def gradient_2x2(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the gradient by Burns' 2x2 masks, (H, W, 2), at (x + 0.5, y + 0.5); 0 in the last row and column."""
    gradient = np.zeros((*image.shape, 2), dtype=np.float32)
    a, b, c, d = image[:-1, :-1], image[:-1, 1:], image[1:, :-1], image[1:, 1:]
    gradient[:-1, :-1, 0] = (b + d - a - c) * _CENTRE_OFFSET_PX
    gradient[:-1, :-1, 1] = (c + d - a - b) * _CENTRE_OFFSET_PX
    return gradient


def strong_gradient(magnitude: NDArray[np.float32], parameters: EdgeParameters) -> float:
    """Return the least gradient of a strong pixel: above the image's own noise and texture, within the limits."""
    noise = parameters.noise_factor * float(np.median(magnitude)) if magnitude.size else 0.0
    highest = max(parameters.min_gradient, parameters.max_gradient)
    return float(np.clip(noise, parameters.min_gradient, highest))


def supported(
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    direction_deg: NDArray[np.float32],
    strength: NDArray[np.float32],
    shape: tuple[int, ...],
    parameters: EdgeParameters,
) -> NDArray[np.bool_]:
    """Return which strong pixels belong to a kept line-support region.

    Args:
        rows: of the strong pixels, shape (N,).
        columns: of the strong pixels, shape (N,).
        direction_deg: gradient direction of each, 0 to 360.
        strength: gradient of each over that of the weakest strong pixel. The least length is that of the weakest
            edge; a stronger one, as at the corner of a face, may be shorter in proportion.
        shape: of the image.
        parameters: support and length limits.
    """
    pairs = _neighbour_pairs(rows, columns, shape)
    regions, lengths = [], []
    for turn_deg in (0.0, _PARTITION_DEG / 2.0):
        bins = ((direction_deg + turn_deg) // _PARTITION_DEG).astype(np.int32) % int(360.0 / _PARTITION_DEG)
        same = bins[pairs[0]] == bins[pairs[1]]
        labels = _components(pairs[0][same], pairs[1][same], rows.size)
        regions.append(labels)
        lengths.append(_lengths(labels, rows, columns))
    votes_first = lengths[0][regions[0]] >= lengths[1][regions[1]]
    kept = np.zeros(rows.size, dtype=np.bool_)
    for labels, length, votes in ((regions[0], lengths[0], votes_first), (regions[1], lengths[1], ~votes_first)):
        pixels = np.bincount(labels)
        support = np.bincount(labels, weights=votes) / pixels
        evidence = length * np.bincount(labels, weights=strength) / pixels
        kept |= ((support >= parameters.min_support) & (evidence >= parameters.min_length_px))[labels]
    return kept


def _neighbour_pairs(
    rows: NDArray[np.intp], columns: NDArray[np.intp], shape: tuple[int, ...]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the numbers of strong pixels that are 8-neighbours of each other."""
    # a frame of one pixel makes every neighbour's index valid
    index = np.full((shape[0] + 2, shape[1] + 2), -1, dtype=np.int32)
    index[rows + 1, columns + 1] = np.arange(rows.size, dtype=np.int32)
    first, second = [], []
    for d_row, d_column in _FORWARD_NEIGHBOURS:
        neighbour = index[rows + 1 + d_row, columns + 1 + d_column]
        present = np.flatnonzero(neighbour >= 0)
        first.append(present.astype(np.int32))
        second.append(neighbour[present])
    return np.concatenate(first), np.concatenate(second)


def _components(first: NDArray[np.int32], second: NDArray[np.int32], count: int) -> NDArray[np.int32]:
    graph = coo_array((np.ones(first.size, dtype=np.int8), (first, second)), shape=(count, count))
    _, labels = connected_components(graph.tocsr(), directed=False)
    return np.asarray(labels, dtype=np.int32)


def _lengths(labels: NDArray[np.int32], rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the diagonal of each region's bounding box, pixels."""
    count = int(labels.max()) + 1
    extents = []
    for position in (rows, columns):
        low = np.full(count, np.iinfo(np.int64).max)
        high = np.full(count, -1)
        np.minimum.at(low, labels, position)
        np.maximum.at(high, labels, position)
        extents.append(high - low + 1)
    return np.asarray(np.hypot(extents[0], extents[1]), dtype=np.float64)
