"""What surfaces look like close by: a cloudy table, grain on parts, printed labels. Functions of position only."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array

_LATTICE: Final = 64
_LABEL_SHARE: Final = 0.62
_BAR_COUNT: Final = 17
_FRAME: Final = (0.95, 0.93)
_BARS: Final = (-0.75, 0.05)
_FIRST_LINE, _LINE_STEP, _HALF_LINE = 0.25, 0.22, 0.06
_MARGIN: Final = 0.85


class ValueNoise:
    """Smooth noise about 0 with a standard deviation of about 1: bilinear-smooth steps of a periodic random lattice."""

    def __init__(self, random: np.random.Generator) -> None:
        self._lattice = random.standard_normal((_LATTICE, _LATTICE))

    def at(self, u: Array, v: Array) -> Array:
        """Return the noise at lattice coordinates of any shape."""
        i, j = np.floor(u), np.floor(v)
        s, t = u - i, v - j
        s, t = s * s * (3.0 - 2.0 * s), t * t * (3.0 - 2.0 * t)
        i0, j0 = i.astype(np.intp) % _LATTICE, j.astype(np.intp) % _LATTICE
        i1, j1 = (i0 + 1) % _LATTICE, (j0 + 1) % _LATTICE
        lattice = self._lattice
        top = lattice[i0, j0] * (1.0 - t) + lattice[i0, j1] * t
        bottom = lattice[i1, j0] * (1.0 - t) + lattice[i1, j1] * t
        return np.asarray(top * (1.0 - s) + bottom * s)


class SurfaceGrain:
    """Relative variation of reflectance over a surface.

    Args:
        random: of the noise.
        octaves: (period in millimetres, relative standard deviation) of each layer.
    """

    def __init__(self, random: np.random.Generator, octaves: tuple[tuple[float, float], ...]) -> None:
        self._layers = [(ValueNoise(random), period, depth) for period, depth in octaves]

    def factor(self, u_mm: Array, v_mm: Array) -> Array:
        """Return the factor on the reflectance at surface coordinates in millimetres."""
        factor = np.ones(np.shape(u_mm))
        for noise, period_mm, depth in self._layers:
            factor += depth * noise.at(u_mm / period_mm, v_mm / period_mm)
        return np.clip(factor, 0.3, 1.7)


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
