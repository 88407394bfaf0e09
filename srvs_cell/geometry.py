"""Poses, frames, FANUC XYZWPR and equation (1) of the paper.

Millimetres and degrees at every interface. A transform ``a_T_b`` maps coordinates of frame ``b`` into frame ``a``;
composing two transforms whose inner frames differ raises `FrameMismatchError`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

_AXES = {
    "x": lambda c, s: [[1, 0, 0], [0, c, -s], [0, s, c]],
    "y": lambda c, s: [[c, 0, s], [0, 1, 0], [-s, 0, c]],
    "z": lambda c, s: [[c, -s, 0], [s, c, 0], [0, 0, 1]],
}
_ORTHONORMAL_TOLERANCE = 1e-6


class FrameMismatchError(ValueError):
    """Two transforms were composed whose inner frames are not the same frame."""


def axis_rotation(axis: str, angle_deg: float) -> Array:
    """Return the 3x3 right-handed rotation about the axis ``"x"``, ``"y"`` or ``"z"`` by ``angle_deg``."""
    angle_rad = np.deg2rad(angle_deg)
    return np.array(_AXES[axis](np.cos(angle_rad), np.sin(angle_rad)), dtype=np.float64)


@dataclass(frozen=True)
class Xyzwpr:
    """A pose as FANUC writes it: millimetres, and W, P, R in degrees about the *fixed* X, Y and Z axes."""

    x_mm: float
    y_mm: float
    z_mm: float
    w_deg: float
    p_deg: float
    r_deg: float

    def as_tuple(self) -> tuple[float, float, float, float, float, float]:
        """Return (X, Y, Z, W, P, R)."""
        return self.x_mm, self.y_mm, self.z_mm, self.w_deg, self.p_deg, self.r_deg

    def __str__(self) -> str:
        return ",".join(f"{value:.3f}" for value in self.as_tuple())


def fanuc_rotation(w_deg: float, p_deg: float, r_deg: float) -> Array:
    """Return the 3x3 rotation of FANUC's W, P, R: ``Rz(R) Ry(P) Rx(W)`` (references/fanuc.md section 3)."""
    return axis_rotation("z", r_deg) @ axis_rotation("y", p_deg) @ axis_rotation("x", w_deg)


def fanuc_angles_deg(rotation: ArrayLike) -> tuple[float, float, float]:
    """Return W, P, R in degrees of a 3x3 rotation; W is 0 where P is +-90 degrees and only R -+ W is defined."""
    r = np.asarray(rotation, dtype=np.float64)
    cos_p = float(np.hypot(r[0, 0], r[1, 0]))
    p_rad = np.arctan2(-r[2, 0], cos_p)
    if cos_p > 1e-9:  # noqa: PLR2004 - below this the arctangents read rounding noise
        w_rad, r_rad = np.arctan2(r[2, 1], r[2, 2]), np.arctan2(r[1, 0], r[0, 0])
    else:
        w_rad, r_rad = 0.0, np.arctan2(-r[0, 1], r[1, 1])
    w, p, yaw = np.rad2deg([w_rad, p_rad, r_rad])
    return float(w), float(p), float(yaw)


def equation_1(X_co: float, Y_co: float, Z_co: float, alpha_deg: float, beta_deg: float, gamma_deg: float) -> Array:
    """Return T_R^C, the paper's equation (1): ``Trans(X_co, Y_co, Z_co) Rot(x, a) Rot(y, b) Rot(z, g)``, 4x4.

    The paper's angle order is not FANUC's: this is Rx Ry Rz, `fanuc_rotation` is Rz Ry Rx.
    The columns of the rotation are the paper's N, O and A. Lengths in millimetres.
    """
    matrix = np.eye(4)
    matrix[:3, :3] = axis_rotation("x", alpha_deg) @ axis_rotation("y", beta_deg) @ axis_rotation("z", gamma_deg)
    matrix[:3, 3] = (X_co, Y_co, Z_co)
    return matrix


@dataclass(frozen=True, eq=False)
class Transform:
    """``target_T_source``: a rigid transform that knows which frames it connects.

    Attributes:
        target: name of the frame that coordinates are mapped into.
        source: name of the frame that they come from.
        matrix: 4x4 homogeneous matrix, millimetres; read-only.
    """

    target: str
    source: str
    matrix: Array

    def __post_init__(self) -> None:
        """Take a read-only copy and refuse what is not a rigid transform."""
        matrix = np.array(self.matrix, dtype=np.float64)
        if matrix.shape != (4, 4):
            raise ValueError(f"a transform is 4x4, got shape {matrix.shape}")
        rotation = matrix[:3, :3]
        rigid = (
            np.allclose(rotation @ rotation.T, np.eye(3), atol=_ORTHONORMAL_TOLERANCE)
            and np.linalg.det(rotation) > 0
            and np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0])
        )
        if not (rigid and np.isfinite(matrix).all()):
            raise ValueError(f"{self.target}_T_{self.source} is not a rigid transform")
        matrix.flags.writeable = False
        object.__setattr__(self, "matrix", matrix)

    @classmethod
    def from_parts(cls, target: str, source: str, rotation: ArrayLike, translation_mm: ArrayLike) -> Self:
        """Build from a 3x3 rotation and a 3-vector in millimetres."""
        matrix = np.eye(4)
        matrix[:3, :3] = np.asarray(rotation)
        matrix[:3, 3] = np.asarray(translation_mm)
        return cls(target, source, matrix)

    @classmethod
    def from_xyzwpr(cls, target: str, source: str, pose: Xyzwpr) -> Self:
        """Build from FANUC XYZWPR."""
        rotation = fanuc_rotation(pose.w_deg, pose.p_deg, pose.r_deg)
        return cls.from_parts(target, source, rotation, (pose.x_mm, pose.y_mm, pose.z_mm))

    @classmethod
    def identity(cls, target: str, source: str) -> Self:
        """Return the transform between two frames that coincide."""
        return cls(target, source, np.eye(4))

    @property
    def rotation(self) -> Array:
        """The 3x3 rotation."""
        return self.matrix[:3, :3]

    @property
    def translation_mm(self) -> Array:
        """The origin of ``source`` in ``target``, millimetres, shape (3,)."""
        return self.matrix[:3, 3]

    def to_xyzwpr(self) -> Xyzwpr:
        """Return the pose as FANUC XYZWPR."""
        x, y, z = (float(value) for value in self.translation_mm)
        return Xyzwpr(x, y, z, *fanuc_angles_deg(self.rotation))

    def inverse(self) -> Transform:
        """Return ``source_T_target``."""
        rotation = self.rotation.T
        return Transform.from_parts(self.source, self.target, rotation, -rotation @ self.translation_mm)

    def __matmul__(self, other: Transform) -> Transform:
        """Compose ``a_T_b @ b_T_c`` to ``a_T_c``; raises `FrameMismatchError` where b is not the same frame."""
        if self.source != other.target:
            raise FrameMismatchError(
                f"{self.target}_T_{self.source} @ {other.target}_T_{other.source}: "
                f"frame {self.source!r} is not frame {other.target!r}"
            )
        return Transform(self.target, other.source, self.matrix @ other.matrix)

    def apply(self, points_mm: ArrayLike) -> Array:
        """Map points of shape (..., 3) in ``source`` to ``target``, millimetres."""
        return np.asarray(points_mm, dtype=np.float64) @ self.rotation.T + self.translation_mm

    def rotate(self, vectors: ArrayLike) -> Array:
        """Map directions of shape (..., 3): rotation without translation."""
        return np.asarray(vectors, dtype=np.float64) @ self.rotation.T


def pose_difference(a: Transform, b: Transform) -> tuple[float, float]:
    """Return the distance in millimetres and the angle in degrees between two poses of the same frames."""
    if (a.target, a.source) != (b.target, b.source):
        raise FrameMismatchError(f"cannot compare {a.target}_T_{a.source} with {b.target}_T_{b.source}")
    angle_rad = Rotation.from_matrix(a.rotation.T @ b.rotation).magnitude()
    return float(np.linalg.norm(a.translation_mm - b.translation_mm)), float(np.rad2deg(angle_rad))


def wrap_angle_deg(angle_deg: float, period_deg: float = 360.0) -> float:
    """Return the angle reduced to (-period/2, period/2]."""
    half = period_deg / 2.0
    return half - (half - angle_deg) % period_deg
