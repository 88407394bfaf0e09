"""Step 11b: the grey levels that a stretch of an outline has, by weighted least squares, for many stretches at once.

Sums over the offsets of the profiles come first, as products with the few rows that the model is; then sums over the
samples of a stretch; what is left are five levels a stretch, small systems that are solved side by side.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.profiles import GROUPS, OFFSETS_PX

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.profiles import Profiles

_SIDE_SIGMA = 60.0
"""Grey values by which a side face may differ from what lies behind it."""
_LEAST_RIDGE = 1e-6
_ONES = np.ones(len(OFFSETS_PX), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class LevelNormal:
    """Cholesky factors of the normal matrices of the levels of B x G stretches.

    In each image a stretch has a level of the face and one of what lies behind; that of the side face is the same in
    both, and comes last: all but that can be done for both images at once.

    Attributes:
        face, behind: the diagonal, shape (2, B, G).
        side: its last element, shape (B, G).
        face_behind, face_side, behind_side: below the diagonal, shape (2, B, G).
        behind_both: the same between what lies behind in both images, shape (B, G).
    """

    face: Array
    behind: Array
    side: Array
    face_behind: Array
    face_side: Array
    behind_side: Array
    behind_both: Array

    @classmethod
    def of(cls, profiles: Profiles, weights: NDArray[np.float32], noise: float) -> LevelNormal:
        """Factor the normal matrices that the values' weights make."""
        weighted = weights * profiles.shares
        by_sample = np.empty((6, *weights.shape[1:]), dtype=np.float32)
        by_sample[0] = over_offsets(weights, profiles.model.face**2)
        by_sample[1:3] = over_offsets(weighted, profiles.model.face)
        by_sample[3:5] = over_offsets(weighted * profiles.shares)
        by_sample[5] = over_offsets(weighted[0] * profiles.shares[1])
        ff, fs, fb, ss, bb, bs = of_stretches(by_sample)
        # a side face that is hidden has no level: it is held to the mean of the backgrounds
        tie = 0.25 * (noise / _SIDE_SIGMA) ** 2
        face = np.sqrt(ff + _LEAST_RIDGE)
        face_behind, face_side = fb / face, fs / face
        behind = np.sqrt(bb + (tie + _LEAST_RIDGE) - face_behind**2)
        behind_side = (bs - 2.0 * tie - face_behind * face_side) / behind
        behind_both = tie / behind[0]
        alone = behind[1].copy()
        behind[1] = np.sqrt(alone**2 - behind_both**2)
        behind_side[1] = (behind_side[1] * alone - behind_both * behind_side[0]) / behind[1]
        left = ss - face_side**2 - behind_side**2
        side = np.sqrt(left[0] + left[1] + (4.0 * tie + _LEAST_RIDGE))
        return cls(face, behind, side, face_behind, face_side, behind_side, behind_both)

    def levels(self, sums: Array) -> Array:
        """Return the levels that explain weighted sums of grey values, both of shape (3, 2, B, G)."""
        face, behind, side = self._forward(sums[:, :, :, None])
        levels = np.empty(sums.shape)
        levels[2] = side = side[:, 0] / self.side
        behind = behind[:, :, 0] - self.behind_side * side
        levels[1, 1] = behind[1] / self.behind[1]
        levels[1, 0] = (behind[0] - self.behind_both * levels[1, 1]) / self.behind[0]
        levels[0] = (face[:, :, 0] - self.face_behind * levels[1] - self.face_side * side) / self.face
        return levels

    def whitened(self, sums: Array) -> Array:
        """Return rows of each face whose products are what levels explain: (3, 2, B, P, G) becomes (B, P, 5 G)."""
        face, behind, side = self._forward(sums)
        return np.concatenate([*face, *behind, side], axis=-1)

    def _forward(self, sums: Array) -> tuple[Array, Array, Array]:
        """Solve with the factor: (3, 2, B, P, G) becomes twice (2, B, P, G) and (B, P, G)."""
        face = sums[0] / self.face[:, :, None]
        behind = (sums[1] - self.face_behind[:, :, None] * face) / self.behind[:, :, None]
        behind[1] -= (self.behind_both / self.behind[1])[:, None] * behind[0]
        left = sums[2] - self.face_side[:, :, None] * face - self.behind_side[:, :, None] * behind
        return face, behind, (left[0] + left[1]) / self.side[:, None]


def by_level(profiles: Profiles, weighted: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return sums of weighted values over the offsets by face, background and side face, shape (3, 2, B, N)."""
    by_sample = np.empty((3, *weighted.shape[1:]), dtype=np.float32)
    by_sample[0] = over_offsets(weighted, profiles.model.face)
    by_sample[2:0:-1] = over_offsets(weighted * profiles.shares)
    return by_sample


def over_offsets(values: NDArray[np.float32], factors: NDArray[np.float32] = _ONES) -> NDArray[np.float32]:
    """Return sums over the offsets, each value times its offset's factor: (..., T, 2, B, N) becomes (..., 2, B, N)."""
    *more, offsets, eyes, faces, samples = values.shape
    sums: NDArray[np.float32] = factors @ values.reshape(*more, offsets, -1)
    return sums.reshape(*more, eyes, faces, samples)


@lru_cache(maxsize=8)
def _stretches(samples: int) -> NDArray[np.float32]:
    return np.repeat(np.eye(GROUPS, dtype=np.float32), samples // GROUPS, axis=0)


def of_stretches(by_sample: NDArray[np.float32]) -> Array:
    """Return sums over the samples of each stretch: (..., N) becomes (..., G)."""
    samples = by_sample.shape[-1]
    sums = by_sample.reshape(-1, samples) @ _stretches(samples)
    return sums.reshape(*by_sample.shape[:-1], GROUPS).astype(np.float64)
