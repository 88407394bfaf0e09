"""Step 11f, beyond the paper: which top faces really stand there, and what stands there besides.

Edges alone take a shadow for a face, miss a face of nearly the table's grey, and are misled by a sliver of side face.
The relief over the table knows what rises; the grey values across the borders know where exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.ledges import find_ledges, find_lines
from srvs_cell.vision.profile_fit import measure_blur
from srvs_cell.vision.profiles import Pictures
from srvs_cell.vision.relief import risen, rising_outlines
from srvs_cell.vision.rising_faces import different, fit_rising
from srvs_cell.vision.spanned_faces import spanned_faces
from srvs_cell.vision.top_faces import is_top
from srvs_cell.vision.tops import CERTAIN_RMS_PX, Top, explained_polygons, is_print, one_per_place, rank, share_place
from srvs_cell.vision.witnesses import Bench, Witnesses

if TYPE_CHECKING:
    from srvs_cell.geometry import Array
    from srvs_cell.scene import PlaneImage
    from srvs_cell.vision.face_fit import EdgeField
    from srvs_cell.vision.faces import Face
    from srvs_cell.vision.ledges import Ledges
    from srvs_cell.vision.recognition import RecognitionParameters
    from srvs_cell.vision.rectification import RectifiedRig
    from srvs_cell.vision.relief import Relief

_TRUSTED_RMS_PX = 0.5
"""A figure that fits worse does not explain what rises at its place."""
_SEAM_PX = 1.5
"""Where a face stands over the table, its outline leaves at least a seam of this width in the relief."""
_UNSEEN_PX = 200
"""So many pixels of relief that no face explains are a part that was not recognised."""
_ROUNDS = (False, True, True)
"""Whether every figure is searched for: first ledges alone, then what is left, then what was hidden by that."""
_SPANNED_SUPPORT = 0.55
"""Two borders in space are witnesses already: a face that they span may lack more of its outline than others."""
_CONVINCING_PX2 = 0.6
"""A face whose misfit is less needs no search, and what lies in it is print."""
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
    spanning: _Spanning | None = None
    tried: list[tuple[bool, Array]] = []
    for search in _ROUNDS:
        trusted = [top for top in known if top.fit.rms_px <= _TRUSTED_RMS_PX]
        outlines = rising_outlines(relief, explained_polygons(trusted, rig, table_z_mm))
        new = [
            outline
            for outline in outlines
            if not any(before == search and np.array_equal(outline, one) for before, one in tried)
        ]
        if not new:
            continue
        if spanning is None:
            spanning = _Spanning.of(images, bench, limits)
        settled = [both for outline in new for both in spanning.witnesses(outline)]
        if search:
            settled += _searched(new, left, bench, limits)
        else:
            settled = [both for both in settled if both.misfit_px2 < _CONVINCING_PX2]
        known += _new_tops(settled, known)
        tried += [(search, outline) for outline in new]
    known = sorted(one_per_place(known), key=lambda top: top.fit.rms_px)
    rising_px = risen(relief, explained_polygons(known, rig, table_z_mm))
    standing = [
        top for top, pixels in zip(known, rising_px, strict=True) if pixels >= _SEAM_PX * _outline_px(top.fit.face, rig)
    ]
    unseen = rising_outlines(relief, explained_polygons(standing, rig, table_z_mm), _UNSEEN_PX)
    return standing, unseen


@dataclass(frozen=True, eq=False)
class _Spanning:
    """The faces that borders in space span, each outline's fitted once.

    Attributes:
        ledges: the borders.
        bench: what faces are fitted to.
        max_rms_px: of a fit to the edges.
        fitted: outlines and what was found there.
    """

    ledges: Ledges
    bench: Bench
    max_rms_px: float
    fitted: list[tuple[Array, list[Witnesses]]] = field(default_factory=list)

    @classmethod
    def of(cls, images: tuple[PlaneImage, PlaneImage], bench: Bench, limits: RecognitionParameters) -> _Spanning:
        """Find the borders in both images."""
        left, right = images
        lines = (find_lines(left.grey), find_lines(right.grey))
        ledges = find_ledges(lines, bench.rig, bench.table_z_mm, limits.max_height_mm)
        lenient = replace(limits, min_support=_SPANNED_SUPPORT)
        possible = replace(bench, possible=lambda fit: is_top(fit, bench.table_z_mm, lenient))
        return cls(ledges, possible, limits.max_rms_px)

    def witnesses(self, outline: Array) -> list[Witnesses]:
        """Return the faces over an outline that suit edges and grey values."""
        for before, found in self.fitted:
            if np.array_equal(before, outline):
                return found
        faces = spanned_faces(self.ledges, outline, self.bench.rig)
        found = self.bench.from_lines(faces, self.max_rms_px)
        settled = self.bench.settled([found[number] for number in different([both.by_profiles for both in found])])
        self.fitted.append((outline, settled))
        return settled


def _searched(outlines: list[Array], left: PlaneImage, bench: Bench, limits: RecognitionParameters) -> list[Witnesses]:
    """Return what a search for every figure at every height finds behind outlines of what rises."""
    heights_mm = (limits.min_height_mm, limits.max_height_mm)
    rising = fit_rising(outlines, left, bench.pictures, bench.rig, heights_mm, bench.table_z_mm, bench.possible)
    # part of a face may explain the grey values along itself, but it has no edges of its own
    there = [
        (edges, fit)
        for fit, edges in zip(rising, bench.by_edges([fit.face for fit in rising]), strict=True)
        if edges is not None and edges.rms_px <= limits.max_rms_px
    ]
    return bench.settled(bench.together(there))


def _new_tops(found: list[Witnesses], known: list[Top]) -> list[Top]:
    """Return the best face of each place where no known top fits better."""
    places: list[list[Witnesses]] = []
    for both in sorted(found, key=lambda both: both.misfit_px2):
        place = next((one for one in places if share_place(both.agreed(), one[0].agreed())), None)
        if place is None:
            places.append([both])
        elif both.misfit_px2 < _CONVINCING_PX2 and is_print(place[0].agreed(), both.agreed()):
            place[0] = both
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
