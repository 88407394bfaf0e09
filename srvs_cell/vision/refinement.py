"""Step 9, beyond the paper: photometric alignment of a plane.

In a rectified pair the disparity of a flat face is affine, d = a x + b y + c. Gauss-Newton finds the a, b, c, with a
gain and an offset of the brightness, for which the right image's grey values, shifted by d, are the left image's over
the face. Its border is included: the edge of a face moves with the face.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.linalg.lapack import dgesv

from srvs_cell.vision.edges import smooth
from srvs_cell.vision.median import median

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.scene import DisparityPlane, Plane, PlaneImage, PlaneMatch
    from srvs_cell.vision.parameters import RefinementParameters

SMOOTHING_PX = 1.0
_SLOPE = np.array([[-0.5, 0.0, 0.5]], dtype=np.float32)
_SLOPE_SIGMA = 0.05
_NOISE_GREY = 1.0
_TUKEY = 4.685
_MAD_TO_SIGMA = 1.4826
_EVEN = np.ones(1, dtype=np.float32)
"""The spread of the residuals where the surface is smooth: the same for all."""
_CONVERGED_PX = 0.005
_MIN_PIXELS = 12
_CORRELATED_PIXELS = 12.0
"""Smoothing makes so many neighbouring pixels count as one."""
_LEAST_SIGMA_PX = 0.02
_CONVINCING = 0.97
_GAIN, _OFFSET, _ROW = 3, 4, 5
"""The numbers of what is solved for besides the plane; the last one only where rows may be apart."""
_LEVEL_STEP_PX = 0.5
_ROUGH_PIXELS = 500
"""So many pixels tell which of several starts is the best."""
_MIN_CONTRAST = 5.0
"""Standard deviation in grey values below which the noise spoils the correlation."""
_RANGE_MARGIN_PX = 1.0


@dataclass(frozen=True, eq=False)
class GreyPair:
    """Two smoothed rectified images and the left one's derivative along the rows, each float32, shape (H, W)."""

    left: NDArray[np.float32]
    right: NDArray[np.float32]
    left_x: NDArray[np.float32]

    @cached_property
    def left_y(self) -> NDArray[np.float32]:
        """The left image's derivative along the columns, float32, shape (H, W)."""
        return np.asarray(cv2.filter2D(self.left, cv2.CV_32F, _SLOPE.T), dtype=np.float32)

    @classmethod
    def of(cls, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> GreyPair:
        """Prepare two grey images, uint8, shape (H, W)."""
        smoothed = smooth(left, SMOOTHING_PX)
        slope = cv2.filter2D(smoothed, cv2.CV_32F, _SLOPE)
        return cls(smoothed, smooth(right, SMOOTHING_PX), np.asarray(slope, dtype=np.float32))


@dataclass(frozen=True)
class Alignment:
    """A plane after the alignment.

    Attributes:
        plane: (a, b, c).
        sigma_px: standard deviation of the disparity in the middle of the pixels used.
        correlation: of the left and the aligned right grey values, -1 to 1.
        contrast: standard deviation of the left grey values: without contrast there is no correlation.
    """

    plane: DisparityPlane
    sigma_px: float
    correlation: float
    contrast: float


def refine_matches(
    left: PlaneImage,
    matches: Sequence[PlaneMatch],
    pair: GreyPair,
    disparity_range_px: tuple[float, float],
    parameters: RefinementParameters,
) -> list[PlaneMatch]:
    """Align every match; drop those whose grey values disagree or whose disparity is out of range.

    A face without contrast, and one that cannot be aligned though its grey values agree, keeps the plane that its
    borders gave.
    """
    low, high = disparity_range_px
    refined = []
    for match in matches:
        plane = left.planes[match.left - 1]
        rows, columns = _with_band(left, plane, parameters.band_px)
        alignment = _best_alignment(pair, rows, columns, match, plane.centre_px, parameters)
        if alignment is None:
            alignment = _unaligned(pair, rows, columns, match)
        better = match
        if alignment.correlation >= parameters.min_correlation:
            x, y = plane.centre_px
            a, b, c = alignment.plane
            better = replace(
                match,
                disparity_px=a * x + b * y + c,
                disparity_plane=alignment.plane,
                disparity_sigma_px=alignment.sigma_px,
            )
        elif alignment.contrast > _MIN_CONTRAST:
            continue
        if low - _RANGE_MARGIN_PX <= better.disparity_px <= high + _RANGE_MARGIN_PX:
            refined.append(better)
    return refined


def _best_alignment(
    pair: GreyPair,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    match: PlaneMatch,
    centre_px: tuple[float, float],
    parameters: RefinementParameters,
) -> Alignment | None:
    """Align from the plane of the borders and, where that does not convince, from level planes around it.

    The borders of a face that another one partly hides do not correspond, and give a false slope.
    """
    found = align_plane(pair, rows, columns, match.disparity_plane, parameters)
    if found is not None and found.correlation >= _CONVINCING:
        return found
    x, y = centre_px
    a, b, c = match.disparity_plane
    level = _best_level(pair, rows, columns, a * x + b * y + c, parameters.max_shift_px)
    again = align_plane(pair, rows, columns, (0.0, 0.0, level), parameters)
    return max((each for each in (found, again) if each is not None), key=_correlation_of, default=None)


def _unaligned(pair: GreyPair, rows: NDArray[np.intp], columns: NDArray[np.intp], match: PlaneMatch) -> Alignment:
    """Return how well the grey values agree where the plane of the borders puts them."""
    design = np.stack([columns, rows, np.ones(rows.size)]).astype(np.float32)
    seen, inside = _Samples.of(pair, rows, columns).at(np.array(match.disparity_plane), design)
    correlation, contrast = _correlation(pair.left[rows, columns][inside], seen[inside])
    return Alignment(match.disparity_plane, match.disparity_sigma_px, correlation, contrast)


def _best_level(
    pair: GreyPair, rows: NDArray[np.intp], columns: NDArray[np.intp], middle_px: float, max_shift_px: float
) -> float:
    """Return the constant disparity near ``middle_px`` at which the grey values correlate best."""
    stride = max(1, rows.size // _ROUGH_PIXELS)
    rows, columns = rows[::stride], columns[::stride]
    levels = middle_px + np.arange(-max_shift_px, max_shift_px + _LEVEL_STEP_PX, _LEVEL_STEP_PX)
    level = np.ones((1, rows.size), dtype=np.float32)
    seen, inside = _Samples.of(pair, rows, columns).at(levels[:, None], level)
    target = pair.left[rows, columns]
    counted = np.maximum(inside.sum(axis=1, keepdims=True), 1)
    one = (target - (target * inside).sum(axis=1, keepdims=True) / counted) * inside
    other = (seen - (seen * inside).sum(axis=1, keepdims=True) / counted) * inside
    norm = np.sqrt((one**2).sum(axis=1) * (other**2).sum(axis=1))
    return float(levels[np.argmax((one * other).sum(axis=1) / np.maximum(norm, _NOISE_GREY))])


def _correlation_of(alignment: Alignment) -> float:
    return alignment.correlation


def _with_band(image: PlaneImage, plane: Plane, band_px: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows and columns of a plane's pixels and of a band around it."""
    x, y, width, height = plane.box_px
    top, left = max(y - band_px, 0), max(x - band_px, 0)
    window = image.labels[top : y + height + band_px, left : x + width + band_px]
    mask = (window == plane.id).view(np.uint8)
    if band_px:
        mask = np.asarray(cv2.dilate(mask, np.ones((2 * band_px + 1, 2 * band_px + 1), np.uint8)), dtype=np.uint8)
    rows, columns = np.nonzero(mask.view(np.bool_))
    return rows + top, columns + left


def align_plane(
    pair: GreyPair,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    start: DisparityPlane,
    parameters: RefinementParameters,
    roughness_px: float = 0.0,
    row_sigma_px: float = 0.0,
) -> Alignment | None:
    """Align a plane over some pixels of the left image.

    Args:
        pair: the prepared images.
        rows: of the pixels, shape (N,).
        columns: of the pixels, shape (N,).
        start: (a, b, c) to begin with, right to about a pixel.
        parameters: number of steps, pixels used, greatest shift.
        roughness_px: standard deviation of the surface's own disparities from a plane. A sharp edge tells no more of
            the plane than this, so that paper that curls is levelled over its area and not over its boldest print.
        row_sigma_px: standard deviation of what the rows of the two images are apart, which is found too; 0 where they
            are the same. Rows that are apart shift an inclined edge along the rows, as a disparity does.

    Returns:
        The alignment, or None where too few pixels lie in both images, the plane moved too far, or explains the pixels
        no better than it did to begin with.
    """
    if rows.size < _MIN_PIXELS:
        return None
    stride = math.ceil(rows.size / parameters.max_pixels)
    rows, columns = rows[::stride], columns[::stride]
    middle_x, middle_y = int(columns.sum()) / columns.size, int(rows.sum()) / rows.size
    a, b, c = start
    first_level = a * middle_x + b * middle_y + c
    design = np.ones((3, rows.size), dtype=np.float32)
    design[0], design[1] = columns - middle_x, rows - middle_y
    samples = _Samples.of(pair, rows, columns)
    place = samples.row_start + columns
    target, slope = pair.left.ravel().take(place), pair.left_x.ravel().take(place)
    # without contrast nothing but this holds the plane
    held = (_NOISE_GREY / _SLOPE_SIGMA) ** 2
    row_held = [(_NOISE_GREY / row_sigma_px) ** 2] if row_sigma_px else []
    prior = np.array([held, held, (_NOISE_GREY / parameters.max_shift_px) ** 2, 1e-3, 1e-3, *row_held])
    expected = np.zeros(prior.size)
    expected[2:4] = first_level, 1.0
    solution = expected.copy()
    solution[:2] = a, b
    # what the prediction changes by with a, b, level (all three by -gain times this), gain, offset and row
    basis = np.ones((solution.size, rows.size), dtype=np.float32)
    basis[:3] = slope * design
    if row_sigma_px:
        basis[_ROW] = pair.left_y.ravel().take(place)
    moved = np.ones(solution.size)
    seen_first, inside_first = seen, inside = samples.at(solution[:3], design)
    for _ in range(parameters.iterations):
        if np.count_nonzero(inside) < _MIN_PIXELS:
            return None
        gain = np.float32(solution[_GAIN])
        residual = target - _predicted(solution, basis, seen)
        residual *= inside
        scale = max(_NOISE_GREY, _MAD_TO_SIGMA * median(np.abs(residual)))
        # in units of the noise: what the surface's roughness makes of a slope adds to it
        spread = 1.0 + np.square(np.float32(roughness_px / scale) * gain * slope) if roughness_px else _EVEN
        weight = _tukey(residual / np.float32(_TUKEY * scale), spread)
        weight *= weight
        weight *= inside / spread
        basis[3] = seen
        # d moves the sample against x
        moved[:3] = -gain
        weighted = basis * weight
        normal = (weighted @ basis.T) * np.multiply.outer(moved, moved)
        normal.flat[:: solution.size + 1] += prior
        _, _, step, _ = dgesv(normal, (weighted @ residual) * moved - prior * (solution - expected))
        step[:3] *= min(1.0, 1.0 / max(abs(float(step[2])), 1e-9))
        solution = solution + step
        seen, inside = samples.at(solution[:3], design)
        if abs(float(step[2])) < _CONVERGED_PX:
            break
    if abs(solution[2] - first_level) > parameters.max_shift_px or not np.isfinite(solution).all():
        return None
    predicted, both = _predicted(solution, basis, seen), inside & inside_first
    units = np.float32(_TUKEY * scale)
    before, same_light, after = (
        _robust_cost(np.asarray((target - each) / units, dtype=np.float32), spread, both)
        for each in (seen_first, _predicted(solution, basis, seen_first), predicted)
    )
    if after > min(before, same_light):
        return None
    variance = float(weight @ np.square(residual) / max(weight.sum(), 1.0))
    _, _, inverse, _ = dgesv(normal, np.eye(solution.size))
    sigma = math.sqrt(max(variance, 1e-6) * _CORRELATED_PIXELS * stride * float(inverse[2, 2]))
    if not inside.all():
        target, predicted = target[inside], predicted[inside]
    correlation, contrast = _correlation(target, predicted)
    a, b, level = (float(value) for value in solution[:3])
    return Alignment((a, b, level - a * middle_x - b * middle_y), max(sigma, _LEAST_SIGMA_PX), correlation, contrast)


@dataclass(frozen=True, eq=False)
class _Samples:
    """Some pixels of the left image, and the right image where they are looked up.

    Attributes:
        columns: of the pixels, float32, shape (N,).
        row_start: number of their rows' first pixels in the flat right image, shape (N,).
        right: the flat right image.
        last: the last column that has one after it.
    """

    columns: NDArray[np.float32]
    row_start: NDArray[np.intp]
    right: NDArray[np.float32]
    last: np.float32

    @classmethod
    def of(cls, pair: GreyPair, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> _Samples:
        width = pair.right.shape[1]
        return cls(columns.astype(np.float32), rows * width, pair.right.ravel(), np.float32(width - 1.001))

    def at(self, plane: Array, design: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return the right image, linearly interpolated, where a plane puts the pixels, and which lie in the image.

        Args:
            plane: of the disparities, shape (3,), or shape (M, 3).
            design: what it is multiplied by, shape (3, N).
        """
        x = self.columns - plane.astype(np.float32) @ design
        clipped = np.minimum(np.maximum(x, np.float32(0.0)), self.last)
        whole = np.floor(clipped)
        left = whole.astype(np.intp)
        left += self.row_start
        value = self.right.take(left)
        return value + (clipped - whole) * (self.right[1:].take(left) - value), clipped == x


def _predicted(solution: Array, basis: NDArray[np.float32], seen: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the left grey values by the right ones: with gain, offset, and what rows that are apart make of them."""
    found = solution.astype(np.float32)
    return np.asarray(found[_GAIN] * seen + found[_OFFSET:] @ basis[_OFFSET:], dtype=np.float32)


def _tukey(residual: NDArray[np.float32], spread: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the square root of Tukey's weights of residuals in units of where they are bounded."""
    inlying = np.square(residual)
    if spread is not _EVEN:
        inlying /= spread
    np.subtract(np.float32(1.0), inlying, out=inlying)
    return np.asarray(np.maximum(inlying, np.float32(0.0), out=inlying))


def _robust_cost(residual: NDArray[np.float32], spread: NDArray[np.float32], counted: NDArray[np.bool_]) -> float:
    """Return the sum of Tukey's bounded costs, each 0 to 1, of residuals in units of where they are bounded."""
    inlying = _tukey(residual, spread)
    return float((1.0 - inlying * inlying * inlying) @ counted.astype(np.float32))


def _correlation(one: NDArray[np.float32], other: NDArray[np.float32]) -> tuple[float, float]:
    """Return the correlation of grey values, 0 where they are too few, and the standard deviation of the first."""
    if one.size < _MIN_PIXELS:
        return 0.0, 0.0
    one, other = one - one.mean(), other - other.mean()
    power = float(one @ one)
    norm = math.sqrt(power * float(other @ other))
    return float(one @ other) / norm if norm > 0.0 else 0.0, math.sqrt(power / one.size)
