"""What surfaces look like close by: a cloudy table, grain on parts, printed labels. Functions of position only."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array

_TEXEL_MM: Final = 0.5
_SIDE_TEXELS: Final = 1024
"""A power of two."""

_PAD: Final = 2
_FACTOR_RANGE: Final = (0.3, 1.7)
_LABEL_SHARE: Final = 0.62
_BAR_COUNT: Final = 17
_FRAME: Final = (0.95, 0.93)
_BARS: Final = (-0.75, 0.05)
_FIRST_LINE, _LINE_STEP, _HALF_LINE = 0.25, 0.22, 0.06
_MARGIN: Final = 0.85


class SurfaceGrain:
    """Relative variation of reflectance over a surface, periodic, baked once: a look-up has no arithmetic.

    Args:
        random: of the noise.
        octaves: (period in millimetres, relative standard deviation) of each layer.
    """

    def __init__(self, random: np.random.Generator, octaves: tuple[tuple[float, float], ...]) -> None:
        side_mm = _SIDE_TEXELS * _TEXEL_MM
        factor = np.ones((_SIDE_TEXELS, _SIDE_TEXELS))
        for period_mm, depth in octaves:
            count = max(2, round(side_mm / period_mm))
            # wrapped around, so that the pattern has no seam
            lattice = np.pad(random.standard_normal((count, count)), _PAD, mode="wrap")
            scale = _SIDE_TEXELS / count
            at = ((np.arange(_SIDE_TEXELS) + 0.5) / scale - 0.5 + _PAD).astype(np.float32)
            columns, rows = np.meshgrid(at, at)
            factor += depth * cv2.remap(lattice, columns, rows, cv2.INTER_CUBIC)
        self._factor = np.clip(factor, *_FACTOR_RANGE)

    def factor(self, u_mm: Array, v_mm: Array) -> Array:
        """Return the factor on the reflectance at surface coordinates in millimetres."""
        i = (u_mm * (1.0 / _TEXEL_MM)).astype(np.int32) & (_SIDE_TEXELS - 1)
        j = (v_mm * (1.0 / _TEXEL_MM)).astype(np.int32) & (_SIDE_TEXELS - 1)
        return np.asarray(self._factor[i, j])


class Label:
    """A printed label in the middle of a face: a frame, a bar code and lines like writing."""

    def __init__(self, random: np.random.Generator) -> None:
        self._bars = np.sort(random.uniform(-_MARGIN, _MARGIN, 2 * _BAR_COUNT))
        self._words = np.sort(random.uniform(-_MARGIN, _MARGIN, (3, 10)), axis=1)

    def printed(self, u: Array, v: Array) -> NDArray[np.bool_]:
        """Return where ink is; ``u`` and ``v`` run from -1 to 1 over the face."""
        u, v = u / _LABEL_SHARE, v / _LABEL_SHARE
        inside = (np.abs(u) < 1.0) & (np.abs(v) < 1.0)
        frame = inside & ((np.abs(u) > _FRAME[0]) | (np.abs(v) > _FRAME[1]))
        bars = (np.searchsorted(self._bars, u) % 2 == 1) & (v > _BARS[0]) & (v < _BARS[1])
        writing = np.zeros(np.shape(u), dtype=bool)
        for line, words in enumerate(self._words):
            at = _FIRST_LINE + _LINE_STEP * line
            writing |= (np.abs(v - at) < _HALF_LINE) & (np.searchsorted(words, u) % 2 == 1)
        return np.asarray(frame | (inside & (bars | writing)))
