"""Step 11b, beyond edges: fit a top face to the grey values across its outline in both images at once.

Across the border of a top face the grey value goes from that of the face to that of its side face, as far as this is
seen, and on to that of what lies behind. The width of the visible side face follows from the face's height over the
table, so that a sliver of a pixel is told from the face itself; levels and geometry are estimated together (variable
projection), which uses all of the picture's evidence: faint borders, too, that show no edge at any single place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.special import ndtr

from srvs_cell.vision.face_fit import FaceFit
from srvs_cell.vision.outlines import Outlines

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces import Face
    from srvs_cell.vision.rectification import RectifiedRig

_SAMPLES = 96
_GROUPS = 12
"""Stretches of the outline that have grey levels of their own: three of a rectangle's side, two of a hexagon's."""
_OFFSETS_PX = np.arange(-4.0, 3.5, 1.0)
BLURS_PX = (0.4, 0.55, 0.7, 0.85, 1.0, 1.2)
"""Standard deviations that the picture of a sharp border may have: lens, pixel and rectification."""
_USUAL_BLUR_PX = 0.85
_COARSE = 2.0
"""A border so many times wider than the picture's reaches farther."""
_SIDE_SIGMA = 60.0
"""Grey values by which a side face may differ from what lies behind it."""
_ROBUST_SIGMA = 3.0
_ROBUST_SHARE = 0.1
"""Share of a stretch's contrast that the picture may deviate from the model like noise."""
_STEP_LIMITS = np.array([6.0, 6.0, 12.0, 6.0, 0.15, 6.0, 0.3])
_DAMPING = 1e-4
_SEEN_SIGMA = 4.0
"""A border whose step is less than so many standard deviations of its noise is not seen."""
_MIN_SIGMA = 0.5
_LOST_PX = 2.0
"""What a sample counts at most whose profile is another border's."""
_LAPLACIAN = float(np.sqrt(6.0))
_MAD = 1.4826
_INVSQRT = 1.0 / float(np.sqrt(2.0 * np.pi))
_LEVELS = 5
"""Levels of a stretch: face and background in each image, side face in both."""


SCOUT = (_COARSE, _COARSE)
"""Shows whether a start leads anywhere."""
REACH = (_COARSE, _COARSE, 1.0, 1.0, 1.0, 1.0)
"""From a start a few pixels off."""
SETTLE = (1.0, 1.0, 1.0, 1.0, 1.0)
"""From where the edges led."""


@dataclass(frozen=True, eq=False)
class Pictures:
    """Both rectified images as the fit needs them.

    Attributes:
        images: left and right, float32, shape (H, W).
        noise: standard deviation of the grey values.
        blur_px: standard deviation of the picture of a sharp border.
    """

    images: tuple[NDArray[np.float32], NDArray[np.float32]]
    noise: float
    blur_px: float = _USUAL_BLUR_PX

    @classmethod
    def of(cls, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Pictures:
        """Take two rectified images and measure their noise by second differences along the rows."""
        images = (left.astype(np.float32), right.astype(np.float32))
        bends = [np.abs(image[:, :-2] - 2.0 * image[:, 1:-1] + image[:, 2:]) for image in images]
        noise = max(float(np.median(bend)) * _MAD / _LAPLACIAN for bend in bends)
        return cls(images, max(noise, _MIN_SIGMA))


def measure_blur(faces: Sequence[Face], pictures: Pictures, rig: RectifiedRig, table_z_mm: float) -> float:
    """Return which blur explains the borders of well known faces best, pixels; the usual one where there are none."""
    if not faces:
        return _USUAL_BLUR_PX
    outlines = Outlines.of(faces, [False] * len(faces), _SAMPLES, equal_sides=True)
    return min(BLURS_PX, key=lambda blur: float(_compared(outlines, pictures, rig, table_z_mm, blur).energy.sum()))


def fit_profiles(
    starts: Sequence[Face],
    inclined: Sequence[bool],
    pictures: Pictures,
    rig: RectifiedRig,
    table_z_mm: float,
    effort: Sequence[float] = SETTLE,
) -> list[FaceFit]:
    """Fit faces to the grey values across their outlines, each for itself.

    Args:
        starts: where to begin, a few pixels from the face's borders.
        inclined: whether the slope along a rectangle's length is free.
        pictures: the rectified images.
        rig: the rectified cameras.
        table_z_mm: height of the table, base frame.
        effort: width of the model's border over the picture's in each iteration; wide ones reach farther.

    Returns:
        A fit for each start; its ``rms_px`` is the displacement of the borders that would cause the misfit, its
        ``support`` the share of the outline that is seen in both images.
    """
    if not starts:
        return []
    outlines = Outlines.of(starts, inclined, _SAMPLES, equal_sides=True)
    for width in effort:
        outlines = outlines.moved(_compared(outlines, pictures, rig, table_z_mm, width * pictures.blur_px).steps)
    last = _compared(outlines, pictures, rig, table_z_mm, effort[-1] * pictures.blur_px)
    return [
        FaceFit(face, covariance, float(rms_px), float(support))
        for face, covariance, rms_px, support in zip(
            outlines.faces(), last.covariances, last.rms_px, last.support, strict=True
        )
    ]


@dataclass(frozen=True, eq=False)
class _Compared:
    """One iteration of B faces: steps (B, 7), covariances of the centres (B, 3, 3), misfits, support, squared residuals (B,)."""

    steps: Array
    covariances: Array
    rms_px: Array
    support: Array
    energy: Array


def _compared(
    outlines: Outlines, pictures: Pictures, rig: RectifiedRig, table_z_mm: float, blur_px: float
) -> _Compared:
    values, basis, by_shift, geometry, weight = [], [], [], [], []
    points_mm = outlines.points_mm()
    feet_mm = points_mm * (1.0, 1.0, 0.0) + (0.0, 0.0, table_z_mm)
    points, feet = rig.camera_T_base.apply(points_mm), rig.camera_T_base.apply(feet_mm)
    along = rig.camera_T_base.rotate(outlines.directions_mm())
    faces, samples = points.shape[:2]
    per_group = samples // _GROUPS
    for image, shift_mm in zip(pictures.images, (0.0, rig.baseline_mm), strict=True):
        seen, foot = points - (shift_mm, 0.0, 0.0), feet - (shift_mm, 0.0, 0.0)
        scale = rig.f_px / np.maximum(seen[..., 2:], 1.0)
        pixels = seen[..., :2] * scale + (rig.cx_px, rig.cy_px)
        foot_px = foot[..., :2] * (rig.f_px / np.maximum(foot[..., 2:], 1.0)) + (rig.cx_px, rig.cy_px)
        flow = along[..., :2] - seen[..., :2] / seen[..., 2:] * along[..., 2:]
        normals = _outward(flow, pixels)
        # as much of the side face shows as its foot lies outside of the face
        side_px = np.maximum(((foot_px - pixels) * normals).sum(axis=-1), 0.0)
        places = pixels[:, :, None, :] + normals[:, :, None, :] * _OFFSETS_PX[:, None]
        flat = places.reshape(faces, -1, 2).astype(np.float32)
        grey = cv2.remap(
            image,
            np.ascontiguousarray(flat[..., 0]),
            np.ascontiguousarray(flat[..., 1]),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        ).reshape(faces, samples, -1)
        inside = (places >= 0.0).all(axis=-1) & (places <= (image.shape[1] - 1.0, image.shape[0] - 1.0)).all(axis=-1)
        first = _OFFSETS_PX / blur_px
        second = (_OFFSETS_PX - side_px[..., None]) / blur_px
        beyond_face, beyond_side = np.broadcast_to(ndtr(first), grey.shape), ndtr(second)
        peak_face = np.broadcast_to(np.exp(-0.5 * first**2) * (_INVSQRT / blur_px), grey.shape)
        peak_side = np.exp(-0.5 * second**2) * (_INVSQRT / blur_px)
        values.append(grey)
        basis.append((1.0 - beyond_face, beyond_side, beyond_face - beyond_side))
        by_shift.append((peak_face, -peak_side, peak_side - peak_face))
        covectors = np.concatenate(
            [normals, -(normals * seen[..., :2]).sum(axis=-1, keepdims=True) / seen[..., 2:]], axis=-1
        )
        geometry.append(outlines.change((covectors * scale) @ rig.camera_T_base.rotation))
        spacing = np.linalg.norm(np.roll(pixels, -1, axis=1) - pixels, axis=-1)
        weight.append(inside * np.minimum(np.median(spacing, axis=1), 1.0)[:, None, None])
    # (B, groups, image, samples of a group, offsets)
    shape = (faces, _GROUPS, 2, per_group, _OFFSETS_PX.size)

    def grouped(parts: Sequence[Array]) -> Array:
        stacked = np.stack(parts, axis=1).reshape(faces, 2, _GROUPS, per_group, -1)
        return np.swapaxes(stacked, 1, 2)

    grey = grouped(values)
    weights = grouped(weight)
    levels = np.zeros((*shape, _LEVELS))
    slopes = np.zeros((*shape, _LEVELS))
    for number in range(2):
        for place, level in enumerate((2 * number, 2 * number + 1, 4)):
            levels[:, :, number, ..., level] = grouped([one[place] for one in basis])[:, :, number]
            slopes[:, :, number, ..., level] = grouped([one[place] for one in by_shift])[:, :, number]
    rows = (faces, _GROUPS, 2 * per_group * _OFFSETS_PX.size)
    x = levels.reshape(*rows, _LEVELS)
    y, w0 = grey.reshape(rows), weights.reshape(rows)
    w = w0
    noise2 = pictures.noise**2
    ridge = np.zeros((_LEVELS, _LEVELS))
    # a side face that is hidden has no level: it is held to that of the background
    tie = np.array([0.0, -0.5, 0.0, -0.5, 1.0])
    ridge += np.outer(tie, tie) * noise2 / _SIDE_SIGMA**2 + np.eye(_LEVELS) * 1e-6
    found = np.zeros((faces, _GROUPS, _LEVELS))
    residual = y
    for _ in range(3):
        xw = x * w[..., None]
        normal = np.swapaxes(xw, -1, -2) @ x + ridge
        found = np.linalg.solve(normal, np.swapaxes(xw, -1, -2) @ y[..., None])[..., 0]
        residual = y - (x @ found[..., None])[..., 0]
        contrast = np.ptp(found, axis=-1)
        limit = np.maximum(_ROBUST_SIGMA * pictures.noise, _ROBUST_SHARE * contrast)[..., None]
        w = w0 / (1.0 + (residual / limit) ** 2) ** 2
    gradient = (slopes.reshape(*rows, _LEVELS) @ found[..., None])[..., 0].reshape(shape)
    change = grouped(geometry).reshape(faces, _GROUPS, 2, per_group, 1, -1)
    jacobian = (gradient[..., None] * change).reshape(*rows, -1)
    xw = x * w[..., None]
    jw = jacobian * w[..., None]
    cross = np.swapaxes(xw, -1, -2) @ jacobian
    normal = np.swapaxes(xw, -1, -2) @ x + ridge
    schur = (np.swapaxes(jw, -1, -2) @ jacobian - np.swapaxes(cross, -1, -2) @ np.linalg.solve(normal, cross)).sum(
        axis=1
    )
    vector = (np.swapaxes(jw, -1, -2) @ residual[..., None]).sum(axis=1)[..., 0]
    diagonal = np.einsum("bii->bi", schur)
    norm = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    scaled = schur / (norm[:, :, None] * norm[:, None, :])
    held = np.where(diagonal > 0.0, _DAMPING, 1.0)
    scaled = scaled + held[:, :, None] * np.eye(scaled.shape[-1])
    steps = np.linalg.solve(scaled, (vector / norm)[..., None])[..., 0] / norm
    covariances = np.linalg.inv(scaled) / (norm[:, :, None] * norm[:, None, :])
    sampled = (faces, _GROUPS, 2, per_group, _OFFSETS_PX.size)
    energy = (w0 * np.minimum(np.abs(residual), 2.0 * limit) ** 2).sum(axis=(1, 2))
    size = w0.reshape(sampled).sum(axis=-1)
    squares = (w0 * residual**2).reshape(sampled).sum(axis=-1)
    steepness = (w0 * gradient.reshape(rows) ** 2).reshape(sampled).sum(axis=-1)
    # what a sample's misfit amounts to as a displacement of its border
    excess = np.maximum(squares - size * noise2, 0.0)
    usual = np.median(steepness.reshape(faces, -1), axis=1)[:, None, None, None]
    displaced2 = np.minimum(excess / np.maximum(np.maximum(steepness, 0.3 * usual), 1e-9), _LOST_PX**2)
    weights = size / np.maximum(size.sum(axis=(1, 2, 3), keepdims=True), 1e-9)
    rms_px = np.sqrt((weights * displaced2).sum(axis=(1, 2, 3)))
    excess = np.maximum(1.0, energy / np.maximum(size.sum(axis=(1, 2, 3)) * noise2, 1e-9))
    support = (np.sqrt(steepness.sum(axis=-1)) > _SEEN_SIGMA * pictures.noise).mean(axis=1).min(axis=1)
    return _Compared(
        np.clip(steps, -_STEP_LIMITS, _STEP_LIMITS),
        covariances[:, :3, :3] * (noise2 * excess)[:, None, None],
        rms_px,
        support,
        energy,
    )


def _outward(along: Array, pixels: Array) -> Array:
    """Return the unit normals of outlines that point away from their middles, shape (B, N, 2)."""
    normals = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), np.finfo(float).tiny)
    inward = ((pixels - pixels.mean(axis=1, keepdims=True)) * normals).sum(axis=-1, keepdims=True) < 0.0
    return np.where(inward, -normals, normals)
