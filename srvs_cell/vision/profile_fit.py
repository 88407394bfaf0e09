"""Step 11b, beyond edges: fit a top face to the grey values across its outline in both images at once.

Grey levels and geometry are estimated together (variable projection, Golub and Pereyra 1973), which uses all of the
picture's evidence: faint borders, too, that show no edge at any single place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.face_fit import FaceFit
from srvs_cell.vision.outlines import Outlines, in_front
from srvs_cell.vision.profiles import LEVELS, LEVELS_SEEN, USUAL_BLUR_PX, Pictures, Profiles, read_profiles

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
        widths: of the model's border over the picture's in each iteration; wide ones reach farther.
        samples: on each outline, a multiple of 12.
    """

    widths: tuple[float, ...]
    samples: int = 96


SCOUT = Effort((2.0, 2.0), 48)
"""Shows whether a start leads anywhere: a border twice as wide as the picture's reaches farther."""
REACH = Effort((2.0, 2.0, 1.0, 1.0, 1.0, 1.0))
"""From a start a few pixels off."""
SETTLE = Effort((1.0, 1.0, 1.0, 1.0, 1.0))
"""From where the edges led."""
_SIDE_SIGMA = 60.0
"""Grey values by which a side face may differ from what lies behind it."""
_ROBUST_SIGMA = 3.0
_ROBUST_SHARE = 0.1
"""Share of a stretch's contrast that the picture may deviate from the model like noise."""
_CAPPED = 2.0
"""A residual counts at most this many times what it may be like noise."""
_LEVEL_PASSES = 3
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
    alive = np.arange(len(starts))
    for width in (*effort.widths, None):
        there = np.flatnonzero(in_front(outlines, rig))
        if there.size == 0:
            return fits
        outlines, alive = outlines.only(there), alive[there]
        blur_px = (effort.widths[-1] if width is None else width) * pictures.blur_px
        profiles = read_profiles(outlines, pictures, rig, table_z_mm, blur_px)
        explained = _explain(profiles, pictures.noise)
        steps, covariances = _solved(profiles, explained, pictures.noise)
        if width is not None:
            outlines = outlines.moved(steps)
            continue
        rms_px, support, excess = _judged(profiles, explained, pictures.noise)
        covariances = covariances[:, :3, :3] * (pictures.noise**2 * excess)[:, None, None]
        for number, *fit in zip(alive, outlines.faces(), covariances, rms_px, support, strict=True):
            face, covariance, rms, share = fit
            fits[number] = FaceFit(face, covariance, float(rms), float(share))
    return fits


def measure_blur(faces: Sequence[Face], pictures: Pictures, rig: RectifiedRig, table_z_mm: float) -> float:
    """Return which blur explains the borders of well known faces best, pixels; the usual one where there are none."""
    if not faces:
        return USUAL_BLUR_PX
    outlines = Outlines.of(faces, [False] * len(faces), SETTLE.samples, equal_sides=True)

    def energy(blur_px: float) -> float:
        profiles = read_profiles(outlines, pictures, rig, table_z_mm, blur_px)
        return float(_explain(profiles, pictures.noise).energy(profiles).sum())

    return min(BLURS_PX, key=energy)


@dataclass(frozen=True, eq=False)
class _Explained:
    """Profiles explained by grey levels: B faces, G stretches, M values in each of both images.

    Attributes:
        residual: seen minus expected, shape (B, G, 2, M).
        weights: robust weights, the same shape.
        limit: what a residual may be like noise, shape (B, G, 1, 1).
        gradient: how the expected values change when the border moves outwards, shape (B, G, 2, M).
    """

    residual: NDArray[np.float32]
    weights: NDArray[np.float32]
    limit: NDArray[np.float32]
    gradient: NDArray[np.float32]

    def energy(self, profiles: Profiles) -> Array:
        """Return the capped squared residuals of each face, shape (B,)."""
        capped = np.minimum(np.abs(self.residual), _CAPPED * self.limit)
        return np.asarray((profiles.weights * capped**2).sum(axis=(1, 2, 3)), dtype=np.float64)


def _explain(profiles: Profiles, noise: float) -> _Explained:
    """Estimate the grey levels of each stretch, robustly."""
    ridge = _ridge(noise)
    weights = profiles.weights
    residual, limit = profiles.grey, np.ones((*profiles.grey.shape[:2], 1, 1), np.float32)
    by_image = np.zeros((*profiles.grey.shape[:3], len(LEVELS_SEEN[0])), np.float32)
    for _ in range(_LEVEL_PASSES):
        weighted = profiles.by_level * weights[..., None, :]
        own = _together(weighted @ np.swapaxes(profiles.by_level, -1, -2))
        seen = _stacked((weighted @ profiles.grey[..., None])[..., 0])
        levels = np.linalg.solve(own + ridge, seen[..., None])[..., 0]
        by_image = levels[..., LEVELS_SEEN].astype(np.float32)
        residual = profiles.grey - (by_image[..., None, :] @ profiles.by_level)[..., 0, :]
        spread = np.maximum(_ROBUST_SIGMA * noise, _ROBUST_SHARE * np.ptp(levels, axis=-1))
        limit = spread.astype(np.float32)[..., None, None]
        weights = profiles.weights / (1.0 + (residual / limit) ** 2) ** 2
    return _Explained(residual, weights, limit, (by_image[..., None, :] @ profiles.slopes)[..., 0, :])


def _solved(profiles: Profiles, explained: _Explained, noise: float) -> tuple[Array, Array]:
    """Return Gauss-Newton steps (B, 7) and unscaled covariances (B, 7, 7), the grey levels eliminated."""
    faces, *_, parameters = profiles.by_parameter.shape
    # all values of a profile move together: sums over its offsets come first
    sloped = explained.weights * explained.gradient
    steepness = profiles.per_sample(sloped * explained.gradient)
    pull = profiles.per_sample(sloped * explained.residual)
    by_level = profiles.per_sample(profiles.by_level * sloped[..., None, :])
    cross = _stacked(by_level @ profiles.by_parameter)
    weighted = profiles.by_level * explained.weights[..., None, :]
    own = _together(weighted @ np.swapaxes(profiles.by_level, -1, -2)) + _ridge(noise)
    moved = profiles.by_parameter.reshape(faces, -1, parameters)
    normal = np.swapaxes(moved * steepness.reshape(faces, -1, 1), -1, -2) @ moved
    normal -= (np.swapaxes(cross, -1, -2) @ np.linalg.solve(own, cross)).sum(axis=1)
    vector = (np.swapaxes(moved, -1, -2) @ pull.reshape(faces, -1, 1))[..., 0]
    diagonal = np.einsum("bii->bi", normal)
    # what is held has no row: 1 on the diagonal keeps the inverse of the rest
    norm = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    held = np.where(diagonal > 0.0, _DAMPING, 1.0)
    scaled = normal / (norm[:, :, None] * norm[:, None, :]) + held[:, :, None] * np.eye(normal.shape[-1])
    steps = np.linalg.solve(scaled, (vector / norm)[..., None])[..., 0] / norm
    covariances = np.linalg.inv(scaled) / (norm[:, :, None] * norm[:, None, :])
    return np.clip(steps, -_STEP_LIMITS, _STEP_LIMITS), covariances


def _stacked(by_image: Array) -> Array:
    """Return sums by the three levels that each image shows, shape (B, G, 2, 3, ...), by the five levels."""
    stacked = np.zeros((*by_image.shape[:2], LEVELS, *by_image.shape[4:]))
    for image, levels in enumerate(LEVELS_SEEN):
        stacked[:, :, levels] += by_image[:, :, image]
    return stacked


def _together(by_image: Array) -> Array:
    """Return the normal matrices of both images, shape (B, G, 2, 3, 3), as those of the five levels."""
    together = np.zeros((*by_image.shape[:2], LEVELS, LEVELS))
    for image, levels in enumerate(LEVELS_SEEN):
        rows, columns = np.ix_(levels, levels)
        together[:, :, rows, columns] += by_image[:, :, image]
    return together


def _ridge(noise: float) -> Array:
    ridge: Array = _TIE * (noise / _SIDE_SIGMA) ** 2 + np.eye(LEVELS) * _LEAST_RIDGE
    return ridge


def _judged(profiles: Profiles, explained: _Explained, noise: float) -> tuple[Array, Array, Array]:
    """Return the misfit as a displacement, the seen share of the outline, the variance over the noise's; each (B,)."""
    size = profiles.per_sample(profiles.weights)
    squares = profiles.per_sample(profiles.weights * explained.residual**2)
    steepness = profiles.per_sample(profiles.weights * explained.gradient**2)
    usual = np.median(steepness.reshape(len(size), -1), axis=1)[:, None, None, None]
    unexplained = np.maximum(squares - size * noise**2, 0.0)
    displaced2 = unexplained / np.maximum(np.maximum(steepness, _FAINT_SHARE * usual), _TINY)
    total = np.maximum(size.sum(axis=(1, 2, 3)), _TINY)
    rms_px = np.sqrt((size * np.minimum(displaced2, _LOST_PX**2)).sum(axis=(1, 2, 3)) / total)
    seen = np.sqrt(steepness.sum(axis=-1)) > _SEEN_SIGMA * noise
    excess = np.maximum(1.0, explained.energy(profiles) / (total * noise**2))
    return rms_px, seen.mean(axis=1).min(axis=1), excess
