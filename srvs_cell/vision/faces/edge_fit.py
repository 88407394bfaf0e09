"""Step 11b: fit the outline of a top face to the edges of both images at once.

A region says roughly where a face is; its edges say exactly. The outline of a figure is projected into both rectified
images, the edge is measured along the outline's normals there, and the figure's parameters follow by Gauss-Newton:
place, height, orientation and size in one estimate, with its covariance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.faces.outlines import Outlines, batches, newton_steps

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces.face import Face
    from srvs_cell.vision.faces.outlines import Borders
    from srvs_cell.vision.rectification import RectifiedRig

_SMOOTHING_PX = 1.0
_CLEAR_SHARE = 0.15
"""An edge is never asked to have more than this share of the strongest gradient in its window."""
_TEXTURE_FACTOR = 2.0
"""An edge must exceed the face's own texture by this factor."""
_TEXTURE_QUANTILE = 0.9
_INSIDE = (0.25, 0.45, 0.65)
"""Where, as shares of the way from centre to outline, the texture is measured."""
_TINY = float(np.finfo(float).tiny)
_FLAT = 1e-9
"""Curvature of a profile that has no peak, so that the parabola stays defined."""
_MISSING_PX = 3.0
_HOPELESS_SHARE = 0.5
"""Where less of the outline has an edge, the fit is given up."""
_SUPPORT_PX = 1.0
_DAMPING = 1e-6
_STEP_LIMITS = np.array([12.0, 12.0, 12.0, 12.0, 0.3, 12.0, 0.4])
_EDGE_SIGMA_PX = 0.05
"""Least standard deviation of one edge sample (references/vision.md C: a sober practical limit)."""
_INDEPENDENT_PX = 10.0
"""Length of outline whose samples share noise, so that they count as one."""


@dataclass(frozen=True)
class Effort:
    """How thoroughly outlines are fitted.

    Attributes:
        samples: on each outline, a multiple of 12.
        schedule: half width of the search and scale of the robust weight in each iteration, pixels.
        step_px: distance of the samples of a profile across the outline.
    """

    samples: int
    schedule: tuple[tuple[float, float], ...]
    step_px: float


SCOUT = Effort(36, ((6.0, 4.0), (6.0, 3.0), (5.0, 2.0), (4.0, 1.5)), 0.75)
"""Shows whether a start leads anywhere."""
SETTLE = Effort(48, ((3.0, 1.0), (3.0, 0.7), (2.5, 0.5), (2.5, 0.3)), 0.5)
"""Tells which of the figures that scouting left is the best."""
MEASURE = Effort(96, ((2.5, 0.4), (2.5, 0.3), (2.5, 0.3)), 0.5)
"""Measures what is a face."""


@dataclass(frozen=True, eq=False)
class EdgeField:
    """An image, smoothed: grey values, float32, shape (H, W), and their gradient, x and y, float32, shape (H, W, 2)."""

    smooth: NDArray[np.float32]
    gradient: NDArray[np.float32]

    @classmethod
    def of(cls, grey: NDArray[np.uint8]) -> EdgeField:
        """Smooth a grey image by a Gaussian and differentiate it."""
        reach = int(np.ceil(4.0 * _SMOOTHING_PX))
        t = np.arange(-reach, reach + 1, dtype=np.float64)
        smooth = np.exp(-0.5 * (t / _SMOOTHING_PX) ** 2)
        smooth /= smooth.sum()
        slope = t * smooth
        slope /= (slope * t).sum()
        image = grey.astype(np.float32)
        grey_values, *parts = (
            cv2.sepFilter2D(image, cv2.CV_32F, *kernels)
            for kernels in ((smooth, smooth), (slope, smooth), (smooth, slope))
        )
        return cls(np.asarray(grey_values, dtype=np.float32), np.asarray(cv2.merge(parts), dtype=np.float32))

    def along_normals(self, points_px: Array, normals: Array, offsets_px: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the gradient along normals at T offsets from points; 0 outside the image.

        Args:
            points_px: x and y, shape (B, 2, N).
            normals: of the same shape.
            offsets_px: shape (T,).

        Returns:
            float32, shape (T, B, N).
        """
        # x and y come first
        points, across = (each.transpose(1, 0, 2).astype(np.float32, order="C") for each in (points_px, normals))
        places = across[:, None] * offsets_px[:, None, None]
        places += points[:, None]
        places_x, places_y = places.reshape(2, len(offsets_px), -1)
        seen = cv2.remap(self.gradient, places_x, places_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        both = seen.reshape(*places.shape[1:], 2)
        return np.asarray(both[..., 0] * across[0] + both[..., 1] * across[1], dtype=np.float32)


@dataclass(frozen=True, eq=False)
class FaceFit:
    """A face fitted to the edges of both images.

    Attributes:
        face: the fitted figure.
        covariance_mm2: of (x, y, z) of its centre from the edges alone, 3x3.
        rms_px: root mean square distance of outline and edges, where there is no edge counted as 3 px.
        support: share of the outline that has an edge within a pixel, the less of both images.
    """

    face: Face
    covariance_mm2: Array
    rms_px: float
    support: float


@dataclass(frozen=True, eq=False)
class _Linearised:
    """One Gauss-Newton iteration of B figures; distances and whether there is an edge have shape (2, B, N).

    The covariances of the places, shape (B, 3, 3), are those of edges with a standard deviation of one pixel.
    """

    steps: Array
    covariances: Array
    distances_px: Array
    found: NDArray[np.bool_]


def fit_faces(
    starts: Sequence[Face],
    inclined: Sequence[bool],
    fields: tuple[EdgeField, EdgeField],
    rig: RectifiedRig,
    effort: Effort,
    min_gradient: float,
) -> list[FaceFit | None]:
    """Fit faces to the edges of both images, each for itself.

    Args:
        starts: where to begin; within the reach of the effort's search from the edges.
        inclined: whether the slope along a rectangle's length is free.
        fields: gradients of the rectified left and right image.
        rig: the rectified cameras.
        effort: number of samples and iterations.
        min_gradient: least gradient of an edge, grey values per pixel.

    Returns:
        For each start the fit, or None where the outline leaves the view or the edges do not determine it.
    """
    fits = [
        _fit_batch(starts[some], inclined[some], fields, rig, effort, min_gradient)
        for some in batches(len(starts), effort.samples)
    ]
    return [fit for batch in fits for fit in batch]


def _fit_batch(
    starts: Sequence[Face],
    inclined: Sequence[bool],
    fields: tuple[EdgeField, EdgeField],
    rig: RectifiedRig,
    effort: Effort,
    min_gradient: float,
) -> list[FaceFit | None]:
    """Fit a few faces, at least one, as `fit_faces` does."""
    fits: list[FaceFit | None] = [None] * len(starts)
    outlines = Outlines.of(starts, inclined, effort.samples)
    borders = outlines.seen(rig)
    alive = np.flatnonzero(borders.in_front)
    if alive.size == 0:
        return fits
    outlines, borders = outlines.only(alive), borders.only(alive)
    textures = _textures(borders, fields)
    for half_width_px, scale_px in effort.schedule:
        search_px = (half_width_px, scale_px, effort.step_px)
        now = _linearise(outlines, borders, textures, fields, search_px, min_gradient)
        outlines = outlines.moved(now.steps)
        borders = outlines.seen(rig)
        hopeful = np.flatnonzero((now.found.mean(axis=(0, 2)) >= _HOPELESS_SHARE) & borders.in_front)
        if hopeful.size == 0:
            return fits
        if hopeful.size < alive.size:
            outlines, borders = outlines.only(hopeful), borders.only(hopeful)
            textures, alive = textures[:, hopeful], alive[hopeful]
    last = _linearise(outlines, borders, textures, fields, (*effort.schedule[-1], effort.step_px), min_gradient)
    for number, fit in zip(alive, _judged(outlines, borders, last), strict=True):
        fits[number] = fit
    return fits


def _judged(outlines: Outlines, borders: Borders, last: _Linearised) -> list[FaceFit]:
    distances = np.where(last.found, np.abs(last.distances_px), _MISSING_PX)
    capped = np.sqrt(np.mean(np.minimum(distances, _SUPPORT_PX) ** 2, axis=(0, 2)))
    noise_px = np.maximum(_EDGE_SIGMA_PX, capped)
    points = borders.points_px[0]
    perimeter_px = np.linalg.norm(np.diff(points, append=points[..., :1]), axis=1).sum(axis=1)
    # a sample of a densely sampled outline tells less than one of a sparsely sampled one
    samples_per_one = np.maximum(1.0, outlines.unit.shape[2] * _INDEPENDENT_PX / np.maximum(perimeter_px, 1.0))
    covariances = last.covariances * (noise_px**2 * samples_per_one)[:, None, None]
    rms = np.sqrt(np.mean(distances**2, axis=(0, 2)))
    support = (distances < _SUPPORT_PX).mean(axis=2).min(axis=0)
    return [
        FaceFit(face, covariance, float(rms_px), float(share))
        for face, covariance, rms_px, share in zip(outlines.faces(), covariances, rms, support, strict=True)
    ]


def _linearise(
    outlines: Outlines,
    borders: Borders,
    textures: Array,
    fields: tuple[EdgeField, EdgeField],
    search_px: tuple[float, float, float],
    min_gradient: float,
) -> _Linearised:
    """Measure the edges and solve for a step; ``search_px``: half width, scale of the weight, step of a profile."""
    half_width_px, scale_px, step_px = search_px
    distance, there = _edges(borders, fields, outlines, (half_width_px, step_px), (min_gradient, textures))
    weight = there / (1.0 + (distance / scale_px) ** 2) ** 2
    weighted = borders.by_parameter * weight[:, :, None, :]
    normal_matrices = (weighted @ np.swapaxes(borders.by_parameter, -1, -2)).sum(axis=0)
    gradients = (weighted @ distance[..., None])[..., 0].sum(axis=0)
    steps, covariances = newton_steps(normal_matrices, gradients, _DAMPING)
    steps = np.minimum(np.maximum(steps, -_STEP_LIMITS), _STEP_LIMITS)
    return _Linearised(steps, covariances, distance, there)


def _edges(
    borders: Borders,
    fields: tuple[EdgeField, EdgeField],
    outlines: Outlines,
    search_px: tuple[float, float],
    gradients: tuple[float, Array],
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the signed distance of the edge along each normal, 0 where there is none, and whether there is one.

    Args:
        borders: the outlines in both images.
        fields: the images' gradients.
        outlines: the figures.
        search_px: half width of the search and step of a profile.
        gradients: least gradient of any edge, and what each figure's texture reaches in both images, shape (2, B).

    Returns:
        Both of shape (2, B, N).
    """
    half_width_px, step_px = search_px
    min_gradient, textures = gradients
    reach = round(half_width_px / step_px) + 1
    offsets = np.arange(-reach, reach + 1, dtype=np.float32) * np.float32(step_px)
    size = np.stack(
        [
            field.along_normals(points, normals, offsets)
            for field, points, normals in zip(fields, borders.points_px, borders.normals, strict=True)
        ]
    )
    size = np.abs(_averaged(size, outlines))
    # an edge is a local maximum, so that the flank of one beyond the window does not count
    inner = size[:, 1:-1]
    peak = (inner >= size[:, :-2]) & (inner > size[:, 2:])
    strongest = (inner * peak).max(axis=1)
    clear = _TEXTURE_FACTOR * textures[..., None]
    needed = np.maximum(min_gradient, np.minimum(clear, _CLEAR_SHARE * strongest))
    # walking outwards from inside the face its own edge comes first; side face and shadow lie beyond it
    peak &= inner >= needed[:, None].astype(np.float32)
    count = inner.shape[1]
    ahead = (peak * np.arange(count, 0, -1, dtype=np.uint8)[:, None, None]).max(axis=1)
    found, best = ahead > 0, count - np.maximum(ahead, 1).astype(np.intp)
    eye, figure, sample = np.ogrid[: len(best), : best.shape[1], : best.shape[2]]
    before, at, after = (size[eye, best + step, figure, sample] for step in range(3))
    curvature = np.minimum(before - 2.0 * at + after, -_FLAT)
    shift = np.minimum(np.maximum(0.5 * (before - after) / curvature, -0.5), 0.5)
    return np.where(found, offsets[best + 1] + shift * step_px, 0.0), found


def _averaged(profiles: NDArray[np.float32], outlines: Outlines) -> NDArray[np.float32]:
    """Average profiles, shape (2, T, B, N), with their neighbours on the same side, weights 1 2 1, against noise."""
    # at a side's end the sample itself takes the missing neighbour's place
    share = np.where(outlines.last[:, :-1], np.float32(0.0), np.float32(0.25))
    step = (profiles[..., 1:] - profiles[..., :-1]) * share
    averaged = profiles.copy()
    averaged[..., :-1] += step
    averaged[..., 1:] -= step
    return averaged


def _textures(borders: Borders, fields: tuple[EdgeField, EdgeField]) -> Array:
    """Return the gradient that each face's own texture reaches in both images, across its outline, shape (2, B)."""
    found = []
    for field, points in zip(fields, borders.points_px, strict=True):
        middle = points.mean(axis=2, keepdims=True)
        rays = points - middle
        length = np.maximum(np.hypot(rays[:, :1], rays[:, 1:]), _TINY)
        # the samples drawn towards the middle, one share after the other
        inside = np.concatenate([middle + share * rays for share in _INSIDE], axis=2)
        directions = np.tile(rays / length, len(_INSIDE))
        size = np.abs(field.along_normals(inside, directions, np.zeros(1, dtype=np.float32)))[0]
        rank = round(_TEXTURE_QUANTILE * (size.shape[1] - 1))
        found.append(np.partition(size, rank, axis=1)[:, rank])
    return np.stack(found)
