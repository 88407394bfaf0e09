"""What ``truth.json`` of a rendered scene says: disparities, outlines, and how well an object's place can be known."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from srvs_cell.vision import StereoView
    from srvs_cell.vision.rectification import RectifiedRig

    Array = NDArray[np.float64]

BAND_PX = 3
"""The blurred border of a face lies within this."""
_HALF_SOBEL = np.array([[-0.5, 0.0, 0.5]])
_NOISE_ALONE = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]) / 6.0
"""White noise keeps its variance, a grey value that changes linearly vanishes (Immerkaer 1996)."""
_MAD_TO_SIGMA = 1.4826
_ROUNDING_VARIANCE = 1.0 / 12.0
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


def position_bound_mm(one: dict[str, Any], left: NDArray[np.uint8], view: StereoView) -> float:
    """Return the Cramer-Rao bound of an object's position: the least rms 3-D error of any unbiased estimate.

    The face and a band around its border are displaced by (u, v) in both images and by the disparity between them: a
    constant one for an upright object, whose face is known to be level, else a x + b y + c. Noise is white, of one
    standard deviation, in both images. What it adds to the squared slopes of the left image, which stand for the true
    ones, is taken off; what is left is too little where the face hardly shows, and the bound then infinite, as it is
    where the picture shows nothing of the face.

    Args:
        one: the object, an entry of ``truth.json``.
        left: the left image as it was taken, uint8, shape (H, W).
        view: calibration and poses, both exact.
    """
    camera_T_base = (view.base_T_tcp_left @ view.calibration.tcp_T_camera).inverse()
    lens = (view.calibration.camera_matrix, view.calibration.distortion)
    outline, _ = cv2.projectPoints(camera_T_base.apply(top_outline_mm(one)), np.zeros(3), np.zeros(3), *lens)
    face = np.zeros(left.shape, np.uint8)
    cv2.fillPoly(face, [np.rint(outline).astype(np.int32)], 1)
    square = np.ones((2 * BAND_PX + 1, 2 * BAND_PX + 1), np.uint8)
    grey = left.astype(np.float64)
    inside = cv2.erode(face, square) > 0
    if not inside.any():
        return float("inf")
    noise2 = (_MAD_TO_SIGMA * np.median(np.abs(cv2.filter2D(grey, -1, _NOISE_ALONE)[inside]))) ** 2
    noise2 = max(float(noise2), _ROUNDING_VARIANCE)
    rows, columns = np.nonzero(cv2.dilate(face, square))
    along, down = (cv2.filter2D(grey, -1, kernel)[rows, columns] for kernel in (_HALF_SOBEL, _HALF_SOBEL.T))
    shape = np.ones((1, rows.size))
    if one["kind"] == "wedge":
        shape = np.stack([shape[0], columns - columns.mean(), rows - rows.mean()])
    # derivatives of the left and of the right grey value by u, v and the disparity's parameters, by slope
    by_along = np.vstack([np.ones(rows.size), np.zeros(rows.size), shape])
    by_down = np.vstack([np.zeros(rows.size), np.ones(rows.size), np.zeros_like(shape)])
    information = np.zeros((len(by_along), len(by_along)))
    for sees_disparity in (0.0, -1.0):
        from_along = by_along * np.append([1.0, 1.0], np.full(len(shape), sees_disparity))[:, None]
        jacobian = from_along * along + by_down * down
        # a central difference halves the noise's variance
        by_noise = 0.5 * noise2 * (from_along @ from_along.T + by_down @ by_down.T)
        information += (jacobian @ jacobian.T - by_noise) / noise2
    if np.linalg.eigvalsh(information).min() <= 0.0:
        return float("inf")
    base_T_cameras = (view.base_T_tcp_left, view.base_T_tcp_right)
    baseline_mm = np.linalg.norm(np.subtract(*(pose.translation_mm for pose in base_T_cameras)))
    place = camera_T_base.apply(np.array(one["position_mm"]))
    f_px = view.calibration.camera.fx
    by_pixel = np.eye(3)[:, :2] * place[2] / f_px
    by_disparity = -place[:, None] * place[2] / (f_px * baseline_mm)
    by_parameter = np.hstack([by_pixel, by_disparity])
    covariance = by_parameter @ np.linalg.inv(information)[:3, :3] @ by_parameter.T
    return float(np.sqrt(np.trace(covariance)))
