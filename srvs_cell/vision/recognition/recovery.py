"""Step 9, beyond the paper: faces that have no matched plane.

Texture, print, a sliver of side face or a weak edge can split or merge a plane; its partner then has other parameters,
and the paper's rule finds nothing. A plane of the left image without a partner, or what rises and is no known figure,
is looked for in the right image by its grey values: with a band around it it is moved along the row, and the disparity
of the best correlation gives it a place. Recognition verifies it by its edges in both images.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.scene import PlaneMatch
from srvs_cell.vision.lateral_stereo import mask_outline_px, place_surface
from srvs_cell.vision.recognition.rising_height import rising_disparity

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.scene import PlaneImage, Surface
    from srvs_cell.vision.recognition.evidence import Evidence
    from srvs_cell.vision.rectification import RectifiedRig
    from srvs_cell.vision.relief import Relief

NO_PLANE = 0
"""``PlaneMatch.left`` or ``right`` where a face was found without a plane of that image."""
_BAND_PX = 3
_MAX_PIXELS = 1500
_MIN_CORRELATION = 0.7
_USUAL_SHARE = 0.5
"""Share of the contrast of a region and what is around it by which grey values usually go beyond both."""
_USUAL_LEAST = 10.0
_MIN_VARIANCE = 1e-6
_MARGIN_PX = 3.0
_SIGMA_PX = 0.5
_RISING_SIGMA_PX = 0.6
"""Of a height that only what rises tells: an inclined face has many."""
_BORDER_PX = 5
"""What comes so near to where a picture ends goes on there: what was cut off came within 3, nearly all else kept away
by 10."""
_AROUND_PX = 2 * _BORDER_PX + 1
"""Side of the square that grows a region by as much on every side."""
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Region:
    """Pixels of the left image that may be a face.

    Attributes:
        plane: id of the plane that it is; `NO_PLANE` for none.
        mask: bool, shape (h, w).
        corner_px: (x, y) of the mask's first pixel.
    """

    plane: int
    mask: NDArray[np.bool_]
    corner_px: tuple[int, int]

    @property
    def outline_px(self) -> NDArray[np.float32]:
        """Convex hull in the image, shape (N, 2)."""
        contours, _ = cv2.findContours(self.mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        hull = cv2.convexHull(np.concatenate(contours)).reshape(-1, 2)
        return np.asarray(hull + np.array(self.corner_px), dtype=np.float32)

    def holds(self, x_px: float, y_px: float) -> bool:
        """Whether a place of the image lies in the region."""
        column, row = round(x_px) - self.corner_px[0], round(y_px) - self.corner_px[1]
        height, width = self.mask.shape
        return 0 <= row < height and 0 <= column < width and bool(self.mask[row, column])

    @cached_property
    def centre_px(self) -> tuple[float, float]:
        """Mean pixel position."""
        rows, columns = np.nonzero(self.mask)
        return float(columns.mean()) + self.corner_px[0], float(rows.mean()) + self.corner_px[1]


def unmatched_planes(left: PlaneImage, matched: Collection[int]) -> list[Region]:
    """Return the planes of the left image without a partner."""
    regions = []
    for plane in left.planes:
        if plane.id not in matched:
            x, y, width, height = plane.box_px
            regions.append(Region(plane.id, left.labels[y : y + height, x : x + width] == plane.id, (x, y)))
    return regions


def rising_regions(outlines: Iterable[Array], explained: Iterable[Array], shape: tuple[int, ...]) -> list[Region]:
    """Return regions inside convex outlines in an image of a shape (height, width), without what is explained.

    Args:
        outlines: in the image, each of shape (N, 2).
        explained: polygons in the image that belong to known parts.
        shape: of the image.
    """
    height, width = shape[:2]
    others = np.zeros((height, width), dtype=np.uint8)
    for polygon in explained:
        cv2.fillPoly(others, [np.rint(polygon).astype(np.int32)], 1)
    regions = []
    for outline in outlines:
        corners = np.rint(outline).astype(np.int32)
        left, top = np.maximum(corners.min(axis=0), 0)
        right, bottom = np.minimum(corners.max(axis=0), (width - 1, height - 1))
        mask = np.zeros((bottom - top + 1, right - left + 1), dtype=np.uint8)
        cv2.fillConvexPoly(mask, corners - (left, top), 1)
        own = (mask > 0) & (others[top : bottom + 1, left : right + 1] == 0)
        if own.any():
            regions.append(Region(NO_PLANE, own, (int(left), int(top))))
    return regions


def find_places(regions: Iterable[Region], evidence: Evidence) -> tuple[Surface, ...]:
    """Give regions of the left image a place in the base frame by their grey values.

    Returns:
        Surfaces, taken as level, without systematic errors, that are as large and as high as a part may be; their match
        has `NO_PLANE` on the right.
    """
    found = [_by_grey_values(region, evidence) for region in regions]
    return tuple(surface for surface in found if surface is not None)


def place_unknown(regions: Iterable[Region], relief: Relief, evidence: Evidence) -> list[Surface | None]:
    """Give regions of the left image in which something rises a place, whatever their grey values tell.

    Returns:
        For each a surface as above, or None where it is a line; one that the grey values do not place is half as high
        as a part may be, as unsure as that.
    """
    found: list[Surface | None] = []
    for region in regions:
        disparity_px = rising_disparity(region, relief, evidence)
        if disparity_px is None:
            found.append(_somewhere(region, evidence))
        else:
            found.append(_placed(region, disparity_px, 0.0, _RISING_SIGMA_PX, evidence.rig))
    return found


def is_cut_off(region: Region, relief: Relief) -> bool:
    """Whether a region reaches to where one of the two pictures ends: what rises there goes on unseen."""
    grown = cv2.dilate(np.pad(region.mask, _BORDER_PX).astype(np.uint8), np.ones((_AROUND_PX, _AROUND_PX), np.uint8))
    # what is outside of the picture is not seen
    framed = np.pad(relief.valid, _BORDER_PX)
    x, y = region.corner_px
    window = framed[y : y + grown.shape[0], x : x + grown.shape[1]]
    return bool((grown.view(np.bool_) & ~window).any())


def _by_grey_values(region: Region, evidence: Evidence) -> Surface | None:
    limits, rig = evidence.limits, evidence.rig
    least, most = _disparities(region, evidence)
    if not _possible(region, rig, most, (limits.min_size_mm, limits.max_size_mm)):
        return None
    smooth = (evidence.fields[0].smooth, evidence.fields[1].smooth)
    found = _best_disparity(region, smooth, (least - _MARGIN_PX, most + _MARGIN_PX))
    return None if found is None else _placed(region, *found, _SIGMA_PX, rig)


def _somewhere(region: Region, evidence: Evidence) -> Surface | None:
    least, most = _disparities(region, evidence)
    return _placed(region, (least + most) / 2.0, 0.0, (most - least) / np.sqrt(12.0), evidence.rig)


def _disparities(region: Region, evidence: Evidence) -> tuple[float, float]:
    """Return the disparities of a region's centre on the table and as high as a part may be."""
    heights_mm = (evidence.table_z_mm, evidence.table_z_mm + evidence.limits.max_height_mm)
    low, high = (np.array(evidence.rig.plane_disparity(_UP, z_mm)) @ (*region.centre_px, 1.0) for z_mm in heights_mm)
    return float(low), float(high)


def _placed(
    region: Region, disparity_px: float, correlation: float, sigma_px: float, rig: RectifiedRig
) -> Surface | None:
    level = _level_plane(rig, region.centre_px, disparity_px)
    match = PlaneMatch(region.plane, NO_PLANE, correlation, disparity_px, level, sigma_px)
    border_px = mask_outline_px(region.mask, region.corner_px)
    return place_surface(border_px, region.centre_px, match, rig, systematic=False)


def _possible(region: Region, rig: RectifiedRig, disparity_px: float, size_range_mm: tuple[float, float]) -> bool:
    """Whether a region, at the least distance it may have, is as large as a face."""
    if disparity_px <= 0.0:
        return False
    mm_per_px = rig.baseline_mm / disparity_px
    least, most = size_range_mm
    side_px = float(np.sqrt(region.mask.sum()))
    return max(region.mask.shape) * mm_per_px <= most and side_px * mm_per_px >= least / 2.0


def _level_plane(rig: RectifiedRig, centre_px: tuple[float, float], disparity_px: float) -> tuple[float, float, float]:
    """Return the disparity plane of the level surface that has a disparity at a centre."""
    x, y = centre_px
    centre = rig.points_mm(np.array([x]), np.array([y]), np.array([disparity_px]))[0]
    return rig.plane_disparity(_UP, float(centre[2]))


def _best_disparity(
    region: Region, smooth: tuple[NDArray[np.float32], NDArray[np.float32]], span_px: tuple[float, float]
) -> tuple[float, float] | None:
    """Return the disparity at which the region's grey values correlate best, and the correlation."""
    grey_left, grey_right = smooth
    rows, columns, band = _pixels(region, grey_left.shape)
    disparities = np.arange(int(np.floor(span_px[0])), int(np.ceil(span_px[1])) + 1)
    if columns.size == 0 or disparities.size < 3:  # noqa: PLR2004 - a maximum has two neighbours
        return None
    template = grey_left[rows, columns]
    usual = _usual_greys(template, band)
    template = np.clip(template, *usual)
    template = template - template.mean()
    moved = columns[None, :] - disparities[:, None]
    inside = (moved >= 0).all(axis=1) & (moved < grey_right.shape[1]).all(axis=1)
    values = np.clip(grey_right[rows[None, :], np.clip(moved, 0, grey_right.shape[1] - 1)], *usual)
    values = values - values.mean(axis=1, keepdims=True)
    power = np.maximum((values**2).mean(axis=1) * (template**2).mean(), _MIN_VARIANCE)
    correlation = np.where(inside, (values * template).mean(axis=1) / np.sqrt(power), -1.0)
    best = int(correlation.argmax())
    if correlation[best] < _MIN_CORRELATION or best in {0, disparities.size - 1}:
        return None
    before, at, after = (float(value) for value in correlation[best - 1 : best + 2])
    curvature = before - 2.0 * at + after
    shift = 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0
    return float(disparities[best]) + float(np.clip(shift, -0.5, 0.5)), at


def _usual_greys(values: NDArray[np.float32], band: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the least and greatest grey value that a region and the band around it usually have.

    What is beyond is another part's, which stands before or beside the region and is at another height.
    """
    inside, around = (float(np.median(values[which])) if which.any() else 0.0 for which in (~band, band))
    margin = max(_USUAL_SHARE * abs(inside - around), _USUAL_LEAST)
    return min(inside, around) - margin, max(inside, around) + margin


def _pixels(region: Region, shape: tuple[int, ...]) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
    """Return rows and columns of a region with a band around it, thinned, and which of them are the band's."""
    size = 2 * _BAND_PX + 1
    grown = cv2.dilate(np.pad(region.mask, _BAND_PX).astype(np.uint8), np.ones((size, size), np.uint8))
    rows, columns = np.nonzero(grown)
    step = max(1, rows.size // _MAX_PIXELS)
    rows, columns = rows[::step], columns[::step]
    band = ~np.pad(region.mask, _BAND_PX)[rows, columns]
    rows, columns = rows + region.corner_px[1] - _BAND_PX, columns + region.corner_px[0] - _BAND_PX
    seen = (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
    return rows[seen], columns[seen], band[seen]
