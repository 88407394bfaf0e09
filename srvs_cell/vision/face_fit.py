"""Step 11a: fit the outline of a top face to the edges of both images at once.

A region says roughly where a face is; its edges say exactly. The model is a flat figure over the table (rectangle,
circle, regular hexagon), upright or, for the rectangle, inclined. Its outline is projected into both rectified
images, the nearest edge is measured along the outline's normals there, and the figure's parameters follow by
Gauss-Newton: place, height, orientation and size in one estimate, with its covariance.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.rectification import RectifiedRig

_SMOOTHING_PX = 1.0
_SAMPLE_STEP_PX = 0.5
_SAMPLE_SPACING_PX = 1.5
_SIDE_SAMPLES_MIN, _SIDE_SAMPLES_MAX = 8, 60
_CORNER_SHARE = 0.1
"""Share of a side left out at either end: there the neighbouring side's edge is met."""
_ALONG = np.array([1.0, 2.0, 3.0, 2.0, 1.0]) / 9.0
"""Weights that average neighbouring profiles of one side against noise."""
_CLEAR_SHARE = 0.15
"""An edge must have this share of the strongest gradient in its window, so that texture within the face is none."""
_HALF_WIDTHS_PX = (6.0, 6.0, 5.0, 4.0, 3.0, 3.0, 2.5, 2.5)
_HUBER_PX = 0.5
_MISSING_PX = 3.0
_SUPPORT_PX = 1.0
_TANGENT_STEP_MM = 0.01
_DAMPING = 1e-6
_STEP_LIMITS = {"length": 12.0, "angle": 0.3, "slope": 0.4}
_MIN_SIZE_MM = 3.0
_EDGE_SIGMA_PX = 0.05
"""Least standard deviation of one edge sample (references/vision.md C: a sober practical limit)."""
_CORRELATED_SAMPLES = 4.0
"""Neighbouring samples share pixels, so that this many count as one."""


class Figure(StrEnum):
    """The outline of a top face."""

    RECTANGLE = "rectangle"
    CIRCLE = "circle"
    HEXAGON = "hexagon"


@dataclass(frozen=True)
class Face:
    """A flat figure over the table.

    Attributes:
        figure: its outline seen from above.
        x_mm: centre, base frame.
        y_mm: centre, base frame.
        z_mm: height of the centre, base frame.
        angle_rad: direction of the length (a hexagon: of one corner), from base x towards base y.
        length_mm: along that direction, seen from above (a circle: diameter; a hexagon: across corners).
        width_mm: across (a circle: diameter; a hexagon: across flats).
        slope_u: rise per millimetre along the length.
        slope_v: rise per millimetre along the width.
    """

    figure: Figure
    x_mm: float
    y_mm: float
    z_mm: float
    angle_rad: float
    length_mm: float
    width_mm: float
    slope_u: float = 0.0
    slope_v: float = 0.0

    @property
    def inclination_deg(self) -> float:
        """Angle between the face and the horizontal."""
        return float(np.rad2deg(np.arctan(np.hypot(self.slope_u, self.slope_v))))

    def corners_mm(self) -> Array:
        """Return the outline's corners (a circle: 24 points), (N, 3), base frame, counter-clockwise from above."""
        if self.figure is Figure.RECTANGLE:
            plan = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * (
                self.length_mm / 2.0,
                self.width_mm / 2.0,
            )
        else:
            count = 6 if self.figure is Figure.HEXAGON else 24
            turn = np.arange(count) * (2.0 * np.pi / count)
            plan = np.column_stack([np.cos(turn), np.sin(turn)]) * (self.length_mm / 2.0)
        return self._place(plan)

    def outline_mm(self, counts: NDArray[np.int_]) -> tuple[Array, Array]:
        """Return points of the outline and unit tangents, each shape (N, 3).

        Args:
            counts: number of points on each side; a circle has one side.
        """
        if self.figure is Figure.CIRCLE:
            turn = np.arange(counts[0]) * (2.0 * np.pi / counts[0])
            plan = np.column_stack([np.cos(turn), np.sin(turn)])
            return self._place(plan * (self.length_mm / 2.0)), self._turn(np.column_stack([-plan[:, 1], plan[:, 0]]))
        corners = self.corners_mm()
        points, tangents = [], []
        for start, end, count in zip(corners, np.roll(corners, -1, axis=0), counts, strict=True):
            share = np.linspace(_CORNER_SHARE, 1.0 - _CORNER_SHARE, count)[:, None]
            points.append(start + share * (end - start))
            tangents.append(np.broadcast_to((end - start) / np.linalg.norm(end - start), (count, 3)))
        return np.concatenate(points), np.concatenate(tangents)

    def side_lengths_mm(self) -> Array:
        """Return the length of each side; a circle has one side."""
        if self.figure is Figure.CIRCLE:
            return np.array([np.pi * self.length_mm])
        corners = self.corners_mm()
        return np.asarray(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1))

    def parameters(self, *, inclined: bool) -> Array:
        """Return the free parameters as a vector: x, y, z, length and, as the figure has them, angle, width, slopes."""
        common = [self.x_mm, self.y_mm, self.z_mm, self.length_mm]
        if self.figure is Figure.CIRCLE:
            return np.array(common)
        if self.figure is Figure.HEXAGON:
            return np.array([*common, self.angle_rad])
        slopes = [self.slope_u, self.slope_v] if inclined else []
        return np.array([*common, self.angle_rad, self.width_mm, *slopes])

    def with_parameters(self, values: Array) -> Face:
        """Return the face with other free parameters, in the order of `parameters`."""
        x_mm, y_mm, z_mm, length_mm, *rest = (float(value) for value in values)
        length_mm = max(length_mm, _MIN_SIZE_MM)
        if self.figure is Figure.CIRCLE:
            return Face(self.figure, x_mm, y_mm, z_mm, 0.0, length_mm, length_mm)
        if self.figure is Figure.HEXAGON:
            return Face(self.figure, x_mm, y_mm, z_mm, rest[0], length_mm, length_mm * float(np.cos(np.pi / 6.0)))
        angle_rad, width_mm, *slopes = rest
        return Face(self.figure, x_mm, y_mm, z_mm, angle_rad, length_mm, max(width_mm, _MIN_SIZE_MM), *slopes)

    def _place(self, plan: Array) -> Array:
        cos, sin = np.cos(self.angle_rad), np.sin(self.angle_rad)
        u, v = plan[:, 0], plan[:, 1]
        return np.column_stack(
            [
                self.x_mm + cos * u - sin * v,
                self.y_mm + sin * u + cos * v,
                self.z_mm + self.slope_u * u + self.slope_v * v,
            ]
        )

    def _turn(self, plan: Array) -> Array:
        return self._place(plan) - (self.x_mm, self.y_mm, self.z_mm)


@dataclass(frozen=True, eq=False)
class EdgeField:
    """The grey gradient of an image, smoothed: float32, shape (H, W) each."""

    gradient_x: NDArray[np.float32]
    gradient_y: NDArray[np.float32]

    @classmethod
    def of(cls, grey: NDArray[np.uint8]) -> EdgeField:
        """Differentiate a grey image by a derivative of a Gaussian."""
        reach = int(np.ceil(4.0 * _SMOOTHING_PX))
        t = np.arange(-reach, reach + 1, dtype=np.float64)
        smooth = np.exp(-0.5 * (t / _SMOOTHING_PX) ** 2)
        smooth /= smooth.sum()
        slope = t * smooth
        slope /= (slope * t).sum()
        image = grey.astype(np.float32)
        return cls(
            np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, slope, smooth), dtype=np.float32),
            np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, smooth, slope), dtype=np.float32),
        )

    def along_normals(self, points_px: Array, normals: Array, offsets_px: Array) -> Array:
        """Return the gradient along the normals, shape (N, T), at T offsets from N points."""
        x = (points_px[:, :1] + normals[:, :1] * offsets_px).astype(np.float32)
        y = (points_px[:, 1:] + normals[:, 1:] * offsets_px).astype(np.float32)
        outside = cv2.BORDER_CONSTANT
        along_x = cv2.remap(self.gradient_x, x, y, cv2.INTER_LINEAR, borderMode=outside)
        along_y = cv2.remap(self.gradient_y, x, y, cv2.INTER_LINEAR, borderMode=outside)
        return np.asarray(along_x * normals[:, :1] + along_y * normals[:, 1:], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class FaceFit:
    """A face fitted to the edges of both images.

    Attributes:
        face: the fitted figure.
        covariance: of (x, y, z) of its centre from the edges alone, 3x3, square millimetres.
        rms_px: root mean square distance of outline and edges, where there is no edge counted as 3 px.
        support: share of the outline that has an edge within a pixel, the less of both images.
        slope_sigma: standard deviation of the slopes; 0 where none were fitted.
    """

    face: Face
    covariance: Array
    rms_px: float
    support: float
    slope_sigma: float


def fit_face(
    start: Face, fields: tuple[EdgeField, EdgeField], rig: RectifiedRig, *, inclined: bool, min_gradient: float
) -> FaceFit | None:
    """Fit a face to the edges of both images.

    Args:
        start: where to begin; within about six pixels of the edges.
        fields: gradients of the rectified left and right image.
        rig: the rectified cameras.
        inclined: whether the slopes of a rectangle are free.
        min_gradient: least gradient of an edge, grey values per pixel.

    Returns:
        The fit, or None where the outline leaves the view or the edges do not determine it.
    """
    face = start
    counts = _side_samples(face, rig)
    for half_width_px in _HALF_WIDTHS_PX:
        step = _step(face, fields, rig, counts, half_width_px, inclined=inclined, min_gradient=min_gradient)
        if step is None:
            return None
        face = face.with_parameters(face.parameters(inclined=inclined) + step[0])
    last = _step(face, fields, rig, counts, _HALF_WIDTHS_PX[-1], inclined=inclined, min_gradient=min_gradient)
    if last is None:
        return None
    _, normal_matrix, residuals, found = last
    distances = np.where(found, np.abs(residuals), _MISSING_PX)
    noise_px = max(_EDGE_SIGMA_PX, float(np.sqrt(np.mean(np.minimum(distances, _SUPPORT_PX) ** 2))))
    covariance = np.asarray(np.linalg.pinv(normal_matrix), dtype=np.float64) * noise_px**2 * _CORRELATED_SAMPLES
    near = (distances < _SUPPORT_PX).reshape(2, -1)
    free_slopes = inclined and face.figure is Figure.RECTANGLE
    return FaceFit(
        face,
        covariance[:3, :3],
        float(np.sqrt(np.mean(distances**2))),
        float(near.mean(axis=1).min()),
        float(np.sqrt(covariance[-2:, -2:].trace())) if free_slopes else 0.0,
    )


def _step(
    face: Face,
    fields: tuple[EdgeField, EdgeField],
    rig: RectifiedRig,
    counts: NDArray[np.int_],
    half_width_px: float,
    *,
    inclined: bool,
    min_gradient: float,
) -> tuple[Array, Array, Array, NDArray[np.bool_]] | None:
    """Return the Gauss-Newton step, the normal matrix, the residuals and which of them were found."""
    points, tangents = face.outline_mm(counts)
    centre = np.array([[face.x_mm, face.y_mm, face.z_mm]])
    here = _images(points, rig)
    if here is None:
        return None
    ahead, middle = _images(points + _TANGENT_STEP_MM * tangents, rig), _images(centre, rig)
    if ahead is None or middle is None:
        return None
    parameters = face.parameters(inclined=inclined)
    moved = []
    for index in range(parameters.size):
        changed = parameters.copy()
        changed[index] += _TANGENT_STEP_MM
        there = _images(face.with_parameters(changed).outline_mm(counts)[0], rig)
        if there is None:
            return None
        moved.append(there)
    residuals, weights, jacobians = [], [], []
    for side, field in enumerate(fields):
        normals = _outward(here[side], ahead[side], middle[side])
        offsets, strengths = _edge_offsets(field, here[side], normals, counts, half_width_px, min_gradient)
        closed = 1.0 / np.maximum(1.0, np.abs(offsets) / _HUBER_PX)
        weights.append(strengths / (strengths + 2.0 * min_gradient) * closed * (strengths > 0.0))
        residuals.append(offsets)
        columns = [((there[side] - here[side]) * normals).sum(axis=1) / _TANGENT_STEP_MM for there in moved]
        jacobians.append(np.column_stack(columns))
    residual, weight, jacobian = np.concatenate(residuals), np.concatenate(weights), np.concatenate(jacobians)
    normal_matrix = jacobian.T @ (jacobian * weight[:, None])
    scale = np.sqrt(np.diag(normal_matrix))
    if not (scale > 0.0).all():
        return None
    scaled = normal_matrix / np.outer(scale, scale) + _DAMPING * np.eye(scale.size)
    step = np.linalg.solve(scaled, jacobian.T @ (residual * weight) / scale) / scale
    limits = _limits(step.size)
    return np.clip(step, -limits, limits), normal_matrix, residual, weight > 0.0


def _limits(count: int) -> Array:
    kinds = ["length"] * 4 + ["angle", "length", "slope", "slope"]
    return np.array([_STEP_LIMITS[kind] for kind in kinds[:count]])


def _side_samples(face: Face, rig: RectifiedRig) -> NDArray[np.int_]:
    depth_mm = max(1.0, float(rig.base_T_camera.translation_mm[2] - face.z_mm))
    sides_px = face.side_lengths_mm() * rig.f_px / depth_mm
    most = _SIDE_SAMPLES_MAX * (3 if face.figure is Figure.CIRCLE else 1)
    return np.clip(sides_px / _SAMPLE_SPACING_PX, _SIDE_SAMPLES_MIN, most).astype(np.int_)


def _images(points_mm: Array, rig: RectifiedRig) -> tuple[Array, Array] | None:
    """Project into the left and the right image, shape (N, 2) each; None where a point lies behind the cameras."""
    x, y, disparity = rig.project_px(points_mm)
    if not (np.isfinite(disparity).all() and (disparity > 0.0).all()):
        return None
    return np.column_stack([x, y]), np.column_stack([x - disparity, y])


def _outward(points: Array, ahead: Array, centre: Array) -> Array:
    along = ahead - points
    normals = np.column_stack([along[:, 1], -along[:, 0]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    inward = ((points - centre) * normals).sum(axis=1) < 0.0
    normals[inward] *= -1.0
    return normals


def _edge_offsets(
    field: EdgeField,
    points_px: Array,
    normals: Array,
    counts: NDArray[np.int_],
    half_width_px: float,
    min_gradient: float,
) -> tuple[Array, Array]:
    """Return the signed distance of the edge along each normal and its gradient; both 0 where there is no edge."""
    reach = round(half_width_px / _SAMPLE_STEP_PX) + 1
    offsets = np.arange(-reach, reach + 1, dtype=np.float64) * _SAMPLE_STEP_PX
    profiles = _averaged(field.along_normals(points_px, normals, offsets), counts)
    size = np.abs(profiles)
    # an edge is a local maximum, so that the flank of one beyond the window does not count
    peak = np.zeros_like(size, dtype=bool)
    peak[:, 1:-1] = (size[:, 1:-1] >= size[:, :-2]) & (size[:, 1:-1] > size[:, 2:]) & (size[:, 1:-1] >= min_gradient)
    # walking outwards from inside the face its own edge comes first; sliver of side face and shadow lie beyond it
    clear = peak & (size >= _CLEAR_SHARE * (size * peak).max(axis=1, keepdims=True))
    best = clear.argmax(axis=1)
    rows = np.arange(best.size)
    found = clear[rows, best]
    best = np.clip(best, 1, offsets.size - 2)
    before, at, after = size[rows, best - 1], size[rows, best], size[rows, best + 1]
    curvature = before - 2.0 * at + after
    shift = np.where(curvature < 0.0, 0.5 * (before - after) / np.where(curvature < 0.0, curvature, -1.0), 0.0)
    place = offsets[best] + np.clip(shift, -0.5, 0.5) * _SAMPLE_STEP_PX
    return np.where(found, place, 0.0), np.where(found, at, 0.0)


def _averaged(profiles: Array, counts: NDArray[np.int_]) -> Array:
    """Average neighbouring profiles within each side."""
    averaged = np.empty_like(profiles)
    start = 0
    for count in counts:
        side = profiles[start : start + count]
        padded = np.pad(side, ((2, 2), (0, 0)), mode="edge")
        averaged[start : start + count] = sum(
            weight * padded[shift : shift + count] for shift, weight in enumerate(_ALONG)
        )
        start += count
    return averaged
