"""Step 9, beyond the paper: regions that print and texture cut up become one surface again.

Matched regions whose disparities lie on one plane suggest a surface. The surface is tested on every region of the left
image: the right image, shifted by the surface's disparity, must show the region's grey values, clearly better than a
pixel beside it. Neighbouring regions of one surface become one plane, in the left image and, shifted, in the right one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.scene import PlaneImage, PlaneMatch
from srvs_cell.vision.interpolation import disparity_at
from srvs_cell.vision.planes import measure_planes
from srvs_cell.vision.refinement import GreyPair, align_plane

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.scene import DisparityPlane
    from srvs_cell.vision.parameters import GroupingParameters, VisionParameters

_MAX_SURFACES = 16
_LARGEST = 40
_TRIALS = 300
_MIN_REGIONS = 2
_POINTS = 3
_GREY_LIMIT = 30.0
_OUTSIDE_GREY = -1000.0
_SOBEL_SCALE = 0.125
_NOISE_GREY = 0.5
"""Costs that differ by less are alike: it is what rounding and noise cost."""
_LEAST_WEIGHT = 0.1
"""Grey values per pixel: what a pixel counts that lies on no slope."""
_BESIDE_PX = 1.0
_FLAT_SLOPE = 0.3
"""A surface whose disparity changes by more per pixel is none that a camera sees well."""
_ROUNDS = 2


@dataclass(frozen=True, eq=False)
class Grouping:
    """Both images with their surfaces as planes, and the matches among them."""

    left: PlaneImage
    right: PlaneImage
    matches: tuple[PlaneMatch, ...]


def group_surfaces(
    left: PlaneImage,
    right: PlaneImage,
    matches: Sequence[PlaneMatch],
    parameters: VisionParameters,
    valid: tuple[NDArray[np.bool_] | None, NDArray[np.bool_] | None] = (None, None),
) -> Grouping:
    """Join the regions of common surfaces.

    Args:
        left: the left image's planes.
        right: the right image's planes.
        matches: their matches, with disparity planes.
        parameters: of the vision.
        valid: pixels that belong to each image; all where None.

    Returns:
        The images and matches with joined planes; the same ones where nothing was to be joined.
    """
    limits = parameters.grouping
    surfaces = suggest_surfaces(left, matches, limits)
    if not surfaces:
        return Grouping(left, right, tuple(matches))
    pair = GreyPair.of(left.grey, right.grey)
    owner = np.full(len(left.planes) + 1, -1, dtype=np.int_)
    own = np.full((len(left.planes) + 1, 3), np.nan)
    for match in matches:
        own[match.left] = match.disparity_plane
    for _ in range(_ROUNDS):
        owner = assign_regions(pair, left.labels, own, surfaces, limits)
        surfaces = [_realigned(pair, left.labels, owner == k, plane, parameters) for k, plane in enumerate(surfaces)]
    return _joined(left, right, matches, owner, surfaces, parameters, valid)


def suggest_surfaces(
    left: PlaneImage, matches: Sequence[PlaneMatch], limits: GroupingParameters
) -> list[DisparityPlane]:
    """Return planes on which the disparities of at least two matched regions lie, the largest total area first.

    Candidates are the largest regions' own planes and planes through three regions' centres, drawn with a fixed seed.
    """
    planes = {plane.id: plane for plane in left.planes}
    points = np.array([(*planes[match.left].centre_px, match.disparity_px) for match in matches]).reshape(-1, 3)
    area = np.array([planes[match.left].area_px for match in matches])
    own = np.array([match.disparity_plane for match in matches]).reshape(-1, 3)
    generator = np.random.default_rng(0)
    free = np.ones(len(matches), dtype=np.bool_)
    found: list[DisparityPlane] = []
    while len(found) < _MAX_SURFACES and np.count_nonzero(free) >= _MIN_REGIONS:
        numbers = np.flatnonzero(free)
        largest = numbers[np.argsort(-area[numbers])][:_LARGEST]
        candidates = np.concatenate([own[largest], _through_three(points[numbers], area[numbers], generator)])
        design = np.column_stack([points[:, :2], np.ones(len(points))])
        near = np.abs(candidates @ design.T - points[:, 2]) < limits.max_step_px
        near &= free & (np.abs(candidates[:, :2]) < _FLAT_SLOPE).all(axis=1)[:, None]
        # three points always have a plane: one that was drawn through three needs two more
        needed = np.where(np.arange(len(candidates)) < largest.size, _MIN_REGIONS, _POINTS + _MIN_REGIONS)
        near &= (near.sum(axis=1) >= needed)[:, None]
        best = int(np.argmax(near @ area))
        inliers = near[best]
        if np.count_nonzero(inliers) < _MIN_REGIONS:
            break
        plane = candidates[best]
        if np.count_nonzero(inliers) > _POINTS:
            root = np.sqrt(area[inliers])
            plane = np.linalg.lstsq(design[inliers] * root[:, None], points[inliers, 2] * root, rcond=None)[0]
        found.append((float(plane[0]), float(plane[1]), float(plane[2])))
        free &= ~inliers
    return found


def _through_three(points: Array, area: Array, generator: np.random.Generator) -> Array:
    """Return planes through triples of points, large regions more often, shape (N, 3)."""
    if len(points) < _POINTS:
        return np.empty((0, 3))
    picks = generator.choice(len(points), size=(_TRIALS, _POINTS), p=area / area.sum())
    triples = points[picks]
    design = np.concatenate([triples[..., :2], np.ones((_TRIALS, _POINTS, 1))], axis=-1)
    proper = np.abs(np.linalg.det(design)) > 1.0
    solved: Array = np.linalg.solve(design[proper], triples[proper][..., 2:])[..., 0]
    return solved


def assign_regions(
    pair: GreyPair,
    labels: NDArray[np.int32],
    own: Array,
    surfaces: Sequence[DisparityPlane],
    limits: GroupingParameters,
) -> NDArray[np.int_]:
    """Return for each region the number of the surface that explains it best, or -1 where it belongs to none.

    A region belongs to a surface that explains it distinctly, and better than or as well as the region's own plane.

    Args:
        pair: the prepared images.
        labels: regions of the left image, int32, shape (H, W).
        own: (a, b, c) of every label's own plane, NaN where it has none, shape (labels, 3).
        surfaces: their disparity planes.
        limits: greatest cost, distinctness.
    """
    count = len(own)
    weights = np.abs(cv2.Sobel(pair.left, cv2.CV_32F, 1, 0, scale=_SOBEL_SCALE)) + _LEAST_WEIGHT
    flat = labels.ravel()
    total = np.maximum(np.bincount(flat, weights=weights.ravel(), minlength=count), _LEAST_WEIGHT)

    def cost(planes: Array, shift_px: float) -> Array:
        difference = _difference(pair, planes, shift_px) * weights
        return np.asarray(np.bincount(flat, weights=difference.ravel(), minlength=count) / total)

    planes = [np.array(plane).reshape(3, 1, 1) for plane in surfaces]
    at = np.array([cost(plane, 0.0) for plane in planes])
    beside = np.array([np.minimum(cost(plane, _BESIDE_PX), cost(plane, -_BESIDE_PX)) for plane in planes])
    best = np.argmin(at, axis=0)
    number = np.arange(count)
    lowest = at[best, number]
    distinct = beside[best, number] > limits.distinctness * lowest
    matched = np.isfinite(own).all(axis=1)
    own_cost = cost(np.moveaxis(np.nan_to_num(own)[labels], -1, 0), 0.0)
    as_good = lowest <= limits.distinctness * own_cost + _NOISE_GREY
    chosen = np.where((lowest < limits.max_cost) & np.where(matched, as_good, distinct), best, -1)
    chosen[0] = -1
    return np.asarray(chosen)


def _difference(pair: GreyPair, planes: Array, shift_px: float) -> NDArray[np.float32]:
    """Return the bounded grey differences under planes (a, b, c), broadcast to shape (3, H, W)."""
    height, width = pair.left.shape
    a, b, c = planes.astype(np.float32)
    columns = np.arange(width, dtype=np.float32)
    rows = np.broadcast_to(np.arange(height, dtype=np.float32)[:, None], (height, width))
    map_x = columns - (a * columns + b * rows + c + np.float32(shift_px))
    shifted = cv2.remap(
        pair.right,
        map_x,
        np.ascontiguousarray(rows),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=_OUTSIDE_GREY,
    )
    return np.asarray(np.minimum(np.abs(pair.left - shifted), _GREY_LIMIT), dtype=np.float32)


def _realigned(
    pair: GreyPair,
    labels: NDArray[np.int32],
    members: NDArray[np.bool_],
    plane: DisparityPlane,
    parameters: VisionParameters,
) -> DisparityPlane:
    rows, columns = np.nonzero(members[labels])
    aligned = align_plane(pair, rows, columns, plane, parameters.refinement)
    return plane if aligned is None else aligned.plane


def _joined(
    left: PlaneImage,
    right: PlaneImage,
    matches: Sequence[PlaneMatch],
    owner: NDArray[np.int_],
    surfaces: Sequence[DisparityPlane],
    parameters: VisionParameters,
    valid: tuple[NDArray[np.bool_] | None, NDArray[np.bool_] | None],
) -> Grouping:
    """Give the joined regions of each surface one label in both images and measure all planes anew."""
    labels_left, labels_right = left.labels.copy(), right.labels.copy()
    offset = max(len(left.planes), len(right.planes)) + 1
    partner = {match.left: match for match in matches}
    joined: list[tuple[int, DisparityPlane, float]] = []
    # the far surfaces first, so that the near ones hide them in the right image
    order = sorted(range(len(surfaces)), key=lambda k: _level(left, surfaces[k]))
    for k in order:
        member = (owner == k)[left.labels]
        count, parts = cv2.connectedComponents(_closed(member).astype(np.uint8), connectivity=4)
        for part in range(1, count):
            inside = (parts == part) & member
            regions = np.unique(left.labels[inside])
            if regions.size < _MIN_REGIONS:
                continue
            scores = [partner[region].score for region in regions.tolist() if region in partner]
            if not scores:
                continue
            filled = _with_enclosed(left.labels, inside, parameters.grouping.min_enclosure)
            labels_left[filled] = offset
            labels_right[_shifted(filled, surfaces[k])] = offset
            joined.append((offset, surfaces[k], float(np.mean(scores))))
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
            renewed.append(_moved(match, new_left, new_right, match.disparity_plane, centres[new_left], match.score))
    for label, plane, score in joined:
        new_left, new_right = id_left.get(label, 0), id_right.get(label, 0)
        if new_left and new_right:
            renewed.append(_moved(None, new_left, new_right, plane, centres[new_left], score))
    return Grouping(
        PlaneImage(left.grey, number_left, planes_left),
        PlaneImage(right.grey, number_right, planes_right),
        tuple(sorted(renewed, key=lambda match: match.left)),
    )


def _moved(
    match: PlaneMatch | None,
    left: int,
    right: int,
    plane: DisparityPlane,
    centre: tuple[float, float],
    score: float,
) -> PlaneMatch:
    sigma_px = match.disparity_sigma_px if match is not None else 0.1
    return PlaneMatch(left, right, score, float(disparity_at(plane, *centre)), plane, sigma_px)


def _level(image: PlaneImage, plane: DisparityPlane) -> float:
    height, width = image.grey.shape
    return float(disparity_at(plane, width / 2.0, height / 2.0))


def _closed(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask with slits of rejected slivers between its regions closed."""
    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)) > 0)


def _with_enclosed(labels: NDArray[np.int32], inside: NDArray[np.bool_], min_enclosure: float) -> NDArray[np.bool_]:
    """Return a surface's pixels with those of the regions that it encloses."""
    grown = cv2.dilate(inside.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    count = int(labels.max()) + 1
    border = _outlines(labels)
    length = np.bincount(labels[border], minlength=count)
    touching = np.bincount(labels[border & grown], minlength=count)
    enclosed = touching >= min_enclosure * np.maximum(length, 1)
    enclosed[0] = False
    return np.asarray(inside | enclosed[labels])


def _outlines(labels: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return the pixels beside another label."""
    outline = np.zeros(labels.shape, dtype=np.bool_)
    across, down = labels[:, 1:] != labels[:, :-1], labels[1:] != labels[:-1]
    outline[:, 1:] |= across
    outline[:, :-1] |= across
    outline[1:] |= down
    outline[:-1] |= down
    return outline


def _shifted(mask: NDArray[np.bool_], plane: DisparityPlane) -> NDArray[np.bool_]:
    """Return where the pixels of a left mask lie in the right image."""
    height, width = mask.shape
    a, b, c = plane
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    # x_R = x_L - (a x_L + b y + c)
    map_x = (columns + np.float32(b) * rows + np.float32(c)) / np.float32(1.0 - a)
    moved = cv2.remap(mask.astype(np.uint8), map_x, rows, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
    return np.asarray(moved > 0)


def _renumbered(before: NDArray[np.int32], after: NDArray[np.int32]) -> dict[int, int]:
    """Return old label -> new label of the planes that were kept."""
    new_of_old = np.zeros(int(before.max()) + 1, dtype=np.int32)
    new_of_old[before] = after
    return {int(old): int(new_of_old[old]) for old in np.flatnonzero(new_of_old)}
