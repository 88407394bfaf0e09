"""Every pixel its surface: a disparity map without holes.

The planes that explain the pair (`srvs_cell.vision.hypotheses`) compete for every superpixel: it takes the one that
explains its pixels and suits its neighbours, by Potts' model (`srvs_cell.vision.labelling`). Along the borders the
pixels then choose for themselves, by their own costs and by what those around them chose: no superpixel follows an
edge quite. Each plane is aligned once more over its own pixels, away from their border.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.labelling import choose_labels
from srvs_cell.vision.photometric import PhotometricCost
from srvs_cell.vision.refinement import GreyPair, align_plane
from srvs_cell.vision.superpixels import cut_superpixels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.scene import DisparityPlane
    from srvs_cell.vision.parameters import DenseParameters, RefinementParameters

_ERODED = np.ones((7, 7), np.uint8)
"""So far from a surface's border its pixels are surely its own, and hidden in neither image."""
_VOTERS = (5, 5)
_VOTE_WEIGHT = 3.0
"""What the share of the pixels around counts, in greatest costs."""
_VOTES = 3
_SMALL_WINDOW = (5, 5)
"""A pixel's own cost is that of those around it: one alone tells no surface from another."""
_NEVER = 100.0


def fill_disparity(
    images: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    surfaces: Sequence[DisparityPlane],
    parameters: DenseParameters,
    refinement: RefinementParameters,
    valid: NDArray[np.bool_] | None = None,
) -> NDArray[np.float32]:
    """Return the disparity of every pixel of the left image, float32, shape (H, W).

    Args:
        images: left and right grey image, uint8, shape (H, W).
        surfaces: disparity planes of which every pixel takes one; at least one.
        parameters: of the superpixels and of Potts' model.
        refinement: of the alignment.
        valid: pixels that belong to the left image, all where None; the others get NaN.
    """
    grey, _ = images
    cost, pair = PhotometricCost.of(*images), GreyPair.of(*images)
    pieces = cut_superpixels(grey, parameters.cell_px, parameters.contrast_grey)
    flat = pieces.labels.ravel()
    of_pixels = cost.of_planes(surfaces)
    costs = np.zeros((len(surfaces), pieces.count))
    for k, each in enumerate(of_pixels):
        costs[k] = np.bincount(flat, each.ravel(), pieces.count)
    weight = parameters.smoothness * pieces.weight
    owner = choose_labels(costs, pieces.one, pieces.other, weight, parameters.iterations)[pieces.labels]
    owner = _smooth_borders(owner, of_pixels)
    planes = np.array(surfaces, dtype=np.float64)
    for k, surface in enumerate(surfaces):
        rows, columns = np.nonzero(cv2.erode((owner == k).astype(np.uint8), _ERODED))
        aligned = align_plane(
            pair, rows, columns, surface, refinement, parameters.roughness_px, parameters.row_sigma_px
        )
        if aligned is not None:
            planes[k] = aligned.plane
    a, b, c = planes.astype(np.float32).T
    y, x = np.indices(grey.shape, dtype=np.float32)
    disparity = a[owner] * x + b[owner] * y + c[owner]
    if valid is not None:
        disparity[~valid] = np.nan
    return np.asarray(disparity, dtype=np.float32)


def _smooth_borders(owner: NDArray[np.intp], costs: NDArray[np.float32]) -> NDArray[np.intp]:
    """Let the pixels near a border choose among the surfaces around them.

    Args:
        owner: the surface of each pixel, shape (H, W).
        costs: of each surface at each pixel, shape (K, H, W).
    """
    own = np.stack([cv2.boxFilter(each, -1, _SMALL_WINDOW) for each in costs])
    for _ in range(_VOTES):
        votes = np.stack([cv2.boxFilter((owner == k).astype(np.float32), -1, _VOTERS) for k in range(len(costs))])
        total = own - _VOTE_WEIGHT * votes + _NEVER * (votes <= 0.0)
        # where all around agree there is no other surface to choose
        owner = np.argmin(total, axis=0)
    return owner
