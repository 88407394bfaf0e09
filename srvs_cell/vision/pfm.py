"""The portable float map: float32, bottom row first, scale -1 (little-endian)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_DIMENSIONS = 2


def encode_pfm(array: NDArray[Any]) -> bytes:
    """Return an image of shape (H, W) as PFM; NaN stays NaN.

    Raises:
        ValueError: the array has not two dimensions.
    """
    if array.ndim != _DIMENSIONS:
        raise ValueError(f"a PFM of one channel needs shape (H, W), got {array.shape}")
    height, width = array.shape
    header = f"Pf\n{width} {height}\n-1\n".encode("ascii")
    return header + np.ascontiguousarray(array[::-1], dtype="<f4").tobytes()
