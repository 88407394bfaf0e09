"""The median of a few or many numbers, without what `numpy.median` does for axes and NaN."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def median(values: NDArray[np.floating[Any]]) -> float:
    """Return the middle value of an array of any shape; of an even number the upper one of the two."""
    middle = values.size // 2
    return float(np.partition(values, middle, axis=None)[middle])
