"""The true disparity of every pixel of a rendered scene's rectified left image, painted from ``truth.json``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from srvs_cell.vision.rectification import RectifiedRig

    Array = NDArray[np.float64]

CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
ROUND = 72


def true_disparity(
    objects: Iterable[dict[str, Any]], table_z_mm: float, rig: RectifiedRig, shape: tuple[int, int]
) -> Array:
    """Return the disparity map, shape (H, W): table, top faces and side faces, the nearest of them.

    The truth does not say how a prism is turned about its axis; it is painted as the cylinder between its corners and
    its flats, so that its sides are right to a few pixels only.
    """
    up = np.array([0.0, 0.0, 1.0])
    rows, columns = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    a, b, c = rig.plane_disparity(up, table_z_mm)
    disparity: Array = a * columns + b * rows + c
    for one in objects:
        top = top_outline_mm(one)
        foot = top * (1.0, 1.0, 0.0) + (0.0, 0.0, table_z_mm)
        faces = [top]
        for index in range(len(top)):
            after = (index + 1) % len(top)
            faces.append(np.array([top[index], top[after], foot[after], foot[index]]))
        for face in faces:
            _paint(disparity, face, rig)
    return disparity


def top_outline_mm(one: dict[str, Any]) -> Array:
    """Return the corners of an object's top face in the base frame, shape (N, 3)."""
    centre = np.array(one["position_mm"])
    length, width = one["size_mm"]
    if one["yaw_deg"] is None:
        turn = np.linspace(0.0, 2.0 * np.pi, ROUND, endpoint=False)
        outline = 0.25 * (length + width) * np.column_stack([np.cos(turn), np.sin(turn)])
    else:
        yaw = np.deg2rad(one["yaw_deg"])
        turned = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        outline = (CORNERS * (length, width)) @ turned
    normal = np.array(one["face_normal"])
    rise = -(outline @ normal[:2]) / normal[2]
    return np.asarray(centre + np.column_stack([outline, rise]), dtype=np.float64)


def _paint(disparity: Array, face_mm: Array, rig: RectifiedRig) -> None:
    """Enter one flat face where it is nearer than what is there."""
    x, y, d = rig.project_px(face_mm)
    plane = _plane_through(np.column_stack([x, y]), d)
    if plane is None:
        return
    mask = np.zeros(disparity.shape, np.uint8)
    cv2.fillPoly(mask, [np.rint(np.column_stack([x, y]) * 16.0).astype(np.int32)], 1, cv2.LINE_8, 4)
    rows, columns = np.nonzero(mask)
    value = np.column_stack([columns, rows, np.ones_like(rows)]) @ plane
    # a face seen edge on has no use for its plane beyond its corners
    value = np.clip(value, d.min(), d.max())
    disparity[rows, columns] = np.maximum(disparity[rows, columns], value)


def _plane_through(points_px: Array, d: Array) -> Array | None:
    if np.linalg.matrix_rank(points_px - points_px.mean(axis=0), tol=0.1) < 2:
        return None
    design = np.column_stack([points_px, np.ones(len(d))])
    return np.asarray(np.linalg.lstsq(design, d, rcond=None)[0], dtype=np.float64)


def depth_mm(rig: RectifiedRig, disparity_px: Array | Sequence[float]) -> Array:
    """Return the distance along the optical axis."""
    return np.asarray(rig.f_px * rig.baseline_mm / np.asarray(disparity_px), dtype=np.float64)
