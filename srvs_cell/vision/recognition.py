"""Step 11: planes to objects.

From above a camera sees top faces, slivers of side faces, shadows and print. A surface that rises over the table and
whose outline, fitted to the edges of both images, is a rectangle, a circle or a hexagon is a top face; what lies in
the column under it (its side faces) or in it (print) belongs to it. The figure and the inclination of the top face
say the kind. Surfaces at the height of the table, shadows among them, are table. What rises and is no known figure is
reported as unknown with its surfaces.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated

import cv2
import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as checked_dataclass

from srvs_cell.scene import UNKNOWN_KIND, Workpiece
from srvs_cell.vision.face_fit import MEASURE, SCOUT, SETTLE, EdgeField, FaceFit, fit_faces
from srvs_cell.vision.faces import HEXAGON_RATIO, Face, Figure
from srvs_cell.vision.grasping import GraspParameters, plan_grasp
from srvs_cell.vision.recovery import NO_PLANE, Region, find_places, stable_regions, unmatched_planes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.scene import PlaneImage, Surface
    from srvs_cell.vision.face_fit import Effort
    from srvs_cell.vision.rectification import RectifiedRig

_HALF_TURN_DEG = 180.0
_LEAST_SHARE = 0.4
_WALL_TILT_DEG = 65.0
"""A matched plane that leans more is a side face."""
_LEVEL_TILT_DEG = 5.0
"""A well matched plane that leans less is level."""
_SLOPE_SIGMA_PX = 0.12
_SHARED_PLACE = 0.4
"""Share of the smaller footprint that measuring errors never let two neighbours share."""
_SURE_RMS_PX = 0.4
"""A figure that fits worse waits until the better ones have taken their surfaces."""
_CERTAIN_RMS_PX = 0.15
"""A figure that fits like this leaves nothing for another one to explain."""
_PROMISING_PX = 0.6
"""A figure that fits worse than the best by more, after scouting, is given up."""
_DOUBT_FACTOR = 6.0
"""Standard deviation that an edge misfit of a pixel more than the sure one adds, pixels."""
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
_ALONG_SLOPE = float(np.cos(np.pi / 4.0))
_START_SLOPE = 0.36
"""20 degrees: from here the edges of inclinations from 5 to 35 degrees are within reach."""
_SIDES = 4
_UP = np.array([0.0, 0.0, 1.0])
_SIDE_FACE_MARGIN_MM = 4.0
_SILHOUETTE_MARGIN_PX = 4.0
_COLUMN_SHARE = 0.5
_STEEP_TILT_DEG = 30.0
_STEEP_SHARE = 0.15
"""A steep surface that only touches a part is its side face with shadow."""
_TOP_MARGIN_MM = 5.0


@checked_dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid"))
class RecognitionParameters:
    """Limits of the recognition."""

    min_height_mm: Annotated[
        float, Field(gt=0.0, le=500.0, description="what rises less above the table is table, shadow or print")
    ] = 8.0
    max_height_mm: Annotated[
        float, Field(gt=0.0, le=2000.0, description="what rises more above the table is a false match")
    ] = 200.0
    min_size_mm: Annotated[float, Field(gt=0.0, le=500.0, description="least side of a top face")] = 10.0
    max_size_mm: Annotated[float, Field(gt=0.0, le=2000.0, description="greatest side of a top face")] = 160.0
    min_unknown_area_mm2: Annotated[
        float, Field(gt=0.0, le=1e6, description="least area of a surface that is reported as unknown")
    ] = 200.0
    max_rms_px: Annotated[
        float, Field(gt=0.0, le=3.0, description="greatest distance between a figure and the edges")
    ] = 1.2
    min_support: Annotated[
        float, Field(gt=0.0, le=1.0, description="least share of a figure's outline that has an edge in both images")
    ] = 0.7
    min_gradient: Annotated[
        float, Field(gt=0.0, le=100.0, description="least gradient of an edge, grey values per pixel")
    ] = 0.5
    min_inclination_deg: Annotated[
        float, Field(gt=0.0, lt=90.0, description="a top face inclined by less is level")
    ] = 5.0
    max_inclination_deg: Annotated[
        float, Field(gt=0.0, lt=90.0, description="a face inclined by more is a side face")
    ] = 50.0
    inclined_gain: Annotated[
        float, Field(gt=0.0, le=1.0, description="an inclined figure must fit better than the level one by this factor")
    ] = 0.7
    recover: Annotated[
        bool, Field(description="look for planes without a partner by their grey values (beyond the paper)")
    ] = True
    grasp: GraspParameters = Field(default_factory=GraspParameters)


@dataclass(frozen=True, eq=False)
class _Top:
    """A top face and the surfaces that belong to its object."""

    fit: FaceFit
    surfaces: tuple[int, ...]

    def joined(self, surface: Surface) -> _Top:
        """Return the top with one more surface; a region that is no plane has no number to join."""
        return self if surface.id == NO_PLANE else replace(self, surfaces=(*self.surfaces, surface.id))


def recognise(
    surfaces: Iterable[Surface],
    left: PlaneImage,
    right: PlaneImage,
    rig: RectifiedRig,
    table_z_mm: float,
    parameters: RecognitionParameters | None = None,
) -> tuple[Workpiece, ...]:
    """Group surfaces into objects, recognise their kinds and measure them.

    Args:
        surfaces: matched planes in the base frame.
        left: the rectified left image with its planes.
        right: the rectified right image with its planes.
        rig: the rectified cameras.
        table_z_mm: height of the table in the base frame.
        parameters: limits; the defaults where None.

    Returns:
        Workpieces, the highest first; shapes that are not recognised have the kind ``unknown``.
    """
    limits = parameters or RecognitionParameters()
    fields = (EdgeField.of(left.grey), EdgeField.of(right.grey))
    matched = tuple(surfaces)
    tops: list[_Top] = []
    leftover = _add_tops(matched, tops, fields, rig, table_z_mm, limits)
    if limits.recover:
        planes = unmatched_planes(left, {surface.id for surface in matched})
        for find in (partial(_unknown_planes, planes), partial(stable_regions, left.grey)):
            found = find_places(
                find(_explainer(tops, rig)),
                left.grey,
                right.grey,
                rig,
                (table_z_mm, table_z_mm + limits.max_height_mm),
                (limits.min_size_mm, limits.max_size_mm),
            )
            _add_tops(found, tops, fields, rig, table_z_mm, limits)
    tops = _one_per_place(tops)
    unknown: list[Surface] = []
    for surface in leftover:
        owner = _column(np.array([surface.centre_mm]), surface.centre_mm[2], tops)
        if owner is None:
            owner = _silhouette(surface, tops, rig, table_z_mm)
        if owner is not None:
            tops[owner] = tops[owner].joined(surface)
        elif _rises(surface, table_z_mm, limits):
            unknown.append(surface)
    workpieces = [_workpiece(top, rig, table_z_mm, limits) for top in tops]
    workpieces += [_unknown(surface, table_z_mm) for surface in unknown]
    workpieces.sort(key=lambda workpiece: -workpiece.height_mm)
    return tuple(replace(workpiece, id=number) for number, workpiece in enumerate(workpieces))


def _add_tops(
    surfaces: Sequence[Surface],
    tops: list[_Top],
    fields: tuple[EdgeField, EdgeField],
    rig: RectifiedRig,
    table_z_mm: float,
    limits: RecognitionParameters,
) -> list[Surface]:
    """Add the top faces among surfaces to those known, the surest and largest first; returns the other surfaces."""
    fitted = list(zip(surfaces, _fit_tops(surfaces, fields, rig, table_z_mm, limits), strict=True))
    found = [(surface, fit) for surface, fit in fitted if fit is not None]
    found.sort(key=lambda one: _rank(one[1]))
    for surface, fit in found:
        owner = _column(fit.face.corners_mm(), min(surface.centre_mm[2], fit.face.z_mm), tops)
        if owner is None or _rank(tops[owner].fit)[0] > _rank(fit)[0]:
            tops.append(_Top(fit, ()).joined(surface))
        else:
            tops[owner] = tops[owner].joined(surface)
    return [surface for surface, fit in fitted if fit is None]


def _one_per_place(tops: list[_Top]) -> list[_Top]:
    """Return the tops without those that stand where a surer one stands; its surfaces go to the surer one.

    Parts stand on the table beside each other, so that two top faces over one place cannot both be right.
    """
    kept: list[_Top] = []
    for top in sorted(tops, key=lambda one: _rank(one.fit)):
        outline = top.fit.face.corners_mm()[:, :2].astype(np.float32)
        for number, other in enumerate(kept):
            standing = other.fit.face.corners_mm()[:, :2].astype(np.float32)
            shared_mm2, _ = cv2.intersectConvexConvex(outline, standing)
            if shared_mm2 > _SHARED_PLACE * min(cv2.contourArea(outline), cv2.contourArea(standing)):
                kept[number] = replace(other, surfaces=(*other.surfaces, *top.surfaces))
                break
        else:
            kept.append(top)
    return kept


def _rank(fit: FaceFit) -> tuple[int, float]:
    """Return the sort key that puts the surest first, among equals the largest: a face before the print on it."""
    sureness = (fit.rms_px > _CERTAIN_RMS_PX) + (fit.rms_px > _SURE_RMS_PX)
    return sureness, -fit.face.length_mm * fit.face.width_mm


def _unknown_planes(planes: list[Region], known: Callable[[tuple[float, float]], bool]) -> list[Region]:
    return [region for region in planes if not known(region.centre_px)]


def _explainer(tops: list[_Top], rig: RectifiedRig) -> Callable[[tuple[float, float]], bool]:
    """Return whether a pixel of the left image lies on a surely known top face, as a function of it."""
    polygons = []
    for top in tops:
        if top.fit.rms_px > _SURE_RMS_PX:
            continue
        x, y, _ = rig.project_px(top.fit.face.corners_mm())
        polygons.append(np.column_stack([x, y]).astype(np.float32))

    def known(pixel: tuple[float, float]) -> bool:
        return any(cv2.pointPolygonTest(polygon, pixel, measureDist=False) > 0 for polygon in polygons)

    return known


def _plan_area_mm2(surface: Surface) -> float:
    return float(cv2.contourArea(surface.outline_mm[:, :2].astype(np.float32)))


def _fit_tops(
    surfaces: Sequence[Surface],
    fields: tuple[EdgeField, EdgeField],
    rig: RectifiedRig,
    table_z_mm: float,
    limits: RecognitionParameters,
) -> list[FaceFit | None]:
    """Return for each surface the best figure as a top face, or None where it is none.

    Every figure in every likely attitude is tried, all together: a few iterations leave the promising ones, these are
    settled, and the best one of each surface is measured.
    """
    starts = [
        _Start(number, face, inclined=inclined)
        for number, surface in enumerate(surfaces)
        if _may_be_top(surface, table_z_mm, limits)
        for face, inclined in (*_level_starts(surface, rig), *_inclined_starts(surface, rig))
    ]
    scouted = _promising(_fitted(starts, fields, rig, SCOUT, limits), inclined=1)
    settled = _fitted([start for start, _ in scouted], fields, rig, SETTLE, limits)
    retried = _promising(_fitted(_retries(settled, surfaces), fields, rig, SCOUT, limits), inclined=_RETRIED_INCLINED)
    settled += _fitted([start for start, _ in retried], fields, rig, SETTLE, limits)
    best: dict[int, _Start] = {}
    for number in range(len(surfaces)):
        chosen = _chosen([(start, fit) for start, fit in settled if start.number == number], surfaces[number], limits)
        if chosen is not None:
            best[number] = chosen
    measured = _fitted(list(best.values()), fields, rig, MEASURE, limits)
    fits = {start.number: fit for start, fit in measured if _is_top(fit, table_z_mm, limits)}
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


def _fitted(
    starts: Sequence[_Start],
    fields: tuple[EdgeField, EdgeField],
    rig: RectifiedRig,
    effort: Effort,
    limits: RecognitionParameters,
) -> list[tuple[_Start, FaceFit]]:
    """Fit figures; each that has a fit comes back with its fit as the next start."""
    fits = fit_faces(
        [start.face for start in starts], [start.inclined for start in starts], fields, rig, effort, limits.min_gradient
    )
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
        if _has_slope(surfaces[number]) and _tilt_deg(surfaces[number]) >= _LEVEL_TILT_DEG:
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
    if not _has_slope(surface) and doubt(level) < _SURE_RMS_PX and doubt(inclined) > _RETRY_RMS_PX:
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
    return inside and _tilt_deg(surface) <= _WALL_TILT_DEG


def _tilt_deg(surface: Surface) -> float:
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
    if (_has_slope(surface) and _tilt_deg(surface) < _LEVEL_TILT_DEG) or cv2.contourArea(
        hull.astype(np.float32)
    ) <= 0.0:
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


def _is_top(fit: FaceFit, table_z_mm: float, limits: RecognitionParameters) -> bool:
    face = fit.face
    return (
        fit.rms_px <= limits.max_rms_px
        and fit.support >= limits.min_support
        and limits.min_size_mm <= min(face.length_mm, face.width_mm)
        and max(face.length_mm, face.width_mm) <= limits.max_size_mm
        and limits.min_height_mm <= _height_mm(face, table_z_mm) <= limits.max_height_mm
    )


def _height_mm(face: Face, table_z_mm: float) -> float:
    return face.highest_mm - table_z_mm


def _column(outline_mm: Array, z_mm: float, tops: list[_Top]) -> int | None:
    """Return the top face whose column, widened a little, holds most of an outline that is not above it."""
    for number, top in enumerate(tops):
        face = top.fit.face
        if z_mm > _height_mm(face, 0.0) + _TOP_MARGIN_MM:
            continue
        polygon = face.corners_mm()[:, :2].astype(np.float32)
        inside = [
            cv2.pointPolygonTest(polygon, (float(x), float(y)), measureDist=True) > -_SIDE_FACE_MARGIN_MM
            for x, y, *_ in outline_mm
        ]
        if np.mean(inside) > _COLUMN_SHARE:
            return number
    return None


def _silhouette(surface: Surface, tops: list[_Top], rig: RectifiedRig, table_z_mm: float) -> int | None:
    """Return the top whose part, standing on the table, covers most of a surface's outline in either image.

    What lies in the picture of a part and is not its top is its side face, whatever place a false match gave it.
    """
    outline = _pictures(surface.outline_mm, rig)
    needed = _STEEP_SHARE if _tilt_deg(surface) > _STEEP_TILT_DEG else _COLUMN_SHARE
    for number, top in enumerate(tops):
        corners = top.fit.face.corners_mm()
        feet = corners * (1.0, 1.0, 0.0) + (0.0, 0.0, table_z_mm)
        shares = []
        for seen, part in zip(outline, _pictures(np.concatenate([corners, feet]), rig), strict=True):
            hull = cv2.convexHull(part)
            inside = [
                cv2.pointPolygonTest(hull, (float(x), float(y)), measureDist=True) > -_SILHOUETTE_MARGIN_PX
                for x, y in seen
            ]
            shares.append(float(np.mean(inside)))
        if max(shares) > needed:
            return number
    return None


def _pictures(points_mm: Array, rig: RectifiedRig) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return points' pixels in the left and in the right image, each float32, shape (N, 2)."""
    x, y, disparity = rig.project_px(points_mm)
    return np.column_stack([x, y]).astype(np.float32), np.column_stack([x - disparity, y]).astype(np.float32)


def _rises(surface: Surface, table_z_mm: float, limits: RecognitionParameters) -> bool:
    """Whether a surface is a face of something that stands on the table, and no wall."""
    height_mm = surface.centre_mm[2] - table_z_mm
    steepest = float(np.cos(np.deg2rad(limits.max_inclination_deg)))
    return (
        limits.min_height_mm <= height_mm <= limits.max_height_mm
        and surface.normal[2] > steepest
        and _plan_area_mm2(surface) >= limits.min_unknown_area_mm2
    )


def _workpiece(top: _Top, rig: RectifiedRig, table_z_mm: float, limits: RecognitionParameters) -> Workpiece:
    face = _long_side_first(top.fit.face)
    centre = (face.x_mm, face.y_mm, face.z_mm)
    mm_per_px = (rig.base_T_camera.translation_mm[2] - face.z_mm) / rig.f_px
    # edges that do not fit are another face's or a shadow's, and may have moved a side by some times their misfit
    doubt_mm = _DOUBT_FACTOR * max(0.0, top.fit.rms_px - _SURE_RMS_PX) * float(mm_per_px)
    covariance = top.fit.covariance_mm2 + rig.error_budget.systematic_mm2(centre) + np.eye(3) * doubt_mm**2
    grasp, refusal = plan_grasp(face, covariance, table_z_mm, limits.grasp)
    return Workpiece(
        id=0,
        kind=_kind(face),
        position_mm=centre,
        height_mm=_height_mm(face, table_z_mm),
        yaw_deg=float(np.rad2deg(face.angle_rad)) % _HALF_TURN_DEG if face.figure is Figure.RECTANGLE else None,
        size_mm=(face.length_mm, face.width_mm),
        covariance_mm2=covariance,
        footprint_mm=face.corners_mm()[:, :2],
        surfaces=top.surfaces,
        grasp=grasp,
        grasp_refusal=refusal,
    )


def _kind(face: Face) -> str:
    if face.figure is Figure.CIRCLE:
        return "cylinder"
    if face.figure is Figure.HEXAGON:
        return "prism"
    return "wedge" if face.inclination_deg > 0.0 else "cuboid"


def _long_side_first(face: Face) -> Face:
    if face.figure is not Figure.RECTANGLE or face.length_mm >= face.width_mm:
        return face
    return face.quarter_turned()


def _unknown(surface: Surface, table_z_mm: float) -> Workpiece:
    hull = cv2.convexHull(surface.outline_mm[:, :2].astype(np.float32))
    _, (length_mm, width_mm), angle_deg = cv2.minAreaRect(hull)
    if width_mm > length_mm:
        length_mm, width_mm, angle_deg = width_mm, length_mm, angle_deg + 90.0
    return Workpiece(
        id=0,
        kind=UNKNOWN_KIND,
        position_mm=surface.centre_mm,
        height_mm=float(surface.centre_mm[2]) - table_z_mm,
        yaw_deg=float(angle_deg) % _HALF_TURN_DEG,
        size_mm=(float(length_mm), float(width_mm)),
        covariance_mm2=surface.covariance_mm2,
        footprint_mm=hull.reshape(-1, 2).astype(np.float64),
        surfaces=(surface.id,),
        grasp=None,
        grasp_refusal="the shape is in no library",
    )
