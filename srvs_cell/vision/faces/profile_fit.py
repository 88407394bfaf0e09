"""Step 11b, beyond edges: fit a top face to the grey values across its outline in both images at once.

Grey levels and geometry are estimated together (variable projection, Golub and Pereyra 1973), which uses all of the
picture's evidence: faint borders, too, that show no edge at any single place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.faces.edge_fit import FaceFit
from srvs_cell.vision.faces.levels import LevelNormal, by_level, of_stretches, over_offsets
from srvs_cell.vision.faces.outlines import Outlines, batches, newton_steps
from srvs_cell.vision.faces.profiles import GROUPS, USUAL_BLUR_PX, Pictures, Profiles, read_profiles

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces.face import Face
    from srvs_cell.vision.faces.shadows import Lamp
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
SETTLE = Effort((1.0,) * 16)
"""From where the edges led; few faces need more than half of it to come to rest."""
_FOR_LIGHT = 48
"""Samples that tell blur and lamp."""
_EXPLAINED_SHARE = 0.97
"""A lamp must leave less than this share unexplained of what is without it."""
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
_TABLE_SLACK_MM = 1.0
"""No inclined face reaches into the table by more than the table is misplaced."""
_TINY = 1e-9
_SEEN_SIGMA = 4.0
"""A border whose step is less than so many standard deviations of its noise is not seen."""
_FAINT_SHARE = 0.3
"""A sample of a faint border is judged by this share of the outline's usual steepness."""
_LOST_PX = 2.0
"""What a sample counts at most whose profile is another border's."""
_LEAST_SHADOW_PX = 0.7
"""A shadow of this width is expected beside a stretch, or nothing tells that the stretch is a shadow's border."""
_LIKE_SHADOW, _UNLIKE_FACE = 0.15, 0.5
"""Shares of the contrast of table and shadow: what lies within a shadow's border differs by less from the shadow and by
more from the rest of the face."""


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
    fits = [
        _fit_batch(starts[some], inclined[some], pictures, rig, table_z_mm, effort)
        for some in batches(len(starts), effort.samples)
    ]
    return [fit for batch in fits for fit in batch]


def _fit_batch(
    starts: Sequence[Face],
    inclined: Sequence[bool],
    pictures: Pictures,
    rig: RectifiedRig,
    table_z_mm: float,
    effort: Effort,
) -> list[FaceFit | None]:
    """Fit a few faces, at least one, as `fit_profiles` does."""
    fits: list[FaceFit | None] = [None] * len(starts)
    outlines = Outlines.of(starts, inclined, effort.samples, equal_sides=True)
    alive, robust = np.arange(len(starts)), None
    for number, width in enumerate(effort.widths):
        borders = outlines.seen(rig)
        there = np.flatnonzero(borders.in_front)
        if there.size < alive.size:
            outlines, borders, alive = outlines.only(there), borders.only(there), alive[there]
            robust = None if robust is None else robust[:, :, there]
        if there.size == 0:
            break
        profiles = read_profiles(outlines, borders, pictures, rig, table_z_mm, width * pictures.blur_px)
        # far from its place a face explains other values than where it will come to: there it is judged anew
        explained = _explain(profiles, pictures.noise, robust if width == _NARROW else None)
        room = outlines.room_above(table_z_mm - _TABLE_SLACK_MM)
        steps, covariances = _solved(profiles, explained, pictures.noise, room)
        settled = np.abs(steps[:, None] @ borders.by_parameter).max(axis=(0, 2, 3)) < _SETTLED_PX
        if number + 1 == len(effort.widths):
            settled[:] = True
        elif width != _NARROW:
            settled[:] = False
        if settled.any():
            done = np.flatnonzero(settled)
            rms_px, support, excess = _judged(profiles.only(done), explained.only(done), pictures.noise)
            covariances = covariances[done] * (pictures.noise**2 * excess)[:, None, None]
            for one, face, *fit in zip(done, outlines.only(done).faces(), covariances, rms_px, support, strict=True):
                fits[alive[one]] = FaceFit(face, fit[0], float(fit[1]), float(fit[2]))
        going = np.flatnonzero(~settled)
        if going.size == 0:
            break
        outlines, robust = outlines.moved(steps), explained.robust
        if going.size < alive.size:
            outlines, alive, robust = outlines.only(going), alive[going], robust[:, :, going]
    return fits


def measure_blur(faces: Sequence[Face], pictures: Pictures, rig: RectifiedRig, table_z_mm: float) -> float:
    """Return which blur explains the borders of well known faces best, pixels; the usual one where there are none."""
    if not faces:
        return USUAL_BLUR_PX
    left_over = _left_over(faces, rig, table_z_mm)
    return min(BLURS_PX, key=lambda blur_px: left_over(replace(pictures, blur_px=blur_px)))


def measure_lamp(
    lamps: Sequence[Lamp], faces: Sequence[Face], pictures: Pictures, rig: RectifiedRig, table_z_mm: float
) -> Lamp | None:
    """Return the lamp whose shadows explain the borders of well known faces best; None where none do it as well."""
    if not lamps:
        return None
    left_over = _left_over(faces, rig, table_z_mm)
    dark = left_over(replace(pictures, lamp=None))
    left, best = min((left_over(replace(pictures, lamp=lamp)), number) for number, lamp in enumerate(lamps))
    return lamps[best] if left < _EXPLAINED_SHARE * dark else None


def _left_over(faces: Sequence[Face], rig: RectifiedRig, table_z_mm: float) -> Callable[[Pictures], float]:
    """Return what the model leaves unexplained of the borders of faces, at least one, by what the pictures are."""
    outlines = Outlines.of(faces, [False] * len(faces), _FOR_LIGHT, equal_sides=True)
    borders = outlines.seen(rig)

    def left_over(pictures: Pictures) -> float:
        profiles = read_profiles(outlines, borders, pictures, rig, table_z_mm, pictures.blur_px)
        return float(_explain(profiles, pictures.noise).energy(profiles.weights).sum())

    return left_over


@dataclass(frozen=True, eq=False)
class _Explained:
    """Profiles explained by grey levels: T offsets, B faces, N samples in each of both images.

    Attributes:
        levels: of face, behind, side face and shadow, of each stretch, shape (4, 2, B, G).
        residual: seen minus expected, shape (T, 2, B, N).
        robust: how much each value counts because it is explained, 0 to 1, the same shape.
        weights: the profiles' weights times that.
        limit: what a residual may be like noise, shape (B, N).
        gradient: how the expected values change when the border moves outwards, shape (T, 2, B, N).
    """

    levels: Array
    residual: NDArray[np.float32]
    robust: NDArray[np.float32]
    weights: NDArray[np.float32]
    limit: NDArray[np.float32]
    gradient: NDArray[np.float32]

    def only(self, kept: NDArray[np.intp]) -> _Explained:
        """Return some of the faces by their numbers."""
        return _Explained(
            self.levels[:, :, kept],
            self.residual[:, :, kept],
            self.robust[:, :, kept],
            self.weights[:, :, kept],
            self.limit[kept],
            self.gradient[:, :, kept],
        )

    def energy(self, weights: NDArray[np.float32]) -> Array:
        """Return the capped squared residuals of each face, shape (B,); ``weights``: of the profiles."""
        capped = np.minimum(np.abs(self.residual), _CAPPED * self.limit)
        return np.asarray(over_offsets(weights * capped**2).sum(axis=(0, 2)), dtype=np.float64)


def _explain(profiles: Profiles, noise: float, robust: NDArray[np.float32] | None = None) -> _Explained:
    """Estimate the grey levels of each stretch, robustly; ``robust``: how much the values counted when last judged."""
    weights = profiles.weights if robust is None else profiles.weights * robust
    samples = profiles.grey.shape[-1] // GROUPS
    for _ in range(_LEVEL_PASSES if robust is None else 1):
        seen = of_stretches(by_level(profiles, weights * profiles.grey))
        levels = LevelNormal.of(profiles, weights, noise).levels(seen)
        spread = np.maximum(_ROBUST_SIGMA * noise, _ROBUST_SHARE * (levels.max(axis=(0, 1)) - levels.min(axis=(0, 1))))
        limit = spread.astype(np.float32).repeat(samples, axis=-1)
        face, behind, side, shadow = levels.astype(np.float32).repeat(samples, axis=-1)
        residual = profiles.grey - face
        residual -= (shadow - face) * profiles.model.shares[1, :, None, None, None]
        residual -= (side - shadow) * profiles.shares[0]
        residual -= (behind - shadow) * profiles.shares[1]
        share = residual / limit
        share *= share
        share += 1.0
        share *= share
        np.reciprocal(share, out=share)
        weights = profiles.weights * share
    gradient = (shadow - side) * profiles.slopes[0]
    gradient += (behind - shadow) * profiles.slopes[1]
    gradient += (side - face) * profiles.model.border_slope[:, None, None, None]
    return _Explained(levels, residual, share, weights, limit, gradient)


def _solved(profiles: Profiles, explained: _Explained, noise: float, room: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return Gauss-Newton steps that stay in the room, shape (B, 7), and unscaled covariances of the places, (B, 3, 3).

    The grey levels are eliminated.
    """
    # all values of a profile move together: sums over its offsets come first
    moved = profiles.by_parameter
    sloped = explained.weights * explained.gradient
    steepness = over_offsets(sloped * explained.gradient)
    pull = over_offsets(sloped * explained.residual)
    # by level and parameter, of each stretch, shape (4, 2, B, 7, G)
    cross = of_stretches(by_level(profiles, sloped)[:, :, :, None] * moved.astype(np.float32))
    taken = LevelNormal.of(profiles, explained.weights, noise).whitened(cross)
    normal = ((moved * steepness[:, :, None]) @ moved.swapaxes(-1, -2)).sum(axis=0) - taken @ taken.swapaxes(-1, -2)
    vector = (moved @ pull[..., None])[..., 0].sum(axis=0)
    steps, covariances = newton_steps(normal, vector, _DAMPING, room)
    steps = np.minimum(np.maximum(steps, -_STEP_LIMITS), _STEP_LIMITS)
    # a step that was cut short may have lost what kept it in the room
    room_mm, by_parameter = room
    steps[:, 2] += np.maximum(-room_mm - (by_parameter * steps).sum(axis=1), 0.0)
    return steps, covariances


def _judged(profiles: Profiles, explained: _Explained, noise: float) -> tuple[Array, Array, Array]:
    """Return the misfit as a displacement, the seen share of the outline, the variance over the noise's; each (B,)."""
    weights = profiles.weights
    size = over_offsets(weights)
    squares = over_offsets(weights * explained.residual**2)
    steepness = over_offsets(weights * explained.gradient**2)
    middle = steepness.shape[2]
    usual = np.sort(np.concatenate([*steepness], axis=1))[:, middle - 1 : middle + 1].mean(axis=1, keepdims=True)
    unexplained = np.maximum(squares - size * noise**2, 0.0)
    displaced2 = unexplained / np.maximum(np.maximum(steepness, _FAINT_SHARE * usual), _TINY)
    displaced2[_in_shadow(profiles, explained.levels, noise)] = _LOST_PX**2
    total = np.maximum(size.sum(axis=(0, 2)), _TINY)
    rms_px = np.sqrt((size * np.minimum(displaced2, _LOST_PX**2)).sum(axis=(0, 2)) / total)
    seen = np.sqrt(of_stretches(steepness)) > _SEEN_SIGMA * noise
    excess = np.maximum(1.0, explained.energy(weights) / (total * noise**2))
    return rms_px, seen.mean(axis=2).min(axis=0), excess


def _in_shadow(profiles: Profiles, levels: Array, noise: float) -> NDArray[np.bool_]:
    """Return at which samples, shape (2, B, N), a figure takes a shadow on the table for part of the face.

    There a shadow is expected beside the face, and what lies within the border is unlike the rest of the face, and as
    dark as a shadow on what lies beside it.
    """
    if profiles.shade is None:
        return np.zeros(profiles.weights.shape[1:], dtype=np.bool_)
    samples = profiles.weights.shape[-1] // GROUPS
    outside = over_offsets(profiles.model.shares[1, :, None, None, None] - profiles.shares[0] - profiles.shares[1])
    expected = of_stretches(outside) > _LEAST_SHADOW_PX * samples
    # at the outer edge of a shadow what is taken for the next one is the lit table
    face, _, _, lit = levels
    contrast, least = (1.0 - profiles.shade) * lit, _ROBUST_SIGMA * noise
    like_shadow = np.abs(face - profiles.shade * lit) < np.maximum(least, _LIKE_SHADOW * contrast)
    usual = np.median(face, axis=-1, keepdims=True)
    unlike_face = np.abs(face - usual) > np.maximum(least, _UNLIKE_FACE * contrast)
    return np.asarray((expected & like_shadow & unlike_face).repeat(samples, axis=-1))
