"""Step 11h: workpieces from top faces: place, size, covariance and grasp of what is one object.

An object of one face has the place of that face. An object of several faces has the place of the least rectangle
around all of them, seen from above, at the height of its highest point.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.scene import UNKNOWN_KIND, Workpiece
from srvs_cell.vision.faces.face import Face, Figure
from srvs_cell.vision.recognition.brightness import face_brightness
from srvs_cell.vision.recognition.grasping import plan_grasp, plan_joint_grasp
from srvs_cell.vision.recognition.top_faces import SURE_RMS_PX, height_above_mm

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.calibration import TableReference
    from srvs_cell.geometry import Array
    from srvs_cell.scene import Point3, Surface
    from srvs_cell.vision.recognition.grasping import GraspParameters
    from srvs_cell.vision.recognition.kind_matching import FaceGroup
    from srvs_cell.vision.recognition.tops import Top
    from srvs_cell.vision.rectification import RectifiedRig

IN_NO_LIBRARY = "its shape is in no library"
CUT_OFF = "the picture's border cuts it off"
_HALF_TURN_DEG = 180.0
_DOUBT_FACTOR = 6.0
"""Standard deviation that an edge misfit of a pixel more than the sure one adds, pixels."""
_LEAST_SIGMA_PX = 0.08
"""No face is known better across the line of sight, however many pixels tell of it: what they share (how a border is
sampled, what the model of it leaves out) does not average out."""


@dataclass(frozen=True, eq=False)
class MeasuredFace:
    """A top face with its place corrected by the table, and what is known of the place.

    Attributes:
        face: its long side is its length.
        covariance_mm2: 3x3 of its centre, random and systematic.
        systematic_mm2: the systematic part of it.
        surfaces: ids of the surfaces that belong to its object.
        brightness: its grey value in the left image, 0 to 255; None where it was not measured.
    """

    face: Face
    covariance_mm2: Array
    systematic_mm2: Array
    surfaces: tuple[int, ...]
    brightness: float | None


def measure_face(
    top: Top, grey: NDArray[np.uint8], rig: RectifiedRig, reference: TableReference | None
) -> MeasuredFace:
    """Return the face of a top, corrected where the table told how."""
    face = _long_side_first(top.fit.face)
    (x_mm, y_mm, z_mm), systematic_mm2 = _corrected_point((face.x_mm, face.y_mm, face.z_mm), rig, reference)
    face = replace(face, x_mm=x_mm, y_mm=y_mm, z_mm=z_mm)
    mm_per_px = (rig.base_T_camera.translation_mm[2] - face.z_mm) / rig.f_px
    # edges that do not fit are another face's or a shadow's, and may have moved a side by some times their misfit
    doubt_mm = _DOUBT_FACTOR * max(0.0, top.fit.rms_px - SURE_RMS_PX) * float(mm_per_px)
    doubt_mm2 = doubt_mm**2 + (_LEAST_SIGMA_PX * float(mm_per_px)) ** 2
    covariance_mm2 = top.fit.covariance_mm2 + systematic_mm2 + np.eye(3) * doubt_mm2
    brightness = face_brightness(top.fit.face.corners_mm(), grey, rig)
    return MeasuredFace(face, covariance_mm2, systematic_mm2, top.surfaces, brightness)


def corrected(surface: Surface, rig: RectifiedRig, reference: TableReference | None) -> tuple[Surface, Array]:
    """Return a surface that was placed without systematic errors, corrected and as unsure as those make it, and them.

    Args:
        surface: its covariance is random alone.
        rig: the rectified cameras.
        reference: corrects what calibration and poses misplace; None corrects nothing.

    Returns:
        The surface, and the systematic part of its covariance, 3x3.
    """
    centre_mm, systematic_mm2 = _corrected_point(surface.centre_mm, rig, reference)
    moved = replace(
        surface,
        centre_mm=centre_mm,
        outline_mm=surface.outline_mm + np.subtract(centre_mm, surface.centre_mm),
        covariance_mm2=surface.covariance_mm2 + systematic_mm2,
    )
    return moved, systematic_mm2


def make_workpiece(
    group: FaceGroup, faces: Sequence[MeasuredFace], table_z_mm: float, parameters: GraspParameters
) -> Workpiece:
    """Return one object.

    Args:
        group: which of the faces it has, and its kind.
        faces: all top faces.
        table_z_mm: height of the table, base frame.
        parameters: what the gripper can take.
    """
    members = [faces[number] for number in group.members]
    body = members[0].face if len(members) == 1 else _around([one.face for one in members])
    corners = np.concatenate([one.face.corners_mm() for one in members])
    footprint = corners[:, :2] if len(members) == 1 else _hull(corners)
    # the faces of an object share their errors but for the edges' noise: the least sure one speaks for all
    unsure = max(members, key=lambda one: float(np.trace(one.covariance_mm2)))
    covariance = unsure.covariance_mm2
    if group.kind is None:
        grasp, refusal = None, IN_NO_LIBRARY
    elif len(members) == 1:
        grasp, refusal = plan_grasp(body, covariance, table_z_mm, parameters)
    else:
        grasp, refusal = plan_joint_grasp(body, [one.face for one in members], covariance, table_z_mm, parameters)
    return Workpiece(
        id=0,
        kind=UNKNOWN_KIND if group.kind is None else group.kind.name,
        position_mm=(body.x_mm, body.y_mm, body.z_mm),
        height_mm=max(height_above_mm(one.face, table_z_mm) for one in members),
        yaw_deg=float(np.rad2deg(body.angle_rad)) % _HALF_TURN_DEG if body.figure is Figure.RECTANGLE else None,
        size_mm=(body.length_mm, body.width_mm),
        covariance_mm2=covariance,
        footprint_mm=footprint,
        surfaces=tuple(surface for one in members for surface in one.surfaces),
        grasp=grasp,
        grasp_refusal=refusal,
        rise_deg=body.rise_deg,
        brightness=max(members, key=lambda one: one.face.length_mm * one.face.width_mm).brightness,
        systematic_mm2=unsure.systematic_mm2,
    )


def unrecognised(
    surface: Surface,
    systematic_mm2: Array,
    surfaces: tuple[int, ...],
    table_z_mm: float,
    brightness: float | None,
    refusal: str,
) -> Workpiece:
    """Return what stands there where a surface is no top face that could be measured.

    Args:
        surface: what is seen of it.
        systematic_mm2: the systematic part of its covariance, 3x3.
        surfaces: ids of the matched surfaces that belong to it.
        table_z_mm: height of the table, base frame.
        brightness: its grey value in the left image; None where it was not measured.
        refusal: why there is no grasp.
    """
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
        surfaces=surfaces,
        grasp=None,
        grasp_refusal=refusal,
        brightness=brightness,
        systematic_mm2=systematic_mm2,
    )


def _corrected_point(point_mm: Point3, rig: RectifiedRig, reference: TableReference | None) -> tuple[Point3, Array]:
    """Return where the table puts a point, and what calibration and poses make it unsure by, 3x3."""
    if reference is None:
        return point_mm, rig.error_budget.systematic_mm2(point_mm)
    correction_mm, systematic_mm2 = reference.at(point_mm)
    x_mm, y_mm, z_mm = (float(value) for value in np.array(point_mm) + correction_mm)
    return (x_mm, y_mm, z_mm), systematic_mm2


def _long_side_first(face: Face) -> Face:
    if face.figure is not Figure.RECTANGLE or face.length_mm >= face.width_mm:
        return face
    return face.quarter_turned()


def _around(faces: Sequence[Face]) -> Face:
    """Return the least rectangle around faces, seen from above, at the height of their highest point."""
    corners = np.concatenate([face.corners_mm() for face in faces])
    # whole millimetres of the base frame would cost the last digits of single precision
    origin = corners[:, :2].mean(axis=0)
    (x_mm, y_mm), (length_mm, width_mm), angle_deg = cv2.minAreaRect((corners[:, :2] - origin).astype(np.float32))
    return _long_side_first(
        Face(
            Figure.RECTANGLE,
            float(origin[0] + x_mm),
            float(origin[1] + y_mm),
            float(corners[:, 2].max()),
            float(np.deg2rad(angle_deg)),
            float(length_mm),
            float(width_mm),
        )
    )


def _hull(corners_mm: Array) -> Array:
    hull: Array = cv2.convexHull(corners_mm[:, :2].astype(np.float32)).reshape(-1, 2).astype(np.float64)
    return hull
