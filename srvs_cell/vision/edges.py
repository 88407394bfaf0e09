"""Step 2: edge extraction by line-support regions (Burns, Hanson, Riseman, PAMI 8(4), 1986).

Pixels with a strong gradient are labelled by the gradient's direction in two overlapping partitions of 45 degrees, the
second turned by 22.5 degrees, so that a line whose direction falls on the border of one lies within the other.
Connected pixels of one label are a line-support region. Each pixel votes for the longer of its two regions, of two as
long for one that is clearly larger; a region's support is the share of its pixels that vote for it, and regions with
enough support and length are kept.

Few pixels have a strong gradient: after the threshold only these are looked at, as runs of one label along the rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Self

import cv2
import numpy as np
from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass as checked_dataclass

from srvs_cell.vision.limit_pairs import check_pairs
from srvs_cell.vision.median import median
from srvs_cell.vision.runs import joined, runs_of, touching_runs

if TYPE_CHECKING:
    from numpy.typing import NDArray

_PARTITION_DEG = 45.0
_PARTITIONS = 8
_TURNS_DEG = (0.0, _PARTITION_DEG / 2.0)
_CHANCE_PX = 1.0
"""Votes that a region may lack: along an arc half of the pixels vote for it, give or take where the rows cut it."""
_CLEARLY_LARGER = 1.4
"""A region with so many times the pixels of one as long is the whole of what that is a flank of."""
_KERNEL_SIGMAS = 4.0
_MASK = np.array([[-0.5, 0.5], [-0.5, 0.5]], dtype=np.float32)


@checked_dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid"))
class EdgeParameters:
    """Step 2, line-support regions (Burns, Hanson, Riseman 1986)."""

    smoothing_px: Annotated[
        float, Field(ge=0.0, le=5.0, description="sigma of the Gaussian before the gradient; 0: none")
    ] = 1.0
    min_gradient: Annotated[
        float, Field(gt=0.0, le=100.0, description="least gradient of a strong pixel, grey values per pixel")
    ] = 0.6
    max_gradient: Annotated[
        float, Field(gt=0.0, le=255.0, description="what the noise may raise min_gradient to, grey values per pixel")
    ] = 4.0
    noise_factor: Annotated[
        float, Field(ge=0.0, le=20.0, description="a strong pixel exceeds the image's median gradient this many times")
    ] = 3.5
    # along an arc the two partitions share the votes evenly, and a region has half of them give or take a few pixels:
    # a limit of just one half would drop arcs by chance
    min_support: Annotated[
        float, Field(ge=0.0, le=1.0, description="least share of a region's pixels that vote for it")
    ] = 0.45
    min_length_px: Annotated[float, Field(ge=1.0, le=200.0, description="least length of a line-support region")] = 6.0

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        check_pairs(self, ("min_gradient", "max_gradient"), equal=True)
        return self


@dataclass(frozen=True, eq=False)
class EdgeImage:
    """Line-support regions of one image.

    Attributes:
        mask: bool, shape (H, W): pixels of the regions that were kept.
        threshold: least gradient of a strong pixel, grey values per pixel.
    """

    mask: NDArray[np.bool_]
    threshold: float


def extract_edges(
    grey: NDArray[np.uint8], parameters: EdgeParameters, smoothed: NDArray[np.float32] | None = None
) -> EdgeImage:
    """Find the line-support regions of an image.

    Args:
        grey: uint8, shape (H, W).
        parameters: limits.
        smoothed: the same image after the Gaussian, where it is at hand.
    """
    gradient = gradient_2x2(smooth(grey, parameters.smoothing_px) if smoothed is None else smoothed)
    magnitude = np.asarray(cv2.magnitude(*gradient), dtype=np.float32)
    threshold = strong_gradient(magnitude, parameters)
    strong = np.flatnonzero(magnitude > threshold)
    mask = np.zeros(grey.shape, dtype=np.bool_)
    if strong.size:
        x, y = (slope.ravel()[strong] for slope in gradient)
        direction_deg = np.rad2deg(np.arctan2(y, x))
        strength = magnitude.ravel()[strong] / np.float32(threshold)
        kept = supported(strong, direction_deg, strength, grey.shape[1], parameters)
        mask.ravel()[strong[kept]] = True
    return EdgeImage(mask, threshold)


def smooth(grey: NDArray[np.uint8], sigma_px: float) -> NDArray[np.float32]:
    """Return the image after a Gaussian, float32."""
    if sigma_px <= 0.0:
        return grey.astype(np.float32)
    size = 2 * round(_KERNEL_SIGMAS * sigma_px) + 1
    kernel = cv2.getGaussianKernel(size, sigma_px, cv2.CV_32F)
    return np.asarray(cv2.sepFilter2D(grey, cv2.CV_32F, kernel, kernel), dtype=np.float32)


def gradient_2x2(image: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the gradient along x and along y by Burns' 2x2 masks, each (H, W), at (x + 0.5, y + 0.5).

    It is 0 in the last row and column.
    """
    slopes = []
    for mask in (_MASK, _MASK.T):
        slope = np.asarray(cv2.filter2D(image, cv2.CV_32F, mask, anchor=(0, 0)), dtype=np.float32)
        slope[-1], slope[:, -1] = 0.0, 0.0
        slopes.append(slope)
    return slopes[0], slopes[1]


def strong_gradient(magnitude: NDArray[np.float32], parameters: EdgeParameters) -> float:
    """Return the least gradient of a strong pixel: above the image's own noise and texture, within the limits."""
    highest = max(parameters.min_gradient, parameters.max_gradient)
    return min(max(parameters.noise_factor * median(magnitude), parameters.min_gradient), highest)


def supported(
    strong: NDArray[np.intp],
    direction_deg: NDArray[np.float32],
    strength: NDArray[np.float32],
    width: int,
    parameters: EdgeParameters,
) -> NDArray[np.bool_]:
    """Return which strong pixels belong to a kept line-support region.

    Args:
        strong: numbers of the strong pixels in the flat image, ascending, none in its last column, shape (N,).
        direction_deg: gradient direction of each, -180 to 180.
        strength: gradient of each over that of the weakest strong pixel. The least length is that of the weakest
            edge; a stronger one, as at the corner of a face, may be shorter in proportion.
        width: of the image.
        parameters: support and length limits.
    """
    regions = support_regions(strong, direction_deg, width)
    for_first = votes_for_first(*regions)
    kept = np.zeros(strong.size, dtype=np.bool_)
    for each, votes in zip(regions, (for_first, ~for_first), strict=True):
        support = (np.bincount(each.of_pixel, weights=votes) + _CHANCE_PX) / each.pixels
        evidence = each.length_px * np.bincount(each.of_pixel, weights=strength) / each.pixels
        kept |= ((support >= parameters.min_support) & (evidence >= parameters.min_length_px))[each.of_pixel]
    return kept


def support_regions(
    strong: NDArray[np.intp], direction_deg: NDArray[np.float32], width: int
) -> tuple[SupportRegions, SupportRegions]:
    """Return the line-support regions of both partitions; arguments as of `supported`."""
    first, second = (SupportRegions.of(strong, _partition(direction_deg, turn_deg), width) for turn_deg in _TURNS_DEG)
    return first, second


def votes_for_first(first: SupportRegions, second: SupportRegions) -> NDArray[np.bool_]:
    """Return whether each strong pixel votes for its region of the first partition, shape (N,).

    It votes for the longer of its two regions, of two as long for the first one unless the second is clearly larger.
    Along a line whose direction falls on the border of one partition its regions there lie side by side, each as long
    as the whole: by length alone they would take half of the votes, and neither they nor the whole had support enough.
    """
    one, other = first.of_pixel, second.of_pixel
    longer = first.length_px[one] - second.length_px[other]
    whole = _CLEARLY_LARGER * first.pixels[one] > second.pixels[other]
    return np.where(longer == 0.0, whole, longer > 0.0)


def _partition(direction_deg: NDArray[np.float32], turn_deg: float) -> NDArray[np.int8]:
    """Return the number of the 45 degrees that each direction lies in."""
    number = np.floor((direction_deg + turn_deg) / _PARTITION_DEG).astype(np.int8)
    return np.asarray(number % _PARTITIONS)


@dataclass(frozen=True, eq=False)
class SupportRegions:
    """Connected strong pixels of one label.

    Attributes:
        of_pixel: the region of each strong pixel, shape (N,).
        pixels: number of each region's pixels.
        length_px: diagonal of each region's bounding box.
    """

    of_pixel: NDArray[np.intp]
    pixels: NDArray[np.intp]
    length_px: NDArray[np.float64]

    @classmethod
    def of(cls, strong: NDArray[np.intp], label: NDArray[np.int8], width: int) -> SupportRegions:
        """Connect 8-neighbours of one label.

        Args:
            strong: numbers of the strong pixels in the flat image, ascending, none in its last column, shape (N,).
            label: of each of them.
            width: of the image.
        """
        begin = runs_of(strong, label[1:] != label[:-1])
        first = strong[begin]
        last = strong[np.append(begin[1:], strong.size) - 1]
        above, below = touching_runs(first, last, width)
        same = label[begin[above]] == label[begin[below]]
        root = joined(np.arange(begin.size), above[same], below[same])
        lowest = root == np.arange(begin.size)
        count, of_run = np.count_nonzero(lowest), (np.cumsum(lowest) - 1)[root]
        row, left = np.divmod(first, width)
        extents = []
        for start, end in ((row, row), (left, left + last - first)):
            low, high = np.full(count, np.iinfo(np.intp).max), np.full(count, -1)
            np.minimum.at(low, of_run, start)
            np.maximum.at(high, of_run, end)
            extents.append(high - low + 1.0)
        of_pixel = np.repeat(of_run, last - first + 1)
        return cls(of_pixel, np.bincount(of_pixel), np.hypot(extents[0], extents[1]))
