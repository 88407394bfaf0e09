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
_SIDE_LEVEL = 4
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
    """The profiles of B faces: G stretches of M values each, in the order image, sample, offset.

    Attributes:
        grey: what was seen, shape (B, G, M).
        weights: 0 outside of the image; less than 1 where samples lie closer than a pixel, shape (B, G, M).
        by_level: what the model expects, by each of the five grey levels, shape (B, G, M, 5).
        slopes: how that changes with the border's place, grey values per pixel outwards, the same shape.
        by_parameter: how far the border moves outwards with each of the face's seven parameters, pixels,
            shape (B, G, M, 7).
        samples: number of samples of a stretch in both images; M over it is the number of offsets.
    """

    grey: Array
    weights: Array
    by_level: Array
    slopes: Array
    by_parameter: Array
    samples: int

    def per_sample(self, values: Array) -> Array:
        """Return values of shape (B, G, M) summed over the offsets of each profile, shape (B, G, 2, samples / 2)."""
        faces = len(values)
        summed: Array = values.reshape(faces, GROUPS, 2, self.samples // 2, -1).sum(axis=-1)
        return summed


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
    seen = [
        _read_one(outlines, image, shift_mm, rig, table_z_mm, blur_px)
        for image, shift_mm in zip(pictures.images, (0.0, rig.baseline_mm), strict=True)
    ]
    faces, samples = outlines.unit.shape[:2]
    per_group = samples // GROUPS
    shape = (faces, GROUPS, 2, per_group, _OFFSETS_PX.size)
    by_level, slopes = np.zeros((*shape, LEVELS)), np.zeros((*shape, LEVELS))
    for number, one in enumerate(seen):
        for part, level in enumerate((2 * number, 2 * number + 1, _SIDE_LEVEL)):
            by_level[:, :, number, ..., level] = one.parts[part].reshape(faces, GROUPS, per_group, -1)
            slopes[:, :, number, ..., level] = one.slopes[part].reshape(faces, GROUPS, per_group, -1)
    flat = (faces, GROUPS, 2 * per_group * _OFFSETS_PX.size)

    def together(values: list[Array]) -> Array:
        parts = [value.reshape(faces, GROUPS, per_group, _OFFSETS_PX.size, -1) for value in values]
        stacked: Array = np.stack(parts, axis=2).reshape(*flat, -1)
        return stacked

    moved = [np.broadcast_to(one.moved[:, :, None, :], (*one.grey.shape, one.moved.shape[-1])) for one in seen]
    return Profiles(
        together([one.grey for one in seen])[..., 0],
        together([one.weights for one in seen])[..., 0],
        by_level.reshape(*flat, LEVELS),
        slopes.reshape(*flat, LEVELS),
        together(moved),
        2 * per_group,
    )


@dataclass(frozen=True, eq=False)
class _Seen:
    """The profiles in one image, shape (B, N, T); ``parts`` and ``slopes`` by face, background and side face."""

    grey: Array
    weights: Array
    parts: tuple[Array, Array, Array]
    slopes: tuple[Array, Array, Array]
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
    places = pixels[:, :, None, :] + normals[:, :, None, :] * _OFFSETS_PX[:, None]
    flat = places.reshape(len(places), -1, 2).astype(np.float32)
    read = cv2.remap(
        image,
        np.ascontiguousarray(flat[..., 0]),
        np.ascontiguousarray(flat[..., 1]),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    grey = np.asarray(read, dtype=np.float64).reshape(places.shape[:3])
    last = (image.shape[1] - 1.0, image.shape[0] - 1.0)
    inside = (places >= 0.0).all(axis=-1) & (places <= last).all(axis=-1)
    spacing_px = np.median(np.linalg.norm(np.roll(pixels, -1, axis=1) - pixels, axis=-1), axis=1)
    border, end = _OFFSETS_PX / blur_px, (_OFFSETS_PX - side_px[..., None]) / blur_px
    beyond_border, beyond_end = np.broadcast_to(ndtr(border), grey.shape), ndtr(end)
    peak_border = np.broadcast_to(np.exp(-0.5 * border**2) * (_PEAK / blur_px), grey.shape)
    peak_end = np.exp(-0.5 * end**2) * (_PEAK / blur_px)
    covectors = np.concatenate(
        [normals, -(normals * seen[..., :2]).sum(axis=-1, keepdims=True) / seen[..., 2:]], axis=-1
    ) * (rig.f_px / seen[..., 2:])
    return _Seen(
        grey,
        inside * np.minimum(spacing_px, 1.0)[:, None, None],
        (1.0 - beyond_border, beyond_end, beyond_border - beyond_end),
        (peak_border, -peak_end, peak_end - peak_border),
        outlines.change(covectors @ rig.camera_T_base.rotation),
    )


def _pixels(points_mm: Array, rig: RectifiedRig) -> Array:
    pixels: Array = points_mm[..., :2] * (rig.f_px / points_mm[..., 2:]) + (rig.cx_px, rig.cy_px)
    return pixels
