"""Superpixels: the image cut into small pieces whose borders follow the grey values' steps.

A watershed from a grid of seeds, each moved to the flattest place near it. A piece lies on one surface, but for what
no grey value tells; choosing surfaces for pieces instead of pixels is a hundred times less work, and the choice ends
where the picture has an edge.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.sparse import coo_array

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array

_SQUARE = np.ones((3, 3), np.uint8)
_SEED_RADIUS = 3
"""A seed is moved by at most a cell's side over this."""
_FILLINGS = 3
"""Lines between pieces are a pixel wide, two where they meet the image's border."""
_LEAST_STEP = 0.05
"""Of the weight between two pixels, what stays across the sharpest step."""


@dataclass(frozen=True, eq=False)
class Superpixels:
    """The pieces of an image and which of them touch.

    Attributes:
        labels: the piece of each pixel, 0 and up, shape (H, W).
        count: number of pieces.
        one, other: pieces that touch, shape (E,) each, every pair once.
        weight: of their common border: its length in pixels, less where the grey values step, shape (E,).
    """

    labels: NDArray[np.int32]
    count: int
    one: NDArray[np.intp]
    other: NDArray[np.intp]
    weight: Array


def cut_superpixels(grey: NDArray[np.uint8], cell_px: int, contrast_grey: float) -> Superpixels:
    """Cut an image into superpixels.

    Args:
        grey: uint8, shape (H, W).
        cell_px: side of the grid of seeds.
        contrast_grey: step of grey values that lowers a border's weight to 1/e.
    """
    labels = _watershed(grey, _seeds(grey, cell_px))
    count = int(labels.max()) + 1
    values = grey.astype(np.int16)
    fade = np.exp(-np.arange(256) / contrast_grey) + _LEAST_STEP
    first, second, weights = [], [], []
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        apart = labels[a] != labels[b]
        first.append(labels[a][apart])
        second.append(labels[b][apart])
        weights.append(fade[np.abs(values[a][apart] - values[b][apart])])
    i, j = np.concatenate(first), np.concatenate(second)
    summed = (
        coo_array((np.concatenate(weights), (np.minimum(i, j), np.maximum(i, j))), shape=(count, count)).tocsr().tocoo()
    )  # the rows' sums of what occurs more than once
    return Superpixels(
        labels, count, summed.coords[0].astype(np.intp), summed.coords[1].astype(np.intp), np.asarray(summed.data)
    )


def _seeds(grey: NDArray[np.uint8], cell_px: int) -> NDArray[np.int32]:
    """Return an image with one numbered pixel a cell, at the flattest place near the cell's middle."""
    height, width = grey.shape
    radius = cell_px // _SEED_RADIUS
    slope = cv2.blur(cv2.morphologyEx(grey, cv2.MORPH_GRADIENT, _SQUARE), (3, 3))
    rows = np.arange(cell_px // 2, height, cell_px)
    columns = np.arange(cell_px // 2, width, cell_px)
    dy, dx = (offset.ravel() for offset in np.mgrid[-radius : radius + 1, -radius : radius + 1])
    # the outermost pixels are no seeds: the watershed overwrites them
    y = np.clip(rows[:, None, None] + dy, 1, height - 2)
    x = np.clip(columns[None, :, None] + dx, 1, width - 2)
    flattest = np.argmin(slope[y, x], axis=2)[..., None]
    y, x = np.broadcast_arrays(y, x)
    y, x = np.take_along_axis(y, flattest, axis=2)[..., 0], np.take_along_axis(x, flattest, axis=2)[..., 0]
    seeds = np.zeros(grey.shape, dtype=np.int32)
    seeds[y, x] = np.arange(1, y.size + 1).reshape(y.shape)
    return seeds


def _watershed(grey: NDArray[np.uint8], seeds: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the pieces, 0 and up; a line's pixel belongs to the neighbour whose grey value is nearest."""
    labels = np.asarray(cv2.watershed(cv2.merge([grey, grey, grey]), seeds), dtype=np.int32)
    framed = cv2.copyMakeBorder(labels, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=(0,)).astype(np.int32)
    values = cv2.copyMakeBorder(grey, 1, 1, 1, 1, cv2.BORDER_REPLICATE).astype(np.int16).ravel()
    flat = framed.ravel()
    width = framed.shape[1]
    lines = np.zeros(framed.shape, dtype=np.bool_)
    lines[1:-1, 1:-1] = framed[1:-1, 1:-1] <= 0
    at = np.flatnonzero(lines)
    for _ in range(_FILLINGS):
        around = at[:, None] + np.array([-1, 1, -width, width])
        near = flat[around]
        difference = np.where(near > 0, np.abs(values[around] - values[at][:, None]), np.iinfo(np.int16).max)
        chosen = near[np.arange(at.size), np.argmin(difference, axis=1)]
        flat[at] = chosen
        at = at[chosen <= 0]
    return np.asarray(np.maximum(framed[1:-1, 1:-1], 1) - 1, dtype=np.int32)
