"""Rectified pairs of flat faces whose disparity planes are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_OVERSAMPLING = 4


@dataclass(frozen=True)
class Face:
    """A convex polygon in the left image, its grey value and its disparity plane; ``grain`` gives it texture."""

    corners_px: tuple[tuple[float, float], ...]
    grey: float
    plane: tuple[float, float, float]
    grain: float = 0.0


def square(x: float, y: float, side: float, grey: float, disparity: float, angle_deg: float = 12.0) -> Face:
    box = cv2.boxPoints(((x, y), (side, side), angle_deg))
    return Face(tuple((float(u), float(v)) for u, v in box), grey, (0.0, 0.0, disparity))


def render(
    faces: list[Face], shape: tuple[int, int] = (160, 220), background: float = 60.0, noise: float = 0.0
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Draw the left and the right image, each pixel the mean of 16 samples; later faces lie in front."""
    generator = np.random.default_rng(5)
    texture = cv2.GaussianBlur(generator.normal(size=(shape[0] * 2, shape[1] * 2)).astype(np.float32), (0, 0), 2.0)
    texture = np.asarray(texture / np.std(texture), dtype=np.float32)
    fine_y, fine_x = (np.indices((shape[0] * _OVERSAMPLING, shape[1] * _OVERSAMPLING)) + 0.5) / _OVERSAMPLING - 0.5
    pictures = []
    for right in (False, True):
        fine = np.full(fine_x.shape, background)
        for face in faces:
            a, b, c = face.plane
            # the left x of a right pixel: x_R = x_L - (a x_L + b y + c)
            x = (fine_x + b * fine_y + c) / (1.0 - a) if right else fine_x
            inside = np.ones(fine.shape, dtype=np.bool_)
            corners = np.array(face.corners_px)
            for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
                inside &= (end[0] - start[0]) * (fine_y - start[1]) - (end[1] - start[1]) * (x - start[0]) >= 0.0
            map_x, map_y = x.astype(np.float32) + 20.0, fine_y.astype(np.float32) + 20.0
            grain = cv2.remap(texture, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
            fine = np.where(inside, face.grey + face.grain * grain, fine)
        picture = fine.reshape(shape[0], _OVERSAMPLING, shape[1], _OVERSAMPLING).mean(axis=(1, 3))
        picture += generator.normal(scale=noise, size=shape) if noise else 0.0
        pictures.append(np.asarray(np.clip(np.rint(picture), 0, 255), dtype=np.uint8))
    return pictures[0], pictures[1]
