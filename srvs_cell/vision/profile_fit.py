"""Step 11b, beyond edges: fit a top face to the grey values across its outline in both images at once.

Grey levels and geometry are estimated together (variable projection, Golub and Pereyra 1973), which uses all of the
picture's evidence: faint borders, too, that show no edge at any single place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.face_fit import FaceFit
from srvs_cell.vision.outlines import Outlines, newton_steps
from srvs_cell.vision.profiles import GROUPS, LEVELS, LEVELS_SEEN, USUAL_BLUR_PX, Pictures, Profiles, read_profiles

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces import Face
    from srvs_cell.vision.rectification import RectifiedRig

BLURS_PX = (0.4, 0.55, 0.7, 0.85, 1.0, 1.2)
"""Standard deviations that the picture of a sharp border may have."""


@dataclass(frozen=True)
class Effort:
    """How thoroughly outlines are fitted.

    Attributes:
        widths: of the model's border over the picture's in each iteration; wide ones reach farther, the last one only
            judges.
        samples: on each outline, a multiple of 12.
    """

    widths: tuple[float, ...]
    samples: int = 96


SCOUT = Effort((2.0, 2.0, 2.0), 36)
"""Shows whether a start leads anywhere: a border twice as wide as the picture's reaches farther."""
REACH = Effort((2.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0))
"""From a start a few pixels off."""
SETTLE = Effort((1.0, 1.0, 1.0, 1.0, 1.0, 1.0))
"""From where the edges led."""
_FOR_BLUR = 48
"""Samples that tell the blur."""
_SIDE_SIGMA = 60.0
"""Grey values by which a side face may differ from what lies behind it."""
_ROBUST_SIGMA = 3.0
_ROBUST_SHARE = 0.1
"""Share of a stretch's contrast that the picture may deviate from the model like noise."""
_CAPPED = 2.0
"""A residual counts at most this many times what it may be like noise."""
_NARROW = 1.0
"""Width of a model that is the picture's: a face may come to rest."""
_LEVEL_PASSES = 3
_SETTLED_PX = 0.02
"""A face whose outline would move by less is where it belongs."""
_STEP_LIMITS = np.array([6.0, 6.0, 12.0, 6.0, 0.15, 6.0, 0.3])
_DAMPING = 1e-4
_TINY = 1e-9
_SEEN_SIGMA = 4.0
"""A border whose step is less than so many standard deviations of its noise is not seen."""
_FAINT_SHARE = 0.3
"""A sample of a faint border is judged by this share of the outline's usual steepness."""
_LOST_PX = 2.0
"""What a sample counts at most whose profile is another border's."""
_LEAST_RIDGE = 1e-6
_TIE = np.outer([0.0, -0.5, 0.0, -0.5, 1.0], [0.0, -0.5, 0.0, -0.5, 1.0])
"""A side face that is hidden has no level: it is held to that of the background."""


def fit_profiles(
    starts: Sequence[Face],
    inclined: Sequence[bool],
    pictures: Pictures,
    rig: RectifiedRig,
    table_z_mm: float,
    effort: Effort = SETTLE,
) -> list[FaceFit | None]:
    """Fit faces to the grey values across their outlines, each for itself.

    Args:
        starts: where to begin, a few pixels from the face's borders.
        inclined: whether the slope along a rectangle's length is free.
        pictures: the rectified images.
        rig: the rectified cameras.
        table_z_mm: height of the table, base frame.
        effort: iterations and samples.

    Returns:
        For each start a fit, or None where the outline is not in front of the cameras. Its ``rms_px`` is the
        displacement of the borders that would cause the misfit, its ``support`` the share of the outline that is seen
        in both images.
    """
    fits: list[FaceFit | None] = [None] * len(starts)
    if not starts:
        return fits
    outlines = Outlines.of(starts, inclined, effort.samples, equal_sides=True)
    alive, robust = np.arange(len(starts)), None
    for number, width in enumerate(effort.widths):
        borders = outlines.seen(rig)
        there = np.flatnonzero(borders.in_front)
        if there.size < alive.size:
            outlines, borders, alive = outlines.only(there), borders.only(there), alive[there]
            robust = None if robust is None else robust[:, there]
        if there.size == 0:
            break
        profiles = read_profiles(outlines, borders, pictures, rig, table_z_mm, width * pictures.blur_px)
        # far from its place a face explains other values than where it will come to: there it is judged anew
        explained = _explain(profiles, pictures.noise, robust if width == _NARROW else None)
        steps, covariances = _solved(profiles, explained, pictures.noise)
        settled = np.abs(steps[:, None] @ borders.by_parameter).max(axis=(0, 2, 3)) < _SETTLED_PX
        if number + 1 == len(effort.widths):
            settled[:] = True
        elif width != _NARROW:
            settled[:] = False
        if settled.any():
            rms_px, support, excess = _judged(profiles, explained, pictures.noise)
            covariances = covariances[:, :3, :3] * (pictures.noise**2 * excess)[:, None, None]
            faces = outlines.faces()
            for one in np.flatnonzero(settled):
                fits[alive[one]] = FaceFit(faces[one], covariances[one], float(rms_px[one]), float(support[one]))
        going = np.flatnonzero(~settled)
        outlines, alive = outlines.moved(steps).only(going), alive[going]
        robust = explained.robust[:, going]
    return fits


def measure_blur(faces: Sequence[Face], pictures: Pictures, rig: RectifiedRig, table_z_mm: float) -> float:
    """Return which blur explains the borders of well known faces best, pixels; the usual one where there are none."""
    if not faces:
        return USUAL_BLUR_PX
    outlines = Outlines.of(faces, [False] * len(faces), _FOR_BLUR, equal_sides=True)
    borders = outlines.seen(rig)

    def energy(blur_px: float) -> float:
        profiles = read_profiles(outlines, borders, pictures, rig, table_z_mm, blur_px)
        return float(_explain(profiles, pictures.noise).energy(profiles).sum())

    return min(BLURS_PX, key=energy)


@dataclass(frozen=True, eq=False)
class _Explained:
    """Profiles explained by grey levels: B faces, T offsets, N samples in each of both images.

    Attributes:
        residual: seen minus expected, shape (2, B, T, N).
        robust: how much each value counts because it is explained, 0 to 1, the same shape.
        weights: the profiles' weights times that.
        limit: what a residual may be like noise, shape (B, 1, N).
        gradient: how the expected values change when the border moves outwards, shape (2, B, T, N).
    """

    residual: NDArray[np.float32]
    robust: NDArray[np.float32]
    weights: NDArray[np.float32]
    limit: NDArray[np.float32]
    gradient: NDArray[np.float32]

    def energy(self, profiles: Profiles) -> Array:
        """Return the capped squared residuals of each face, shape (B,)."""
        capped = np.minimum(np.abs(self.residual), _CAPPED * self.limit)
        return np.asarray((profiles.weights * capped**2).sum(axis=(0, 2, 3)), dtype=np.float64)


def _explain(profiles: Profiles, noise: float, robust: NDArray[np.float32] | None = None) -> _Explained:
    """Estimate the grey levels of each stretch, robustly; ``robust``: how much the values counted when last judged."""
    ridge = _ridge(noise)
    weights = profiles.weights if robust is None else profiles.weights * robust
    samples = profiles.grey.shape[-1] // GROUPS
    for _ in range(_LEVEL_PASSES if robust is None else 1):
        weighted = profiles.by_level * weights
        seen = _of_stretches((weighted * profiles.grey).sum(axis=-2))
        levels = _solve(_level_products(weighted, profiles.by_level) + ridge, _stacked(seen)[:, None])[:, 0]
        # of each sample: the three levels that an image shows, shape (3, 2, B, 1, N)
        shown = levels[np.transpose(LEVELS_SEEN)].astype(np.float32)
        shown = np.repeat(shown, samples, axis=-1)[..., None, :]
        residual = profiles.grey - (shown * profiles.by_level).sum(axis=0)
        spread = np.maximum(_ROBUST_SIGMA * noise, _ROBUST_SHARE * np.ptp(levels, axis=0))
        limit = np.repeat(spread.astype(np.float32), samples, axis=-1)[:, None, :]
        share = 1.0 / (1.0 + (residual / limit) ** 2) ** 2
        weights = profiles.weights * share
    return _Explained(residual, share, weights, limit, (shown * profiles.slopes).sum(axis=0))


def _solved(profiles: Profiles, explained: _Explained, noise: float) -> tuple[Array, Array]:
    """Return Gauss-Newton steps (B, 7) and unscaled covariances (B, 7, 7), the grey levels eliminated."""
    # all values of a profile move together: sums over its offsets come first
    moved = profiles.by_parameter
    sloped = explained.weights * explained.gradient
    steepness = (sloped * explained.gradient).sum(axis=-2)
    pull = (sloped * explained.residual).sum(axis=-2)
    by_level = (profiles.by_level * sloped).sum(axis=-2)
    # by level and parameter, of each stretch, shape (5, 7, B, G)
    cross = np.moveaxis(_stacked(_of_stretches(by_level[..., None, :] * moved)), 1, 2)
    own = _level_products(profiles.by_level * explained.weights, profiles.by_level) + _ridge(noise)
    normal = ((moved * steepness[..., None, :]) @ np.swapaxes(moved, -1, -2)).sum(axis=0)
    normal -= np.einsum("lpbg,lqbg->bpq", cross, _solve(own, cross), optimize=True)
    vector = (moved @ pull[..., None])[..., 0].sum(axis=0)
    steps, covariances = newton_steps(normal, vector, _DAMPING)
    return np.clip(steps, -_STEP_LIMITS, _STEP_LIMITS), covariances


def _of_stretches(by_sample: Array | NDArray[np.float32]) -> Array:
    """Return sums over the samples of each stretch: (..., N) becomes (..., G)."""
    samples = by_sample.shape[-1] // GROUPS
    return np.asarray(by_sample @ np.repeat(np.eye(GROUPS, dtype=by_sample.dtype), samples, axis=0))


def _stacked(by_image: Array) -> Array:
    """Return sums by the three levels that each image shows, shape (3, 2, ...), by the five levels, (5, ...)."""
    stacked = np.zeros((LEVELS, *by_image.shape[2:]))
    for image, levels in enumerate(LEVELS_SEEN):
        stacked[list(levels)] += by_image[:, image]
    return stacked


def _level_products(weighted: NDArray[np.float32], by_level: NDArray[np.float32]) -> Array:
    """Return the normal matrices of the five levels of each stretch, shape (5, 5, B, G)."""
    together = np.zeros((LEVELS, LEVELS, weighted.shape[2], GROUPS))
    pairs = [(one, other) for one in range(len(weighted)) for other in range(one + 1)]
    products = _of_stretches(np.stack([(weighted[one] * by_level[other]).sum(axis=-2) for one, other in pairs]))
    for (one, other), by_image in zip(pairs, products, strict=True):
        for image, levels in enumerate(LEVELS_SEEN):
            together[levels[one], levels[other]] += by_image[image]
            if one != other:
                together[levels[other], levels[one]] += by_image[image]
    return together


def _solve(matrices: Array, right_sides: Array) -> Array:
    """Solve many small positive definite systems at once: numpy's own solver takes a microsecond for each.

    Args:
        matrices: shape (K, K, ...); not kept.
        right_sides: R of each, shape (K, R, ...).

    Returns:
        The solutions, shape (K, R, ...).
    """
    solved = right_sides.copy()
    size = len(matrices)
    for row in range(size):
        pivot = matrices[row, row]
        for below in range(row + 1, size):
            factor = matrices[below, row] / pivot
            matrices[below, row + 1 :] -= factor * matrices[row, row + 1 :]
            solved[below] -= factor * solved[row]
    for row in reversed(range(size)):
        for beyond in range(row + 1, size):
            solved[row] -= matrices[row, beyond] * solved[beyond]
        solved[row] /= matrices[row, row]
    return solved


def _ridge(noise: float) -> Array:
    ridge: Array = _TIE * (noise / _SIDE_SIGMA) ** 2 + np.eye(LEVELS) * _LEAST_RIDGE
    return ridge[..., None, None]


def _judged(profiles: Profiles, explained: _Explained, noise: float) -> tuple[Array, Array, Array]:
    """Return the misfit as a displacement, the seen share of the outline, the variance over the noise's; each (B,)."""
    size = profiles.weights.sum(axis=-2)
    squares = (profiles.weights * explained.residual**2).sum(axis=-2)
    steepness = (profiles.weights * explained.gradient**2).sum(axis=-2)
    usual = np.median(np.swapaxes(steepness, 0, 1).reshape(size.shape[1], -1), axis=1)[:, None]
    unexplained = np.maximum(squares - size * noise**2, 0.0)
    displaced2 = unexplained / np.maximum(np.maximum(steepness, _FAINT_SHARE * usual), _TINY)
    total = np.maximum(size.sum(axis=(0, 2)), _TINY)
    rms_px = np.sqrt((size * np.minimum(displaced2, _LOST_PX**2)).sum(axis=(0, 2)) / total)
    seen = np.sqrt(_of_stretches(steepness)) > _SEEN_SIGMA * noise
    excess = np.maximum(1.0, explained.energy(profiles) / (total * noise**2))
    return rms_px, seen.mean(axis=2).min(axis=0), excess
