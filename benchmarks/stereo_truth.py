"""The published truth of the Middlebury 2001 pairs, and how a disparity map is scored against it.

Definitions, the same for every matcher:

- *Visible* pixels: truth known, the true match lies inside the right image, and no true surface nearer by more than
  0.6 px of disparity covers it there. Everything is scored on visible pixels alone.
- *bad-t*: share of the visible pixels whose disparity is off by more than t px **or missing**: a hole counts as bad.
- *True planes*: the truth was drawn by hand as planes and stored in eighths of a pixel. They are won back by
  sequential RANSAC (fixed seed) on the truth: within 0.13 px, at least 1 % of the image each.
- *rms of a plane*: to the matcher's disparities inside the true plane, eroded by 2 px, a plane is fitted robustly
  (Tukey's weights, from the middle difference to the truth on); the rms of that plane against the stored truth over
  the eroded area is the figure. The rounding of the truth alone makes 0.036 px; the truth itself is good to about
  0.1 px. A plane that the matcher covers by less than 5 % counts with 1 px.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Image = NDArray[np.uint8]
    Mask = NDArray[np.bool_]
    Array = NDArray[np.float64]

TRUTH_SCALE = 8.0
SETS = ("sawtooth", "venus", "poster")
MAX_DISPARITY_PX = 32
_OCCLUSION_PX = 0.6
_PLANE_TOLERANCE_PX = 0.13
_LEAST_SHARE = 0.01
_ERODED_PX = 2
_TRIALS = 600
_SAMPLED = 6000
_TRIPLE_RADIUS_PX = 60
_LEAST_DETERMINANT = 50.0
_POLISHINGS = 5
_TUKEY = 4.685
_MAD_TO_SIGMA = 1.4826
_LEAST_SCALE_PX = 0.05
_FIT_STEPS = 30
_LEAST_COVER = 0.05
_UNCOVERED_PX = 1.0


@dataclass(frozen=True, eq=False)
class StereoPair:
    """A pair of pictures with its truth.

    Attributes:
        name: of the set.
        left, right: BGR pictures, uint8, shape (H, W, 3).
        truth_px: disparity of the left picture, 0 where unknown, shape (H, W).
        visible: the pixels that are scored.
        planes: the masks of the true planes, eroded.
        plane_values: (a, b, c) of each true plane.
    """

    name: str
    left: Image
    right: Image
    truth_px: Array
    visible: Mask
    planes: tuple[Mask, ...]
    plane_values: tuple[Array, ...]


@dataclass(frozen=True)
class Score:
    """What a disparity map is worth: shares in percent, rms in px."""

    bad_1: float
    bad_half: float
    rms_px: tuple[float, ...]

    @property
    def rms_mean_px(self) -> float:
        """Mean over the true planes."""
        return float(np.mean(self.rms_px))


def read_image(path: Path, mode: int = cv2.IMREAD_COLOR) -> Image:
    """Return an image; raises `FileNotFoundError` where there is none."""
    image = cv2.imread(str(path), mode)
    if image is None:
        raise FileNotFoundError(path)
    return np.asarray(image, dtype=np.uint8)


def read_pair(folder: Path) -> StereoPair:
    """Read a set of Middlebury 2001 and find its visible pixels and true planes."""
    truth = read_image(folder / "disp2.pgm", cv2.IMREAD_GRAYSCALE) / TRUTH_SCALE
    visible = visible_pixels(truth)
    found = true_planes(truth, visible)
    square = np.ones((2 * _ERODED_PX + 1,) * 2, np.uint8)
    return StereoPair(
        folder.name,
        read_image(folder / "im2.ppm"),
        read_image(folder / "im6.ppm"),
        truth,
        visible,
        tuple(cv2.erode(mask.astype(np.uint8), square) > 0 for _, mask in found),
        tuple(plane for plane, _ in found),
    )


def visible_pixels(truth_px: Array) -> Mask:
    """Return the pixels of the left image that the right one shows too."""
    height, width = truth_px.shape
    matched = np.arange(width) - truth_px
    known = (truth_px > 0.0) & (matched >= 0.0)
    rows, columns = np.nonzero(known)
    disparity, at = truth_px[known], matched[known]
    nearest = np.zeros((height, width + 1))
    for beside in (np.floor(at), np.ceil(at)):
        np.maximum.at(nearest, (rows, beside.astype(np.intp)), disparity)
    visible = np.zeros(truth_px.shape, dtype=np.bool_)
    visible[rows, columns] = nearest[rows, np.rint(at).astype(np.intp)] <= disparity + _OCCLUSION_PX
    return visible


def true_planes(truth_px: Array, visible: Mask) -> list[tuple[Array, Mask]]:
    """Split the truth into the planes that it was drawn as: (a, b, c) and visible pixels of each, largest first."""
    generator = np.random.default_rng(0)
    least = _LEAST_SHARE * truth_px.size
    free = visible.copy()
    found: list[tuple[Array, Mask]] = []
    while np.count_nonzero(free) >= least:
        rows, columns = np.nonzero(free)
        points = np.column_stack([columns, rows, np.ones(rows.size)]).astype(np.float64)
        disparity = truth_px[free]
        plane = _most_common_plane(points, disparity, generator)
        for _ in range(_POLISHINGS):
            inliers = np.abs(points @ plane - disparity) < _PLANE_TOLERANCE_PX
            plane = np.asarray(np.linalg.lstsq(points[inliers], disparity[inliers], rcond=None)[0], dtype=np.float64)
        if np.count_nonzero(inliers) < least:
            break
        mask = np.zeros_like(free)
        mask[rows[inliers], columns[inliers]] = True
        found.append((plane, mask))
        free &= ~mask
    return found


def _most_common_plane(points: Array, disparity: Array, generator: np.random.Generator) -> Array:
    chosen = generator.choice(len(points), min(_SAMPLED, len(points)), replace=False)
    points, disparity = points[chosen], disparity[chosen]
    best: Array = np.zeros(3)
    most = 0
    for _ in range(_TRIALS):
        first = int(generator.integers(len(points)))
        near = np.flatnonzero((np.abs(points - points[first]) < _TRIPLE_RADIUS_PX).all(axis=1))
        triple = [first, *generator.choice(near, 2)]
        if abs(float(np.linalg.det(points[triple]))) < _LEAST_DETERMINANT:
            continue
        plane = np.asarray(np.linalg.solve(points[triple], disparity[triple]), dtype=np.float64)
        count = int(np.count_nonzero(np.abs(points @ plane - disparity) < _PLANE_TOLERANCE_PX))
        if count > most:
            best, most = plane, count
    return best


def score(pair: StereoPair, disparity_px: NDArray[np.floating]) -> Score:
    """Score a disparity map, NaN where it has a hole."""
    error = np.abs(disparity_px - pair.truth_px)[pair.visible]
    rms = []
    for plane, mask in zip(pair.plane_values, pair.planes, strict=True):
        rows, columns = np.nonzero(mask)
        offset = _offset_plane(rows, columns, np.asarray(disparity_px[mask], dtype=np.float64), plane)
        fitted = columns * (plane[0] + offset[0]) + rows * (plane[1] + offset[1]) + plane[2] + offset[2]
        rms.append(float(np.sqrt(np.mean((fitted - pair.truth_px[mask]) ** 2))))
    bad_1, bad_half = (100.0 * float(1.0 - np.mean(error <= limit)) for limit in (1.0, 0.5))
    return Score(bad_1, bad_half, tuple(rms))


def _offset_plane(rows: NDArray[np.intp], columns: NDArray[np.intp], disparity: Array, plane: Array) -> Array:
    """Return the robust fit of the difference between a matcher's disparities and a true plane, (a, b, c)."""
    there = np.isfinite(disparity)
    if np.count_nonzero(there) < _LEAST_COVER * rows.size:
        return np.array([0.0, 0.0, _UNCOVERED_PX])
    points = np.column_stack([columns, rows, np.ones(rows.size)])[there].astype(np.float64)
    difference = disparity[there] - points @ plane
    solution = np.asarray([0.0, 0.0, float(np.median(difference))], dtype=np.float64)
    for _ in range(_FIT_STEPS):
        residual = difference - points @ solution
        scale = max(_MAD_TO_SIGMA * float(np.median(np.abs(residual))), _LEAST_SCALE_PX)
        weight = np.clip(1.0 - (residual / (_TUKEY * scale)) ** 2, 0.0, None) ** 2
        weighted = points * weight[:, None]
        fitted = np.linalg.lstsq(weighted.T @ points, weighted.T @ difference, rcond=None)[0]
        solution = np.asarray(fitted, dtype=np.float64)
    return solution
