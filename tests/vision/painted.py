"""A painter of simple scenes: parts over a table, seen by a rectified rig, with sub-pixel edges and no renderer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.geometry import Transform, Xyzwpr
from srvs_cell.scene import Plane, PlaneImage, PlaneMatch
from srvs_cell.vision.faces.face import HEXAGON_RATIO, Face, Figure
from srvs_cell.vision.rectification import RectifiedRig

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array

SIZE = (640, 480)
TABLE_Z_MM = 5.0
TABLE_GREY = 110
SHADOW_GREY = 65
_SUPER = 4


def rig(tilt_deg: float = 3.0, yaw_deg: float = 35.0) -> RectifiedRig:
    pose = Xyzwpr(500.0, 50.0, 500.0, 180.0 - tilt_deg, 1.5, yaw_deg)
    return RectifiedRig(800.0, 321.0, 238.0, 30.0, Transform.from_xyzwpr("base", "camera_left", pose))


@dataclass(frozen=True)
class Part:
    """A part on the table: its top face and grey values."""

    kind: str
    face: Face
    top_grey: int
    side_grey: int


def cuboid(x_mm: float, y_mm: float, height_mm: float, yaw_deg: float, size_mm: tuple[float, float], grey: int) -> Part:
    face = Face(Figure.RECTANGLE, x_mm, y_mm, TABLE_Z_MM + height_mm, float(np.deg2rad(yaw_deg)), *size_mm)
    return Part("cuboid", face, grey, grey // 2)


def wedge(
    x_mm: float, y_mm: float, low_mm: float, high_mm: float, yaw_deg: float, size_mm: tuple[float, float], grey: int
) -> Part:
    z_mm = TABLE_Z_MM + (low_mm + high_mm) / 2.0
    slope = (high_mm - low_mm) / size_mm[0]
    face = Face(Figure.RECTANGLE, x_mm, y_mm, z_mm, float(np.deg2rad(yaw_deg)), *size_mm, slope)
    return Part("wedge", face, grey, grey // 2)


def cylinder(x_mm: float, y_mm: float, height_mm: float, diameter_mm: float, grey: int) -> Part:
    face = Face(Figure.CIRCLE, x_mm, y_mm, TABLE_Z_MM + height_mm, 0.0, diameter_mm, diameter_mm)
    return Part("cylinder", face, grey, grey // 2)


def prism(x_mm: float, y_mm: float, height_mm: float, corner_deg: float, across_mm: float, grey: int) -> Part:
    angle = float(np.deg2rad(corner_deg))
    width = across_mm * HEXAGON_RATIO
    face = Face(Figure.HEXAGON, x_mm, y_mm, TABLE_Z_MM + height_mm, angle, across_mm, width)
    return Part("prism", face, grey, grey // 2)


def outline_mm(part: Part) -> Array:
    if part.face.figure is Figure.CIRCLE:
        turn = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
        return part.face.place(np.column_stack([np.cos(turn), np.sin(turn)]))
    return part.face.corners_mm()


def shadow_mm(part: Part, lamp_mm: tuple[float, float, float]) -> Array:
    """Return the outline of a part's foot and shadow on the table."""
    top, lamp = outline_mm(part), np.array(lamp_mm)
    thrown = lamp + (top - lamp) * ((lamp[2] - TABLE_Z_MM) / (lamp[2] - top[:, 2]))[:, None]
    flat = np.concatenate([top, thrown])[:, :2].astype(np.float32)
    hull = cv2.convexHull(flat).reshape(-1, 2).astype(np.float64)
    return np.column_stack([hull, np.full(len(hull), TABLE_Z_MM)])


def paint(
    parts: list[Part],
    seen_by: RectifiedRig,
    *,
    noise: float = 1.0,
    seed: int = 0,
    lamp_mm: tuple[float, float, float] | None = None,
) -> list[NDArray[np.uint8]]:
    """Paint the left and the right image: side faces first, far parts first, then a little blur and noise.

    A lamp at a place in the base frame throws shadows on the table.
    """
    rng = np.random.default_rng(seed)
    images = []
    for side in (0.0, 1.0):
        canvas = np.full((SIZE[1] * _SUPER, SIZE[0] * _SUPER), float(TABLE_GREY), np.float32)
        for part in parts:
            if lamp_mm is not None:
                _fill(canvas, seen_by, shadow_mm(part, lamp_mm), side, SHADOW_GREY)
        for part in parts:
            top = outline_mm(part)
            foot = top * (1.0, 1.0, 0.0) + (0.0, 0.0, TABLE_Z_MM)
            for index in range(len(top)):
                after = (index + 1) % len(top)
                _fill(
                    canvas, seen_by, np.array([top[index], top[after], foot[after], foot[index]]), side, part.side_grey
                )
            _fill(canvas, seen_by, top, side, part.top_grey)
        image = cv2.GaussianBlur(cv2.resize(canvas, SIZE, interpolation=cv2.INTER_AREA), (0, 0), 0.7)
        images.append(np.clip(np.rint(image + rng.normal(0.0, noise, image.shape)), 0, 255).astype(np.uint8))
    return images


def planes(
    parts: list[Part],
    seen_by: RectifiedRig,
    images: list[NDArray[np.uint8]],
    *,
    disparity_noise_px: float,
    seed: int = 0,
) -> tuple[PlaneImage, PlaneImage, list[PlaneMatch]]:
    """Return what a plane matcher would give: eroded top faces and noisy disparity planes."""
    rng = np.random.default_rng(seed)
    labels = np.zeros((2, SIZE[1], SIZE[0]), np.int32)
    found: tuple[list[Plane], list[Plane]] = ([], [])
    matches = []
    for number, part in enumerate(parts, start=1):
        for side in (0, 1):
            mask = np.zeros((SIZE[1], SIZE[0]), np.uint8)
            pixels = np.rint(_pixels(seen_by, outline_mm(part), float(side))).astype(np.int32)
            cv2.fillPoly(mask, [pixels], 1)
            mask = np.asarray(cv2.erode(mask, np.ones((3, 3), np.uint8)), dtype=np.uint8)
            labels[side][mask > 0] = number
            found[side].append(_plane(number, mask, part.top_grey))
        x, y = found[0][-1].centre_px
        normal = np.array(
            [-part.face.slope_u * np.cos(part.face.angle_rad), -part.face.slope_u * np.sin(part.face.angle_rad), 1.0]
        )
        centre = np.array([part.face.x_mm, part.face.y_mm, part.face.z_mm])
        a, b, c = seen_by.plane_disparity(normal, float(normal @ centre))
        shift = float(rng.normal(0.0, disparity_noise_px))
        matches.append(PlaneMatch(number, number, 0.9, a * x + b * y + c + shift, (a, b, c + shift), 0.5))
    left, right = (PlaneImage(images[side], labels[side], tuple(found[side])) for side in (0, 1))
    return left, right, matches


def _pixels(seen_by: RectifiedRig, points_mm: Array, side: float) -> Array:
    x, y, disparity = seen_by.project_px(points_mm)
    return np.column_stack([x - side * disparity, y])


def _fill(canvas: NDArray[np.float32], seen_by: RectifiedRig, points_mm: Array, side: float, grey: int) -> None:
    # pixel centres lie on whole numbers: the finer grid is shifted by half a coarse less half a fine pixel
    fine = (_pixels(seen_by, points_mm, side) + 0.5) * _SUPER - 0.5
    cv2.fillPoly(canvas, [np.rint(fine * 16.0).astype(np.int32)], float(grey), cv2.LINE_8, 4)


def _plane(number: int, mask: NDArray[np.uint8], grey: int) -> Plane:
    rows, columns = np.nonzero(mask)
    x, y, width, height = cv2.boundingRect(mask)
    centre = (float(columns.mean()), float(rows.mean()))
    return Plane(number, centre, float(rows.size), 1.0, 1.0, 1.0, float(grey), (x, y, width, height), False)
