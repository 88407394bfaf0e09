"""Step 9, beyond the paper: regions that print and texture cut up become one surface again.

The surfaces are the few planes that together explain the pair (`srvs_cell.vision.hypotheses`). Each is tested on every
region of the left image: the right image, shifted by the surface's disparity, must show the region's grey values,
clearly better than a pixel beside it. Neighbouring regions of one surface become one plane, in the left image and,
shifted, in the right one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.scene import PlaneImage, PlaneMatch
from srvs_cell.vision.hypotheses import LEAST_SLOPE, find_surfaces
from srvs_cell.vision.interpolation import disparity_at
from srvs_cell.vision.photometric import row_slope
from srvs_cell.vision.planes import measure_planes
from srvs_cell.vision.refinement import align_plane
from srvs_cell.vision.runs import RowRuns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.scene import DisparityPlane
    from srvs_cell.vision.parameters import GroupingParameters, VisionParameters
    from srvs_cell.vision.refinement import GreyPair

    Mask = NDArray[np.bool_]

_MIN_REGIONS = 2
_SLIT_PX = 2
"""Regions so far apart still touch: an edge lies between them."""
_GREY_LIMIT = 30.0
_SAMPLED_PIXELS = 1000
"""A larger region is judged by an even choice of about so many of its pixels."""
_LATTICE = (49472, 37345)
"""Steps of the two-dimensional low-discrepancy sequence (Roberts 2018), in 65536ths."""
_WHOLE = 65535
_ALL = slice(None)
_SQUARE = np.ones((3, 3), np.uint8)
_NOISE_GREY = 0.5
"""Costs that differ by less are alike: it is what rounding and noise cost."""
_LEAST_WEIGHT = 0.1
"""Grey values per pixel: what a pixel counts that lies on no slope."""
_BESIDE_PX = 1.0
_RIM_PX = 3
_MOST_RIM = 0.5
"""Share of a region's pixels that its rim may have to be left out."""


@dataclass(frozen=True, eq=False)
class Grouping:
    """Both images with their surfaces as planes, and the matches among them.

    Attributes:
        left, right: images and planes.
        matches: matched planes.
        surfaces: disparity planes that together explain the pair; empty where none were sought.
    """

    left: PlaneImage
    right: PlaneImage
    matches: tuple[PlaneMatch, ...]
    surfaces: tuple[DisparityPlane, ...] = ()


def group_surfaces(
    left: PlaneImage,
    right: PlaneImage,
    matches: Sequence[PlaneMatch],
    pair: GreyPair,
    parameters: VisionParameters,
    valid: tuple[NDArray[np.bool_] | None, NDArray[np.bool_] | None] = (None, None),
) -> Grouping:
    """Join the regions of common surfaces.

    Args:
        left: the left image's planes.
        right: the right image's planes.
        matches: their matches, with disparity planes.
        pair: the images prepared for the alignment.
        parameters: of the vision.
        valid: pixels that belong to each image; all where None.

    Returns:
        The images and matches with joined planes; the same ones where nothing was to be joined.
    """
    limits = parameters.grouping
    planes = np.array([match.disparity_plane for match in matches]).reshape(-1, 3)
    shared = _are_shared(planes, left, matches, limits.max_step_px)
    candidates = matches if parameters.dense.enabled else [matches[k] for k in np.flatnonzero(shared).tolist()]
    if not candidates:
        return Grouping(left, right, tuple(matches))
    slope = row_slope(left.grey).ravel()
    # a bare table would take all the places of the few pixels that tell something
    pixels = np.flatnonzero(np.abs(slope) >= LEAST_SLOPE)
    sloping = (pixels, slope[pixels])
    found = find_surfaces(left, right, candidates, sloping, pair, (limits, parameters.refinement))
    everything = tuple(each.plane for each in found)
    shared = _are_shared(np.array(everything).reshape(-1, 3), left, matches, limits.max_step_px)
    known = [found[k] for k in np.flatnonzero(shared).tolist() if found[k].sigma_px <= limits.max_step_px]
    if not known:
        return Grouping(left, right, tuple(matches), everything)
    surfaces, sigmas_px = [each.plane for each in known], [each.sigma_px for each in known]
    own = np.full((len(left.planes) + 1, 3), np.nan)
    for match in matches:
        own[match.left] = match.disparity_plane
    outlines = _outlines(left.labels)
    inner = _inner_labels(left, outlines, np.isnan(own).any(axis=1))
    region = inner.ravel()[pixels]
    samples = sample_regions(left, inner)
    owner = assign_regions(pair, samples, own, surfaces, limits)
    for k in np.unique(owner[owner >= 0]).tolist():
        rows, columns = np.divmod(pixels[(owner == k)[region]], left.labels.shape[1])
        aligned = align_plane(pair, rows, columns, surfaces[k], parameters.refinement)
        if aligned is not None:
            surfaces[k], sigmas_px[k] = aligned.plane, aligned.sigma_px
        if sigmas_px[k] > limits.max_step_px:
            # the picture does not tell where these regions lie: they cannot be taken for one surface's
            owner[owner == k] = -1
    known_now = list(zip(surfaces, sigmas_px, strict=True))
    joined = _joined(left, right, matches, (owner, known_now, outlines), parameters, valid)
    return replace(joined, surfaces=everything)


def _are_shared(surfaces: Array, left: PlaneImage, matches: Sequence[PlaneMatch], max_step_px: float) -> Mask:
    """Return on which surfaces, (a, b, c), shape (K, 3), two matched regions lie whose boxes touch, shape (K,).

    Regions that are apart may lie on one by chance: the tops of parts of one height.
    """
    regions = [left.planes[match.left - 1] for match in matches]
    centre = np.array([region.centre_px for region in regions]).reshape(-1, 2)
    box = np.array([region.box_px for region in regions]).reshape(-1, 4)
    disparity = np.array([match.disparity_px for match in matches])
    lying = np.abs(surfaces[:, :2] @ centre.T + surfaces[:, 2:] - disparity) < max_step_px
    corner, end = box[:, :2], box[:, :2] + box[:, 2:] + _SLIT_PX
    touching = ((corner[:, None] <= end) & (corner <= end[:, None])).all(axis=2)
    one, other = np.nonzero(np.triu(touching, 1))
    return np.asarray((lying[:, one] & lying[:, other]).any(axis=1))


def assign_regions(
    pair: GreyPair,
    samples: tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]],
    own: Array,
    surfaces: Sequence[DisparityPlane],
    limits: GroupingParameters,
) -> NDArray[np.int_]:
    """Return for each region the number of the surface that explains it best, or -1 where it belongs to none.

    A region belongs to a surface that explains it distinctly, and better than or as well as the region's own plane.

    Args:
        pair: the prepared images.
        samples: region, row and column of pixels of the left image, as `sample_regions` chooses them.
        own: (a, b, c) of every label's own plane, NaN where it has none, shape (labels, 3).
        surfaces: their disparity planes.
        limits: greatest cost, distinctness.
    """
    count = len(own)
    region, rows, columns = samples
    weights = np.abs(pair.left_x[rows, columns]) + _LEAST_WEIGHT
    total = np.maximum(np.bincount(region, weights=weights, minlength=count), _LEAST_WEIGHT)
    x, y, target = columns.astype(np.float32), rows.astype(np.float32), pair.left[rows, columns]

    def cost(planes: Array, shift_px: float, of: NDArray[np.bool_] | slice = _ALL) -> Array:
        """Return the regions' costs under one plane or, shape (3, N), one for each pixel ``of`` the sampled ones."""
        a, b, c = planes.astype(np.float32)
        disparity = a * x[of] + b * y[of] + (c + np.float32(shift_px))
        difference = _difference(pair, rows[of], x[of] - disparity, target[of]) * weights[of]
        return np.asarray(np.bincount(region[of], weights=difference, minlength=count) / total)

    planes = np.array(surfaces)
    at = np.array([cost(plane, 0.0) for plane in planes])
    best = np.argmin(at, axis=0)
    lowest = at[best, np.arange(count)]
    matched = np.asarray(np.isfinite(own).all(axis=1))
    own_to = matched[region]
    as_good = lowest <= limits.distinctness * cost(own[region[own_to]].T, 0.0, own_to) + _NOISE_GREY
    # beside the surface, only the regions are looked at that have no plane of their own
    open_to = (~matched & (lowest < limits.max_cost))[region]
    nearest = planes[best[region[open_to]]].T
    beside = np.minimum(cost(nearest, _BESIDE_PX, open_to), cost(nearest, -_BESIDE_PX, open_to))
    distinct = beside > limits.distinctness * lowest + _NOISE_GREY
    chosen = np.where((lowest < limits.max_cost) & np.where(matched, as_good, distinct), best, -1)
    chosen[0] = -1
    return np.asarray(chosen)


def _inner_labels(image: PlaneImage, outlines: Mask, unmatched: Mask) -> NDArray[np.int32]:
    """Return the labels without the rim of those regions that keep most of their pixels without it.

    The edge around a large region without a match may be that of what stands before it, and speak for that one's plane.

    Args:
        image: the left image's planes.
        outlines: the pixels beside another label.
        unmatched: which labels have no plane of their own, shape (labels,).
    """
    near = cv2.dilate(outlines.view(np.uint8), np.ones((2 * _RIM_PX + 1, 2 * _RIM_PX + 1), np.uint8))
    rim = np.flatnonzero(np.asarray(near, dtype=np.uint8).view(np.bool_))
    inner = image.labels.copy()
    label = inner.ravel()[rim]
    area = np.array([0.0, *[plane.area_px for plane in image.planes]])
    left_out = unmatched & (np.bincount(label, minlength=area.size) < _MOST_RIM * area)
    inner.ravel()[rim[left_out[label]]] = 0
    return inner


def sample_regions(
    image: PlaneImage, labels: NDArray[np.int32]
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Return region, row and column of every region's pixels, of a large region of a part of them, shape (N,)."""
    # what belongs to no region has no share
    share = np.array([0.0, *[_SAMPLED_PIXELS / plane.area_px for plane in image.planes]])
    limit = (np.minimum(share, 1.0) * _WHOLE).astype(np.uint16)
    # a lattice of irrational steps, modulo 1, leaves pixels out evenly along every direction
    across, down = (np.arange(size) * step for size, step in zip(labels.shape[::-1], _LATTICE, strict=True))
    place = np.add.outer(down.astype(np.uint16), across.astype(np.uint16))
    kept = np.flatnonzero(place < limit.take(labels, mode="clip"))
    rows = kept // labels.shape[1]
    return labels.ravel()[kept].astype(np.intp), rows, kept - rows * labels.shape[1]


def _difference(
    pair: GreyPair, rows: NDArray[np.intp], x: NDArray[np.float32], target: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the bounded grey differences of left pixels and the right image at (x, row), shape (N,)."""
    width = pair.right.shape[1]
    inside = (x >= 0.0) & (x <= width - 1.0)
    x = np.minimum(np.maximum(x, np.float32(0.0)), np.float32(width - 1.001))
    left = x.astype(np.intp)
    share = x - left.astype(np.float32)
    left += rows * width
    flat = pair.right.ravel()
    value = flat[left]
    value += share * (flat[left + 1] - value)
    return np.asarray(np.where(inside, np.minimum(np.abs(target - value), _GREY_LIMIT), _GREY_LIMIT), dtype=np.float32)


def _joined(
    left: PlaneImage,
    right: PlaneImage,
    matches: Sequence[PlaneMatch],
    found: tuple[NDArray[np.int_], Sequence[tuple[DisparityPlane, float]], Mask],
    parameters: VisionParameters,
    valid: tuple[NDArray[np.bool_] | None, NDArray[np.bool_] | None],
) -> Grouping:
    """Give the joined regions of each surface one label in both images and measure all planes anew.

    Args:
        left: the left image's planes.
        right: the right image's planes.
        matches: their matches.
        found: the surface of each region; the surfaces with their sigmas; the regions' outlines.
        parameters: of the vision.
        valid: pixels that belong to each image.
    """
    owner, surfaces, outlines = found
    length = np.bincount(left.labels[outlines], minlength=len(left.planes) + 1)
    labels_left, labels_right = left.labels.copy(), right.labels.copy()
    offset = max(len(left.planes), len(right.planes)) + 1
    partner = {match.left: match for match in matches}
    joined: list[tuple[int, DisparityPlane, float, float]] = []
    apart = np.zeros(owner.size, dtype=np.bool_)
    apart[list(partner)] = True
    # the far surfaces first, so that the near ones hide them in the right image
    order = sorted(range(len(surfaces)), key=lambda k: _level(left, surfaces[k][0]))
    for k in order:
        plane, sigma_px = surfaces[k]
        for regions in _neighbours_among(left, owner == k):
            scores = [partner[region].score for region in regions.tolist() if region in partner]
            if not scores:
                continue
            chosen = _with_enclosed(left, regions, (outlines, length), parameters.grouping.min_enclosure)
            # what has a plane of its own that explains it better is a part that stands on the surface, no print
            chosen[apart & (owner != k)] = False
            window = _window(left, np.flatnonzero(chosen))
            filled = chosen[left.labels[window]]
            labels_left[window][filled] = offset
            _paint_shifted(labels_right, filled, window, plane, offset)
            joined.append((offset, plane, float(np.mean(scores)), sigma_px))
            offset += 1
    if not joined:
        return Grouping(left, right, tuple(matches))
    number_left, planes_left = measure_planes(left.grey, labels_left, parameters.planes, valid[0])
    number_right, planes_right = measure_planes(right.grey, labels_right, parameters.planes, valid[1])
    id_left, id_right = _renumbered(labels_left, number_left), _renumbered(labels_right, number_right)
    centres = {plane.id: plane.centre_px for plane in planes_left}
    renewed = []
    for match in matches:
        new_left, new_right = id_left.get(match.left, 0), id_right.get(match.right, 0)
        if new_left and new_right:
            level = float(disparity_at(match.disparity_plane, *centres[new_left]))
            renewed.append(replace(match, left=new_left, right=new_right, disparity_px=level))
    for label, plane, score, sigma_px in joined:
        new_left, new_right = id_left.get(label, 0), id_right.get(label, 0)
        if new_left and new_right:
            level = float(disparity_at(plane, *centres[new_left]))
            renewed.append(PlaneMatch(new_left, new_right, score, level, plane, sigma_px))
    return Grouping(
        PlaneImage(left.grey, number_left, planes_left),
        PlaneImage(right.grey, number_right, planes_right),
        tuple(sorted(renewed, key=lambda match: match.left)),
    )


def _level(image: PlaneImage, plane: DisparityPlane) -> float:
    height, width = image.grey.shape
    return float(disparity_at(plane, width / 2.0, height / 2.0))


def _window(image: PlaneImage, ids: NDArray[np.intp]) -> tuple[slice, slice]:
    """Return the rows and columns that hold some planes and one pixel around them."""
    x, y, width, height = np.array([image.planes[plane - 1].box_px for plane in ids.tolist()]).T
    top, left = max(int(y.min()) - 1, 0), max(int(x.min()) - 1, 0)
    return slice(top, int((y + height).max()) + 1), slice(left, int((x + width).max()) + 1)


def _neighbours_among(image: PlaneImage, member: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Return the groups of at least two member planes that lie beside each other, or but for a slit of a sliver."""
    ids = np.flatnonzero(member)
    if ids.size < _MIN_REGIONS:
        return []
    labels = image.labels[_window(image, ids)]
    inside = member[labels].astype(np.uint8)
    _, found = cv2.connectedComponents(cv2.morphologyEx(inside, cv2.MORPH_CLOSE, _SQUARE), connectivity=4)
    group = np.zeros(member.size, dtype=np.intp)
    group[labels[inside > 0]] = found[inside > 0]
    groups = [ids[group[ids] == number] for number in np.unique(group[ids])]
    return [regions for regions in groups if regions.size >= _MIN_REGIONS]


def _with_enclosed(
    image: PlaneImage, regions: NDArray[np.intp], outlined: tuple[Mask, NDArray[np.intp]], min_enclosure: float
) -> NDArray[np.bool_]:
    """Return which planes are among the regions or enclosed by them, shape (planes + 1,).

    Args:
        image: the image's planes.
        regions: their ids.
        outlined: the pixels beside another label, and how many of them each plane has.
        min_enclosure: share of these that must lie beside the regions.
    """
    (outlines, length), count = outlined, len(image.planes) + 1
    chosen = np.zeros(count, dtype=np.bool_)
    chosen[regions] = True
    window = _window(image, regions)
    labels = image.labels[window]
    grown = cv2.dilate(chosen[labels].astype(np.uint8), _SQUARE) > 0
    touching = np.bincount(labels[outlines[window] & grown], minlength=count)
    enclosed = touching >= min_enclosure * np.maximum(length, 1)
    enclosed[0] = False
    return np.asarray(chosen | enclosed)


def _outlines(labels: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return the pixels beside another label."""
    outline = np.zeros(labels.shape, dtype=np.bool_)
    across, down = labels[:, 1:] != labels[:, :-1], labels[1:] != labels[:-1]
    outline[:, 1:] |= across
    outline[:, :-1] |= across
    outline[1:] |= down
    outline[:-1] |= down
    return outline


def _paint_shifted(
    labels: NDArray[np.int32], filled: NDArray[np.bool_], window: tuple[slice, slice], plane: DisparityPlane, label: int
) -> None:
    """Write a label where the pixels of a left mask lie in the right image, in place."""
    a, b, c = plane
    rows, columns = np.arange(window[0].start, window[0].start + filled.shape[0]), window[1]
    edge = np.array([columns.start - 1, columns.start + filled.shape[1]])
    seen = edge[:, None] - disparity_at(plane, edge[:, None], rows[[0, -1]])
    first, last = max(int(seen.min()), 0), min(int(seen.max()) + 1, labels.shape[1] - 1)
    if last < first:
        return
    # x_R = x_L - (a x_L + b y + c)
    map_x = (np.arange(first, last + 1) + b * rows[:, None] + c) / (1.0 - a) - columns.start
    map_y = np.broadcast_to(np.arange(rows.size, dtype=np.float32)[:, None], map_x.shape)
    moved = cv2.remap(
        filled.astype(np.uint8),
        map_x.astype(np.float32),
        np.ascontiguousarray(map_y),
        cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT,
    )
    labels[window[0], first : last + 1][moved > 0] = label


def _renumbered(before: NDArray[np.int32], after: NDArray[np.int32]) -> dict[int, int]:
    """Return old label -> new label of the planes that were kept."""
    runs = RowRuns.of(before)
    new_of_old = np.zeros(int(runs.label.max()) + 1, dtype=np.int32)
    new_of_old[runs.label] = after.ravel()[runs.start]
    return {int(old): int(new_of_old[old]) for old in np.flatnonzero(new_of_old)}
