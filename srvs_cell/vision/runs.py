"""Rows of a label image as runs of equal labels: what is summed over regions is summed over far fewer runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class RowRuns:
    """The runs of a label image in reading order, arrays of shape (runs,).

    Attributes:
        label: of the run's pixels.
        row: the run's row.
        first, last: its first and last column.
        start: the number of its first pixel in the flat image.
    """

    label: NDArray[np.intp]
    row: NDArray[np.intp]
    first: NDArray[np.intp]
    last: NDArray[np.intp]
    start: NDArray[np.intp]

    @classmethod
    def of(cls, labels: NDArray[np.int32]) -> RowRuns:
        """Find the runs of a label image, int32, shape (H, W)."""
        width, flat = labels.shape[1], labels.ravel()
        begins = np.empty(flat.size, dtype=np.bool_)
        np.not_equal(flat[1:], flat[:-1], out=begins[1:])
        begins[::width] = True
        start = np.flatnonzero(begins)
        row = start // width
        first = start - row * width
        length = np.diff(start, append=labels.size)
        return cls(flat[start].astype(np.intp), row, first, first + length - 1, start)

    def sums(self, grey: NDArray[np.uint8]) -> NDArray[np.int32]:
        """Return the sum of the grey values of each run of an image of the same shape, uint8."""
        # of the pixels above and to the left of each; sums beyond 32 bits wrap, and their differences wrap back
        total = np.asarray(cv2.integral(grey), dtype=np.int32)
        in_row = [total[self.row + 1, end] - total[self.row, end] for end in (self.last + 1, self.first)]
        return in_row[0] - in_row[1]

    def painted(self, number: NDArray[np.int32], shape: tuple[int, ...]) -> NDArray[np.int32]:
        """Return the image in which every label has the number that a table, shape (labels,), gives it."""
        return np.repeat(number[self.label], self.length).reshape(shape)

    @property
    def length(self) -> NDArray[np.intp]:
        """Number of pixels of each run."""
        return np.asarray(self.last - self.first + 1)


def runs_of(pixels: NDArray[np.intp], differs: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return where runs begin in a list of pixels.

    Args:
        pixels: numbers in a flat image whose last column holds none of them, so that no run goes on in the next row;
            ascending, shape (N,).
        differs: whether each pixel but the first must not share a run with the one before it, shape (N - 1,).
    """
    begins = np.ones(pixels.size, dtype=np.bool_)
    begins[1:] = (np.diff(pixels) > 1) | differs
    return np.flatnonzero(begins)


def touching_runs(
    first: NDArray[np.intp], last: NDArray[np.intp], width: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the pairs of a run and a run of the next row that touch, if only by a corner.

    Args:
        first: numbers of the runs' first pixels in the flat image, ascending, shape (runs,).
        last: of their last pixels.
        width: of the image, whose last column no run reaches.
    """
    low = np.searchsorted(last, first + (width - 1))
    count = np.searchsorted(first, last + (width + 1), side="right") - low
    above = np.repeat(np.arange(first.size), count)
    number_in_run = np.arange(above.size) - np.repeat(np.cumsum(count) - count, count)
    return above, np.repeat(low, count) + number_in_run


def joined(root: NDArray[np.intp], one: NDArray[np.intp], other: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the groups of things after more of them were connected (Shiloach and Vishkin 1982).

    Args:
        root: for each thing the lowest of its group, shape (things,).
        one: a thing of each connected pair, shape (pairs,).
        other: the other thing.
    """
    one, other = root[one], root[other]
    while True:
        apart = one != other
        one, other = one[apart], other[apart]
        if not one.size:
            return root
        root = root.copy()
        np.minimum.at(root, np.maximum(one, other), np.minimum(one, other))
        above = root[root]
        while not np.array_equal(above, root):
            root, above = above, above[above]
        one, other = root[one], root[other]
