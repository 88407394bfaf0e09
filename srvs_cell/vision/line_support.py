"""Straight lines with eight parameters, from Burns' line-support regions: the features of the paper's baseline.

The paper compares its plane matching with the straight line matching of McIntosh and Mutch (CVGIP 43, 1988), which
works on the lines of Burns, Hanson and Riseman (PAMI 8(4), 1986). The text of McIntosh and Mutch was not at hand; the
paper says only that a line has eight parameters. This is therefore a **reconstruction**, and the eight are our choice
among the attributes that Burns gives a line: x and y of the midpoint, orientation, length, contrast, width, steepness
and mean grey value.

The edge pixels are those of step 2, the same as the planes are grown between. Each belongs to one region of either
partition of gradient directions and votes for the longer one. A region's line is where the plane that is fitted to its
grey values, weighted by the gradient, cuts the level of their weighted mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as checked_dataclass

from srvs_cell.vision.edges import smooth, support_regions, votes_for_first

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array

_CENTRE_OFFSET_PX = 0.5
"""A 2x2 mask measures between the pixels."""
_FLAT = 1e-6
"""Spread, px^2, or slope, grey values per pixel, below which a region has no fitted plane; least weight."""


@checked_dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid"))
class LineParameters:
    """What makes a line-support region a line."""

    min_support: Annotated[
        float, Field(ge=0.0, le=1.0, description="least share of a region's pixels that vote for it")
    ] = 0.5
    min_length_px: Annotated[float, Field(ge=2.0, le=500.0, description="a shorter line is not used")] = 8.0
    min_pixels: Annotated[int, Field(ge=3, le=10_000, description="a region of fewer pixels is not used")] = 8


@dataclass(frozen=True, eq=False)
class LineImage:
    """The straight lines of one rectified image; line i has row i of every array.

    A line runs from its start to its end with the bright side on its left hand, as the picture is seen (y down).

    Attributes:
        grey: the rectified image, uint8, shape (H, W).
        centre_px: midpoint (x, y), shape (N, 2); two of the eight parameters.
        orientation_deg: direction of the grey values' ascent, 0 to 360, from x towards y, shape (N,).
        length_px: between the ends, shape (N,).
        contrast: grey values across the line, shape (N,).
        width_px: of the support region, its area over its length, shape (N,).
        steepness: slope of the fitted plane, grey values per pixel, shape (N,).
        brightness: mean grey value of the support region, shape (N,).
        start_px, end_px: ends (x, y), shape (N, 2).
    """

    grey: NDArray[np.uint8]
    centre_px: Array
    orientation_deg: Array
    length_px: Array
    contrast: Array
    width_px: Array
    steepness: Array
    brightness: Array
    start_px: Array
    end_px: Array

    def __len__(self) -> int:
        """Return the number of lines."""
        return len(self.length_px)


def extract_lines(
    grey: NDArray[np.uint8], edges: NDArray[np.bool_], smoothing_px: float, parameters: LineParameters
) -> LineImage:
    """Find the straight lines of an image and their eight parameters.

    Args:
        grey: the rectified image, uint8, shape (H, W).
        edges: bool, shape (H, W): the pixels of the line-support regions (`EdgeImage.mask`).
        smoothing_px: sigma of the Gaussian before the gradient, as the edges were found with.
        parameters: limits of a line.
    """
    # the last row and column have no 2x2 mask
    rows, columns = np.nonzero(edges[:-1, :-1])
    image = smooth(grey, smoothing_px)
    a, b = image[rows, columns], image[rows, columns + 1]
    c, d = image[rows + 1, columns], image[rows + 1, columns + 1]
    gradient_x, gradient_y = (b + d - a - c) * _CENTRE_OFFSET_PX, (c + d - a - b) * _CENTRE_OFFSET_PX
    direction_deg = np.rad2deg(np.arctan2(gradient_y, gradient_x))
    width = edges.shape[1]
    region = voted_regions(rows * width + columns, direction_deg, width, parameters.min_support)
    kept = np.flatnonzero(region >= 0)
    kept = kept[np.argsort(region[kept], kind="stable")]
    _, first, pixels = np.unique(region[kept], return_index=True, return_counts=True)
    large = pixels >= parameters.min_pixels
    kept = kept[np.repeat(large, pixels)]
    pixels = pixels[large]
    first = np.cumsum(pixels) - pixels
    level = (a + b + c + d)[kept].astype(np.float64) / 4.0
    return _measure(
        grey,
        np.column_stack([columns[kept], rows[kept]]).astype(np.float64) + _CENTRE_OFFSET_PX,
        level,
        np.maximum(np.hypot(gradient_x, gradient_y)[kept], _FLAT).astype(np.float64),
        (first, pixels),
        parameters,
    )


def voted_regions(
    strong: NDArray[np.intp], direction_deg: NDArray[np.float32], width: int, min_support: float
) -> NDArray[np.intp]:
    """Return the number of the line-support region that each edge pixel votes for; -1 where that has no support.

    Args:
        strong: numbers of the edge pixels in the flat image, ascending, none in its last column, shape (N,).
        direction_deg: gradient direction of each.
        width: of the image.
        min_support: least share of a region's pixels that vote for it.
    """
    if strong.size == 0:
        return np.zeros(0, dtype=np.intp)
    first, second = support_regions(strong, direction_deg, width)
    for_first = votes_for_first(first, second)
    region = np.where(for_first, first.of_pixel, second.of_pixel + first.pixels.size)
    pixels = np.concatenate([first.pixels, second.pixels])
    votes = np.bincount(region, minlength=pixels.size)
    return np.where((votes >= min_support * pixels)[region], region, -1)


def _measure(
    grey: NDArray[np.uint8],
    position: Array,
    level: Array,
    weight: Array,
    regions: tuple[NDArray[np.intp], NDArray[np.intp]],
    parameters: LineParameters,
) -> LineImage:
    """Fit a plane to the grey values of each region and return the lines.

    Args:
        grey: the image.
        position: (x, y) of the pixels, ordered by region, shape (N, 2).
        level: their grey values.
        weight: their gradients.
        regions: number of the first pixel, and number of pixels, of each region.
        parameters: limits of a line.
    """
    first, pixels = regions
    if first.size == 0:
        none, nowhere = np.zeros(0), np.zeros((0, 2))
        return LineImage(grey, nowhere, none, none, none, none, none, none, nowhere, nowhere)

    def total(values: Array) -> Array:
        return np.asarray(np.add.reduceat(values, first), dtype=np.float64)

    weights = total(weight)
    middle = np.column_stack([total(weight * position[:, 0]), total(weight * position[:, 1])]) / weights[:, None]
    middle_level = total(weight * level) / weights
    x, y = (position - np.repeat(middle, pixels, axis=0)).T
    rise = level - np.repeat(middle_level, pixels)
    xx, xy, yy = total(weight * x * x), total(weight * x * y), total(weight * y * y)
    x_rise, y_rise = total(weight * x * rise), total(weight * y * rise)
    determinant = xx * yy - xy * xy
    solvable = determinant > _FLAT * weights * weights
    safe = np.where(solvable, determinant, 1.0)
    slope = np.column_stack([x_rise * yy - y_rise * xy, y_rise * xx - x_rise * xy]) / safe[:, None]
    steepness = np.hypot(slope[:, 0], slope[:, 1])
    solvable &= steepness > _FLAT
    normal = slope / np.where(solvable, steepness, 1.0)[:, None]
    along = np.column_stack([-normal[:, 1], normal[:, 0]])
    run = x * np.repeat(along[:, 0], pixels) + y * np.repeat(along[:, 1], pixels)
    low, high = np.minimum.reduceat(run, first), np.maximum.reduceat(run, first)
    length = high - low
    good = solvable & (length >= parameters.min_length_px)
    start, end = middle + low[:, None] * along, middle + high[:, None] * along
    return LineImage(
        grey=grey,
        centre_px=(0.5 * (start + end))[good],
        orientation_deg=np.rad2deg(np.arctan2(normal[good, 1], normal[good, 0])) % 360.0,
        length_px=length[good],
        contrast=(np.maximum.reduceat(level, first) - np.minimum.reduceat(level, first))[good],
        width_px=pixels[good] / length[good],
        steepness=steepness[good],
        brightness=(total(level) / pixels)[good],
        start_px=start[good],
        end_px=end[good],
    )
