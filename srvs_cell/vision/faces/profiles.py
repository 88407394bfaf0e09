"""Step 11b: the grey values across the outline of a face, and what a model of them expects.

Across the border of a top face the grey value goes from that of the face to that of its side face, as far as this is
seen, to that of the shadow on the table, as far as it reaches, and on to that of what lies behind. The width of the
visible side face follows from the face's height over the table, that of the shadow from the height and from where the
lamp stands, so that a sliver of a pixel is told from the face itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.special import ndtr

from srvs_cell.vision.faces.shadows import reach_px

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces.outlines import Borders, Outlines
    from srvs_cell.vision.faces.shadows import Lamp
    from srvs_cell.vision.rectification import RectifiedRig

GROUPS = 12
"""Stretches of an outline that have grey levels of their own: three of a rectangle's side, two of a hexagon's."""
USUAL_BLUR_PX = 0.85
OFFSETS_PX = np.arange(-4.0, 3.5, 1.0, dtype=np.float32)
"""Where a profile is read, outwards from the border. Farther out the edge of a shadow would often be met."""
_WIDTHS_PER_PX, _WIDEST_PX = 64, 12
"""The widths of side faces and shadows that are looked up; beyond a profile's end they make no difference."""
_MIN_SIGMA = 0.5
_SPARSE = 4
"""Every so many rows are enough for a median of the whole picture."""
_MAD = 1.4826
_BEND = float(np.sqrt(6.0))
"""Standard deviation of a second difference over that of its values."""
_PEAK = 1.0 / float(np.sqrt(2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class Pictures:
    """Both rectified images as the fit needs them.

    Attributes:
        images: left and right, float32, shape (2, H, W).
        noise: standard deviation of the grey values.
        blur_px: standard deviation of the picture of a sharp border: lens, pixel and rectification.
        lamp: what throws the shadows; None where that is not known, or nothing throws any.
    """

    images: NDArray[np.float32]
    noise: float
    blur_px: float = USUAL_BLUR_PX
    lamp: Lamp | None = None

    @classmethod
    def of(cls, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Pictures:
        """Take two rectified images and measure their noise by second differences along the rows."""
        images = np.stack([left, right]).astype(np.float32)
        rows = images[:, ::_SPARSE]
        bends = np.abs(rows[..., :-2] - 2.0 * rows[..., 1:-1] + rows[..., 2:])
        noise = max(float(np.median(bend)) * _MAD / _BEND for bend in bends)
        return cls(images, max(noise, _MIN_SIGMA))


@dataclass(frozen=True, eq=False)
class Model:
    """What is expected across a border: face (1 - b) + side (b - e) + shadow (e - r) + background r, with grey levels.

    Attributes:
        shares: of the face itself, 1 - b, and of all outside of it, b, shape (2, T).
        squares: (1 - b)^2, (1 - b) b and b^2, shape (3, T).
        border_slope: how b changes when the border moves outwards, per pixel, shape (T,).
        by_width: the share of what lies beyond so many pixels from the border, and how that changes when the border
            moves outwards, for each width in steps, shape (2, T, widths).
    """

    shares: NDArray[np.float32]
    squares: NDArray[np.float32]
    border_slope: NDArray[np.float32]
    by_width: NDArray[np.float32]

    @classmethod
    @lru_cache(maxsize=32)
    def of(cls, blur_px: float) -> Model:
        """Return the model with borders of a width, one standard deviation."""
        widths_px = np.arange(_WIDEST_PX * _WIDTHS_PER_PX + 1) / _WIDTHS_PER_PX
        place = (OFFSETS_PX[:, None] - widths_px) / blur_px
        by_width = np.stack([ndtr(place), -_PEAK / blur_px * np.exp(-0.5 * place**2)]).astype(np.float32)
        outside, slope = by_width[:, :, 0]
        face = 1.0 - outside
        squares = np.stack([face**2, face * outside, outside**2])
        return cls(np.stack([face, outside]), squares, slope, by_width)

    def beyond(self, widths_px: Array) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the share of what lies beyond so many pixels from the border, and its change, each (T, ...)."""
        widths_px = np.minimum(np.maximum(widths_px, 0.0), _WIDEST_PX)
        steps = np.rint(widths_px * _WIDTHS_PER_PX)
        share, slope = np.take(self.by_width, steps.astype(np.intp), axis=2)
        # from the nearest width to the very one
        share += slope * (widths_px - steps / _WIDTHS_PER_PX).astype(np.float32)
        return share, slope


@dataclass(frozen=True, eq=False)
class Profiles:
    """The profiles of B faces: T grey values across the outline at each of N samples in both images.

    The samples are G stretches of as many each. Values are float32, offsets come first: sums over them are products
    with matrices.

    Attributes:
        grey: what was seen, shape (T, 2, B, N).
        weights: 0 outside of the image; less than 1 where samples lie closer than a pixel, shape (T, 2, B, N).
        model: what is expected.
        shares: of the side face, b - e, and of what lies beyond it and its shadow, r, shape (2, T, 2, B, N).
        slopes: how e and r change when the border moves outwards, per pixel, shape (2, T, 2, B, N).
        shade: what shadows leave of the brightness of what lies behind; None where that is not known.
        by_parameter: how far the border at each sample moves outwards with the face's seven parameters, pixels, shape
            (2, B, 7, N).
    """

    grey: NDArray[np.float32]
    weights: NDArray[np.float32]
    model: Model
    shares: NDArray[np.float32]
    slopes: NDArray[np.float32]
    shade: float | None
    by_parameter: Array

    def only(self, kept: NDArray[np.intp]) -> Profiles:
        """Return some of the faces by their numbers."""
        return replace(
            self,
            grey=self.grey[:, :, kept],
            weights=self.weights[:, :, kept],
            shares=self.shares[:, :, :, kept],
            slopes=self.slopes[:, :, :, kept],
            by_parameter=self.by_parameter[:, kept],
        )


def read_profiles(
    outlines: Outlines, borders: Borders, pictures: Pictures, rig: RectifiedRig, table_z_mm: float, blur_px: float
) -> Profiles:
    """Read the profiles of faces in both images and predict them.

    Args:
        outlines: the faces, with a multiple of twelve samples each and as many on each side.
        borders: the same as the cameras see them; all in front.
        pictures: the rectified images.
        rig: the rectified cameras.
        table_z_mm: height of the table, base frame: there the side faces end.
        blur_px: width of the model's borders, one standard deviation.
    """
    # x and y come first, shape (2, T, 2, B, N)
    points, normals = (
        np.moveaxis(each, 2, 0).astype(np.float32, order="C")[:, None] for each in (borders.points_px, borders.normals)
    )
    places = normals * OFFSETS_PX[:, None, None, None]
    places += points
    _, height, width = pictures.images.shape
    middle = (np.array([width, height], dtype=np.float32)[:, None, None, None, None] - 1.0) / 2.0
    inside = (np.abs(places - middle) <= middle).all(axis=0)
    # the right image lies under the left one
    places[1, :, 1] += height
    places_x, places_y = places.reshape(2, len(OFFSETS_PX), -1)
    under = pictures.images.reshape(-1, width)
    seen = cv2.remap(under, places_x, places_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    grey = np.asarray(seen, dtype=np.float32).reshape(inside.shape)
    # as much of the side face shows as its foot lies outside of the face; then its shadow, as far as it reaches
    model = Model.of(blur_px)
    foot_px = outlines.side_px(borders, rig, table_z_mm)
    shares, slopes = np.empty((2, *grey.shape), dtype=np.float32), np.empty((2, *grey.shape), dtype=np.float32)
    beyond, slopes[0] = model.beyond(foot_px)
    np.subtract(model.shares[1, :, None, None, None], beyond, out=shares[0])
    if pictures.lamp is None:
        shares[1], slopes[1] = beyond, slopes[0]
    else:
        end_px = np.maximum(foot_px, reach_px(outlines, borders, rig, pictures.lamp))
        shares[1], slopes[1] = model.beyond(end_px)
    spacing = np.minimum(borders.spacing_px, 1.0).astype(np.float32)
    return Profiles(
        grey,
        inside * spacing,
        model,
        shares,
        slopes,
        None if pictures.lamp is None else pictures.lamp.shade,
        borders.by_parameter,
    )
