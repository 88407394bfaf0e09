"""Step 11b: the grey levels that a stretch of an outline has, by weighted least squares, for many stretches at once.

Sums over the offsets of the profiles come first, as products with the few rows that the model is; then sums over the
samples of a stretch; what is left are six levels a stretch, small systems that are solved side by side.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.faces.profiles import GROUPS, OFFSETS_PX

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces.profiles import Profiles

_SIDE_SIGMA = 60.0
"""Grey values by which a side face may differ from its shadow, and this from what lies behind it."""
_SHADE_SIGMA = 10.0
"""Grey values by which a shadow may differ from what the lamp leaves of what lies behind it."""
_LEAST_RIDGE = 1e-6
_ONES = np.ones(len(OFFSETS_PX), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class LevelNormal:
    """Cholesky factors of the normal matrices of the levels of B x G stretches.

    In each image a stretch has a level of the face and one of what lies behind, its own; the side face and the shadow
    on the table have one each in both, the common ones, which come last.

    Attributes:
        own: the diagonal of face and behind, and what couples them, shape (3, 2, B, G).
        mixed: what couples side face and shadow (first axis) with face and behind (second), shape (2, 2, 2, B, G).
        common: the diagonal of side face and shadow, and what couples them, shape (3, B, G).
    """

    own: Array
    mixed: Array
    common: Array

    @classmethod
    def of(cls, profiles: Profiles, weights: NDArray[np.float32], noise: float) -> LevelNormal:
        """Factor the normal matrices that the values' weights make."""
        model, shares = profiles.model, profiles.shares
        weighted = weights * shares
        by_sample = np.empty((10, *weights.shape[1:]), dtype=np.float32)
        by_sample[:3] = over_offsets(weights, model.squares)
        by_sample[3:7] = over_offsets(weighted, model.shares).reshape(4, *weights.shape[1:])
        by_sample[7:9] = over_offsets(weighted * shares)
        by_sample[9] = over_offsets(weighted[0] * shares[1])
        # face, all outside of it, side face, behind
        ff, fo, oo, fs, so, fb, bo, ss, bb, sb = of_stretches(by_sample)
        # the shadow is what is left outside
        fd, sd, db = fo - fs - fb, so - ss - sb, bo - sb - bb
        dd = oo - so - bo - sd - db
        # what is hidden has no level: the side face is held to the shadow, and this to what lies behind, darkened
        tie, shade = (noise / _SIDE_SIGMA) ** 2, 1.0 if profiles.shade is None else profiles.shade
        shade_tie = tie if profiles.shade is None else (noise / _SHADE_SIGMA) ** 2
        own, mixed, common = np.empty((3, *ff.shape)), np.empty((2, 2, *ff.shape)), np.empty((3, *ff.shape[1:]))
        own[0] = np.sqrt(ff + _LEAST_RIDGE)
        own[2] = fb / own[0]
        own[1] = np.sqrt(bb + (shade_tie * shade**2 + _LEAST_RIDGE) - own[2] ** 2)
        (side_face, side_behind), (shadow_face, shadow_behind) = mixed
        np.divide(fs, own[0], out=side_face)
        np.divide(fd, own[0], out=shadow_face)
        np.divide(sb - own[2] * side_face, own[1], out=side_behind)
        np.divide(db - shade_tie * shade - own[2] * shadow_face, own[1], out=shadow_behind)
        left_side, left_shadow, left_both = (
            each[0] + each[1]
            for each in (
                ss - side_face**2 - side_behind**2,
                dd - shadow_face**2 - shadow_behind**2,
                sd - side_face * shadow_face - side_behind * shadow_behind,
            )
        )
        common[0] = np.sqrt(left_side + (2.0 * tie + _LEAST_RIDGE))
        common[2] = (left_both - 2.0 * tie) / common[0]
        common[1] = np.sqrt(left_shadow + (2.0 * tie + 2.0 * shade_tie + _LEAST_RIDGE) - common[2] ** 2)
        return cls(own, mixed, common)

    def levels(self, sums: Array) -> Array:
        """Return the levels of face, behind, side face and shadow that explain weighted sums, all (4, 2, B, G)."""
        own, side, shadow = self._forward(sums[:, :, :, None])
        levels = np.empty(sums.shape)
        levels[3] = shadow[:, 0] / self.common[1]
        levels[2] = (side[:, 0] - self.common[2] * levels[3, 0]) / self.common[0]
        own = own[:, :, :, 0] - self.mixed[0] * levels[2] - self.mixed[1] * levels[3]
        levels[1] = own[1] / self.own[1]
        levels[0] = (own[0] - self.own[2] * levels[1]) / self.own[0]
        return levels

    def whitened(self, sums: Array) -> Array:
        """Return rows of each face whose products are what levels explain: (4, 2, B, P, G) becomes (B, P, 6 G)."""
        own, side, shadow = self._forward(sums)
        return np.concatenate([*own[0], *own[1], side, shadow], axis=-1)

    def _forward(self, sums: Array) -> tuple[Array, Array, Array]:
        """Solve with the factor: (4, 2, B, P, G) becomes (2, 2, B, P, G) and twice (B, P, G)."""
        own = np.empty((2, *sums.shape[1:]))
        own[0] = sums[0] / self.own[0][:, :, None]
        own[1] = (sums[1] - self.own[2][:, :, None] * own[0]) / self.own[1][:, :, None]
        side, shadow = (sums[2:] - (self.mixed[:, :, :, :, None] * own).sum(axis=1)).sum(axis=1)
        side /= self.common[0][:, None]
        shadow -= self.common[2][:, None] * side
        shadow /= self.common[1][:, None]
        return own, side, shadow


def by_level(profiles: Profiles, weighted: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return sums of weighted values over the offsets by face, behind, side face and shadow, shape (4, 2, B, N)."""
    by_sample = np.empty((4, *weighted.shape[1:]), dtype=np.float32)
    by_sample[:2] = over_offsets(weighted, profiles.model.shares)
    outside = by_sample[1].copy()
    by_sample[2], by_sample[1] = over_offsets(weighted * profiles.shares)
    by_sample[3] = outside - by_sample[1] - by_sample[2]
    return by_sample


def over_offsets(values: NDArray[np.float32], factors: NDArray[np.float32] = _ONES) -> NDArray[np.float32]:
    """Return sums over the offsets, each value times its offset's factor: (..., T, 2, B, N) becomes (..., 2, B, N).

    Factors have the shape (T,), or (K, T) for as many sums, whose numbers then come in place of the offsets.
    """
    *more, offsets, eyes, faces, samples = values.shape
    sums: NDArray[np.float32] = factors @ values.reshape(*more, offsets, -1)
    return sums.reshape(*sums.shape[:-1], eyes, faces, samples)


@lru_cache(maxsize=8)
def _stretches(samples: int) -> NDArray[np.float32]:
    return np.repeat(np.eye(GROUPS, dtype=np.float32), samples // GROUPS, axis=0)


def of_stretches(by_sample: NDArray[np.float32]) -> Array:
    """Return sums over the samples of each stretch: (..., N) becomes (..., G)."""
    samples = by_sample.shape[-1]
    sums = by_sample.reshape(-1, samples) @ _stretches(samples)
    return sums.reshape(*by_sample.shape[:-1], GROUPS).astype(np.float64)
