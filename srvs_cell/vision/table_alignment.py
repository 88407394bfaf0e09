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

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.rectification import RectifiedPair

_SCALE = 2
"""The images are halved: that smooths the noise, and the table's texture is coarser."""
_BLOCK = 16
"""Side of a block in pixels of the halved image."""
_ITERATIONS = 5
_BORDER_PX = 9
_SOBEL = 8.0 * _SCALE
"""What a 3x3 Sobel operator makes of a grey value per pixel of the full image."""
_NOISE_FACTOR = 1.6
_TEXTURED_PX = 0.1
"""A block whose displacement is known better than this has texture."""
_MOST = 0.5
_SLACK_PX = (0.5, 0.3, 0.2, 0.15, 0.15)
"""Displacement that a block may show and its residual may stem from, iteration by iteration."""
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
    u_basis, v_basis = prior.basis(grid.x_px, grid.y_px, grid.disparity_px)
    reference, used, rejected = prior, np.zeros(grid.count, dtype=np.bool_), 0.0
    for slack_px in _SLACK_PX:
        field = reference.expected_field
        now = grid.linearised(u_basis @ field, v_basis @ field, slack_px)
        used, rejected = now.usable, now.rejected
        if used.sum() < parameters.min_blocks:
            break
        basis = np.stack([u_basis, v_basis], axis=1)[used]
        weights = np.linalg.inv(np.linalg.inv(now.information[used]) * now.inflation + _FLOOR_PX**2 * np.eye(2))
        information = np.einsum("bik,bij,bjl->kl", basis, weights, basis)
        vector = information @ field + np.einsum("bik,bij,bj->k", basis, weights, now.displacement[used])
        reference = prior.measured(information, vector)
    shown, surprise = _Shown.of(reference, pair), reference.surprise()
    refusal = ""
    if used.sum() < parameters.min_blocks and rejected > _MOST:
        # the table deviates by more than the search reaches: at least that is the doubt
        surprise = BASIS * (_SLACK_PX[0] / _Shown.of(prior, pair).sigma_px) ** 2
        refusal = f"the table contradicts the calibration: {100.0 * rejected:.0f} % of its picture is not as predicted"
    elif used.sum() < parameters.min_blocks:
        refusal = f"{used.sum()} blocks of table in view, {parameters.min_blocks} needed"
    elif shown.sigma_px > parameters.max_doubt * _Shown.of(prior, pair).sigma_px:
        refusal = f"the table shows too little: {shown.sigma_px:.3f} px of doubt are left"
    elif surprise > parameters.max_surprise:
        refusal = f"the table contradicts the calibration: chi squared {surprise:.0f}"
    check = TableCheck(int(used.sum()), shown.u_px, shown.v_px, shown.sigma_px, shown.correction_mm, refusal)
    if refusal:
        return prior.doubted(surprise), replace(check, correction_mm=(0.0, 0.0, 0.0))
    return reference, check


@dataclass(frozen=True)
class _Shown:
    """What a reference says of the middle of the image: deviation, its standard deviation, correction of a point."""

    u_px: float
    v_px: float
    sigma_px: float
    correction_mm: tuple[float, float, float]

    @classmethod
    def of(cls, reference: TableReference, pair: RectifiedPair) -> _Shown:
        """Evaluate a reference at the principal point."""
        rig = pair.rig
        a, b, c = rig.plane_disparity(_UP, reference.table_z_mm)
        x, y = np.array([rig.cx_px]), np.array([rig.cy_px])
        disparity = a * x + b * y + c
        u, v = (part[0] for part in reference.basis(x, y, disparity))
        covariance = reference.response @ reference.covariance @ reference.response.T
        correction = reference.at(rig.points_mm(x, y, disparity)[0])[0]
        field = reference.expected_field
        return cls(
            float(u @ field),
            float(v @ field),
            float(np.sqrt(u @ covariance @ u)),
            (float(correction[0]), float(correction[1]), float(correction[2])),
        )


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
    """The halved images, cut into blocks; the arrays of blocks have shape (B,) or (B, 2, 2)."""

    left: NDArray[np.float32]
    right: NDArray[np.float32]
    map_x: NDArray[np.float32]
    map_y: NDArray[np.float32]
    slope_x: NDArray[np.float32]
    slope_y: NDArray[np.float32]
    valid: NDArray[np.bool_]
    x_px: Array
    y_px: Array
    disparity_px: Array
    structure: Array
    shape: tuple[int, int]

    @classmethod
    def of(cls, pair: RectifiedPair, table_z_mm: float) -> _Grid:
        """Halve the images and measure the left one's gradients."""
        left, right = (_as_float(cv2.pyrDown(image.astype(np.float32))) for image in (pair.left, pair.right))
        rows, columns = left.shape[0] // _BLOCK, left.shape[1] // _BLOCK
        height, width = rows * _BLOCK, columns * _BLOCK
        a, b, c = pair.rig.plane_disparity(_UP, table_z_mm)
        x, y = np.meshgrid(np.arange(width, dtype=np.float32) * _SCALE, np.arange(height, dtype=np.float32) * _SCALE)
        disparity = (a * x + b * y + c).astype(np.float32)
        kernel = np.ones((_BORDER_PX, _BORDER_PX), np.uint8)
        seen_left, seen_right = (
            cv2.erode(valid.astype(np.uint8), kernel, borderValue=0)[::_SCALE, ::_SCALE]
            for valid in (pair.left_valid, pair.right_valid)
        )
        map_x, map_y = (x - disparity) / _SCALE, y / _SCALE
        laid_right = cv2.remap(seen_right, map_x, map_y, cv2.INTER_NEAREST, borderValue=0)
        both = _as_float((seen_left[:height, :width] > 0) & (laid_right > 0))
        slope_x, slope_y = (
            _as_float(cv2.Sobel(left, cv2.CV_32F, *order, ksize=3)[:height, :width] / _SOBEL)
            for order in ((1, 0), (0, 1))
        )
        shape = (rows, columns)
        sums = [_blocks(product, shape) for product in (slope_x * slope_x, slope_x * slope_y, slope_y * slope_y)]
        means = [_blocks(slope, shape) / _BLOCK**2 for slope in (slope_x, slope_y)]
        structure = np.empty((rows * columns, 2, 2))
        structure[:, 0, 0] = sums[0] - _BLOCK**2 * means[0] ** 2
        # a displacement along u moves the right picture to the left, one along v moves it down
        structure[:, 0, 1] = structure[:, 1, 0] = -(sums[1] - _BLOCK**2 * means[0] * means[1])
        structure[:, 1, 1] = sums[2] - _BLOCK**2 * means[1] ** 2
        x_px, y_px, disparity_px = (_blocks(_as_float(values), shape) / _BLOCK**2 for values in (x, y, disparity))
        whole = _blocks(both, shape) == _BLOCK**2
        return cls(
            left[:height, :width],
            right,
            _as_float(map_x),
            _as_float(map_y),
            slope_x,
            slope_y,
            whole,
            x_px,
            y_px,
            disparity_px,
            structure,
            shape,
        )

    @property
    def count(self) -> int:
        """Number of blocks."""
        return self.shape[0] * self.shape[1]

    def linearised(self, u_px: Array, v_px: Array, slack_px: float) -> _Linearised:
        """Compare the images, the right one displaced by a field given at the blocks."""
        u, v = (self._spread(field) for field in (u_px, v_px))
        warped = cv2.remap(self.right, self.map_x - u / _SCALE, self.map_y + v / _SCALE, cv2.INTER_CUBIC)
        residual = _as_float(self.left - warped)
        size = _BLOCK**2
        mean = _blocks(residual, self.shape) / size
        energy = _blocks(residual * residual, self.shape) / size - mean**2
        gradient = np.stack(
            [
                -(_blocks(residual * self.slope_x, self.shape) - mean * _blocks(self.slope_x, self.shape)),
                _blocks(residual * self.slope_y, self.shape) - mean * _blocks(self.slope_y, self.shape),
            ],
            axis=-1,
        )
        noise2 = float(np.median(energy[self.valid])) if self.valid.any() else 1.0
        trace = np.trace(self.structure, axis1=1, axis2=2)
        usable = self.valid & (energy <= _NOISE_FACTOR**2 * noise2 + slack_px**2 * trace / size)
        # what stands in one block reaches into its neighbours
        stands = (self.valid & ~usable).reshape(self.shape).astype(np.uint8)
        usable &= cv2.dilate(stands, np.ones((3, 3), np.uint8)).ravel() == 0
        # slopes that are noise tell nothing of a displacement
        told = np.maximum(1.0 - 2.0 * size * _NOISE_SLOPE * noise2 / np.maximum(trace, _RIDGE), _RIDGE)
        information = self.structure * (told / max(noise2, _LEAST_NOISE2))[:, None, None] + _RIDGE * np.eye(2)
        # residual = left - right(displaced): its derivative by u is -slope_x of the picture's content, by v slope_y
        safe = self.structure + _RIDGE * (1.0 + trace)[:, None, None] * np.eye(2)
        displacement = np.linalg.solve(safe, gradient[..., None])[..., 0]
        sigma = np.sqrt(np.linalg.inv(safe)[:, (0, 1), (0, 1)] * noise2)
        usable &= (np.abs(displacement) <= slack_px + _LOOSE_SIGMA * sigma).all(axis=1)
        chi2 = np.einsum("bi,bij,bj->b", displacement, information, displacement)
        inflation = max(1.0, float(np.median(chi2[usable])) / _MEDIAN_CHI2) if usable.any() else 1.0
        textured = self.valid & (sigma < _TEXTURED_PX).all(axis=1)
        rejected = float(np.mean(~usable[textured])) if textured.any() else 0.0
        return _Linearised(usable, rejected, displacement, information, inflation)

    def _spread(self, values: Array) -> NDArray[np.float32]:
        """Return values given at the blocks' centres at every pixel."""
        grid = values.reshape(self.shape).astype(np.float32)
        height, width = self.left.shape
        return np.asarray(cv2.resize(grid, (width, height), interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def _as_float(values: NDArray[Any]) -> NDArray[np.float32]:
    return np.asarray(values, dtype=np.float32)


def _blocks(values: NDArray[np.float32], shape: tuple[int, int]) -> Array:
    """Return the sums over the blocks, shape (B,)."""
    rows, columns = shape
    means = cv2.resize(values, (columns, rows), interpolation=cv2.INTER_AREA)
    return means.astype(np.float64).ravel() * _BLOCK**2
