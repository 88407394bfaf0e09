"""Step 11b: the grey values across the outline of a face, and what a model of them expects.

Across the border of a top face the grey value goes from that of the face to that of its side face, as far as this is
seen, and on to that of what lies behind. The width of the visible side face follows from the face's height over the
table, so that a sliver of a pixel is told from the face itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.special import ndtr

from srvs_cell.vision.outlines import outward_normals

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.outlines import Outlines
    from srvs_cell.vision.rectification import RectifiedRig

GROUPS = 12
"""Stretches of an outline that have grey levels of their own: three of a rectangle's side, two of a hexagon's."""
LEVELS = 5
"""Levels of a stretch: face and background in the left image, the same in the right one, side face in both."""
USUAL_BLUR_PX = 0.85
_OFFSETS_PX = np.arange(-4.0, 3.5, 1.0)
"""Where a profile is read, outwards from the border. Farther out the edge of a shadow would often be met."""
_SEEN = 3
LEVELS_SEEN = ((0, 1, 4), (2, 3, 4))
"""Which of the levels the left and the right image show: face, background, side face."""
_MIN_SIGMA = 0.5
_MAD = 1.4826
_BEND = float(np.sqrt(6.0))
"""Standard deviation of a second difference over that of its values."""
_PEAK = 1.0 / float(np.sqrt(2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class Pictures:
    """Both rectified images as the fit needs them.

    Attributes:
        images: left and right, float32, shape (H, W).
        noise: standard deviation of the grey values.
        blur_px: standard deviation of the picture of a sharp border: lens, pixel and rectification.
    """

    images: tuple[NDArray[np.float32], NDArray[np.float32]]
    noise: float
    blur_px: float = USUAL_BLUR_PX

    @classmethod
    def of(cls, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Pictures:
        """Take two rectified images and measure their noise by second differences along the rows."""
        images = (left.astype(np.float32), right.astype(np.float32))
        bends = [np.abs(image[:, :-2] - 2.0 * image[:, 1:-1] + image[:, 2:]) for image in images]
        noise = max(float(np.median(bend)) * _MAD / _BEND for bend in bends)
        return cls(images, max(noise, _MIN_SIGMA))


@dataclass(frozen=True, eq=False)
class Profiles:
    """The profiles of B faces: G stretches of M values in each of both images, by sample and offset.

    Each image shows three grey levels of a stretch, `LEVELS_SEEN`. Values are float32: twice as many pass at a time.

    Attributes:
        grey: what was seen, shape (B, G, 2, M).
        weights: 0 outside of the image; less than 1 where samples lie closer than a pixel, shape (B, G, 2, M).
        by_level: what the model expects, by each of the three grey levels, shape (B, G, 2, 3, M).
        slopes: how that changes with the border's place, grey values per pixel outwards, the same shape.
        by_parameter: how far the border at each of S samples moves outwards with the face's seven parameters, pixels,
            shape (B, G, 2, S, 7).
    """

    grey: NDArray[np.float32]
    weights: NDArray[np.float32]
    by_level: NDArray[np.float32]
    slopes: NDArray[np.float32]
    by_parameter: Array

    def per_sample(self, values: NDArray[np.float32]) -> Array:
        """Return values of shape (..., M) summed over the offsets of each profile, shape (..., S)."""
        samples = self.by_parameter.shape[3]
        return np.asarray(values.reshape(*values.shape[:-1], samples, -1).sum(axis=-1), dtype=np.float64)


def read_profiles(
    outlines: Outlines, pictures: Pictures, rig: RectifiedRig, table_z_mm: float, blur_px: float
) -> Profiles:
    """Read the profiles of faces in both images and predict them.

    Args:
        outlines: the faces, with a multiple of twelve samples each and as many on each side.
        pictures: the rectified images.
        rig: the rectified cameras.
        table_z_mm: height of the table, base frame: there the side faces end.
        blur_px: width of the model's borders, one standard deviation.
    """
    faces, samples = outlines.unit.shape[:2]
    per_group = samples // GROUPS
    shape = (faces, GROUPS, 2, per_group * _OFFSETS_PX.size)
    profiles = Profiles(
        np.empty(shape, dtype=np.float32),
        np.empty(shape, dtype=np.float32),
        np.empty((*shape[:3], _SEEN, shape[3]), dtype=np.float32),
        np.empty((*shape[:3], _SEEN, shape[3]), dtype=np.float32),
        np.empty((*shape[:3], per_group, outlines.values.shape[1])),
    )
    stretch = (faces, GROUPS, shape[3])
    for number, shift_mm in enumerate((0.0, rig.baseline_mm)):
        one = _read_one(outlines, pictures.images[number], shift_mm, rig, table_z_mm, blur_px)
        profiles.grey[:, :, number] = one.grey.reshape(stretch)
        profiles.weights[:, :, number] = one.weights.reshape(stretch)
        for part in range(_SEEN):
            profiles.by_level[:, :, number, part] = one.parts[part].reshape(stretch)
            profiles.slopes[:, :, number, part] = one.slopes[part].reshape(stretch)
        profiles.by_parameter[:, :, number] = one.moved.reshape(faces, GROUPS, per_group, -1)
    return profiles


@dataclass(frozen=True, eq=False)
class _Seen:
    """The profiles in one image, shape (B, N, T); ``parts`` and ``slopes`` by face, background and side face."""

    grey: NDArray[np.float32]
    weights: NDArray[np.float32]
    parts: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]
    slopes: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]
    moved: Array


def _read_one(
    outlines: Outlines,
    image: NDArray[np.float32],
    shift_mm: float,
    rig: RectifiedRig,
    table_z_mm: float,
    blur_px: float,
) -> _Seen:
    points_mm = outlines.points_mm()
    feet_mm = points_mm * (1.0, 1.0, 0.0) + (0.0, 0.0, table_z_mm)
    seen = rig.camera_T_base.apply(points_mm) - (shift_mm, 0.0, 0.0)
    pixels = _pixels(seen, rig)
    along = rig.camera_T_base.rotate(outlines.directions_mm())
    normals = outward_normals(along[..., :2] - seen[..., :2] / seen[..., 2:] * along[..., 2:], pixels)
    # as much of the side face shows as its foot lies outside of the face
    feet = _pixels(rig.camera_T_base.apply(feet_mm) - (shift_mm, 0.0, 0.0), rig)
    side_px = np.maximum(((feet - pixels) * normals).sum(axis=-1), 0.0)
    x, y = ((pixels[..., axis, None] + normals[..., axis, None] * _OFFSETS_PX).astype(np.float32) for axis in (0, 1))
    flat = (len(x), -1)
    read = cv2.remap(
        image, x.reshape(flat), y.reshape(flat), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    ).reshape(x.shape)
    inside = (x >= 0.0) & (x <= image.shape[1] - 1.0) & (y >= 0.0) & (y <= image.shape[0] - 1.0)
    spacing_px = np.median(np.linalg.norm(np.roll(pixels, -1, axis=1) - pixels, axis=-1), axis=1)
    border = (_OFFSETS_PX / blur_px).astype(np.float32)
    end = ((_OFFSETS_PX - side_px[..., None]) / blur_px).astype(np.float32)
    beyond_border, beyond_end = np.broadcast_to(ndtr(border), read.shape), ndtr(end)
    peak = np.float32(_PEAK / blur_px)
    peak_border, peak_end = np.broadcast_to(np.exp(-0.5 * border**2) * peak, read.shape), np.exp(-0.5 * end**2) * peak
    covectors = np.concatenate(
        [normals, -(normals * seen[..., :2]).sum(axis=-1, keepdims=True) / seen[..., 2:]], axis=-1
    ) * (rig.f_px / seen[..., 2:])
    return _Seen(
        np.asarray(read, dtype=np.float32),
        inside * np.minimum(spacing_px, 1.0).astype(np.float32)[:, None, None],
        (1.0 - beyond_border, beyond_end, beyond_border - beyond_end),
        (peak_border, -peak_end, peak_end - peak_border),
        outlines.change(covectors @ rig.camera_T_base.rotation),
    )


def _pixels(points_mm: Array, rig: RectifiedRig) -> Array:
    pixels: Array = points_mm[..., :2] * (rig.f_px / points_mm[..., 2:]) + (rig.cx_px, rig.cy_px)
    return pixels
