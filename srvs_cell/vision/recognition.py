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
from srvs_cell.vision.face_fit import SETTLE, EdgeField, FaceFit, fit_faces
from srvs_cell.vision.faces import Face, Figure
from srvs_cell.vision.grasping import GraspParameters, plan_grasp
from srvs_cell.vision.profile_fit import Pictures, fit_profiles, measure_blur
from srvs_cell.vision.recovery import (
    NO_PLANE,
    Region,
    find_places,
    rising_regions,
    stable_regions,
    unmatched_planes,
)
from srvs_cell.vision.relief import risen, rising_outlines
from srvs_cell.vision.rising_faces import fit_rising
from srvs_cell.vision.top_faces import SURE_RMS_PX, fit_tops, height_above_mm, is_top, tilt_deg

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    from srvs_cell.calibration import TableReference
    from srvs_cell.geometry import Array
    from srvs_cell.scene import PlaneImage, Surface
    from srvs_cell.vision.rectification import RectifiedRig
    from srvs_cell.vision.relief import Relief

_HALF_TURN_DEG = 180.0
_SHARED_PLACE = 0.4
"""Share of the smaller footprint that measuring errors never let two neighbours share."""
_CERTAIN_RMS_PX = 0.15
"""A figure that fits like this leaves nothing for another one to explain."""
_TRUSTED_RMS_PX = 0.5
"""A figure that fits worse does not explain what rises at its place."""
_RISING_WIDTH_PX = 1.5
"""Where a face stands over the table, its outline leaves at least a seam of this width in the relief."""
_UNSEEN_PX = 500
"""So many pixels of relief that no face explains are a part that was not recognised."""
_ROUNDS = 2
import os

_MSER = int(os.environ.get("MSER", "1"))
_DOUBT_FACTOR = 6.0
"""Standard deviation that an edge misfit of a pixel more than the sure one adds, pixels."""
_SIDE_FACE_MARGIN_MM = 4.0
_SILHOUETTE_MARGIN_PX = 4.0
_COLUMN_SHARE = 0.5
_STEEP_TILT_DEG = 30.0
_STEEP_SHARE = 0.15
"""A steep surface that only touches a part is its side face with shadow."""
_TOP_MARGIN_MM = 5.0
_UP = np.array([0.0, 0.0, 1.0])


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
    reference: TableReference | None = None,
    relief: Relief | None = None,
) -> tuple[Workpiece, ...]:
    """Group surfaces into objects, recognise their kinds and measure them.

    Args:
        surfaces: matched planes in the base frame.
        left: the rectified left image with its planes.
        right: the rectified right image with its planes.
        rig: the rectified cameras.
        table_z_mm: height of the table in the base frame.
        parameters: limits; the defaults where None.
        reference: corrects what calibration and poses misplace; None corrects nothing.
        relief: what rises over the table; None where that was not measured.

    Returns:
        Workpieces, the highest first; shapes that are not recognised have the kind ``unknown``.
    """
    limits = parameters or RecognitionParameters()
    fields = (EdgeField.of(left.grey), EdgeField.of(right.grey))
    matched = tuple(surfaces)
    tops: list[_Top] = []
    spans = ((table_z_mm, table_z_mm + limits.max_height_mm), (limits.min_size_mm, limits.max_size_mm))
    leftover = _add_tops(matched, tops, fields, rig, table_z_mm, limits)
    if limits.recover and (relief is None or _MSER):
        planes = unmatched_planes(left, {surface.id for surface in matched})
        for find in (partial(_unknown_planes, planes), partial(stable_regions, left.grey)):
            found = find_places(find(_explainer(tops, rig)), left.grey, right.grey, rig, *spans)
            _add_tops(found, tops, fields, rig, table_z_mm, limits)
    unseen: list[Array] = []
    if relief is None:
        tops = _one_per_place(tops)
    else:
        tops, unseen = _by_relief(tops, relief, (left, right), fields, rig, table_z_mm, limits)
    unknown: list[Surface] = []
    for surface in leftover:
        owner = _column(np.array([surface.centre_mm]), surface.centre_mm[2], tops)
        if owner is None:
            owner = _silhouette(surface, tops, rig, table_z_mm)
        if owner is not None:
            tops[owner] = tops[owner].joined(surface)
        elif relief is None and _rises(surface, table_z_mm, limits):
            unknown.append(surface)
    for region in find_places(rising_regions(unseen, left.grey.shape), left.grey, right.grey, rig, *spans):
        unknown.append(region)
    workpieces = [_workpiece(top, rig, table_z_mm, limits, reference) for top in tops]
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
    fitted = list(zip(surfaces, fit_tops(surfaces, fields, rig, table_z_mm, limits), strict=True))
    found = [(surface, fit) for surface, fit in fitted if fit is not None]
    found.sort(key=lambda one: _rank(one[1]))
    for surface, fit in found:
        owner = _column(fit.face.corners_mm(), min(surface.centre_mm[2], fit.face.z_mm), tops)
        if owner is None or _rank(tops[owner].fit)[0] > _rank(fit)[0]:
            tops.append(_Top(fit, ()).joined(surface))
        else:
            tops[owner] = tops[owner].joined(surface)
    return [surface for surface, fit in fitted if fit is None]


def _by_relief(
    tops: list[_Top],
    relief: Relief,
    images: tuple[PlaneImage, PlaneImage],
    fields: tuple[EdgeField, EdgeField],
    rig: RectifiedRig,
    table_z_mm: float,
    limits: RecognitionParameters,
) -> tuple[list[_Top], list[Array]]:
    """Return the tops that really rise, those that only their parallax tells among them, and what stays unexplained.

    What is unexplained are outlines in the left image, each of shape (N, 2).
    """
    left, right = images
    sure = [top.fit.face for top in tops if top.fit.rms_px < _CERTAIN_RMS_PX]
    pictures = Pictures.of(left.grey, right.grey)
    pictures = replace(pictures, blur_px=measure_blur(sure, pictures, rig, table_z_mm))
    fits = fit_profiles(
        [top.fit.face for top in tops], [top.fit.face.slope_u != 0.0 for top in tops], pictures, rig, table_z_mm
    )
    known = [
        replace(top, fit=_surer(top.fit, fit))
        for top, fit in zip(tops, fits, strict=True)
        if is_top(fit, table_z_mm, limits)
    ]
    heights = (limits.min_height_mm, limits.max_height_mm)
    outlines: list[Array] = []
    for _ in range(_ROUNDS):
        explained = _explained([top for top in known if top.fit.rms_px <= _TRUSTED_RMS_PX], rig, table_z_mm)
        outlines = rising_outlines(relief, explained)
        if not outlines:
            break
        rising = fit_rising(outlines, left, pictures, rig, heights, table_z_mm)
        rising = [fit for fit in rising if is_top(fit, table_z_mm, limits)]
        starts = [fit.face for fit in rising]
        by_edges = fit_faces(starts, [face.slope_u != 0.0 for face in starts], fields, rig, SETTLE, limits.min_gradient)
        found = [fit if other is None else _surer(other, fit) for fit, other in zip(rising, by_edges, strict=True)]
        before = len(known)
        for fit in sorted(found, key=lambda fit: fit.rms_px):
            if not any(_share_place(fit, other.fit) and other.fit.rms_px <= fit.rms_px for other in known):
                known.append(_Top(fit, ()))
        if len(known) == before:
            break
    known = _one_per_place(known)
    rising_px = risen(relief, _explained(sorted(known, key=lambda top: top.fit.rms_px), rig, table_z_mm))
    kept = []
    for top, pixels in zip(sorted(known, key=lambda top: top.fit.rms_px), rising_px, strict=True):
        x, y, _ = rig.project_px(top.fit.face.corners_mm())
        length_px = cv2.arcLength(np.column_stack([x, y]).astype(np.float32), closed=True)
        if pixels >= _RISING_WIDTH_PX * length_px:
            kept.append(top)
    return kept, rising_outlines(relief, _explained(kept, rig, table_z_mm), _UNSEEN_PX)


def _surer(by_edges: FaceFit, by_profiles: FaceFit) -> FaceFit:
    """Return the better of two fits of one face; that to the grey values where both are good."""
    import os

    if by_profiles.rms_px <= max(float(os.environ.get("PR", "0.3")), by_edges.rms_px):
        return replace(by_profiles, rms_px=min(by_profiles.rms_px, by_edges.rms_px))
    return by_edges


def _share_place(fit: FaceFit, other: FaceFit) -> bool:
    """Whether two faces stand over one place, so that they cannot both be right."""
    outline, standing = (one.face.corners_mm()[:, :2].astype(np.float32) for one in (fit, other))
    shared_mm2, _ = cv2.intersectConvexConvex(outline, standing)
    return bool(shared_mm2 > _SHARED_PLACE * min(cv2.contourArea(outline), cv2.contourArea(standing)))


def _one_per_place(tops: list[_Top]) -> list[_Top]:
    """Return the tops without those that stand where a surer one stands; its surfaces go to the surer one.

    Parts stand on the table beside each other, so that two top faces over one place cannot both be right.
    """
    kept: list[_Top] = []
    for top in sorted(tops, key=lambda one: _rank(one.fit)):
        for number, other in enumerate(kept):
            if _share_place(top.fit, other.fit):
                kept[number] = replace(other, surfaces=(*other.surfaces, *top.surfaces))
                break
        else:
            kept.append(top)
    return kept


def _rank(fit: FaceFit) -> tuple[int, float]:
    """Return the sort key that puts the surest first, among equals the largest: a face before the print on it."""
    sureness = (fit.rms_px > _CERTAIN_RMS_PX) + (fit.rms_px > SURE_RMS_PX)
    return sureness, -fit.face.length_mm * fit.face.width_mm


def _unknown_planes(planes: list[Region], known: Callable[[tuple[float, float]], bool]) -> list[Region]:
    return [region for region in planes if not known(region.centre_px)]


def _explained(tops: list[_Top], rig: RectifiedRig, table_z_mm: float) -> list[Array]:
    """Return what known parts and their pictures in the right image, laid over by the table, cover in the left one."""
    table = np.array(rig.plane_disparity(_UP, table_z_mm))
    polygons = []
    for top in tops:
        corners = top.fit.face.corners_mm()
        x, y, disparity = rig.project_px(np.concatenate([corners, _feet(corners, table_z_mm)]))
        laid = x - (disparity - np.column_stack([x, y, np.ones_like(x)]) @ table)
        both = np.concatenate([np.column_stack([x, y]), np.column_stack([laid, y])])
        hull = cv2.convexHull(both.astype(np.float32)).reshape(-1, 2).astype(np.float64)
        rays = hull - hull.mean(axis=0)
        polygons.append(hull + _SILHOUETTE_MARGIN_PX * rays / np.linalg.norm(rays, axis=1, keepdims=True))
    return polygons


def _feet(corners_mm: Array, table_z_mm: float) -> Array:
    """Return the points of the table under corners."""
    feet: Array = corners_mm * (1.0, 1.0, 0.0) + (0.0, 0.0, table_z_mm)
    return feet


def _explainer(tops: list[_Top], rig: RectifiedRig) -> Callable[[tuple[float, float]], bool]:
    """Return whether a pixel of the left image lies on a surely known top face, as a function of it."""
    polygons = []
    for top in tops:
        if top.fit.rms_px > SURE_RMS_PX:
            continue
        x, y, _ = rig.project_px(top.fit.face.corners_mm())
        polygons.append(np.column_stack([x, y]).astype(np.float32))

    def known(pixel: tuple[float, float]) -> bool:
        return any(cv2.pointPolygonTest(polygon, pixel, measureDist=False) > 0 for polygon in polygons)

    return known


def _plan_area_mm2(surface: Surface) -> float:
    return float(cv2.contourArea(surface.outline_mm[:, :2].astype(np.float32)))


def _column(outline_mm: Array, z_mm: float, tops: list[_Top]) -> int | None:
    """Return the top face whose column, widened a little, holds most of an outline that is not above it."""
    for number, top in enumerate(tops):
        face = top.fit.face
        if z_mm > height_above_mm(face, 0.0) + _TOP_MARGIN_MM:
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
    needed = _STEEP_SHARE if tilt_deg(surface) > _STEEP_TILT_DEG else _COLUMN_SHARE
    for number, top in enumerate(tops):
        corners = top.fit.face.corners_mm()
        feet = _feet(corners, table_z_mm)
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


def _workpiece(
    top: _Top, rig: RectifiedRig, table_z_mm: float, limits: RecognitionParameters, reference: TableReference | None
) -> Workpiece:
    face = _long_side_first(top.fit.face)
    centre = (face.x_mm, face.y_mm, face.z_mm)
    if reference is None:
        systematic = rig.error_budget.systematic_mm2(centre)
    else:
        systematic = reference.covariance_mm2(centre)
        x_mm, y_mm, z_mm = (float(value) for value in centre + reference.correction_mm(centre))
        face = replace(face, x_mm=x_mm, y_mm=y_mm, z_mm=z_mm)
        centre = (x_mm, y_mm, z_mm)
    mm_per_px = (rig.base_T_camera.translation_mm[2] - face.z_mm) / rig.f_px
    # edges that do not fit are another face's or a shadow's, and may have moved a side by some times their misfit
    doubt_mm = _DOUBT_FACTOR * max(0.0, top.fit.rms_px - SURE_RMS_PX) * float(mm_per_px)
    covariance = top.fit.covariance_mm2 + systematic + np.eye(3) * doubt_mm**2
    grasp, refusal = plan_grasp(face, covariance, table_z_mm, limits.grasp)
    return Workpiece(
        id=0,
        kind=_kind(face),
        position_mm=centre,
        height_mm=height_above_mm(face, table_z_mm),
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
