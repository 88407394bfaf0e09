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
    from srvs_cell.scene import Surface
    from srvs_cell.vision.recognition.grasping import GraspParameters
    from srvs_cell.vision.recognition.kind_matching import FaceGroup
    from srvs_cell.vision.recognition.tops import Top
    from srvs_cell.vision.rectification import RectifiedRig

IN_NO_LIBRARY = "its shape is in no library"
CUT_OFF = "the picture's border cuts it off"
_HALF_TURN_DEG = 180.0
_DOUBT_FACTOR = 6.0
"""Standard deviation that an edge misfit of a pixel more than the sure one adds, pixels."""


@dataclass(frozen=True, eq=False)
class MeasuredFace:
    """A top face with its place corrected by the table, and what is known of the place.

    Attributes:
        face: its long side is its length.
        covariance_mm2: 3x3 of its centre, random and systematic.
        surfaces: ids of the surfaces that belong to its object.
        brightness: its grey value in the left image, 0 to 255; None where it was not measured.
    """

    face: Face
    covariance_mm2: Array
    surfaces: tuple[int, ...]
    brightness: float | None


def measure_face(
    top: Top, grey: NDArray[np.uint8], rig: RectifiedRig, reference: TableReference | None
) -> MeasuredFace:
    """Return the face of a top, corrected where the table told how."""
    face = _long_side_first(top.fit.face)
    centre = (face.x_mm, face.y_mm, face.z_mm)
    if reference is None:
        systematic = rig.error_budget.systematic_mm2(centre)
    else:
        correction_mm, systematic = reference.at(centre)
        x_mm, y_mm, z_mm = (float(value) for value in centre + correction_mm)
        face = replace(face, x_mm=x_mm, y_mm=y_mm, z_mm=z_mm)
    mm_per_px = (rig.base_T_camera.translation_mm[2] - face.z_mm) / rig.f_px
    # edges that do not fit are another face's or a shadow's, and may have moved a side by some times their misfit
    doubt_mm = _DOUBT_FACTOR * max(0.0, top.fit.rms_px - SURE_RMS_PX) * float(mm_per_px)
    covariance_mm2 = top.fit.covariance_mm2 + systematic + np.eye(3) * doubt_mm**2
    return MeasuredFace(face, covariance_mm2, top.surfaces, face_brightness(top.fit.face.corners_mm(), grey, rig))


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
    covariance = max((one.covariance_mm2 for one in members), key=lambda matrix: float(np.trace(matrix)))
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
    )


def unrecognised(surface: Surface, table_z_mm: float, brightness: float | None, refusal: str) -> Workpiece:
    """Return what stands there where a surface is no top face that could be measured; ``refusal``: of a grasp."""
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
        grasp_refusal=refusal,
        brightness=brightness,
    )


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
