"""Step 11d, beyond the paper: what the grey values inside a face say of its place.

The border tells where a face is as long as it is the face's border and no shadow's or side face's. The texture inside
has no such doubt: where the face stands at another height or slope than claimed, the two pictures of its inside are
displaced against each other. Little texture says little, and is counted so.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.faces.face import Figure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces.edge_fit import EdgeField
    from srvs_cell.vision.faces.face import Face
    from srvs_cell.vision.rectification import RectifiedRig

_PER_SIDE = 24
_RECTANGLE_SHARE = 0.85
_ROUND_SHARE = 0.6
"""A square of this share of a circle or a hexagon lies inside of it."""
_PASSES = 3
_MAD = 1.4826
_ROBUST_SIGMA = 3.0
_SMOOTHED_NOISE = 0.3
"""Share of the noise that is left in smoothed pictures."""
_INDEPENDENT_PX2 = 6.0
"""Area of a smoothed picture whose noise counts as one."""
_SYSTEMATIC_PX = 0.05
"""Displacement that rectified pictures always have."""
_WEIGHTS = np.array([1.0, 1.0 / 3.0, 1.0 / 3.0])
"""Mean square over the face of a displacement that is 1, u or v, each from -1 to 1."""
_MOST_PX2 = 4.0
_RIDGE = 1e-6


def inner_displacements(
    faces: Sequence[Face], fields: tuple[EdgeField, EdgeField], rig: RectifiedRig, noise: float
) -> list[float]:
    """Return by how much the insides of faces are displaced between the pictures, beyond what noise explains.

    Args:
        faces: as they are claimed to stand.
        fields: smoothed pictures and gradients of the rectified left and right image.
        rig: the rectified cameras.
        noise: standard deviation of the grey values before they were smoothed.

    Returns:
        Of each face the mean square of the displacement along the row, px^2, at most 4.
    """
    if not faces:
        return []
    side = np.linspace(-1.0, 1.0, _PER_SIDE)
    unit = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    shares = [_RECTANGLE_SHARE if face.figure is Figure.RECTANGLE else _ROUND_SHARE for face in faces]
    points = np.stack([face.place(share * unit) for face, share in zip(faces, shares, strict=True)])
    x, y, disparity = rig.project_px(points)
    left, slope_left = _read(fields[0], x, y)
    right, slope_right = _read(fields[1], x - disparity, y)
    slope = 0.5 * (slope_left + slope_right)
    ones = np.ones_like(left)
    u, v = (np.broadcast_to(axis, left.shape) for axis in unit.T)
    # what lens and lamp make of the right picture, offset, gain and their change over the face; then the displacement
    # as a plane over it: on a smooth gradient of grey values a change that was left out would pass for one
    light = [ones, u, v, left - left.mean(axis=1, keepdims=True)]
    columns = np.stack([*light, slope, slope * u, slope * v], axis=-1)
    difference = right - left
    seen = _inside(fields[0], x, y) & _inside(fields[1], x - disparity, y)
    weights, least = seen.astype(np.float64), _SMOOTHED_NOISE * noise
    for _ in range(_PASSES):
        weighted = np.swapaxes(columns * weights[..., None], 1, 2)
        normal = weighted @ columns + _RIDGE * np.eye(columns.shape[-1])
        estimate = np.linalg.solve(normal, weighted @ difference[..., None])
        residual = difference - (columns @ estimate)[..., 0]
        sigma = np.maximum(_MAD * np.median(np.abs(residual), axis=1), least)
        weights = seen / (1.0 + (residual / (_ROBUST_SIGMA * sigma[:, None])) ** 2) ** 2
    counted = np.maximum(1.0, _INDEPENDENT_PX2 / _area_px2(x, y))
    variance = np.einsum("bii->bi", np.linalg.inv(normal))[:, len(light) :] * (sigma**2 * counted)[:, None]
    beyond = estimate[:, len(light) :, 0] ** 2 - variance - _SYSTEMATIC_PX**2
    return [float(value) for value in np.minimum(np.maximum(beyond, 0.0) @ _WEIGHTS, _MOST_PX2)]


def _read(field: EdgeField, x: Array, y: Array) -> tuple[Array, Array]:
    """Return grey value and its slope along the row at pixels of shape (B, N)."""
    at = (x.astype(np.float32), y.astype(np.float32))
    smooth, gradient = (
        cv2.remap(image, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for image in (field.smooth, field.gradient)
    )
    return smooth.astype(np.float64), gradient[..., 0].astype(np.float64)


def _inside(field: EdgeField, x: Array, y: Array) -> NDArray[np.bool_]:
    """Return which pixels lie in a picture."""
    height, width = field.smooth.shape
    return np.asarray((x >= 0.0) & (x <= width - 1.0) & (y >= 0.0) & (y <= height - 1.0))


def _area_px2(x: Array, y: Array) -> NDArray[np.float64]:
    """Return the picture's area that each sample of a grid, shape (B, N), stands for, shape (B,)."""
    across = np.hypot(x[:, 1] - x[:, 0], y[:, 1] - y[:, 0])
    along = np.hypot(x[:, _PER_SIDE] - x[:, 0], y[:, _PER_SIDE] - y[:, 0])
    return np.asarray(np.maximum(across * along, np.finfo(float).tiny), dtype=np.float64)
