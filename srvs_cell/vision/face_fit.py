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

from srvs_cell.vision.faces import Figure

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array, Transform
    from srvs_cell.vision.faces import Face
    from srvs_cell.vision.rectification import RectifiedRig

_SMOOTHING_PX = 1.0
_SAMPLE_STEP_PX = 0.5
_SAMPLE_SPACING_PX = 2.5
_SIDE_SAMPLES_MIN, _SIDE_SAMPLES_MAX = 8, 32
_ALONG = np.array([1.0, 2.0, 1.0]) / 4.0
"""Weights that average neighbouring profiles of one side against noise."""
_CLEAR_SHARE = 0.15
"""An edge is never asked to have more than this share of the strongest gradient in its window."""
_TEXTURE_FACTOR = 2.0
"""An edge must exceed the face's own texture by this factor."""
_TEXTURE_QUANTILE = 0.9
_INSIDE = (0.25, 0.45, 0.65)
"""Where, as shares of the way from centre to outline, the texture is measured."""
_SCHEDULE = ((6.0, 4.0), (6.0, 3.0), (5.0, 2.0), (4.0, 1.5), (3.0, 1.0), (3.0, 0.7), (2.5, 0.5), (2.5, 0.3), (2.5, 0.3))
"""Half width of the search and scale of the robust weight in each iteration, pixels."""
_SCOUTS = 4
"""Iterations after which it shows whether a start leads anywhere."""
_FLAT = 1e-9
"""Curvature of a profile that has no peak, so that the parabola stays defined."""
_MISSING_PX = 3.0
_HOPELESS_SHARE = 0.5
"""Where less of the outline has an edge, the fit is given up."""
_SUPPORT_PX = 1.0
_DAMPING = 1e-6
_STEP_LIMITS = (12.0, 12.0, 12.0, 12.0, 0.3, 12.0, 0.4)
_EDGE_SIGMA_PX = 0.05
"""Least standard deviation of one edge sample (references/vision.md C: a sober practical limit)."""
_CORRELATED_SAMPLES = 4.0
"""Neighbouring samples share pixels, so that this many count as one."""


@dataclass(frozen=True, eq=False)
class EdgeField:
    """The grey gradient of an image, smoothed: float32, shape (H, W) each."""

    gradient_x: NDArray[np.float32]
    gradient_y: NDArray[np.float32]

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
        return cls(
            np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, slope, smooth), dtype=np.float32),
            np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, smooth, slope), dtype=np.float32),
        )

    def along_normals(self, points_px: Array, normals: Array, offsets_px: Array) -> Array:
        """Return the gradient along the normals, shape (N, T), at T offsets from N points; 0 outside the image."""
        x = (points_px[:, :1] + normals[:, :1] * offsets_px).astype(np.float32)
        y = (points_px[:, 1:] + normals[:, 1:] * offsets_px).astype(np.float32)
        along_x = cv2.remap(self.gradient_x, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        along_y = cv2.remap(self.gradient_y, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        return np.asarray(along_x * normals[:, :1] + along_y * normals[:, 1:], dtype=np.float64)


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
class _Outline:
    """Where a figure's outline is sampled, and whether its slopes are free."""

    unit: Array
    tangents: Array
    neighbours: NDArray[np.int_]
    inclined: bool


@dataclass(frozen=True, eq=False)
class _Seeker:
    """Finds edges in one image.

    Attributes:
        field: the image's gradient.
        min_gradient: least gradient of any edge.
        texture: gradient that the face's own texture reaches.
    """

    field: EdgeField
    min_gradient: float
    texture: float

    def edges(
        self, points_px: Array, normals: Array, neighbours: NDArray[np.int_], half_width_px: float
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Return the signed distance of the edge along each normal, 0 where there is none, and whether there is one."""
        reach = round(half_width_px / _SAMPLE_STEP_PX) + 1
        offsets = np.arange(-reach, reach + 1, dtype=np.float64) * _SAMPLE_STEP_PX
        profiles = self.field.along_normals(points_px, normals, offsets)
        size = np.abs(np.einsum("k,nkt->nt", _ALONG, profiles[neighbours]))
        # an edge is a local maximum, so that the flank of one beyond the window does not count
        peak = np.zeros_like(size, dtype=bool)
        peak[:, 1:-1] = (size[:, 1:-1] >= size[:, :-2]) & (size[:, 1:-1] > size[:, 2:])
        strongest = (size * peak).max(axis=1, keepdims=True)
        least = np.maximum(self.min_gradient, np.minimum(_TEXTURE_FACTOR * self.texture, _CLEAR_SHARE * strongest))
        # walking outwards from inside the face its own edge comes first; side face and shadow lie beyond it
        clear = peak & (size >= least)
        best = clear.argmax(axis=1)
        rows = np.arange(best.size)
        found = clear[rows, best]
        best = np.clip(best, 1, offsets.size - 2)
        before, at, after = size[rows, best - 1], size[rows, best], size[rows, best + 1]
        curvature = np.minimum(before - 2.0 * at + after, -_FLAT)
        place = offsets[best] + np.clip(0.5 * (before - after) / curvature, -0.5, 0.5) * _SAMPLE_STEP_PX
        return np.where(found, place, 0.0), found


@dataclass(frozen=True, eq=False)
class _Linearised:
    """One Gauss-Newton iteration."""

    step: Array
    normal_matrix: Array
    residuals_px: Array
    found: NDArray[np.bool_]


def fit_best_face(
    starts: Iterable[Face],
    fields: tuple[EdgeField, EdgeField],
    rig: RectifiedRig,
    *,
    inclined: bool,
    min_gradient: float,
) -> FaceFit | None:
    """Try several starts for a few iterations and fit the one that leads nearest to the edges; see `fit_face`."""
    best: FaceFit | None = None
    for start in starts:
        scout = _fit(start, fields, rig, _SCHEDULE[:_SCOUTS], inclined=inclined, min_gradient=min_gradient)
        if scout is not None and (best is None or scout.rms_px < best.rms_px):
            best = scout
    if best is None:
        return None
    return _fit(best.face, fields, rig, _SCHEDULE[_SCOUTS:], inclined=inclined, min_gradient=min_gradient)


def fit_face(
    start: Face, fields: tuple[EdgeField, EdgeField], rig: RectifiedRig, *, inclined: bool, min_gradient: float
) -> FaceFit | None:
    """Fit a face to the edges of both images.

    Args:
        start: where to begin; within about six pixels of the edges.
        fields: gradients of the rectified left and right image.
        rig: the rectified cameras.
        inclined: whether the slope along a rectangle's length is free.
        min_gradient: least gradient of an edge, grey values per pixel.

    Returns:
        The fit, or None where the outline leaves the view or the edges do not determine it.
    """
    return _fit(start, fields, rig, _SCHEDULE, inclined=inclined, min_gradient=min_gradient)


def _fit(
    start: Face,
    fields: tuple[EdgeField, EdgeField],
    rig: RectifiedRig,
    schedule: tuple[tuple[float, float], ...],
    *,
    inclined: bool,
    min_gradient: float,
) -> FaceFit | None:
    face = start
    counts = _side_samples(face, rig)
    unit, tangents = face.unit_outline(counts)
    outline = _Outline(unit, tangents, _neighbours(counts), inclined=inclined)
    seekers = tuple(
        _Seeker(field, min_gradient, texture)
        for field, texture in zip(fields, _textures(face, unit, fields, rig), strict=True)
    )
    camera_T_base = rig.base_T_camera.inverse()
    for half_width_px, scale_px in schedule:
        now = _linearise(face, outline, seekers, rig, camera_T_base, half_width_px, scale_px)
        if now is None or now.found.mean() < _HOPELESS_SHARE:
            return None
        face = face.with_parameters(face.parameters(inclined=inclined) + now.step)
    last = _linearise(face, outline, seekers, rig, camera_T_base, *schedule[-1])
    if last is None:
        return None
    distances = np.where(last.found, np.abs(last.residuals_px), _MISSING_PX)
    noise_px = max(_EDGE_SIGMA_PX, float(np.sqrt(np.mean(np.minimum(distances, _SUPPORT_PX) ** 2))))
    covariance = np.linalg.pinv(last.normal_matrix) * noise_px**2 * _CORRELATED_SAMPLES
    near = (distances < _SUPPORT_PX).reshape(2, -1)
    return FaceFit(
        face,
        np.asarray(covariance[:3, :3], dtype=np.float64),
        float(np.sqrt(np.mean(distances**2))),
        float(near.mean(axis=1).min()),
    )


def _linearise(
    face: Face,
    outline: _Outline,
    seekers: tuple[_Seeker, ...],
    rig: RectifiedRig,
    camera_T_base: Transform,
    half_width_px: float,
    scale_px: float,
) -> _Linearised | None:
    points = camera_T_base.apply(face.place(outline.unit))
    if points[:, 2].min() <= 0.0:
        return None
    along = camera_T_base.rotate(face.turn(outline.tangents))
    changes = camera_T_base.rotate(face.derivatives(outline.unit, inclined=outline.inclined))
    residuals, weights, jacobians = [], [], []
    for seeker, shift_mm in zip(seekers, (0.0, rig.baseline_mm), strict=True):
        seen = points - (shift_mm, 0.0, 0.0)
        pixels = seen[:, :2] * (rig.f_px / seen[:, 2:]) + (rig.cx_px, rig.cy_px)
        normals = _outward(_flow(seen, along, rig.f_px), pixels)
        offsets, found = seeker.edges(pixels, normals, outline.neighbours, half_width_px)
        weights.append(found / (1.0 + (offsets / scale_px) ** 2) ** 2)
        residuals.append(offsets)
        jacobians.append(
            np.stack([(_flow(seen, change, rig.f_px) * normals).sum(axis=1) for change in changes], axis=1)
        )
    residual, weight, jacobian = np.concatenate(residuals), np.concatenate(weights), np.concatenate(jacobians)
    normal_matrix = jacobian.T @ (jacobian * weight[:, None])
    scale = np.sqrt(np.diag(normal_matrix))
    if not (scale > 0.0).all():
        return None
    scaled = normal_matrix / np.outer(scale, scale) + _DAMPING * np.eye(scale.size)
    step = np.linalg.solve(scaled, jacobian.T @ (residual * weight) / scale) / scale
    limits = np.array(_STEP_LIMITS[: step.size])
    return _Linearised(np.clip(step, -limits, limits), normal_matrix, residual, weight > 0.0)


def _flow(seen_mm: Array, change_mm: Array, f_px: float) -> Array:
    """Return how the pixels of points move when the points change, shape (N, 2)."""
    depth = seen_mm[:, 2:]
    return f_px * (change_mm[:, :2] - seen_mm[:, :2] / depth * change_mm[:, 2:]) / depth


def _outward(along: Array, pixels: Array) -> Array:
    """Return the unit normals of an outline that point away from its middle, shape (N, 2)."""
    normals = np.column_stack([along[:, 1], -along[:, 0]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    inward = ((pixels - pixels.mean(axis=0)) * normals).sum(axis=1) < 0.0
    normals[inward] *= -1.0
    return normals


def _side_samples(face: Face, rig: RectifiedRig) -> NDArray[np.int_]:
    depth_mm = max(1.0, float(rig.base_T_camera.translation_mm[2] - face.z_mm))
    sides_px = face.side_lengths_mm() * rig.f_px / depth_mm
    most = _SIDE_SAMPLES_MAX * (3 if face.figure is Figure.CIRCLE else 1)
    return np.clip(sides_px / _SAMPLE_SPACING_PX, _SIDE_SAMPLES_MIN, most).astype(np.int_)


def _textures(face: Face, unit: Array, fields: tuple[EdgeField, EdgeField], rig: RectifiedRig) -> tuple[float, float]:
    """Return the gradient that the face's own texture reaches in both images, seen across the outline."""
    inside = np.concatenate([unit * share for share in _INSIDE])
    x, y, disparity = rig.project_px(face.place(inside))
    centre_x, centre_y, centre_disparity = rig.project_px(face.place(np.zeros((1, 2))))
    found = []
    for field, share in zip(fields, (0.0, 1.0), strict=True):
        pixels = np.column_stack([x - share * disparity, y])
        rays = pixels - np.column_stack([centre_x - share * centre_disparity, centre_y])
        rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), np.finfo(float).tiny)
        size = np.abs(field.along_normals(pixels, rays, np.zeros(1)))
        found.append(float(np.quantile(size, _TEXTURE_QUANTILE)))
    return found[0], found[1]


def _neighbours(counts: NDArray[np.int_]) -> NDArray[np.int_]:
    """Return for each sample the samples that its profile is averaged with: neighbours on the same side, (N, 3)."""
    reach = _ALONG.size // 2
    starts = np.cumsum(counts) - counts
    return np.concatenate(
        [
            start + np.clip(np.arange(count)[:, None] + np.arange(-reach, reach + 1), 0, count - 1)
            for start, count in zip(starts, counts, strict=True)
        ]
    )
