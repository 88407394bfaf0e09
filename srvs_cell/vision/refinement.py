"""Step 9, beyond the paper: photometric alignment of a plane.

In a rectified pair the disparity of a flat face is affine, d = a x + b y + c. Gauss-Newton finds the a, b, c, with a
gain and an offset of the brightness, for which the right image's grey values, shifted by d, are the left image's over
the face. Its border is included: the edge of a face moves with the face.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.edges import smooth

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.scene import DisparityPlane, Plane, PlaneImage, PlaneMatch
    from srvs_cell.vision.parameters import RefinementParameters

_SMOOTHING_PX = 1.0
_SLOPE_SIGMA = 0.05
_NOISE_GREY = 1.0
_TUKEY = 4.685
_MAD_TO_SIGMA = 1.4826
_CONVERGED_PX = 0.005
_MIN_PIXELS = 12
_CORRELATED_PIXELS = 12.0
"""Smoothing makes so many neighbouring pixels count as one."""
_LEAST_SIGMA_PX = 0.02
_CONVINCING = 0.97
_LEVEL_STEP_PX = 0.5
_ROUGH_PIXELS = 500
"""So many pixels tell which of several starts is the best."""
_MIN_CONTRAST = 5.0
"""Standard deviation in grey values below which the noise spoils the correlation."""
_RANGE_MARGIN_PX = 1.0


@dataclass(frozen=True, eq=False)
class GreyPair:
    """Two smoothed rectified images and the right one's derivative along the rows, each float32, shape (H, W)."""

    left: NDArray[np.float32]
    right: NDArray[np.float32]
    right_x: NDArray[np.float32]

    @classmethod
    def of(cls, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> GreyPair:
        """Prepare two grey images, uint8, shape (H, W)."""
        smoothed = smooth(right, _SMOOTHING_PX)
        slope = cv2.filter2D(smoothed, cv2.CV_32F, np.array([[-0.5, 0.0, 0.5]], dtype=np.float32))
        return cls(smooth(left, _SMOOTHING_PX), smoothed, np.asarray(slope, dtype=np.float32))


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
    right: PlaneImage,
    matches: Sequence[PlaneMatch],
    disparity_range_px: tuple[float, float],
    parameters: RefinementParameters,
) -> list[PlaneMatch]:
    """Align every match; drop those whose grey values disagree or whose disparity is out of range.

    A face without contrast, and one that cannot be aligned, keeps the plane that its borders gave.
    """
    pair = GreyPair.of(left.grey, right.grey)
    low, high = disparity_range_px
    refined = []
    for match in matches:
        plane = left.planes[match.left - 1]
        rows, columns = _with_band(left, plane, parameters.band_px)
        alignment = _best_alignment(pair, rows, columns, match, plane.centre_px, parameters)
        better = match
        agrees = alignment is not None and alignment.correlation >= parameters.min_correlation
        if alignment is not None and not agrees and alignment.contrast > _MIN_CONTRAST:
            continue
        if alignment is not None and agrees:
            x, y = plane.centre_px
            a, b, c = alignment.plane
            better = replace(
                match,
                disparity_px=a * x + b * y + c,
                disparity_plane=alignment.plane,
                disparity_sigma_px=alignment.sigma_px,
            )
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


def _best_level(
    pair: GreyPair, rows: NDArray[np.intp], columns: NDArray[np.intp], middle_px: float, max_shift_px: float
) -> float:
    """Return the constant disparity near ``middle_px`` at which the grey values correlate best."""
    stride = max(1, rows.size // _ROUGH_PIXELS)
    rows, columns = rows[::stride], columns[::stride]
    levels = middle_px + np.arange(-max_shift_px, max_shift_px + _LEVEL_STEP_PX, _LEVEL_STEP_PX)
    seen, _, inside = _Samples.of(pair, rows, columns).at(levels[:, None])
    target = pair.left[rows, columns].astype(np.float64)
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
    mask = (window == plane.id).astype(np.uint8)
    if band_px:
        mask = np.asarray(cv2.dilate(mask, np.ones((2 * band_px + 1, 2 * band_px + 1), np.uint8)), dtype=np.uint8)
    rows, columns = np.nonzero(mask)
    return rows + top, columns + left


def align_plane(
    pair: GreyPair,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    start: DisparityPlane,
    parameters: RefinementParameters,
    roughness_px: float = 0.0,
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

    Returns:
        The alignment, or None where too few pixels lie in both images, the plane moved too far, or explains the pixels
        no better than it did to begin with.
    """
    stride = max(1, rows.size // parameters.max_pixels)
    rows, columns = rows[::stride], columns[::stride]
    if rows.size < _MIN_PIXELS:
        return None
    middle_x, middle_y = float(columns.mean()), float(rows.mean())
    a, b, c = start
    design = np.stack([columns - middle_x, rows - middle_y, np.ones(rows.size)])
    samples = _Samples.of(pair, rows, columns)
    solution = np.array([a, b, a * middle_x + b * middle_y + c, 1.0, 0.0])
    first_level = solution[2]
    # without contrast nothing but this holds the plane
    prior = np.diag(
        [(_NOISE_GREY / _SLOPE_SIGMA) ** 2] * 2 + [(_NOISE_GREY / parameters.max_shift_px) ** 2, 1e-3, 1e-3]
    )
    expected = np.array([0.0, 0.0, first_level, 1.0, 0.0])
    target = pair.left[rows, columns].astype(np.float64)
    variance, normal, scale = 0.0, prior, _NOISE_GREY
    seen_first, _, inside_first = samples.at(solution[:3] @ design)
    jacobian = np.ones((len(solution), rows.size))
    for _ in range(parameters.iterations):
        seen, slope, inside = samples.at(solution[:3] @ design)
        if np.count_nonzero(inside) < _MIN_PIXELS:
            return None
        residual = (target - (solution[3] * seen + solution[4])) * inside
        scale = max(_NOISE_GREY, _MAD_TO_SIGMA * _median(np.abs(residual)))
        # in units of the noise: what the surface's roughness makes of a slope adds to it
        spread = 1.0 + (roughness_px / scale * solution[3] * slope) ** 2
        weight = np.maximum(1.0 - (residual / (_TUKEY * scale)) ** 2 / spread, 0.0) ** 2 / spread * inside
        # d moves the sample against x: the prediction changes by -gain times the slope
        np.multiply(-solution[3] * slope, design, out=jacobian[:3])
        jacobian[3] = seen
        weighted = jacobian * weight
        normal = weighted @ jacobian.T + prior
        step = np.linalg.solve(normal, weighted @ residual - prior @ (solution - expected))
        step[:3] *= min(1.0, 1.0 / max(abs(float(step[2])), 1e-9))
        solution = solution + step
        variance = float(weight @ residual**2 / max(weight.sum(), 1.0))
        if abs(float(step[2])) < _CONVERGED_PX:
            break
    if abs(solution[2] - first_level) > parameters.max_shift_px or not np.isfinite(solution).all():
        return None
    sigma = float(np.sqrt(max(variance, 1e-6) * _CORRELATED_PIXELS * stride * np.linalg.inv(normal)[2, 2]))
    seen, _, inside = samples.at(solution[:3] @ design)
    both = inside & inside_first
    gain, offset = solution[3:]
    before = min(
        _robust_cost(target - seen_first, both, scale), _robust_cost(target - (gain * seen_first + offset), both, scale)
    )
    if _robust_cost(target - (gain * seen + offset), both, scale) > before:
        return None
    contrast = float(target[inside].std()) if inside.any() else 0.0
    a, b, level = (float(value) for value in solution[:3])
    return Alignment(
        (a, b, level - a * middle_x - b * middle_y),
        max(sigma, _LEAST_SIGMA_PX),
        _correlation(target[inside], seen[inside]),
        contrast,
    )


@dataclass(frozen=True, eq=False)
class _Samples:
    """Some pixels of the left image, and the right image where they are looked up.

    Attributes:
        columns: of the pixels, float64, shape (N,).
        row_start: number of their rows' first pixels in the flat right image, shape (N,).
        right, right_x: the flat right image and its derivative.
        width: of the image.
    """

    columns: Array
    row_start: NDArray[np.intp]
    right: NDArray[np.float32]
    right_x: NDArray[np.float32]
    width: int

    @classmethod
    def of(cls, pair: GreyPair, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> _Samples:
        width = pair.right.shape[1]
        return cls(columns.astype(np.float64), rows * width, pair.right.ravel(), pair.right_x.ravel(), width)

    def at(self, disparity_px: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return the right image and its slope at x - d, linearly interpolated, and which lie in the image."""
        x = self.columns - disparity_px
        inside = (x >= 1.0) & (x <= self.width - 2.0)
        x = np.minimum(np.maximum(x, 1.0), self.width - 2.001)
        left = x.astype(np.intp)
        share = x - left
        left += self.row_start
        right = left + 1
        value, slope = self.right[left], self.right_x[left]
        return (
            np.asarray(value + share * (self.right[right] - value), dtype=np.float64),
            np.asarray(slope + share * (self.right_x[right] - slope), dtype=np.float64),
            inside,
        )


def _robust_cost(residual: Array, counted: NDArray[np.bool_], scale: float) -> float:
    """Return the sum of Tukey's bounded costs, each 0 to 1."""
    inlying = np.maximum(1.0 - (residual / (_TUKEY * scale)) ** 2, 0.0)
    return float(counted @ (1.0 - inlying**3))


def _median(values: Array) -> float:
    """Return the middle value; of an even number the upper one of the two."""
    middle = values.size // 2
    return float(np.partition(values, middle)[middle])


def _correlation(one: Array, other: Array) -> float:
    if one.size < _MIN_PIXELS:
        return 0.0
    one, other = one - one.mean(), other - other.mean()
    norm = float(np.sqrt((one**2).sum() * (other**2).sum()))
    return float((one * other).sum() / norm) if norm > 0.0 else 0.0
