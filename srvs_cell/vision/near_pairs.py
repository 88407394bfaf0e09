"""Which pairs of two lists of numbers lie near each other, without a look at all pairs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array

    Numbers = NDArray[np.intp]


def near_pairs(values: Array, others: Array, below: Array | float, above: Array | float) -> tuple[Numbers, Numbers]:
    """Return which values and others satisfy value - below <= other <= value + above.

    The sums are rounded: who means a limit to the last digit asks for a little more and looks at the pairs again.

    Args:
        values: shape (N,).
        others: shape (M,).
        below: how much less than the value the other may be; one number, or one for each value.
        above: how much more, likewise.

    Returns:
        Numbers of the values, ascending, and of the others, shape (P,) each.
    """
    order = np.argsort(others, kind="stable")
    ordered = others[order]
    first = np.searchsorted(ordered, values - below, side="left")
    count = np.maximum(np.searchsorted(ordered, values + above, side="right") - first, 0)
    rows = np.repeat(np.arange(len(values)), count)
    place = np.arange(rows.size) - np.repeat(np.cumsum(count) - count, count)
    return rows, order[first[rows] + place]
