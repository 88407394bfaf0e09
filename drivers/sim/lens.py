"""The exact lens: Brown-Conrady distortion as OpenCV defines it, forwards and inverted by Newton's method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from srvs_cell.geometry import Array

_NEWTON_STEPS: Final = 5


@dataclass(frozen=True, kw_only=True)
class Lens:
    """Intrinsics of a camera; pixel (0, 0) is the centre of the top left pixel.

    Attributes:
        width, height: image size in pixels.
        fx, fy, cx, cy: focal lengths and principal point in pixels.
        distortion: k1, k2, p1, p2, k3.
    """

    width: int = 640
    height: int = 480
    fx: float = 820.0
    fy: float = 820.0
    cx: float = 319.5
    cy: float = 239.5
    distortion: tuple[float, float, float, float, float] = (-0.055, 0.012, 0.0004, -0.0003, 0.0)

    def project(self, points: Array) -> Array:
        """Return pixels (..., 2) of points (..., 3) in the camera frame (x right, y down, z forward)."""
        ideal = points[..., :2] / points[..., 2:]
        return np.asarray(self._distort(ideal)[0] * (self.fx, self.fy) + (self.cx, self.cy))

    def rays(self, pixels: Array) -> tuple[Array, Array]:
        """Return where rays through pixels (..., 2) cross the plane z = 1.

        Returns:
            The points (..., 2) and their derivatives by the pixel, (..., 2, 2).
        """
        distorted = (np.asarray(pixels, dtype=np.float64) - (self.cx, self.cy)) / (self.fx, self.fy)
        ideal = distorted.copy()
        for _ in range(_NEWTON_STEPS):
            value, slope = self._distort(ideal)
            ideal -= np.einsum("...ij,...j->...i", _inverse(slope), value - distorted)
        return ideal, _inverse(self._distort(ideal)[1]) / np.array([self.fx, self.fy])

    def _distort(self, ideal: Array) -> tuple[Array, Array]:
        """Return distorted points (..., 2) and the derivative by the ideal ones (..., 2, 2)."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = ideal[..., 0], ideal[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        d_radial = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)
        value = np.stack(
            [
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            ],
            axis=-1,
        )
        mixed = 2.0 * x * y * d_radial + 2.0 * p1 * x + 2.0 * p2 * y
        slope = np.stack(
            [
                np.stack([radial + 2.0 * x * x * d_radial + 2.0 * p1 * y + 6.0 * p2 * x, mixed], axis=-1),
                np.stack([mixed, radial + 2.0 * y * y * d_radial + 6.0 * p1 * y + 2.0 * p2 * x], axis=-1),
            ],
            axis=-2,
        )
        return value, slope


def _inverse(matrix: Array) -> Array:
    """Return the inverses of 2x2 matrices, shape (..., 2, 2)."""
    a, b, c, d = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 0], matrix[..., 1, 1]
    adjugate = np.stack([np.stack([d, -b], axis=-1), np.stack([-c, a], axis=-1)], axis=-2)
    return np.asarray(adjugate / (a * d - b * c)[..., None, None])
