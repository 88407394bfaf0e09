"""Step 11d, beyond the paper: faces that only their parallax tells.

Where something rises that no known face explains, its outline is a face's, doubled by the parallax that the face's
height gives it. Each height takes its own share of the doubling away and leaves a start; which height and which figure
it is, is seen by fitting them to the grey values of both images.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.faces.face import HEXAGON_RATIO, Face, Figure, inclined_faces, same_place
from srvs_cell.vision.faces.profile_fit import REACH, SCOUT, fit_profiles
from srvs_cell.vision.recognition.face_pieces import face_pieces, plane_hulls
from srvs_cell.vision.recognition.recovery import rising_regions
from srvs_cell.vision.recognition.rising_height import rising_disparity

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces.edge_fit import FaceFit
    from srvs_cell.vision.faces.profile_fit import Effort
    from srvs_cell.vision.faces.witnesses import Bench
    from srvs_cell.vision.recognition.evidence import Evidence
    from srvs_cell.vision.rectification import RectifiedRig
    from srvs_cell.vision.relief import Relief

_RISING_SHARE = 0.6
"""Of a side face the upper part has enough parallax to be seen rising."""
_HEIGHTS = 4
"""Besides the one that what rises tells."""
_INCLINED_STRIDE = 2
"""Inclined faces reach over more heights than level ones: every second one is enough for them."""
_BEST_OF_KIND = 5
_NEXT_OF_KIND = 12
"""So many more are fitted where the best leave much unexplained."""
_UNEXPLAINED_PX2 = 0.4
"""Misfit of a face that leaves much: a third of its outline is not seen, or lies half a pixel off."""
_ABSENT_PX = 1.0
"""So far off is a border that is not there."""
_START_SLOPE = 0.36
_LEAST_INCLINATION_DEG = 5.0
_CORNERS = 3
_CANDIDATES = 8
_SAME_MM = 4.0
"""Fits whose centres and sizes differ by less came to one place."""
_UP = np.array([0.0, 0.0, 1.0])
_INCLINED_GAIN = 0.7
"""An inclined face has one parameter more: it must fit better by this factor."""
_STEEP_DEG = 10.0
_STEEP_GAIN = 0.85
"""A slope that no noise explains need not improve the fit as much."""


def fit_rising(outlines: Iterable[Array], relief: Relief, evidence: Evidence, bench: Bench) -> list[FaceFit]:
    """Return for each outline of what rises the few faces that explain the grey values best.

    Args:
        outlines: convex, in the left image, each of shape (N, 2); see `relief.rising_outlines`.
        relief: what rises over the table.
        evidence: the images; a plane of the left one inside an outline may be the face.
        bench: what faces are fitted to.
    """
    found = []
    rig, table_z_mm, limits = evidence.rig, evidence.table_z_mm, evidence.limits
    planes = plane_hulls(evidence.left, rig, table_z_mm, limits.max_size_mm)
    for outline in outlines:
        told_mm = _told_levels(outline, relief, evidence)
        levels = [*told_mm, *_usual_levels(evidence)]
        single = [(z_mm, without_parallax(outline, rig, z_mm, table_z_mm)) for z_mm in levels]
        alone = [
            (z_mm, without_sides(border, rig, z_mm, z_mm - _RISING_SHARE * (z_mm - table_z_mm)))
            for z_mm, border in single[: len(told_mm)]
            if border is not None
        ]
        seeds = [[(z_mm, border) for z_mm, border in borders if border is not None] for borders in (single, alone)]
        seeds += [
            [(z_mm, laid_on(piece, rig, z_mm)) for z_mm in levels]
            for piece in face_pieces(bench.pictures.images[0], outline, planes)
        ]
        fits = [fit for fit in _fits_of(seeds, bench) if bench.possible(fit)]
        level = min((fit for fit in fits if fit.face.slope_u == 0.0), key=_misfit, default=None)
        inclined = min((fit for fit in fits if _is_inclined(fit)), key=_misfit, default=None)
        best = _better(level, inclined)
        if best is not None:
            ranked = [best, *sorted(fits, key=_misfit)]
            found += [ranked[number] for number in different(ranked, _CANDIDATES)]
    return found


def _told_levels(outline: Array, relief: Relief, evidence: Evidence) -> list[float]:
    """Return the heights, base frame, on which the pictures agree in an outline; none where they do not."""
    rig = evidence.rig
    told_mm = []
    for region in rising_regions([outline], [], relief.rises.shape):
        disparity_px = rising_disparity(region, relief, evidence)
        if disparity_px is not None:
            x, y = np.array(region.centre_px)[:, None]
            told_mm.append(float(rig.points_mm(x, y, np.array([disparity_px]))[0, 2]))
    return told_mm


def _usual_levels(evidence: Evidence) -> list[float]:
    """Return heights, base frame, from which the fit reaches all that a part may have."""
    rig, table_z_mm, limits = evidence.rig, evidence.table_z_mm, evidence.limits
    # equal steps of parallax are equal steps of the image: 1 / distance, not height, is divided evenly
    camera_z_mm = float(rig.base_T_camera.translation_mm[2])
    near, far = (1.0 / (camera_z_mm - table_z_mm - height) for height in (limits.min_height_mm, limits.max_height_mm))
    return [float(z_mm) for z_mm in camera_z_mm - 1.0 / np.linspace(near, far, _HEIGHTS)]


def different(fits: Sequence[FaceFit], most: int | None = None) -> list[int]:
    """Return the numbers of the first fits, as many as asked, that are not of an earlier one's figure and place."""
    kept: list[int] = []
    for number, fit in enumerate(fits):
        if len(kept) == most:
            break
        if not any(same_place(fit.face, fits[one].face, _SAME_MM) for one in kept):
            kept.append(number)
    return kept


def _better(level: FaceFit | None, inclined: FaceFit | None) -> FaceFit | None:
    """Return the level fit, or the inclined one if it explains the picture clearly better."""
    if level is None or inclined is None:
        return level or inclined
    gain = _STEEP_GAIN if inclined.face.inclination_deg >= _STEEP_DEG else _INCLINED_GAIN
    return inclined if inclined.rms_px < gain * level.rms_px else level


def _misfit(fit: FaceFit) -> float:
    """Return what a fit leaves unexplained: border that is displaced, and border that is not there."""
    return fit.rms_px**2 + (1.0 - fit.support) * _ABSENT_PX**2


def _is_inclined(fit: FaceFit) -> bool:
    return fit.face.inclination_deg >= _LEAST_INCLINATION_DEG


def _fits_of(seeds: list[list[tuple[float, Array]]], bench: Bench) -> list[FaceFit]:
    """Return the fits that seeds lead to: each figure is scouted at each height, the promising ones are fitted.

    One that comes out next to level is fitted as level besides.
    """
    starts = [
        face
        for seed in seeds
        for z_mm, border in seed[::_INCLINED_STRIDE]
        for face in inclined_faces(surrounding_rectangle(border, z_mm), _START_SLOPE)
    ]
    starts += [face for seed in seeds for z_mm, border in seed for face in _figures(border, z_mm)]
    promising = _promising(sorted(fitted(starts, bench, SCOUT), key=_misfit))
    fits = fitted([face for alike in promising for face in alike[:_BEST_OF_KIND]], bench, REACH)
    if min((_misfit(fit) for fit in fits if bench.possible(fit)), default=np.inf) > _UNEXPLAINED_PX2:
        fits += fitted([face for alike in promising for face in alike[_BEST_OF_KIND:]], bench, REACH)
    slanted = [fit.face for fit in fits if fit.face.slope_u != 0.0 and not _is_inclined(fit)]
    return fits + fitted([replace(face, slope_u=0.0) for face in slanted], bench, REACH)


def laid_on(border_px: Array, rig: RectifiedRig, z_mm: float) -> Array:
    """Return an outline of the left image laid on a height, seen from above, shape (N, 2)."""
    x, y = border_px.T
    disparity = np.column_stack([x, y, np.ones_like(x)]) @ rig.plane_disparity(_UP, z_mm)
    border: Array = rig.points_mm(x, y, disparity)[:, :2]
    return border


def _promising(scouted: list[FaceFit]) -> list[list[Face]]:
    """Return for each figure, level and inclined, the best scouted faces at different places, the best first."""
    kept: dict[tuple[Figure, bool], list[Face]] = {}
    for face in (fit.face for fit in scouted):
        alike = kept.setdefault((face.figure, face.slope_u != 0.0), [])
        if len(alike) < _BEST_OF_KIND + _NEXT_OF_KIND and not any(same_place(face, one, _SAME_MM) for one in alike):
            alike.append(face)
    return list(kept.values())


def fitted(starts: Sequence[Face], bench: Bench, effort: Effort) -> list[FaceFit]:
    """Return the fits to the grey values that starts lead to, the slope free where a start is inclined."""
    inclined = [start.slope_u != 0.0 for start in starts]
    fits = fit_profiles(starts, inclined, bench.pictures, bench.rig, bench.table_z_mm, effort)
    return [fit for fit in fits if fit is not None]


def without_parallax(outline: Array, rig: RectifiedRig, z_mm: float, table_z_mm: float) -> Array | None:
    """Return the face, seen from above, shape (N, 2), that its doubled outline encloses if it is at a height.

    The outline encloses the face and the face moved to the left by its parallax: the face is what the outline and the
    outline moved to the right share.
    """
    moments = cv2.moments(outline.astype(np.float32))
    if moments["m00"] <= 0.0:
        return None
    centre = np.array([moments["m10"], moments["m01"], moments["m00"]]) / moments["m00"]
    parallax = float(np.subtract(rig.plane_disparity(_UP, z_mm), rig.plane_disparity(_UP, table_z_mm)) @ centre)
    moved = outline.astype(np.float32) + np.array([parallax, 0.0], dtype=np.float32)
    area, shared = cv2.intersectConvexConvex(outline.astype(np.float32), moved)
    if area <= 0.0 or len(shared) < _CORNERS:
        return None
    return laid_on(shared.reshape(-1, 2).astype(np.float64), rig, z_mm)


def without_sides(border: Array, rig: RectifiedRig, z_mm: float, foot_z_mm: float) -> Array | None:
    """Return the face, seen from above, that a border encloses together with the side faces that the camera sees.

    Seen from the camera the foot of a part is its face drawn together about the point below the camera: the face is
    what the border and the border drawn apart by as much share.

    Args:
        border: seen from above, mm, base frame, shape (N, 2), as laid on ``z_mm``.
        rig: the rectified cameras.
        z_mm: height of the face.
        foot_z_mm: height from which on the border encloses the side faces.

    Returns:
        Corners in mm, shape (M, 2); None where nothing is left.
    """
    camera_mm = rig.base_T_camera.translation_mm
    apart = camera_mm[:2] + (border - camera_mm[:2]) * (camera_mm[2] - foot_z_mm) / (camera_mm[2] - z_mm)
    hull, moved = (
        cv2.convexHull(points.astype(np.float32)).reshape(-1, 2).astype(np.float64) for points in (border, apart)
    )
    shared = _cut(hull, moved)
    return shared if len(shared) >= _CORNERS else None


def _cut(polygon: Array, by: Array) -> Array:
    """Return what two convex polygons share, counter-clockwise as they are (Sutherland and Hodgman 1974).

    OpenCV's own way fails where sides lie in one line, as those do that point at the camera.
    """
    for start, along in zip(by, np.roll(by, -1, axis=0) - by, strict=True):
        within = along[0] * (polygon[:, 1] - start[1]) - along[1] * (polygon[:, 0] - start[0])
        ahead = np.roll(within, -1)
        crossing = (within >= 0.0) != (ahead >= 0.0)
        if not crossing.any():
            if not (within >= 0.0).all():
                return polygon[:0]
            continue
        share = np.divide(within, within - ahead, out=np.zeros_like(within), where=crossing)
        met = polygon + share[:, None] * (np.roll(polygon, -1, axis=0) - polygon)
        # each corner is followed by where the side that begins there is crossed
        polygon = np.stack([polygon, met], axis=1).reshape(-1, 2)[np.stack([within >= 0.0, crossing], axis=1).ravel()]
    return polygon


def surrounding_rectangle(border: Array, z_mm: float) -> Face:
    """Return the level rectangle of least area around points seen from above, shape (N, 2)."""
    (x_mm, y_mm), (length_mm, width_mm), angle_deg = cv2.minAreaRect(border.astype(np.float32))
    return Face(Figure.RECTANGLE, x_mm, y_mm, z_mm, float(np.deg2rad(angle_deg)), length_mm, width_mm)


def _figures(border: Array, z_mm: float) -> list[Face]:
    """Return the level figures that a border may be."""
    rectangle = surrounding_rectangle(border, z_mm)
    moments = cv2.moments(border.astype(np.float32))
    area = max(moments["m00"], 1.0)
    middle = (moments["m10"] / area, moments["m01"] / area)
    diameter = float(np.sqrt(area * 4.0 / np.pi))
    circle = Face(Figure.CIRCLE, *middle, z_mm, 0.0, diameter, diameter)
    corners = float(np.sqrt(area * 8.0 / (3.0 * np.sqrt(3.0))))
    hexagons = [
        Face(Figure.HEXAGON, *middle, z_mm, rectangle.angle_rad + turn, corners, corners * HEXAGON_RATIO)
        for turn in (0.0, np.pi / 6.0)
    ]
    return [rectangle, circle, *hexagons]
