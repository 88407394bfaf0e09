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

from srvs_cell.vision.outlines import Outlines, in_front, outward_normals

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces import Face
    from srvs_cell.vision.rectification import RectifiedRig

_SMOOTHING_PX = 1.0
_CLEAR_SHARE = 0.15
"""An edge is never asked to have more than this share of the strongest gradient in its window."""
_TEXTURE_FACTOR = 2.0
"""An edge must exceed the face's own texture by this factor."""
_TEXTURE_QUANTILE = 0.9
_INSIDE = (0.25, 0.45, 0.65)
"""Where, as shares of the way from centre to outline, the texture is measured."""
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
    """The grey gradient of an image, smoothed: x and y, float32, shape (H, W, 2)."""

    gradient: NDArray[np.float32]

    @classmethod
    def of(cls, grey: NDArray[np.uint8]) -> EdgeField:
        """Differentiate a grey image by a derivative of a Gaussian."""
        reach = int(np.ceil(4.0 * _SMOOTHING_PX))
        t = np.arange(-reach, reach + 1, dtype=np.float64)
        smooth = np.exp(-0.5 * (t / _SMOOTHING_PX) ** 2)
        smooth /= smooth.sum()
        slope = t * smooth
        slope /= (slope * t).sum()
        image = grey.astype(np.float32)
        parts = (cv2.sepFilter2D(image, cv2.CV_32F, *kernels) for kernels in ((slope, smooth), (smooth, slope)))
        return cls(np.ascontiguousarray(np.stack(tuple(parts), axis=-1), dtype=np.float32))

    def along_normals(self, points_px: Array, normals: Array, offsets_px: Array) -> NDArray[np.float32]:
        """Return the gradient along normals at T offsets from points; 0 outside the image.

        Args:
            points_px: shape (B, N, 2).
            normals: shape (B, N, 2).
            offsets_px: shape (T,).

        Returns:
            float32, shape (B, N, T).
        """
        figures, samples, _ = points_px.shape
        across = normals.astype(np.float32)[..., None]
        places = points_px.astype(np.float32)[..., None] + across * offsets_px.astype(np.float32)
        shape = (figures, samples * offsets_px.size)
        seen = cv2.remap(
            self.gradient,
            np.ascontiguousarray(places[:, :, 0]).reshape(shape),
            np.ascontiguousarray(places[:, :, 1]).reshape(shape),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
        ).reshape(figures, samples, offsets_px.size, 2)
        return np.asarray(seen[..., 0] * across[:, :, 0] + seen[..., 1] * across[:, :, 1], dtype=np.float32)


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
    """One Gauss-Newton iteration of B figures; distances and whether there is an edge have shape (B, 2, N)."""

    steps: Array
    normal_matrices: Array
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
    fits: list[FaceFit | None] = [None] * len(starts)
    if not starts:
        return fits
    outlines = Outlines.of(starts, inclined, effort.samples)
    alive = np.flatnonzero(in_front(outlines, rig))
    if alive.size == 0:
        return fits
    outlines = outlines.only(alive)
    textures = _textures(outlines, fields, rig)
    for half_width_px, scale_px in effort.schedule:
        now = _linearise(outlines, textures, fields, rig, (half_width_px, scale_px, effort.step_px), min_gradient)
        outlines = outlines.moved(now.steps)
        hopeful = np.flatnonzero((now.found.mean(axis=(1, 2)) >= _HOPELESS_SHARE) & in_front(outlines, rig))
        if hopeful.size == 0:
            return fits
        if hopeful.size < alive.size:
            outlines, textures, alive = outlines.only(hopeful), textures[:, hopeful], alive[hopeful]
    last = _linearise(outlines, textures, fields, rig, (*effort.schedule[-1], effort.step_px), min_gradient)
    for number, fit in zip(alive, _judged(outlines, last, rig), strict=True):
        fits[number] = fit
    return fits


def _judged(outlines: Outlines, last: _Linearised, rig: RectifiedRig) -> list[FaceFit]:
    distances = np.where(last.found, np.abs(last.distances_px), _MISSING_PX)
    capped = np.sqrt(np.mean(np.minimum(distances, _SUPPORT_PX) ** 2, axis=(1, 2)))
    noise_px = np.maximum(_EDGE_SIGMA_PX, capped)
    points = outlines.points_mm()
    depth_mm = np.maximum(1.0, rig.base_T_camera.translation_mm[2] - outlines.values[:, 2])
    perimeter_px = np.linalg.norm(np.roll(points, -1, axis=1) - points, axis=2).sum(axis=1) * rig.f_px / depth_mm
    # a sample of a densely sampled outline tells less than one of a sparsely sampled one
    samples_per_one = np.maximum(1.0, outlines.unit.shape[1] * _INDEPENDENT_PX / np.maximum(perimeter_px, 1.0))
    # what is held has no row: 1 on the diagonal keeps the inverse of the rest
    held = np.where(outlines.free, 0.0, 1.0)[:, :, None] * np.eye(outlines.free.shape[1])
    inverse = np.linalg.pinv(last.normal_matrices + held, hermitian=True)
    covariances = inverse[:, :3, :3] * (noise_px**2 * samples_per_one)[:, None, None]
    rms = np.sqrt(np.mean(distances**2, axis=(1, 2)))
    support = (distances < _SUPPORT_PX).mean(axis=2).min(axis=1)
    return [
        FaceFit(face, covariance, float(rms_px), float(share))
        for face, covariance, rms_px, share in zip(outlines.faces(), covariances, rms, support, strict=True)
    ]


def _linearise(
    outlines: Outlines,
    textures: Array,
    fields: tuple[EdgeField, EdgeField],
    rig: RectifiedRig,
    search_px: tuple[float, float, float],
    min_gradient: float,
) -> _Linearised:
    """Measure the edges and solve for a step; ``search_px``: half width, scale of the weight, step of a profile."""
    half_width_px, scale_px, step_px = search_px
    points = rig.camera_T_base.apply(outlines.points_mm())
    along = rig.camera_T_base.rotate(outlines.directions_mm())
    distances, found, jacobians = [], [], []
    for field, texture, shift_mm in zip(fields, textures, (0.0, rig.baseline_mm), strict=True):
        seen = points - (shift_mm, 0.0, 0.0)
        scale = rig.f_px / seen[..., 2:]
        pixels = seen[..., :2] * scale + (rig.cx_px, rig.cy_px)
        flow = along[..., :2] - seen[..., :2] / seen[..., 2:] * along[..., 2:]
        normals = outward_normals(flow, pixels)
        clear = _TEXTURE_FACTOR * texture
        distance, there = _edges(field, outlines, (pixels, normals), (half_width_px, step_px), (min_gradient, clear))
        # how the pixel moves along the normal when the point moves, as a linear function in the base frame
        covectors = np.concatenate(
            [normals, -(normals * seen[..., :2]).sum(axis=-1, keepdims=True) / seen[..., 2:]], axis=-1
        )
        jacobians.append(outlines.change((covectors * scale) @ rig.camera_T_base.rotation))
        distances.append(distance)
        found.append(there)
    distance, there = np.stack(distances, axis=1), np.stack(found, axis=1)
    figures, parameters = outlines.values.shape
    jacobian = np.stack(jacobians, axis=1).reshape(figures, -1, parameters)
    weight = (there / (1.0 + (distance / scale_px) ** 2) ** 2).reshape(figures, -1)
    weighted = np.swapaxes(jacobian * weight[..., None], 1, 2)
    normal_matrices = weighted @ jacobian
    gradients = (weighted @ distance.reshape(figures, -1, 1))[..., 0]
    diagonal = np.einsum("bii->bi", normal_matrices)
    norm = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    scaled = normal_matrices / (norm[:, :, None] * norm[:, None, :])
    scaled = scaled + np.where(diagonal > 0.0, _DAMPING, 1.0)[:, :, None] * np.eye(parameters)
    steps = np.linalg.solve(scaled, (gradients / norm)[..., None])[..., 0] / norm
    return _Linearised(np.clip(steps, -_STEP_LIMITS, _STEP_LIMITS), normal_matrices, distance, there)


def _edges(
    field: EdgeField,
    outlines: Outlines,
    normals_at: tuple[Array, Array],
    search_px: tuple[float, float],
    gradients: tuple[float, Array],
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the signed distance of the edge along each normal, 0 where there is none, and whether there is one.

    Args:
        field: the image's gradient.
        outlines: the figures.
        normals_at: pixels and unit normals of the samples, shape (B, N, 2).
        search_px: half width of the search and step of a profile.
        gradients: least gradient of any edge, and what exceeds each figure's texture, shape (B,).
    """
    half_width_px, step_px = search_px
    min_gradient, clear_gradient = gradients
    reach = round(half_width_px / step_px) + 1
    offsets = np.arange(-reach, reach + 1, dtype=np.float64) * step_px
    size = np.abs(_averaged(field.along_normals(*normals_at, offsets), outlines))
    # an edge is a local maximum, so that the flank of one beyond the window does not count
    inner = size[..., 1:-1]
    peak = (inner >= size[..., :-2]) & (inner > size[..., 2:])
    strongest = (inner * peak).max(axis=-1)
    needed = np.maximum(min_gradient, np.minimum(clear_gradient[:, None], _CLEAR_SHARE * strongest))
    # walking outwards from inside the face its own edge comes first; side face and shadow lie beyond it
    clear = peak & (inner >= needed[..., None])
    best = clear.argmax(axis=-1)[..., None]
    found = np.take_along_axis(clear, best, axis=-1)[..., 0]
    before, at, after = (np.take_along_axis(size, best + ahead, axis=-1)[..., 0] for ahead in (0, 1, 2))
    curvature = np.minimum(before - 2.0 * at + after, -_FLAT)
    place = offsets[best[..., 0] + 1] + np.clip(0.5 * (before - after) / curvature, -0.5, 0.5) * step_px
    return np.where(found, place, 0.0), found


def _averaged(profiles: NDArray[np.float32], outlines: Outlines) -> NDArray[np.float32]:
    """Average each profile with its neighbours on the same side, weights 1 2 1, against noise."""
    before, after = np.roll(profiles, 1, axis=1), np.roll(profiles, -1, axis=1)
    before[outlines.first] = profiles[outlines.first]
    after[outlines.last] = profiles[outlines.last]
    return np.asarray((before + profiles + profiles + after) * np.float32(0.25), dtype=np.float32)


def _textures(outlines: Outlines, fields: tuple[EdgeField, EdgeField], rig: RectifiedRig) -> Array:
    """Return the gradient that each face's own texture reaches in both images, across its outline, shape (2, B)."""
    inside = np.concatenate([outlines.points_mm(share) for share in _INSIDE], axis=1)
    x, y, disparity = rig.project_px(inside)
    centre_x, centre_y, centre_disparity = rig.project_px(outlines.values[:, None, :3])
    found = []
    for field, share in zip(fields, (0.0, 1.0), strict=True):
        pixels = np.stack([x - share * disparity, y], axis=-1)
        rays = pixels - np.stack([centre_x - share * centre_disparity, centre_y], axis=-1)
        rays /= np.maximum(np.linalg.norm(rays, axis=-1, keepdims=True), np.finfo(float).tiny)
        size = np.abs(field.along_normals(pixels, rays, np.zeros(1)))[..., 0]
        found.append(np.quantile(size, _TEXTURE_QUANTILE, axis=1))
    return np.stack(found)
