"""Rows of a label image as runs of equal labels: what is summed over regions is summed over far fewer runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

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
        width = labels.shape[1]
        begins = np.ones(labels.shape, dtype=np.bool_)
        np.not_equal(labels[:, 1:], labels[:, :-1], out=begins[:, 1:])
        start = np.flatnonzero(begins)
        row, first = np.divmod(start, width)
        length = np.diff(start, append=labels.size)
        return cls(labels.ravel()[start].astype(np.intp), row, first, first + length - 1, start)

    @property
    def length(self) -> NDArray[np.intp]:
        """Number of pixels of each run."""
        return np.asarray(self.last - self.first + 1)
