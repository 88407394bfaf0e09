"""Step 11f, beyond the paper: which top faces really stand there, and what stands there besides.

Edges alone take a shadow for a face, miss a face of nearly the table's grey, and are misled by a sliver of side face.
The relief over the table knows what rises; the grey values across the borders know where exactly.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.faces.face import Figure, same_place, share_place
from srvs_cell.vision.faces.lamp import find_lamps
from srvs_cell.vision.faces.outlines import Outlines
from srvs_cell.vision.faces.profile_fit import measure_blur, measure_lamp
from srvs_cell.vision.faces.profiles import Pictures
from srvs_cell.vision.faces.witnesses import CONVINCING_PX2, SIDE_UNSEEN, Bench
from srvs_cell.vision.recognition.face_sources import Sources
from srvs_cell.vision.recognition.hidden_sides import with_hidden_sides
from srvs_cell.vision.recognition.joined_faces import joined_faces
from srvs_cell.vision.recognition.top_faces import is_top
from srvs_cell.vision.recognition.tops import (
    TRUSTED_RMS_PX,
    Top,
    best_per_place,
    explained_polygons,
    is_better,
    is_print,
    trusted,
)
from srvs_cell.vision.relief import risen, rising_outlines

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces.edge_fit import FaceFit
    from srvs_cell.vision.faces.face import Face
    from srvs_cell.vision.faces.shadows import Lamp
    from srvs_cell.vision.faces.witnesses import Witnesses
    from srvs_cell.vision.recognition.evidence import Evidence
    from srvs_cell.vision.recognition.face_sources import Source
    from srvs_cell.vision.recognition.recovery import Region
    from srvs_cell.vision.rectification import RectifiedRig
    from srvs_cell.vision.relief import Relief


_SEAM_PX = 1.5
"""Where a face stands over the table, its outline leaves at least a seam of this width in the relief."""
_UNSEEN_PX = 200
"""So many pixels of relief that no face explains are a part that was not recognised."""
_FOR_BLUR = 3
"""So many of the surest faces tell the blur of the picture."""
_FOR_LAMP = 6
"""So many faces that are known well enough tell where the lamp stands."""
_TELLING_RMS_PX = 0.7
"""Where the edges told no lamp faces that fit like this may, with shadows beside them that nothing explained."""
_SAME_MM = 4.0
"""A face made of two halves comes to rest within this of where they put it."""
_WHOLE = 0.87
"""Share of an outline that is seen where all sides are."""
_SIDES, _SIDE_SAMPLES = 4, 12
_BESIDE_PX = np.arange(-1.0, 1.5, dtype=np.float32)
_CLEAR_GRADIENT = 2.0
"""A side that is seen has an edge within a pixel, on the whole of so many grey values per pixel."""
_BORDER_PX, _CORNER_PX = 10.0, 6.0
"""A side nearer to the border of a picture may be that border; where a border cuts a part aslant a corner is nearer."""


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
        The tops that stand there, the surest first, as large as they likely are where a side is hidden; and outlines of
        what rises and stays unexplained, pixels of the left image, each of shape (N, 2).
    """
    rig, table_z_mm = evidence.rig, evidence.table_z_mm
    bench = _bench_for(tops, evidence, TRUSTED_RMS_PX)
    known, lamp = _known_tops(tops, planes, relief, evidence, bench)
    rising_px = risen(relief, explained_polygons(known, rig, table_z_mm))
    standing = [
        top
        for top, pixels in zip(known, rising_px, strict=True)
        if pixels >= _SEAM_PX * _outline_px(top.fit.face, rig) and not _is_cut_off(top.fit, evidence)
    ]
    whole = with_hidden_sides(standing, rig, lamp)
    unseen = rising_outlines(relief, explained_polygons(whole, rig, table_z_mm), _UNSEEN_PX)
    return whole, unseen


def _known_tops(
    tops: list[Top], planes: Sequence[Region], relief: Relief, evidence: Evidence, bench: Bench
) -> tuple[list[Top], Lamp | None]:
    """Return tops fitted to the grey values, with those that explain what else rises, the surest first; and the lamp.

    Where the edges told no lamp, and one source's tops do, all is judged anew in its light.
    """
    seen = [
        (top, both)
        for top, both in zip(tops, bench.by_profiles([top.fit for top in tops]), strict=True)
        if both is not None
    ]
    settled = bench.settled([both for _, both in seen])
    known = [
        replace(top, fit=both.agreed(), price_px2=both.price_px2) for (top, _), both in zip(seen, settled, strict=True)
    ]
    sources = Sources(planes, relief, evidence, bench)
    outlines = _unexplained(known, relief, evidence)
    tried: list[tuple[Source, Array]] = []
    # the last one again: what it found may have hidden more
    for source in (sources.from_lines, sources.from_planes, sources.from_search, sources.from_search):
        new = [one for one in outlines if not any(by == source and np.array_equal(one, other) for by, other in tried)]
        added = _new_tops(source(new, known), known) if new else []
        tried += [(source, outline) for outline in new]
        if added:
            known += added
            if bench.pictures.lamp is None:
                lit = _bench_for(known, evidence, _TELLING_RMS_PX)
                if lit.pictures.lamp is not None:
                    # what was judged in the dark took shadows for faces
                    return _known_tops(tops, planes, relief, evidence, lit)
            outlines = _unexplained(known, relief, evidence)
    known += _new_tops(sources.from_high_sides(known), known)
    found = sorted(_in_one_light(best_per_place(known), bench), key=lambda top: top.fit.rms_px)
    return found, bench.pictures.lamp


def _unexplained(known: list[Top], relief: Relief, evidence: Evidence) -> list[Array]:
    """Return outlines of what rises in the left image and is explained by no well fitted top."""
    return rising_outlines(relief, explained_polygons(trusted(known), evidence.rig, evidence.table_z_mm))


def _bench_for(tops: list[Top], evidence: Evidence, telling_rms_px: float) -> Bench:
    """Return what faces are fitted to; the surest tops tell the lamp and how blurred the pictures are.

    ``telling_rms_px``: what fits worse does not tell the lamp.
    """
    rig, table_z_mm, limits = evidence.rig, evidence.table_z_mm, evidence.limits
    surest = sorted((top.fit for top in tops if top.fit.rms_px < telling_rms_px), key=lambda fit: fit.rms_px)
    known = [fit.face for fit in surest[:_FOR_LAMP]]
    pictures = Pictures.of(evidence.left.grey, evidence.right.grey)
    found = find_lamps(known, evidence.fields[0], evidence.left.grey, rig, table_z_mm)
    lamp = found.certain or measure_lamp(found.likely, known, pictures, rig, table_z_mm)
    pictures = replace(pictures, lamp=lamp)
    return Bench(
        replace(pictures, blur_px=measure_blur(known[:_FOR_BLUR], pictures, rig, table_z_mm)),
        evidence.fields,
        rig,
        table_z_mm,
        limits.min_gradient,
        lambda fit: is_top(fit, table_z_mm, limits),
    )


def _new_tops(found: list[Witnesses], known: list[Top]) -> list[Top]:
    """Return the best face of each place where no known top suits better."""
    places: list[list[Witnesses]] = []
    for both in sorted(found, key=lambda both: both.price_px2):
        place = next((one for one in places if share_place(both.agreed().face, one[0].agreed().face)), None)
        if place is None:
            places.append([both])
        elif both.misfit_px2 < CONVINCING_PX2 and is_print(place[0].agreed(), both.agreed()):
            place[0] = both
        else:
            place.append(both)
    new = [Top(best.agreed_among(rivals), (), best.price_px2) for best, *rivals in places]
    return [one for one in new if not any(_stands_before(top, one) for top in known)]


def _stands_before(top: Top, other: Top) -> bool:
    """Whether a top has the place of another one that suits no better."""
    return share_place(top.fit.face, other.fit.face) and not is_better(other, top)


def _in_one_light(known: list[Top], bench: Bench) -> list[Top]:
    """Return the tops; two that a shadow or a band of print made of one face are one."""
    known = list(known)
    while True:
        pairs = joined_faces([top.fit.face for top in known])
        edges = bench.by_edges([face for _, _, face in pairs])
        there = [(pair, fit) for pair, fit in zip(pairs, edges, strict=True) if fit is not None]
        seen = bench.by_profiles([fit for _, fit in there])
        whole = [
            (both, pair)
            for ((*pair, face), _), both in zip(there, seen, strict=True)
            if both is not None
            and both.misfit_px2 < CONVINCING_PX2
            and same_place(both.by_profiles.face, face, _SAME_MM)
        ]
        if not whole:
            return known
        both, pair = min(whole, key=lambda one: one[0].misfit_px2)
        halves = [known[number] for number in pair]
        known = [top for top in known if top not in halves]
        known.append(Top(both.agreed(), halves[0].surfaces + halves[1].surfaces, both.price_px2))


def _is_cut_off(fit: FaceFit, evidence: Evidence) -> bool:
    """Whether one side is not seen and one, or a corner, lies at the border of a picture: the part goes on beyond.

    A side that one picture cuts off may be seen in the other one.
    """
    if fit.face.figure is not Figure.RECTANGLE or fit.support > _WHOLE or _sides_seen(fit.face, evidence).all():
        return False
    height, width = evidence.left.grey.shape
    x, y, disparity = evidence.rig.project_px(fit.face.corners_mm())
    for across in (x, x - disparity):
        inside_px = np.stack([across, width - across, y, height - y])
        beyond = inside_px < _BORDER_PX
        if (beyond & np.roll(beyond, 1, axis=1)).any():
            return True
        if fit.support <= SIDE_UNSEEN and (inside_px < _CORNER_PX).any():
            return True
    return False


def _sides_seen(face: Face, evidence: Evidence) -> NDArray[np.bool_]:
    """Return which sides of a rectangle are along a clear edge in at least one of the pictures, shape (4,)."""
    outlines = Outlines.of([face], [face.slope_u != 0.0], _SIDES * _SIDE_SAMPLES, equal_sides=True)
    borders = outlines.seen(evidence.rig)
    slopes = [
        field.along_normals(points, normals, _BESIDE_PX).reshape(len(_BESIDE_PX), _SIDES, _SIDE_SAMPLES).mean(axis=2)
        for field, points, normals in zip(evidence.fields, borders.points_px, borders.normals, strict=True)
    ]
    return np.asarray(np.abs(slopes).max(axis=(0, 1)) > _CLEAR_GRADIENT)


def _outline_px(face: Face, rig: RectifiedRig) -> float:
    """Return the length of a face's outline in the left image."""
    x, y, _ = rig.project_px(face.corners_mm())
    return float(cv2.arcLength(np.column_stack([x, y]).astype(np.float32), closed=True))
