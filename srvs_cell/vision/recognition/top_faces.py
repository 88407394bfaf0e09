"""Step 11c: which figure a surface is as a top face, and where.

Level and inclined figures are tried together; the measured slope of the surface, where there is one, has a say. A
region with a sliver of side face or shadow is tried again from inside.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.faces.edge_fit import MEASURE, SCOUT, SETTLE, FaceFit, fit_faces
from srvs_cell.vision.faces.face import HEXAGON_RATIO, Face, Figure
from srvs_cell.vision.interpolation import disparity_at
from srvs_cell.vision.recognition.recovery import NO_PLANE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.geometry import Array
    from srvs_cell.scene import Surface
    from srvs_cell.vision.faces.edge_fit import Effort
    from srvs_cell.vision.recognition.evidence import Evidence
    from srvs_cell.vision.recognition.planes_to_objects import RecognitionParameters
    from srvs_cell.vision.rectification import RectifiedRig

SURE_RMS_PX = 0.4
"""A figure that fits worse waits until the better ones have taken their surfaces."""
_LEAST_SHARE = 0.4
_WALL_TILT_DEG = 65.0
"""A matched plane that leans more is a side face."""
_LEVEL_TILT_DEG = 5.0
"""A well matched plane that leans less is level."""
_SLOPE_SIGMA_PX = 0.12
_PROMISING_PX = 0.6
"""A figure that fits worse than the best by more, after scouting, is given up."""
_RETRY_RMS_PX = 0.2
"""A rectangle that fits worse is tried again from other starts."""
_LOST_RMS_PX = 1.0
"""A rectangle that fits worse is a side face or a shadow: its region leads nowhere."""
_PULLS = (0.12, 0.25)
"""Shares of a side by which the neighbouring side is moved inwards."""
_RETRIED_INCLINED = 6
"""So many inclined figures of a surface are settled when it is tried again."""
_DOUBLING_DEG = 10.0
"""Contradiction of measured and fitted attitude that doubles the doubt in a fit."""
_MOST_MOVED_PX = 1.5
"""A doubtful figure whose disparity differs more from its surface's measured one is of other edges than the face's."""
_ALONG_SLOPE = float(np.cos(np.pi / 4.0))
_START_SLOPE = 0.36
"""20 degrees: from here the edges of inclinations from 5 to 35 degrees are within reach."""
_SIDES = 4
_BELOW_TABLE_MM = 3.0
"""No face reaches into the table by more than heights are wrong."""
_UP = np.array([0.0, 0.0, 1.0])


def fit_tops(surfaces: Sequence[Surface], evidence: Evidence) -> list[FaceFit | None]:
    """Return for each surface the best figure as a top face, or None where it is none.

    Every figure in every likely attitude is tried, all together: a few iterations leave the promising ones, these are
    settled, and the best one of each surface is measured.
    """
    rig, limits, table_z_mm = evidence.rig, evidence.limits, evidence.table_z_mm
    starts = [
        _Start(number, face, inclined=inclined)
        for number, surface in enumerate(surfaces)
        if _may_be_top(surface, table_z_mm, limits)
        for face, inclined in (*_level_starts(surface, rig), *_inclined_starts(surface, rig))
    ]
    scouted = _promising(_fitted(starts, evidence, SCOUT), inclined=1)
    settled = _fitted([start for start, _ in scouted], evidence, SETTLE)
    retried = _promising(_fitted(_retries(settled, surfaces), evidence, SCOUT), inclined=_RETRIED_INCLINED)
    settled += _fitted([start for start, _ in retried], evidence, SETTLE)
    best: dict[int, _Start] = {}
    for number in range(len(surfaces)):
        chosen = _chosen([(start, fit) for start, fit in settled if start.number == number], surfaces[number], limits)
        if chosen is not None:
            best[number] = chosen
    measured = _fitted(list(best.values()), evidence, MEASURE)
    fits = {
        start.number: fit
        for start, fit in measured
        if is_top(fit, table_z_mm, limits) and _keeps_place(fit, surfaces[start.number], rig)
    }
    return [fits.get(number) for number in range(len(surfaces))]


@dataclass(frozen=True)
class _Start:
    """A figure that a surface may be.

    Attributes:
        number: of the surface.
        face: the figure.
        inclined: whether its slope is free.
    """

    number: int
    face: Face
    inclined: bool


def _fitted(starts: Sequence[_Start], evidence: Evidence, effort: Effort) -> list[tuple[_Start, FaceFit]]:
    """Fit figures; each that has a fit comes back with its fit as the next start."""
    faces, inclined = [start.face for start in starts], [start.inclined for start in starts]
    fits = fit_faces(faces, inclined, evidence.fields, evidence.rig, effort, evidence.limits.min_gradient)
    return [(replace(start, face=fit.face), fit) for start, fit in zip(starts, fits, strict=True) if fit is not None]


def _promising(fitted: list[tuple[_Start, FaceFit]], inclined: int) -> list[tuple[_Start, FaceFit]]:
    """Return of each surface the figures that fit about as well as the best, of inclined ones the best few."""
    kept = []
    for number in sorted({start.number for start, _ in fitted}):
        mine = [one for one in fitted if one[0].number == number]
        level = [one for one in mine if not one[0].inclined]
        sloped = sorted((one for one in mine if one[0].inclined), key=_misfit)[:inclined]
        kept += [one for one in (*level, *sloped) if _misfit(one) <= min(map(_misfit, mine)) + _PROMISING_PX]
    return kept


def _retries(settled: list[tuple[_Start, FaceFit]], surfaces: Sequence[Surface]) -> list[_Start]:
    """Return more starts for rectangles that fit badly: smaller on one side, and by the measured slope.

    A region with a sliver of side face or shadow is too large on that side, so that a wrong edge is nearest. Edges are
    sought outwards from inside the face: a start inside the face meets its own edge first.
    """
    starts = []
    for number in sorted({start.number for start, _ in settled}):
        mine = [one for one in settled if one[0].number == number]
        best = min(mine, key=_misfit)
        if not _RETRY_RMS_PX < _misfit(best) < _LOST_RMS_PX or best[0].face.figure is not Figure.RECTANGLE:
            continue
        bases = [one[0] for one in mine if one[0].face.figure is Figure.RECTANGLE]
        if _has_slope(surfaces[number]) and tilt_deg(surfaces[number]) >= _LEVEL_TILT_DEG:
            bases.append(replace(best[0], face=_sloped(best[0].face, surfaces[number]), inclined=True))
        starts += [replace(base, face=smaller) for base in bases for smaller in _pulled_in(base.face)]
    return starts


def _has_slope(surface: Surface) -> bool:
    """Whether the slope of a surface was measured well enough to be believed."""
    return surface.match.right != NO_PLANE and surface.match.disparity_sigma_px <= _SLOPE_SIGMA_PX


def _sloped(face: Face, surface: Surface) -> Face:
    """Return a rectangle with its length along the measured slope and that slope."""
    fall = np.array(surface.normal[:2]) / surface.normal[2]
    for _ in range(_SIDES):
        along = -float(fall @ (np.cos(face.angle_rad), np.sin(face.angle_rad)))
        if along >= float(np.linalg.norm(fall)) * _ALONG_SLOPE:
            break
        face = face.quarter_turned()
    return replace(face, slope_u=along, slope_v=0.0)


def _pulled_in(face: Face) -> list[Face]:
    """Return a rectangle itself, and with each side moved inwards a little and more."""
    cos, sin = np.cos(face.angle_rad), np.sin(face.angle_rad)
    smaller = [face]
    for share in _PULLS:
        for side in (-1.0, 1.0):
            along, across = side * share * face.length_mm / 2.0, side * share * face.width_mm / 2.0
            shorter = replace(face, x_mm=face.x_mm - cos * along, y_mm=face.y_mm - sin * along)
            narrower = replace(face, x_mm=face.x_mm + sin * across, y_mm=face.y_mm - cos * across)
            smaller.append(
                replace(shorter, z_mm=face.z_mm - face.slope_u * along, length_mm=face.length_mm * (1.0 - share))
            )
            smaller.append(replace(narrower, width_mm=face.width_mm * (1.0 - share)))
    return smaller


def _misfit(fitted: tuple[_Start, FaceFit]) -> float:
    return fitted[1].rms_px


def _chosen(fitted: list[tuple[_Start, FaceFit]], surface: Surface, limits: RecognitionParameters) -> _Start | None:
    """Return the figure of one surface: the one that fits best, an inclined one only where it fits clearly better.

    A figure that contradicts the measured slope of its surface must fit better for it. Where no slope was measured, a
    sliver of side face lets a level face look a little inclined: an inclination must explain the edges then.
    """

    def doubt(one: tuple[_Start, FaceFit]) -> float:
        return _misfit(one) * (1.0 + _contradiction_deg(one[1].face, surface) / _DOUBLING_DEG)

    level = min((one for one in fitted if not one[0].inclined), key=doubt, default=None)
    inclined = min(
        (
            one
            for one in fitted
            if one[0].inclined
            and limits.min_inclination_deg <= one[1].face.inclination_deg <= limits.max_inclination_deg
        ),
        key=doubt,
        default=None,
    )
    if inclined is None or level is None:
        chosen = level or inclined
        return None if chosen is None else chosen[0]
    if not _has_slope(surface) and doubt(level) < SURE_RMS_PX and doubt(inclined) > _RETRY_RMS_PX:
        return level[0]
    return inclined[0] if doubt(inclined) < limits.inclined_gain * doubt(level) else level[0]


def _contradiction_deg(face: Face, surface: Surface) -> float:
    """Return by how much more than measuring errors explain a figure's attitude differs from its surface's."""
    if not _has_slope(surface):
        return 0.0
    cos, sin = np.cos(face.angle_rad), np.sin(face.angle_rad)
    normal = np.array([-face.slope_u * cos + face.slope_v * sin, -face.slope_u * sin - face.slope_v * cos, 1.0])
    agreement = float(normal @ surface.normal) / float(np.linalg.norm(normal))
    return max(0.0, float(np.rad2deg(np.arccos(np.clip(agreement, -1.0, 1.0)))) - _LEVEL_TILT_DEG)


def _may_be_top(surface: Surface, table_z_mm: float, limits: RecognitionParameters) -> bool:
    """Whether a surface is neither table nor wall."""
    # the middle of an inclined face that runs out on the table is at half its height
    least_mm = table_z_mm + _LEAST_SHARE * limits.min_height_mm
    inside = least_mm < surface.centre_mm[2] < table_z_mm + limits.max_height_mm
    return inside and tilt_deg(surface) <= _WALL_TILT_DEG


def tilt_deg(surface: Surface) -> float:
    """Return the angle between a surface and the horizontal."""
    return float(np.rad2deg(np.arccos(np.clip(surface.normal[2], -1.0, 1.0))))


def _level_starts(surface: Surface, rig: RectifiedRig) -> list[tuple[Face, bool]]:
    """Return the level figures to begin with: they have the region's place and area."""
    hull = _laid_on(surface, rig, _UP)
    moments = cv2.moments(hull.astype(np.float32))
    if moments["m00"] <= 0.0:
        return []
    z_mm = surface.centre_mm[2]
    rectangle = _bounding_rectangle(hull, z_mm)
    middle = (moments["m10"] / moments["m00"], moments["m01"] / moments["m00"])
    diameter = float(np.sqrt(moments["m00"] * 4.0 / np.pi))
    circle = Face(Figure.CIRCLE, *middle, z_mm, 0.0, diameter, diameter)
    across_corners = float(np.sqrt(moments["m00"] * 8.0 / (3.0 * np.sqrt(3.0))))
    corner = _hexagon_angle(hull - middle)
    hexagon = Face(Figure.HEXAGON, *middle, z_mm, corner, across_corners, across_corners * HEXAGON_RATIO)
    return [(rectangle, False), (circle, False), (hexagon, False)]


def _inclined_starts(surface: Surface, rig: RectifiedRig) -> list[tuple[Face, bool]]:
    """Return rectangles inclined along each of their sides; none where the slope is measured and level."""
    hull = _laid_on(surface, rig, _UP)
    if (_has_slope(surface) and tilt_deg(surface) < _LEVEL_TILT_DEG) or cv2.contourArea(hull.astype(np.float32)) <= 0.0:
        return []
    level = _bounding_rectangle(hull, surface.centre_mm[2])
    starts = []
    for turn in range(_SIDES):
        direction = level.angle_rad + turn * np.pi / 2.0
        normal = np.array([-_START_SLOPE * np.cos(direction), -_START_SLOPE * np.sin(direction), 1.0])
        start = _bounding_rectangle(_laid_on(surface, rig, normal), surface.centre_mm[2], direction)
        starts.append((replace(start, slope_u=_START_SLOPE), True))
    return starts


def _laid_on(surface: Surface, rig: RectifiedRig, normal: Array) -> Array:
    """Return the convex hull, seen from above, of a region laid on a plane through its centre, shape (N, 2)."""
    x, y, own = _hull_px(surface, rig)
    a, b, c = rig.plane_disparity(normal, float(np.dot(normal, surface.centre_mm)))
    disparity = a * x + b * y + c
    # a plane that passes behind the camera somewhere says nothing there: the surface's own place is kept
    outline = rig.points_mm(x, y, np.where(disparity > 0.0, disparity, own))[:, :2]
    return np.asarray(cv2.convexHull(outline.astype(np.float32)), dtype=np.float64).reshape(-1, 2)


def _hull_px(surface: Surface, rig: RectifiedRig) -> tuple[Array, Array, Array]:
    """Return x, y and disparity of the corners of a region's convex hull in the left image: a hull stays one."""
    x, y, own = rig.project_px(surface.outline_mm)
    corners = cv2.convexHull(np.column_stack([x, y]).astype(np.float32), returnPoints=False).ravel()
    return x[corners], y[corners], own[corners]


def _bounding_rectangle(hull: Array, z_mm: float, direction_rad: float | None = None) -> Face:
    """Return the bounding rectangle, least in area, or with its length along a direction."""
    if direction_rad is None:
        (x_mm, y_mm), (length_mm, width_mm), angle_deg = cv2.minAreaRect(hull.astype(np.float32))
        face = Face(Figure.RECTANGLE, x_mm, y_mm, z_mm, float(np.deg2rad(angle_deg)), length_mm, width_mm)
        return face if length_mm >= width_mm else face.quarter_turned()
    cos, sin = np.cos(direction_rad), np.sin(direction_rad)
    turned = hull @ np.array([[cos, -sin], [sin, cos]])
    low, high = turned.min(axis=0), turned.max(axis=0)
    u, v = (low + high) / 2.0
    length_mm, width_mm = high - low
    return Face(
        Figure.RECTANGLE, cos * u - sin * v, sin * u + cos * v, z_mm, direction_rad, float(length_mm), float(width_mm)
    )


def _hexagon_angle(hull: Array) -> float:
    """Return the direction of a corner: the phase of the radius' sixth harmonic, weighted by arc length."""
    turn = np.arctan2(hull[:, 1], hull[:, 0])
    radius = np.hypot(hull[:, 0], hull[:, 1])
    arc = 0.5 * np.linalg.norm(np.roll(hull, -1, axis=0) - np.roll(hull, 1, axis=0), axis=1)
    harmonic = (arc * radius * np.exp(6j * turn)).sum()
    return float(np.angle(harmonic) / 6.0)


def is_top(fit: FaceFit, table_z_mm: float, limits: RecognitionParameters) -> bool:
    """Whether a fitted face may be a part's top; one that is next to level is none, for it is fitted as level."""
    face = fit.face
    return (
        (face.slope_u == 0.0 or limits.min_inclination_deg <= face.inclination_deg <= limits.max_inclination_deg)
        and fit.rms_px <= limits.max_rms_px
        and fit.support >= limits.min_support
        and limits.min_size_mm <= min(face.length_mm, face.width_mm)
        and max(face.length_mm, face.width_mm) <= limits.max_size_mm
        and limits.min_height_mm <= height_above_mm(face, table_z_mm) <= limits.max_height_mm
        and face.lowest_mm >= table_z_mm - _BELOW_TABLE_MM
    )


def _keeps_place(fit: FaceFit, surface: Surface, rig: RectifiedRig) -> bool:
    """Whether a doubtful figure has about the disparity that its surface was measured to have.

    Where a narrow side face shows in one image alone, the edges of different borders are taken for each other's, and
    the figure that fits them stands at another height than the face.
    """
    if fit.rms_px <= SURE_RMS_PX or not _has_slope(surface):
        return True
    x, y, disparity = rig.project_px(np.array([fit.face.x_mm, fit.face.y_mm, fit.face.z_mm]))
    moved_px = float(disparity - disparity_at(surface.match.disparity_plane, x, y))
    return abs(moved_px) <= _MOST_MOVED_PX


def height_above_mm(face: Face, table_z_mm: float) -> float:
    """Return the height of a face's highest corner above the table."""
    return face.highest_mm - table_z_mm
