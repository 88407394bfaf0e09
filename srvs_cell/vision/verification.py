"""Step 11f, beyond the paper: which top faces really stand there, and what stands there besides.

Edges alone take a shadow for a face, miss a face of nearly the table's grey, and are misled by a sliver of side face.
The relief over the table knows what rises; the grey values across the borders know where exactly.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.profile_fit import measure_blur
from srvs_cell.vision.profiles import Pictures
from srvs_cell.vision.relief import risen, rising_outlines
from srvs_cell.vision.rising_faces import fit_rising
from srvs_cell.vision.top_faces import is_top
from srvs_cell.vision.tops import CERTAIN_RMS_PX, Top, explained_polygons, one_per_place, rank, share_place
from srvs_cell.vision.witnesses import Bench, Witnesses

if TYPE_CHECKING:
    from srvs_cell.geometry import Array
    from srvs_cell.scene import PlaneImage
    from srvs_cell.vision.face_fit import EdgeField
    from srvs_cell.vision.faces import Face
    from srvs_cell.vision.recognition import RecognitionParameters
    from srvs_cell.vision.rectification import RectifiedRig
    from srvs_cell.vision.relief import Relief

_TRUSTED_RMS_PX = 0.5
"""A figure that fits worse does not explain what rises at its place."""
_SEAM_PX = 1.5
"""Where a face stands over the table, its outline leaves at least a seam of this width in the relief."""
_UNSEEN_PX = 200
"""So many pixels of relief that no face explains are a part that was not recognised."""
_ROUNDS = 2
_FOR_BLUR = 3
"""So many well known faces tell the blur of the picture."""


def verify_tops(
    tops: list[Top],
    relief: Relief,
    images: tuple[PlaneImage, PlaneImage],
    fields: tuple[EdgeField, EdgeField],
    rig: RectifiedRig,
    table_z_mm: float,
    limits: RecognitionParameters,
) -> tuple[list[Top], list[Array]]:
    """Fit tops to the grey values, add those that only their parallax tells, and drop what does not rise.

    Args:
        tops: what the edges told.
        relief: what rises over the table.
        images: the rectified images with their planes.
        fields: their gradients.
        rig: the rectified cameras.
        table_z_mm: height of the table, base frame.
        limits: of the recognition.

    Returns:
        The tops that stand there, the surest first; and outlines of what rises and stays unexplained, pixels of the
        left image, each of shape (N, 2).
    """
    left, right = images
    surest = sorted((top.fit for top in tops if top.fit.rms_px < CERTAIN_RMS_PX), key=lambda fit: fit.rms_px)
    sharp = [fit.face for fit in surest[:_FOR_BLUR]]
    pictures = Pictures.of(left.grey, right.grey)
    pictures = replace(pictures, blur_px=measure_blur(sharp, pictures, rig, table_z_mm))
    bench = Bench(pictures, fields, rig, table_z_mm, limits.min_gradient, lambda fit: is_top(fit, table_z_mm, limits))
    seen = [
        (top, both)
        for top, both in zip(tops, bench.by_profiles([top.fit for top in tops]), strict=True)
        if both is not None
    ]
    settled = bench.settled([both for _, both in seen])
    known = [replace(top, fit=both.agreed()) for (top, _), both in zip(seen, settled, strict=True)]
    tried: list[Array] = []
    for _ in range(_ROUNDS):
        trusted = [top for top in known if top.fit.rms_px <= _TRUSTED_RMS_PX]
        outlines = rising_outlines(relief, explained_polygons(trusted, rig, table_z_mm))
        new = [outline for outline in outlines if not any(np.array_equal(outline, one) for one in tried)]
        more = _rising_tops(new, known, left, bench, limits)
        tried += new
        if not more:
            break
        known += more
    known = sorted(one_per_place(known), key=lambda top: top.fit.rms_px)
    rising_px = risen(relief, explained_polygons(known, rig, table_z_mm))
    standing = [
        top for top, pixels in zip(known, rising_px, strict=True) if pixels >= _SEAM_PX * _outline_px(top.fit.face, rig)
    ]
    unseen = rising_outlines(relief, explained_polygons(standing, rig, table_z_mm), _UNSEEN_PX)
    return standing, unseen


def _rising_tops(
    outlines: list[Array], known: list[Top], left: PlaneImage, bench: Bench, limits: RecognitionParameters
) -> list[Top]:
    """Return the faces behind outlines of what rises that no known top at their place fits better."""
    heights_mm = (limits.min_height_mm, limits.max_height_mm)
    rising = fit_rising(outlines, left, bench.pictures, bench.rig, heights_mm, bench.table_z_mm, bench.possible)
    by_edges = bench.by_edges([fit.face for fit in rising])
    # part of a face may explain the grey values along itself, but it has no edges of its own
    there = [
        (edges, fit)
        for fit, edges in zip(rising, by_edges, strict=True)
        if edges is not None and edges.rms_px <= limits.max_rms_px
    ]
    found = bench.together(there)
    places: list[list[Witnesses]] = []
    for both in sorted(bench.settled(found), key=lambda both: both.misfit_px2):
        place = next((one for one in places if share_place(both.agreed(), one[0].agreed())), None)
        if place is None:
            places.append([both])
        else:
            place.append(both)
    fits = [best.agreed_among(rivals) for best, *rivals in places]
    return [
        Top(fit, ())
        for fit in fits
        if not any(share_place(fit, top.fit) and rank(top.fit) <= rank(fit) for top in known)
    ]


def _outline_px(face: Face, rig: RectifiedRig) -> float:
    """Return the length of a face's outline in the left image."""
    x, y, _ = rig.project_px(face.corners_mm())
    return float(cv2.arcLength(np.column_stack([x, y]).astype(np.float32), closed=True))
