"""Lateral stereo: the paper's equations (2) to (9), and matched planes placed in the base frame.

The paper's frame. Its image is inverted and its z counts from the image plane, with the lens at z = f: with the modern
camera (Z forward) Z = z_P - f and x_L = -f X/Z. Its x runs against the motion, so that it is the modern frame turned
by 180 degrees about the optical axis; then inverted image coordinates run like pixels. All lengths, those in the image
too, are in one unit: `image_coordinates_mm` turns pixels into millimetres on a sensor of any pixel pitch.

The paper's slip. In (3) x_R is written in the *left* image's frame (x_R + b), in (4) to (6) it is in the right image's
own frame. Only the latter gives, with k = (f - z_P)/f, x_P = k x_L and x_P + b = k x_R, hence k = b/(x_R - x_L) and
(4) to (6). Here x_R is in the right image's own frame throughout.

`equation_2` to `equations_7_8_9` are the paper's reference: the steps, those of faithful mode too, triangulate by
`RectifiedRig.points_mm`, and the tests hold that against these equations, to which it is equal.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.geometry import Array, Transform, axis_rotation
from srvs_cell.scene import Surface

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from srvs_cell.scene import PlaneImage, PlaneMatch, Point2
    from srvs_cell.vision.rectification import RectifiedRig

PIXEL_SIGMA_PX = 0.3
"""Standard deviation of a region's centre in the image: the region's border is found to about half a pixel."""


def equation_2(x_P: Array, y_P: Array, z_P: Array, f: float) -> tuple[Array, Array]:
    """Return (x_L, y_L): x_P / x_L = y_P / y_L = (f - z_P) / f."""
    k = (f - z_P) / f
    return x_P / k, y_P / k


def equation_3(x_P: Array, y_P: Array, z_P: Array, f: float, b: float) -> tuple[Array, Array]:
    """Return (x_R, y_R) in the right image's own frame: (x_P + b) / x_R = y_P / y_R = (f - z_P) / f."""
    k = (f - z_P) / f
    return (x_P + b) / k, y_P / k


def equation_4(x_L: Array, x_R: Array, b: float) -> Array:
    """Return x_P = b x_L / (x_R - x_L)."""
    return b * x_L / (x_R - x_L)


def equation_5(y_L: Array, x_L: Array, x_R: Array, b: float) -> Array:
    """Return y_P = b y_L / (x_R - x_L)."""
    return b * y_L / (x_R - x_L)


def equation_6(x_L: Array, x_R: Array, f: float, b: float) -> Array:
    """Return z_P = f (x_R - x_L - b) / (x_R - x_L)."""
    return f * (x_R - x_L - b) / (x_R - x_L)


def equations_7_8_9(x_L: Array, y_L: Array, x_R: Array, f: float, b: float, T_R_C: Array) -> tuple[Array, Array, Array]:
    """Return (x_PR, y_PR, z_PR), the point in the robot's base frame.

    Each is ``1/(x_R - x_L) [b (N x_L + O y_L) + f A (x_R - x_L - b)] + X_co`` with its row of N, O, A and X_co.

    Args:
        x_L: image coordinate in the left image, millimetres, any shape.
        y_L: the same, across the base line.
        x_R: image coordinate in the right image's own frame.
        f: focal length, millimetres.
        b: length of the base line, millimetres.
        T_R_C: 4x4 matrix of equation (1), with the columns N, O, A and (X_co, Y_co, Z_co); see `paper_transform`.
    """
    disparity = x_R - x_L
    rows = [
        (b * (n * x_L + o * y_L) + f * a * (disparity - b)) / disparity + origin_mm for n, o, a, origin_mm in T_R_C[:3]
    ]
    return rows[0], rows[1], rows[2]


def paper_transform(rig: RectifiedRig, f: float) -> Array:
    """Return the T_R^C of equation (1) that belongs to a rectified left camera: 4x4, millimetres.

    The paper's camera frame is the modern one turned by 180 degrees about the optical axis, with its origin in the
    (inverted) image plane, a focal length behind the lens.

    Args:
        rig: the rectified cameras.
        f: focal length in millimetres.
    """
    camera_T_paper = Transform.from_parts("camera_left", "paper", axis_rotation("z", 180.0), (0.0, 0.0, -f))
    return (rig.base_T_camera @ camera_T_paper).matrix


def image_coordinates_mm(rig: RectifiedRig, x_px: Array, y_px: Array, pixel_pitch_mm: float) -> tuple[Array, Array]:
    """Return the paper's image coordinates of pixels: from the principal point, on a sensor of that pixel pitch."""
    return (x_px - rig.cx_px) * pixel_pitch_mm, (y_px - rig.cy_px) * pixel_pitch_mm


def surfaces_from_matches(left: PlaneImage, matches: Iterable[PlaneMatch], rig: RectifiedRig) -> tuple[Surface, ...]:
    """Place each matched plane in the base frame by its disparity plane.

    Args:
        left: planes of the rectified left image.
        matches: matched planes with their disparity planes.
        rig: the rectified cameras.

    Returns:
        The surfaces, in the order of the matches. A match whose disparity is not positive all over its outline has no
        place in front of the cameras and gives none.
    """
    planes = {plane.id: plane for plane in left.planes}
    surfaces = []
    for match in matches:
        plane = planes[match.left]
        x, y, width, height = plane.box_px
        border = mask_outline_px(left.labels[y : y + height, x : x + width] == plane.id, (x, y))
        surface = place_surface(border, plane.centre_px, match, rig, systematic=False)
        if surface is not None:
            surfaces.append(surface)
    if not surfaces:
        return ()
    covariances = rig.error_budget.covariance_mm2(
        [surface.centre_mm for surface in surfaces],
        sigma_x_px=PIXEL_SIGMA_PX,
        sigma_d_px=[surface.match.disparity_sigma_px for surface in surfaces],
    )
    return tuple(
        replace(surface, covariance_mm2=covariance) for surface, covariance in zip(surfaces, covariances, strict=True)
    )


def mask_outline_px(mask: NDArray[np.bool_], corner_px: tuple[int, int]) -> Array:
    """Return the outer boundary of a region along its pixels' outer edges, shape (N, 2).

    Args:
        mask: the region, bool, shape (h, w).
        corner_px: (x, y) of the mask's first pixel in the image.
    """
    # doubled, so that the contour's pixel centres come to lie on quarter pixels near the outer edges
    doubled = cv2.resize(mask.view(np.uint8), None, fx=2.0, fy=2.0, interpolation=cv2.INTER_NEAREST)
    contours, _ = cv2.findContours(doubled, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outer = max(contours, key=len).reshape(-1, 2).astype(np.float64)
    return np.asarray(outer / 2.0 - 0.25 + corner_px, dtype=np.float64)


def place_surface(
    border_px: Array, centre_px: Point2, match: PlaneMatch, rig: RectifiedRig, *, systematic: bool = True
) -> Surface | None:
    """Place a region of the left image in the base frame by a disparity plane.

    Args:
        border_px: its boundary, shape (N, 2).
        centre_px: its centre.
        match: the match with the disparity plane.
        rig: the rectified cameras.
        systematic: whether the covariance has the part of calibration and poses, which takes a while to find.

    Returns:
        The surface, or None where its disparity is not positive all over.
    """
    a, b, c = match.disparity_plane
    disparity = border_px @ (a, b) + c
    centre = np.array(centre_px)
    centre_disparity = float(centre @ (a, b) + c)
    if min(float(disparity.min()), centre_disparity) <= 0.0:
        return None
    centre_mm = rig.points_mm(centre[:1], centre[1:], np.array([centre_disparity]))[0]
    if systematic:
        covariance = rig.error_budget.covariance_mm2(
            centre_mm, sigma_x_px=PIXEL_SIGMA_PX, sigma_d_px=match.disparity_sigma_px
        )
    else:
        covariance = _measured_mm2(centre, centre_disparity, match.disparity_sigma_px, rig)
    return Surface(
        id=match.left,
        centre_mm=_point(centre_mm),
        normal=_point(_normal(rig, match)),
        outline_mm=rig.points_mm(border_px[:, 0], border_px[:, 1], disparity),
        covariance_mm2=covariance,
        match=match,
    )


def _measured_mm2(centre_px: Array, disparity_px: float, disparity_sigma_px: float, rig: RectifiedRig) -> Array:
    """Return the covariance of a point that its pixel and disparity alone cause, base frame, 3x3."""
    ray = np.array([centre_px[0] - rig.cx_px, centre_px[1] - rig.cy_px, rig.f_px])
    by_pixel = np.eye(3)[:, :2] * PIXEL_SIGMA_PX
    by_disparity = -ray[:, None] / disparity_px * disparity_sigma_px
    jacobian = rig.base_T_camera.rotation @ np.hstack([by_pixel, by_disparity]) * (rig.baseline_mm / disparity_px)
    return np.asarray(jacobian @ jacobian.T, dtype=np.float64)


def _normal(rig: RectifiedRig, match: PlaneMatch) -> Array:
    """Return the unit normal towards the camera: n . P = 1 has d = b (n_x (x - cx) + n_y (y - cy) + n_z f)."""
    a, b, c = match.disparity_plane
    in_camera = np.array([a, b, (c + a * rig.cx_px + b * rig.cy_px) / rig.f_px])
    # n . P is positive for what the camera sees, so that n points away from it
    normal: Array = rig.base_T_camera.rotate(-in_camera / np.linalg.norm(in_camera))
    return normal


def _point(values: Array) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
