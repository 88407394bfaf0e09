"""Step 11d: the top faces of a scene, and what belongs to each.

Several claims may be made for one place; the surest stands. What lies in the column under a top face (its side faces)
or in it (print) belongs to its part.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.faces.face import share_place
from srvs_cell.vision.faces.witnesses import CONVINCING_PX2
from srvs_cell.vision.recognition.recovery import NO_PLANE
from srvs_cell.vision.recognition.top_faces import SURE_RMS_PX, fit_tops, height_above_mm, tilt_deg
from srvs_cell.vision.relief import rising_share, unexplained

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.scene import Surface
    from srvs_cell.vision.faces.edge_fit import FaceFit
    from srvs_cell.vision.recognition.evidence import Evidence
    from srvs_cell.vision.rectification import RectifiedRig
    from srvs_cell.vision.relief import Relief

_CERTAIN_RMS_PX = 0.15
"""A figure that fits like this leaves nothing for another one to explain."""
TRUSTED_RMS_PX = 0.5
"""A figure that fits worse does not explain what rises at its place, and does not tell the lamp at first."""
_SIDE_FACE_MARGIN_MM = 4.0
_SILHOUETTE_MARGIN_PX = 5.0
"""What rises so near beside the picture of a known part belongs to it."""
_RING = np.column_stack([np.cos(np.arange(8) * np.pi / 4.0), np.sin(np.arange(8) * np.pi / 4.0)])
_COLUMN_SHARE = 0.5
_STEEP_TILT_DEG = 30.0
_STEEP_SHARE = 0.15
"""A steep surface that only touches a part is its side face with shadow."""
_TOP_MARGIN_MM = 5.0
_MOST_OF_FACE = 0.7
"""What has more of a face's area is another measurement of the face, not print on it."""
_PRINT_MARGIN_MM = 1.0
_LEAST_RISING = 0.3
"""Share of a face's outline that rises at least: all but the sides along the base line."""
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Top:
    """A top face and the surfaces that belong to its object.

    Attributes:
        fit: the face.
        surfaces: ids of the surfaces.
        price_px2: what edges, grey values and inside leave unexplained (`Witnesses.price_px2`); infinite where only
            the edges were asked.
    """

    fit: FaceFit
    surfaces: tuple[int, ...]
    price_px2: float = float("inf")

    def joined(self, surface: Surface) -> Top:
        """Return the top with one more surface; a region that is no plane has no number to join."""
        return self if surface.id == NO_PLANE else replace(self, surfaces=(*self.surfaces, surface.id))


def add_tops(surfaces: Sequence[Surface], tops: list[Top], evidence: Evidence) -> None:
    """Add the top faces among surfaces to those known, the surest and largest first."""
    fits = fit_tops(surfaces, evidence)
    found = [(surface, fit) for surface, fit in zip(surfaces, fits, strict=True) if fit is not None]
    found.sort(key=lambda one: _rank(one[1]))
    for surface, fit in found:
        owner = _column(fit.face.corners_mm(), min(surface.centre_mm[2], fit.face.z_mm), tops)
        if owner is None or _rank(tops[owner].fit)[0] > _rank(fit)[0]:
            tops.append(Top(fit, ()).joined(surface))
        else:
            tops[owner] = tops[owner].joined(surface)


def one_per_place(tops: list[Top]) -> list[Top]:
    """Return the tops without those that stand where a surer one stands; its surfaces go to the surer one.

    Parts stand on the table beside each other, so that two top faces over one place cannot both be right.
    """
    return _per_place(sorted(tops, key=lambda one: _rank(one.fit)), lambda _, __: False)


def best_per_place(tops: list[Top]) -> list[Top]:
    """Return the tops without those that stand where one that is better, see `is_better`, stands; it takes theirs."""
    return _per_place(sorted(tops, key=lambda one: one.price_px2), is_better)


def _per_place(tops: list[Top], is_better_than: Callable[[Top, Top], bool]) -> list[Top]:
    """Return the first top of each place, or a later one that is better."""
    kept: list[Top] = []
    for top in tops:
        for number, other in enumerate(kept):
            if share_place(top.fit.face, other.fit.face):
                stands = top if is_better_than(top, other) else other
                kept[number] = replace(stands, surfaces=(*other.surfaces, *top.surfaces))
                break
        else:
            kept.append(top)
    return kept


def is_better(top: Top, other: Top) -> bool:
    """Whether one of two tops at one place suits the pictures better: the cheaper one, but a face before its print."""
    if top.price_px2 < CONVINCING_PX2 and is_print(other.fit, top.fit):
        return True
    if other.price_px2 < CONVINCING_PX2 and is_print(top.fit, other.fit):
        return False
    return top.price_px2 < other.price_px2


def _rank(fit: FaceFit) -> tuple[int, float]:
    """Return the sort key that puts the surest first, among equals the largest: a face before the print on it."""
    sureness = (fit.rms_px > _CERTAIN_RMS_PX) + (fit.rms_px > SURE_RMS_PX)
    return sureness, -fit.face.length_mm * fit.face.width_mm


def is_print(fit: FaceFit, other: FaceFit) -> bool:
    """Whether a face is something printed on another one: it lies in its plane, and is clearly smaller."""
    face, larger = fit.face, other.face
    if face.length_mm * face.width_mm > _MOST_OF_FACE * larger.length_mm * larger.width_mm:
        return False
    inside = _share_inside(face.corners_mm()[:, :2], larger.corners_mm()[:, :2], _PRINT_MARGIN_MM)
    return inside == 1.0 and abs(larger.height_at_mm(face.x_mm, face.y_mm) - face.z_mm) < _TOP_MARGIN_MM


def share_out(
    surfaces: Sequence[Surface], tops: list[Top], rig: RectifiedRig, table_z_mm: float
) -> tuple[list[Top], list[Surface]]:
    """Return the tops with the surfaces that belong to their parts, and the surfaces that belong to none."""
    tops = list(tops)
    owned = {number for top in tops for number in top.surfaces}
    others = []
    for surface in surfaces:
        if surface.id in owned:
            continue
        owner = _column(np.array([surface.centre_mm]), surface.centre_mm[2], tops)
        if owner is None:
            owner = _silhouette(surface, tops, rig, table_z_mm)
        if owner is None:
            others.append(surface)
        else:
            tops[owner] = tops[owner].joined(surface)
    return tops, others


def _column(outline_mm: Array, z_mm: float, tops: list[Top]) -> int | None:
    """Return the top face whose column, widened a little, holds most of an outline that is not above it."""
    for number, top in enumerate(tops):
        face = top.fit.face
        if z_mm > height_above_mm(face, 0.0) + _TOP_MARGIN_MM:
            continue
        if _share_inside(outline_mm[:, :2], face.corners_mm()[:, :2], _SIDE_FACE_MARGIN_MM) > _COLUMN_SHARE:
            return number
    return None


def _silhouette(surface: Surface, tops: list[Top], rig: RectifiedRig, table_z_mm: float) -> int | None:
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
            shares.append(
                _share_inside(seen, cv2.convexHull(part).reshape(-1, 2).astype(np.float32), _SILHOUETTE_MARGIN_PX)
            )
        if max(shares) > needed:
            return number
    return None


def _share_inside(points: Array | NDArray[np.float32], polygon: Array | NDArray[np.float32], margin: float) -> float:
    """Return the share of points, shape (N, 2), inside a convex polygon, shape (K, 2), or beside it by a margin."""
    along = np.roll(polygon, -1, axis=0) - polygon
    normals = np.column_stack([along[:, 1], -along[:, 0]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(np.float32).tiny)
    beyond = points @ normals.T - (normals * polygon).sum(axis=1)
    # the normals point outwards or inwards, by the polygon's turning sense
    beyond *= np.sign(cv2.contourArea(polygon.astype(np.float32), oriented=True))
    return float(np.mean(beyond.max(axis=1) < margin))


def _pictures(points_mm: Array, rig: RectifiedRig) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return points' pixels in the left and in the right image, each float32, shape (N, 2)."""
    x, y, disparity = rig.project_px(points_mm)
    return np.column_stack([x, y]).astype(np.float32), np.column_stack([x - disparity, y]).astype(np.float32)


def trusted(tops: Sequence[Top]) -> list[Top]:
    """Return the tops that fit so well that they explain what rises at their places."""
    return [top for top in tops if top.fit.rms_px <= TRUSTED_RMS_PX]


def explained_polygons(tops: list[Top], rig: RectifiedRig, table_z_mm: float) -> list[Array]:
    """Return what known parts and their pictures in the right image, laid over by the table, cover in the left one."""
    table = np.array(rig.plane_disparity(_UP, table_z_mm))
    polygons = []
    for top in tops:
        corners = top.fit.face.corners_mm()
        x, y, disparity = rig.project_px(np.concatenate([corners, _feet(corners, table_z_mm)]))
        laid = x - (disparity - np.column_stack([x, y, np.ones_like(x)]) @ table)
        both = np.concatenate([np.column_stack([x, y]), np.column_stack([laid, y])])
        around = (both[:, None] + _SILHOUETTE_MARGIN_PX * _RING).reshape(-1, 2)
        polygons.append(cv2.convexHull(around.astype(np.float32)).reshape(-1, 2).astype(np.float64))
    return polygons


def _feet(corners_mm: Array, table_z_mm: float) -> Array:
    """Return the points of the table under corners."""
    feet: Array = corners_mm * (1.0, 1.0, 0.0) + (0.0, 0.0, table_z_mm)
    return feet


def outline_px(surface: Surface, rig: RectifiedRig) -> NDArray[np.float32]:
    """Return the outline of a surface in the left image, shape (N, 2)."""
    return _pictures(surface.outline_mm, rig)[0]


def rising_test(
    tops: list[Top], relief: Relief, rig: RectifiedRig, table_z_mm: float
) -> Callable[[NDArray[np.float32]], bool]:
    """Return whether a good part of an outline rises that surely known tops do not explain, as a function.

    Outlines are in the left image, float32, shape (N, 2).
    """
    sure = [top for top in tops if top.fit.rms_px <= SURE_RMS_PX]
    rising = unexplained(relief, explained_polygons(sure, rig, table_z_mm))
    return lambda outline: rising_share(rising, outline) >= _LEAST_RISING


def on_tops(tops: list[Top], rig: RectifiedRig) -> Callable[[NDArray[np.float32]], bool]:
    """Return whether the middle of an outline, float32, shape (N, 2), lies on a surely known top, as a function."""
    sure = [top for top in tops if top.fit.rms_px <= SURE_RMS_PX]
    polygons = [_pictures(top.fit.face.corners_mm(), rig)[0] for top in sure]

    def on_top(outline: NDArray[np.float32]) -> bool:
        x, y = outline.mean(axis=0)
        return any(cv2.pointPolygonTest(polygon, (float(x), float(y)), measureDist=False) > 0 for polygon in polygons)

    return on_top
