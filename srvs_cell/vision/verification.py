"""Step 11f, beyond the paper: which top faces really stand there, and what stands there besides.

Edges alone take a shadow for a face, miss a face of nearly the table's grey, and are misled by a sliver of side face.
The relief over the table knows what rises; the grey values across the borders know where exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.faces import same_place
from srvs_cell.vision.ledges import find_ledges, find_lines
from srvs_cell.vision.profile_fit import measure_blur
from srvs_cell.vision.profiles import Pictures
from srvs_cell.vision.recovery import find_places
from srvs_cell.vision.relief import risen, rising_outlines
from srvs_cell.vision.rising_faces import different, fit_rising
from srvs_cell.vision.spanned_faces import spanned_faces
from srvs_cell.vision.top_faces import fit_tops, is_top
from srvs_cell.vision.tops import (
    CERTAIN_RMS_PX,
    Top,
    explained_polygons,
    is_print,
    one_per_place,
    rank,
    rising_test,
    share_place,
)
from srvs_cell.vision.witnesses import Bench

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from srvs_cell.geometry import Array
    from srvs_cell.vision.evidence import Evidence
    from srvs_cell.vision.faces import Face
    from srvs_cell.vision.ledges import Ledges
    from srvs_cell.vision.recovery import Region
    from srvs_cell.vision.rectification import RectifiedRig
    from srvs_cell.vision.relief import Relief
    from srvs_cell.vision.witnesses import Witnesses

    Source = Callable[[list[Array], list[Top]], list[Witnesses]]

_TRUSTED_RMS_PX = 0.5
"""A figure that fits worse does not explain what rises at its place."""
_SEAM_PX = 1.5
"""Where a face stands over the table, its outline leaves at least a seam of this width in the relief."""
_UNSEEN_PX = 200
"""So many pixels of relief that no face explains are a part that was not recognised."""
_LEAST_SUPPORT = 0.55
"""What rises is a witness already: a face that explains it may lack more of its outline than others."""
_CONVINCING_PX2 = 0.6
"""A face whose misfit is less needs no search, and what lies in it is print."""
_SAME_MM = 2.0
"""Two lines of one border span the same face twice."""
_FOR_BLUR = 3
"""So many well known faces tell the blur of the picture."""


def verify_tops(
    tops: list[Top], planes: Sequence[Region], relief: Relief, evidence: Evidence
) -> tuple[list[Top], list[Array]]:
    """Fit tops to the grey values, add those that only their parallax tells, and drop what does not rise.

    Args:
        tops: what the edges told.
        planes: of the left image, those without a partner: some may be top faces, too.
        relief: what rises over the table.
        evidence: the images.

    Returns:
        The tops that stand there, the surest first; and outlines of what rises and stays unexplained, pixels of the
        left image, each of shape (N, 2).
    """
    rig, table_z_mm = evidence.rig, evidence.table_z_mm
    bench = _bench_for(tops, evidence)
    seen = [
        (top, both)
        for top, both in zip(tops, bench.by_profiles([top.fit for top in tops]), strict=True)
        if both is not None
    ]
    settled = bench.settled([both for _, both in seen])
    known = [replace(top, fit=both.agreed()) for (top, _), both in zip(seen, settled, strict=True)]
    sources = _Sources(planes, relief, evidence, bench)
    outlines = _unexplained(known, relief, evidence)
    tried: list[tuple[Source, Array]] = []
    # the last one again: what it found may have hidden more
    for source in (sources.from_lines, sources.from_planes, sources.from_search, sources.from_search):
        new = [one for one in outlines if not any(by == source and np.array_equal(one, other) for by, other in tried)]
        added = _new_tops(source(new, known), known) if new else []
        tried += [(source, outline) for outline in new]
        if added:
            known += added
            outlines = _unexplained(known, relief, evidence)
    known = sorted(one_per_place(known), key=lambda top: top.fit.rms_px)
    rising_px = risen(relief, explained_polygons(known, rig, table_z_mm))
    standing = [
        top for top, pixels in zip(known, rising_px, strict=True) if pixels >= _SEAM_PX * _outline_px(top.fit.face, rig)
    ]
    unseen = rising_outlines(relief, explained_polygons(standing, rig, table_z_mm), _UNSEEN_PX)
    return standing, unseen


def _unexplained(known: list[Top], relief: Relief, evidence: Evidence) -> list[Array]:
    """Return outlines of what rises in the left image and is explained by no well fitted top."""
    trusted = [top for top in known if top.fit.rms_px <= _TRUSTED_RMS_PX]
    return rising_outlines(relief, explained_polygons(trusted, evidence.rig, evidence.table_z_mm))


def _bench_for(tops: list[Top], evidence: Evidence) -> Bench:
    """Return what faces are fitted to; the surest tops tell how blurred the pictures are."""
    rig, table_z_mm, limits = evidence.rig, evidence.table_z_mm, evidence.limits
    surest = sorted((top.fit for top in tops if top.fit.rms_px < CERTAIN_RMS_PX), key=lambda fit: fit.rms_px)
    pictures = Pictures.of(evidence.left.grey, evidence.right.grey)
    blur_px = measure_blur([fit.face for fit in surest[:_FOR_BLUR]], pictures, rig, table_z_mm)
    return Bench(
        replace(pictures, blur_px=blur_px),
        evidence.fields,
        rig,
        table_z_mm,
        limits.min_gradient,
        lambda fit: is_top(fit, table_z_mm, limits),
    )


@dataclass(frozen=True, eq=False)
class _Sources:
    """Where top faces may come from that explain what rises, the cheapest first.

    Each takes outlines of what rises in the left image and the tops known so far.

    Attributes:
        planes: of the left image, those without a partner.
        relief: what rises over the table.
        evidence: the images.
        bench: what faces are fitted to.
    """

    planes: Sequence[Region]
    relief: Relief
    evidence: Evidence
    bench: Bench
    _outlines: list[Array] = field(default_factory=list)
    _spanned: list[Face] = field(default_factory=list)
    _from_borders: list[Witnesses] = field(default_factory=list)

    def from_lines(self, outlines: list[Array], _: list[Top]) -> list[Witnesses]:
        """Return the faces that two borders in space span, where they need no other witness."""
        return [both for both in self._from_ledges(outlines) if both.misfit_px2 < _CONVINCING_PX2]

    def from_planes(self, _: list[Array], known: list[Top]) -> list[Witnesses]:
        """Return the planes without a partner that are top faces."""
        rises = rising_test(known, self.relief, self.evidence.rig, self.evidence.table_z_mm)
        placed = find_places([plane for plane in self.planes if rises(plane.outline_px)], self.evidence)
        there = [fit for fit in fit_tops(placed, self.evidence) if fit is not None]
        return self.bench.settled([both for both in self.bench.by_profiles(there) if both is not None])

    def from_search(self, outlines: list[Array], _: list[Top]) -> list[Witnesses]:
        """Return what a search for every figure at every height finds, and all that borders in space span."""
        rising = fit_rising(outlines, self.evidence, self._lenient)
        there = [
            (edges, fit)
            for fit, edges in zip(rising, self.bench.by_edges([fit.face for fit in rising]), strict=True)
            if edges is not None
        ]
        max_rms_px = self.evidence.limits.max_rms_px
        believed = [both for both in self.bench.together(there) if both.is_believed(max_rms_px)]
        return self._from_ledges(outlines) + self.bench.settled(believed)

    def _from_ledges(self, outlines: list[Array]) -> list[Witnesses]:
        """Return the faces that borders span over these outlines or earlier ones, those that suit the pictures."""
        fresh = [one for one in outlines if not any(np.array_equal(one, other) for other in self._outlines)]
        self._outlines.extend(fresh)
        spanned = spanned_faces(self._ledges, fresh, self.bench.rig)
        new = [face for face in spanned if not any(same_place(face, one, _SAME_MM) for one in self._spanned)]
        self._spanned.extend(new)
        found = self._lenient.from_lines(new, self.evidence.limits.max_rms_px)
        kept = different([both.by_profiles for both in found])
        self._from_borders.extend(self._lenient.settled([found[number] for number in kept]))
        return self._from_borders

    @cached_property
    def _lenient(self) -> Bench:
        """What faces are fitted to that may lack more of their outline."""
        limits, table_z_mm = replace(self.evidence.limits, min_support=_LEAST_SUPPORT), self.evidence.table_z_mm
        return replace(self.bench, possible=lambda fit: is_top(fit, table_z_mm, limits))

    @cached_property
    def _ledges(self) -> Ledges:
        evidence = self.evidence
        lines = (find_lines(evidence.left.grey), find_lines(evidence.right.grey))
        return find_ledges(lines, evidence.rig, evidence.table_z_mm, evidence.limits.max_height_mm)


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
