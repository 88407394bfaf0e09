"""Beyond the paper: how the table's picture deviates from the one that calibration and poses predict.

The left image and the right one, laid over it by the table's known plane, show the same table. What is left of a
displacement is measured by its grey values (texture, print, edges of shadows) block by block; a field with the few
degrees of freedom that wrong calibration and poses have is fitted to the blocks. Blocks with something that stands on
the table show another displacement or do not fit at all, and are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

import cv2
import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as checked_dataclass

from srvs_cell.calibration import BASIS, TableReference
from srvs_cell.scene import TableCheck
from srvs_cell.vision.median import median

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.rectification import RectifiedPair, RectifiedRig

_SCALE = 2
"""The images are halved: that smooths the noise, and the table's texture is coarser."""
_BLOCK = 16
"""Side of a block in pixels of the halved image."""
_SOBEL = 8.0 * _SCALE
"""What a 3x3 Sobel operator makes of a grey value per pixel of the full image."""
_NOISE_FACTOR = 1.6
_TEXTURED_PX = 0.1
"""A block whose displacement is known better than this has texture."""
_MOST = 0.5
_SLACK_PX = (0.5, 0.25, 0.15, 0.15)
"""Displacement that a block may show and its residual may stem from, iteration by iteration."""
_STILL_PX = 0.01
"""Where the field moves by less the images need not be compared anew."""
_LOOSE_SIGMA = 3.0
_MEDIAN_CHI2 = 1.386
"""Median of chi squared with two degrees of freedom."""
_RIDGE = 1e-6
_LEAST_NOISE2 = 0.01
"""Variance of the residual below which rounding to whole grey values is all there is."""
_NOISE_SLOPE = 0.046
"""Variance of a slope that is nothing but noise, per variance of the residual: 18.2 of the Sobel operator on halved
noise over 16 squared, half of it the left image's, and 30 % more so that chance does not pass for texture."""
_FLOOR_PX = 0.15
"""Standard deviation of a block's displacement that no texture lessens: what stands near it, lens, table."""
_UP = np.array([0.0, 0.0, 1.0])


@checked_dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid"))
class TableParameters:
    """The table as reference."""

    enabled: Annotated[bool, Field(description="correct calibration and pose errors by what the table shows")] = True
    min_blocks: Annotated[
        int, Field(ge=4, le=10_000, description="with fewer blocks of table in view nothing is corrected")
    ] = 30
    max_doubt: Annotated[
        float, Field(gt=0.0, le=1.0, description="share of its doubt before that the table's disparity may keep")
    ] = 0.7
    max_surprise: Annotated[
        float,
        Field(gt=0.0, le=1e6, description="squared errors, in sigmas, beyond which the calibration is wrong"),
    ] = 60.0
    max_sigmas: Annotated[
        float, Field(gt=0.0, le=1e3, description="a single error, such as the table's height, beyond which it is wrong")
    ] = 5.0


def align_table(
    pair: RectifiedPair, table_z_mm: float, parameters: TableParameters
) -> tuple[TableReference, TableCheck]:
    """Measure how the table deviates from its predicted picture.

    Args:
        pair: rectified images.
        table_z_mm: height of the table, base frame.
        parameters: limits.

    Returns:
        The errors of calibration and poses as far as the table tells, none where it tells too little or contradicts
        the calibration, with so much more doubt as what it showed contradicts it; and what it showed.
    """
    rig = pair.rig
    height, width = pair.left.shape
    prior = TableReference.unmeasured(rig.error_budget, (rig.cx_px, rig.cy_px), table_z_mm, (width, height))
    grid = _Grid.of(pair, table_z_mm)
    basis = np.stack(prior.basis(grid.x_px, grid.y_px, grid.disparity_px), axis=1)
    reference, used, rejected = prior, np.zeros(len(basis), dtype=np.bool_), 0.0
    field = reference.expected_field
    seen = grid.compared(basis @ field)
    for slack_px in _SLACK_PX:
        if np.abs(basis @ (reference.expected_field - field)).max() > _STILL_PX:
            field = reference.expected_field
            seen = grid.compared(basis @ field)
        now = grid.linearised(seen, slack_px)
        used, rejected = now.usable, now.rejected
        if used.sum() < parameters.min_blocks:
            break
        weights = _inverse(_inverse(now.information[used]) * now.inflation + _FLOOR_PX**2 * np.eye(2))
        # the sum over blocks and both directions
        shown = basis[used].reshape(-1, BASIS)
        weighted = (weights @ basis[used]).reshape(-1, BASIS)
        information = weighted.T @ shown
        vector = information @ field + now.displacement[used].ravel() @ weighted
        reference = prior.measured(information, vector)
    u_px, v_px, sigma_px = _shown(reference, rig)
    _, _, prior_sigma_px = _shown(prior, rig)
    surprise = reference.surprise()
    refusal = ""
    if used.sum() < parameters.min_blocks and rejected > _MOST:
        # the table deviates by more than the search reaches: at least that is the doubt
        # (errors that are claimed to be exactly 0 have no doubt that could grow)
        surprise = BASIS * (_SLACK_PX[0] / prior_sigma_px) ** 2 if prior_sigma_px > 0.0 else surprise
        refusal = f"the table contradicts the calibration: {100.0 * rejected:.0f} % of its picture is not as predicted"
    elif used.sum() < parameters.min_blocks:
        refusal = f"{used.sum()} blocks of table in view, {parameters.min_blocks} needed"
    elif sigma_px > parameters.max_doubt * prior_sigma_px:
        refusal = f"the table shows too little: {sigma_px:.3f} px of doubt are left"
    elif surprise > parameters.max_surprise:
        refusal = f"the table contradicts the calibration: chi squared {surprise:.0f}"
    elif (worst := reference.worst_sigmas()) > parameters.max_sigmas:
        # a sum over all errors lets a single one pass that is far off
        surprise = max(surprise, BASIS * worst**2)
        refusal = f"the table contradicts the calibration: one error, such as its height, is {worst:.1f} sigmas"
    check = TableCheck(int(used.sum()), u_px, v_px, sigma_px, (0.0, 0.0, 0.0), refusal)
    if refusal:
        return prior.doubted(surprise), check
    x, y = np.array([rig.cx_px]), np.array([rig.cy_px])
    middle_mm = rig.points_mm(x, y, _table_disparity(rig, table_z_mm, x, y))[0]
    correction = reference.at(middle_mm)[0]
    return reference, replace(check, correction_mm=(float(correction[0]), float(correction[1]), float(correction[2])))


def _shown(reference: TableReference, rig: RectifiedRig) -> tuple[float, float, float]:
    """Return the deviation (u, v) that a reference says the middle of the image has, and the doubt of u."""
    x, y = np.array([rig.cx_px]), np.array([rig.cy_px])
    u, v = (part[0] for part in reference.basis(x, y, _table_disparity(rig, reference.table_z_mm, x, y)))
    by_error = u @ reference.response
    sigma_px = float(np.sqrt(by_error @ reference.covariance @ by_error))
    return float(by_error @ reference.errors), float(v @ reference.expected_field), sigma_px


def _table_disparity(rig: RectifiedRig, table_z_mm: float, x_px: Array, y_px: Array) -> Array:
    """Return the table's disparity at pixels of the left image."""
    a, b, c = rig.plane_disparity(_UP, table_z_mm)
    return a * x_px + b * y_px + c


@dataclass(frozen=True, eq=False)
class _Compared:
    """What is left between the images, in B blocks.

    Attributes:
        energy: variance of the difference, shape (B,).
        gradient: sums of its products with its derivatives by u and v, shape (B, 2).
    """

    energy: Array
    gradient: Array


@dataclass(frozen=True, eq=False)
class _Linearised:
    """B blocks: which are table, what displacement (u, v) they still show, how sure it is, and by how much it is less.

    ``information`` has shape (B, 2, 2) for the image noise alone; ``inflation`` is the variance of the blocks'
    displacements over what that noise explains; ``rejected`` is the share of the blocks with texture that are not
    usable.
    """

    usable: NDArray[np.bool_]
    rejected: float
    displacement: Array
    information: Array
    inflation: float


@dataclass(frozen=True, eq=False)
class _Grid:
    """The halved images, cut into B blocks of N pixels each.

    Attributes:
        left, right: the images, the left one cut to whole blocks.
        slope_x, slope_y: of the left image, per pixel of the full image.
        map_x, map_y: where the right image shows the table that the left one shows.
        shape: rows and columns of blocks.
        whole: blocks whose pixels both images saw, shape (B,).
        x_px, y_px, disparity_px: the blocks' centres in the full image, and the table's disparity there.
        slope_mean: of the blocks, for u and v, shape (B, 2).
        structure: sums of products of the slopes less their means, for u and v, shape (B, 2, 2).
        solved: inverse of the structure, held where it is singular.
    """

    left: NDArray[np.float32]
    right: NDArray[np.float32]
    slope_x: NDArray[np.float32]
    slope_y: NDArray[np.float32]
    map_x: NDArray[np.float32]
    map_y: NDArray[np.float32]
    shape: tuple[int, int]
    whole: NDArray[np.bool_]
    x_px: Array
    y_px: Array
    disparity_px: Array
    slope_mean: Array
    structure: Array
    solved: Array

    @classmethod
    def of(cls, pair: RectifiedPair, table_z_mm: float) -> _Grid:
        """Halve the images and measure the left one's gradients."""
        left, right = (_as_float(cv2.pyrDown(image.astype(np.float32))) for image in (pair.left, pair.right))
        shape = (left.shape[0] // _BLOCK, left.shape[1] // _BLOCK)
        height, width = shape[0] * _BLOCK, shape[1] * _BLOCK
        column, row = np.arange(width), np.arange(height)[:, None]
        a, b, c = pair.rig.plane_disparity(_UP, table_z_mm)
        map_x = _as_float((1.0 - a) * column - c / _SCALE) - _as_float(b * row)
        map_y = _as_float(np.broadcast_to(row, map_x.shape))
        seen_left, seen_right = (seen[::_SCALE, ::_SCALE] for seen in pair.well_inside)
        laid_right = cv2.remap(seen_right, map_x, map_y, cv2.INTER_NEAREST, borderValue=0)
        whole = _means(_as_float(np.minimum(seen_left[:height, :width], laid_right)), shape) == 1.0
        slope_x, slope_y = (
            _as_float(cv2.Sobel(left, cv2.CV_32F, *order, ksize=3, scale=1.0 / _SOBEL)[:height, :width])
            for order in ((1, 0), (0, 1))
        )
        # a displacement along u moves the right picture to the left, one along v moves it down
        slope_mean = np.stack([-_means(slope_x, shape), _means(slope_y, shape)], axis=1)
        squares = [_means(product, shape) for product in (slope_x * slope_x, -slope_x * slope_y, slope_y * slope_y)]
        structure = np.stack(squares, axis=1)[:, ((0, 1), (1, 2))] - slope_mean[:, :, None] * slope_mean[:, None, :]
        structure *= _BLOCK**2
        trace = np.trace(structure, axis1=1, axis2=2)
        middle = _SCALE * (_BLOCK * np.arange(max(shape)) + 0.5 * (_BLOCK - 1))
        y_px, x_px = (axis.ravel() for axis in np.meshgrid(middle[: shape[0]], middle[: shape[1]], indexing="ij"))
        return cls(
            _as_float(left[:height, :width]),
            right,
            slope_x,
            slope_y,
            map_x,
            map_y,
            shape,
            whole,
            x_px,
            y_px,
            _table_disparity(pair.rig, table_z_mm, x_px, y_px),
            slope_mean,
            structure,
            _inverse(structure + _RIDGE * (1.0 + trace)[:, None, None] * np.eye(2)),
        )

    def compared(self, displaced_px: Array) -> _Compared:
        """Compare the images, the right one displaced by a field (u, v) given at the blocks, shape (B, 2)."""
        u, v = (self._spread(field / _SCALE) for field in displaced_px.T)
        np.subtract(self.map_x, u, out=u)
        np.add(self.map_y, v, out=v)
        residual = _as_float(cv2.remap(self.right, u, v, cv2.INTER_CUBIC))
        np.subtract(self.left, residual, out=residual)
        mean = _means(residual, self.shape)
        by_itself, by_x, by_y = (
            _means(np.multiply(residual, other, out=u), self.shape) for other in (residual, self.slope_x, self.slope_y)
        )
        # residual = left - right(displaced): its derivative by u is -slope_x of the picture's content, by v slope_y
        along = np.stack([-by_x, by_y], axis=1)
        return _Compared(by_itself - mean**2, _BLOCK**2 * (along - mean[:, None] * self.slope_mean))

    def linearised(self, seen: _Compared, slack_px: float) -> _Linearised:
        """Tell the blocks of the table, and their displacements."""
        size, energy, gradient = _BLOCK**2, seen.energy, seen.gradient
        noise2 = median(energy[self.whole]) if self.whole.any() else 1.0
        trace = np.trace(self.structure, axis1=1, axis2=2)
        usable = self.whole & (energy <= _NOISE_FACTOR**2 * noise2 + slack_px**2 * trace / size)
        # what stands in one block reaches into its neighbours
        stands = (self.whole & ~usable).reshape(self.shape).view(np.uint8)
        usable &= cv2.dilate(stands, np.ones((3, 3), np.uint8)).ravel() == 0
        # slopes that are noise tell nothing of a displacement
        told = np.maximum(1.0 - 2.0 * size * _NOISE_SLOPE * noise2 / np.maximum(trace, _RIDGE), _RIDGE)
        information = self.structure * (told / max(noise2, _LEAST_NOISE2))[:, None, None] + _RIDGE * np.eye(2)
        displacement = (self.solved @ gradient[..., None])[..., 0]
        sigma = np.sqrt(self.solved[:, (0, 1), (0, 1)] * noise2)
        usable &= (np.abs(displacement) <= slack_px + _LOOSE_SIGMA * sigma).all(axis=1)
        chi2 = np.einsum("bi,bij,bj->b", displacement, information, displacement)
        inflation = max(1.0, median(chi2[usable]) / _MEDIAN_CHI2) if usable.any() else 1.0
        textured = self.whole & (sigma < _TEXTURED_PX).all(axis=1)
        rejected = float(np.mean(~usable[textured])) if textured.any() else 0.0
        return _Linearised(usable, rejected, displacement, information, inflation)

    def _spread(self, values: Array) -> NDArray[np.float32]:
        """Return values given at the blocks' centres at every pixel."""
        grid = _as_float(values.reshape(self.shape))
        height, width = self.left.shape
        return _as_float(cv2.resize(grid, (width, height), interpolation=cv2.INTER_LINEAR))


def _inverse(matrices: Array) -> Array:
    """Return the inverses of symmetric matrices, shape (B, 2, 2)."""
    xx, xy, yy = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    adjoint = np.stack([yy, -xy, -xy, xx], axis=1).reshape(-1, 2, 2)
    return np.asarray(adjoint / (xx * yy - xy * xy)[:, None, None])


def _as_float(values: NDArray[Any]) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32)


def _means(values: NDArray[np.float32], shape: tuple[int, int]) -> Array:
    """Return the means over the blocks, shape (B,)."""
    rows, columns = shape
    return np.asarray(cv2.resize(values, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.float64).ravel()
