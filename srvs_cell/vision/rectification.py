"""Step 1: undistort and rectify, so that rows are epipolar lines.

Both images are turned, by calculation, into those of two ideal cameras with one orientation, one focal length and one
principal point, whose x axis is the baseline. Calibration and *reported* poses are all that is used. This also takes
up small rotations between the poses and the lens distortion: the paper's third cause of error.

The image is doubled by a long half-sample filter and read from the doubled one linearly. That places edges as well as
Lanczos' 64 taps a pixel do (to a hundredth of a pixel) in a seventh of the time. What depends on calibration and poses
alone is kept for the next pair from the same place.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.calibration import ErrorBudget, Uncertainty, check_baseline
from srvs_cell.geometry import Array, Transform

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.calibration import Calibration

    FixedMap = tuple[NDArray[np.int16], NDArray[np.uint16]]

_COLOUR_DIMENSIONS = 3
_AROUND_PX = 9
"""So wide is what smoothing and slopes make a pixel of."""
_KEPT_MAPS = 2
"""A cell looks from one place again and again; an early analysis of the left image has maps of its own."""
_HALF_SAMPLE = np.array([[-1, 4, -11, 40, 40, -11, 4, -1]], dtype=np.float32) / 64.0
"""The value half way between two samples: the 8-tap filter of ITU-T H.265, table 8-11."""
_HALF_SAMPLE_ANCHOR = 3


@dataclass(frozen=True)
class RectifiedRig:
    """Two ideal cameras side by side, and where the left one is.

    Attributes:
        f_px: focal length of both.
        cx_px, cy_px: principal point of both.
        baseline_mm: distance of the right camera along the left one's x axis.
        base_T_camera: base_T_camera_left.
        tcp_in_camera_mm: the TCP in the left rectified camera's frame.
        uncertainty: one standard deviation of the numbers that all this was computed from.
    """

    f_px: float
    cx_px: float
    cy_px: float
    baseline_mm: float
    base_T_camera: Transform  # noqa: N815 - the house's notation for transforms
    tcp_in_camera_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    uncertainty: Uncertainty = field(default_factory=Uncertainty)

    @cached_property
    def error_budget(self) -> ErrorBudget:
        """How uncertain a triangulated point is."""
        return ErrorBudget(self.f_px, self.baseline_mm, self.base_T_camera, self.tcp_in_camera_mm, self.uncertainty)

    @cached_property
    def camera_T_base(self) -> Transform:
        """The base frame in the left rectified camera's."""
        return self.base_T_camera.inverse()

    @cached_property
    def projections(self) -> Array:
        """Projection matrices of the left and the right camera, base frame to homogeneous pixels, shape (2, 3, 4)."""
        intrinsics = np.array([[self.f_px, 0.0, self.cx_px], [0.0, self.f_px, self.cy_px], [0.0, 0.0, 1.0]])
        cameras = np.empty((2, 3, 4))
        cameras[..., :3] = self.camera_T_base.rotation
        cameras[..., 3] = self.camera_T_base.translation_mm
        cameras[1, 0, 3] -= self.baseline_mm
        projections: Array = intrinsics @ cameras
        return projections

    def plane_disparity(self, normal: Array, offset_mm: float) -> tuple[float, float, float]:
        """Return (a, b, c) of the disparity d = a x + b y + c that the plane ``normal . P = offset_mm`` has.

        Args:
            normal: normal in the base frame, any length, shape (3,).
            offset_mm: the plane's constant, in millimetres times the normal's length.

        Raises:
            ValueError: the plane runs through the camera's centre and has no disparity.
        """
        distance = offset_mm - float(np.dot(normal, self.base_T_camera.translation_mm))
        if distance == 0.0:
            raise ValueError("the plane runs through the left camera's centre")
        n_x, n_y, n_z = self.camera_T_base.rotate(normal) * (self.baseline_mm / distance)
        return float(n_x), float(n_y), float(self.f_px * n_z - n_x * self.cx_px - n_y * self.cy_px)

    def points_mm(self, x_px: Array, y_px: Array, disparity_px: Array) -> Array:
        """Triangulate pixels of the left image: base frame points of shape (..., 3)."""
        depth_mm = self.f_px * self.baseline_mm / disparity_px
        x_mm = (x_px - self.cx_px) * depth_mm / self.f_px
        y_mm = (y_px - self.cy_px) * depth_mm / self.f_px
        return self.base_T_camera.apply(np.stack([x_mm, y_mm, depth_mm], axis=-1))

    def project_px(self, points_mm: Array) -> tuple[Array, Array, Array]:
        """Project base frame points of shape (..., 3): x and y in the left image, and the disparity, pixels."""
        camera = self.camera_T_base.apply(points_mm)
        scale = self.f_px / camera[..., 2]
        return (
            camera[..., 0] * scale + self.cx_px,
            camera[..., 1] * scale + self.cy_px,
            self.baseline_mm * scale,
        )

    def disparity_range(self, z_min_mm: float, z_max_mm: float, image_size: tuple[int, int]) -> tuple[float, float]:
        """Return the least and greatest disparity of what is in view between two heights of the base frame.

        The disparity of a horizontal plane is affine over the image, so that its extremes lie in the corners. Where a
        corner looks past the lower plane the least disparity is 0; where the upper plane reaches the camera the
        greatest is the image's width.

        Args:
            z_min_mm: lower base frame height.
            z_max_mm: upper base frame height.
            image_size: (width, height) of the rectified images.
        """
        width, height = image_size
        corners = np.array(
            [[0.0, 0.0, 1.0], [width - 1.0, 0.0, 1.0], [0.0, height - 1.0, 1.0], [width - 1.0, height - 1.0, 1.0]]
        )
        up = np.array([0.0, 0.0, 1.0])
        camera_z_mm = float(self.base_T_camera.translation_mm[2])
        low = 0.0
        if z_min_mm < camera_z_mm:
            low = max(0.0, float((corners @ self.plane_disparity(up, z_min_mm)).min()))
        high = float(width)
        if z_max_mm < camera_z_mm:
            high = min(high, float((corners @ self.plane_disparity(up, z_max_mm)).max()))
        return low, high


@dataclass(frozen=True, eq=False)
class RectificationMaps:
    """Where each rectified pixel is read from; the same for every pair taken at the same two poses.

    Attributes:
        rig: the ideal cameras.
        left, right: source coordinates in the doubled image (`doubled`) as OpenCV's fixed-point maps, int16 of shape
            (H, W, 2) and uint16 of shape (H, W).
        left_valid, right_valid: bool, shape (H, W): the source lies inside the image.
    """

    rig: RectifiedRig
    left: FixedMap
    right: FixedMap
    left_valid: NDArray[np.bool_]
    right_valid: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class RectifiedPair:
    """Rectified images.

    Attributes:
        left, right: grey, uint8, shape (H, W).
        left_valid, right_valid: bool, shape (H, W): False where the pixel was outside the camera's image.
        rig: the ideal cameras that they belong to.
    """

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    left_valid: NDArray[np.bool_]
    right_valid: NDArray[np.bool_]
    rig: RectifiedRig

    @cached_property
    def well_inside(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Where the left and the right image saw what is around a pixel too: 1, else 0, uint8, shape (H, W)."""
        square = np.ones((_AROUND_PX, _AROUND_PX), np.uint8)
        left, right = (
            np.asarray(cv2.erode(valid.view(np.uint8), square, borderValue=0), dtype=np.uint8)
            for valid in (self.left_valid, self.right_valid)
        )
        return left, right


def rectification_maps(
    calibration: Calibration, base_T_tcp_left: Transform, base_T_tcp_right: Transform
) -> RectificationMaps:
    """Compute the maps for two reported poses.

    Args:
        calibration: intrinsics and hand-eye transform.
        base_T_tcp_left: reported pose at the left end, Transform("base", "tcp").
        base_T_tcp_right: reported pose at the right end.

    Raises:
        AlarmError: BASELINE_INVALID where the poses make no usable baseline.
    """
    check_baseline(calibration, base_T_tcp_left, base_T_tcp_right)
    left = base_T_tcp_left @ calibration.tcp_T_camera
    right = base_T_tcp_right @ calibration.tcp_T_camera
    base_R_rectified = _common_orientation(left, right)
    f_px = 0.5 * (calibration.camera.fx + calibration.camera.fy)
    left_R = base_R_rectified.T @ left.rotation
    right_R = base_R_rectified.T @ right.rotation
    cx_px, cy_px = _common_principal_point(calibration, (left_R, right_R), f_px)
    projection = np.array([[f_px, 0.0, cx_px], [0.0, f_px, cy_px], [0.0, 0.0, 1.0]])
    base_T_camera = Transform.from_parts("base", "camera_left", base_R_rectified, left.translation_mm)
    tcp_x_mm, tcp_y_mm, tcp_z_mm = (
        float(value) for value in base_T_camera.inverse().apply(base_T_tcp_left.translation_mm)
    )
    rig = RectifiedRig(
        f_px=f_px,
        cx_px=cx_px,
        cy_px=cy_px,
        baseline_mm=float(np.linalg.norm(right.translation_mm - left.translation_mm)),
        base_T_camera=base_T_camera,
        tcp_in_camera_mm=(tcp_x_mm, tcp_y_mm, tcp_z_mm),
        uncertainty=calibration.uncertainty,
    )
    left_map, left_valid = _map(calibration, left_R, projection)
    right_map, right_valid = _map(calibration, right_R, projection)
    return RectificationMaps(rig, left_map, right_map, left_valid, right_valid)


def remap_pair(left: NDArray[np.uint8], right: NDArray[np.uint8], maps: RectificationMaps) -> RectifiedPair:
    """Rectify two images, uint8, shape (H, W) grey or (H, W, 3) BGR.

    Raises:
        AlarmError: IMAGE_INVALID where an image has not the calibration's size.
    """
    return RectifiedPair(
        _remap(left, maps.left, "left"), _remap(right, maps.right, "right"), maps.left_valid, maps.right_valid, maps.rig
    )


def rectify_pair(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    calibration: Calibration,
    base_T_tcp_left: Transform,
    base_T_tcp_right: Transform,
) -> RectifiedPair:
    """Compute the maps and rectify; see `rectification_maps` and `remap_pair` for arguments and errors."""
    poses = (base_T_tcp_left.matrix.tobytes(), base_T_tcp_right.matrix.tobytes())
    return remap_pair(left, right, _kept_maps(calibration, *poses))


@lru_cache(maxsize=_KEPT_MAPS)
def _kept_maps(calibration: Calibration, left_matrix: bytes, right_matrix: bytes) -> RectificationMaps:
    left, right = (Transform("base", "tcp", np.frombuffer(pose).reshape(4, 4)) for pose in (left_matrix, right_matrix))
    return rectification_maps(calibration, left, right)


def to_grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the grey image, uint8, shape (H, W), of a grey or BGR image."""
    if image.ndim == _COLOUR_DIMENSIONS:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    return image


def _common_orientation(left: Transform, right: Transform) -> Array:
    """Return base_R_rectified: x along the baseline, z nearest to the mean of the optical axes."""
    x_axis = right.translation_mm - left.translation_mm
    x_axis = x_axis / np.linalg.norm(x_axis)
    y_axis = np.cross(left.rotation[:, 2] + right.rotation[:, 2], x_axis)
    y_axis /= np.linalg.norm(y_axis)
    return np.column_stack([x_axis, y_axis, np.cross(x_axis, y_axis)])


def _common_principal_point(
    calibration: Calibration, rotations: tuple[Array, Array], f_px: float
) -> tuple[float, float]:
    """Return the principal point that keeps the image centres of both cameras, on average, where they were."""
    width, height = calibration.image_size
    centre = np.array([(width - 1) / 2.0, (height - 1) / 2.0])
    normalised = cv2.undistortPoints(centre.reshape(1, 1, 2), calibration.camera_matrix, calibration.distortion)
    ray = np.append(normalised.reshape(2), 1.0)
    turned = [rotation @ ray for rotation in rotations]
    seen = np.mean([f_px * direction[:2] / direction[2] for direction in turned], axis=0)
    return float(centre[0] - seen[0]), float(centre[1] - seen[1])


def _map(calibration: Calibration, rotation: Array, projection: Array) -> tuple[FixedMap, NDArray[np.bool_]]:
    """Return one camera's map, and the pixels whose source lies inside the image."""
    width, height = calibration.image_size
    x, y = cv2.initUndistortRectifyMap(
        calibration.camera_matrix,
        calibration.distortion,
        rotation,
        projection,
        calibration.image_size,
        cv2.CV_32FC1,
    )
    valid = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    places, parts = cv2.convertMaps(2.0 * x, 2.0 * y, cv2.CV_16SC2)
    return (np.asarray(places, dtype=np.int16), np.asarray(parts, dtype=np.uint16)), np.asarray(valid)


def doubled(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the image with a value between any two samples: pixel (x, y) lies at (2x, 2y); shape (2H, 2W)."""
    height, width = grey.shape
    # the border is repeated so that no edge is made where the picture ends
    border = cv2.BORDER_REPLICATE
    across, down = (_HALF_SAMPLE_ANCHOR, 0), (0, _HALF_SAMPLE_ANCHOR)
    beside = cv2.filter2D(grey, cv2.CV_8U, _HALF_SAMPLE, anchor=across, borderType=border)
    rows = np.empty((height, 2, 2 * width), dtype=np.uint8)
    above, below = rows[:, 0], rows[:, 1]
    cv2.merge([grey, beside], dst=above.reshape(height, width, 2))
    cv2.filter2D(above, cv2.CV_8U, _HALF_SAMPLE.T, dst=below, anchor=down, borderType=border)
    return rows.reshape(2 * height, 2 * width)


def _remap(image: NDArray[np.uint8], fixed_map: FixedMap, name: str) -> NDArray[np.uint8]:
    height, width = fixed_map[1].shape
    if image.shape[:2] != (height, width):
        raise AlarmError(
            Alarm.IMAGE_INVALID,
            f"The {name} image is {image.shape[1]} x {image.shape[0]}, the calibration is for {width} x {height}.",
        )
    places, parts = fixed_map
    rectified = cv2.remap(doubled(to_grey(image)), places, parts, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(rectified, dtype=np.uint8)
