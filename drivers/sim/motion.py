"""Paths of the arm and how fast they are run: straight or joint-interpolated, with a trapezoidal speed profile.

A path is a table of samples over the path parameter s from 0 to 1. A `Motion` runs along it under the speed and
acceleration limits that the path demands; override and stop act at any time, on the path.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Self

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.sim.controlled_arm import MotionRefusedError
from drivers.sim.kinematics import JOINT_LIMITS_DEG, JOINT_SPEEDS_DEG_S

if TYPE_CHECKING:
    from drivers.sim.kinematics import Kinematics
    from srvs_cell.geometry import Array

_SAMPLES: Final = 129
_SINGULAR_J5_DEG: Final = 1.0
_MAX_JOINT_STEP_DEG: Final = 15.0
_STILL_MM: Final = 1e-4
_STILL_DEG: Final = 1e-4
_PERCENT: Final = 100.0


@dataclass(frozen=True, kw_only=True)
class MotionLimits:
    """What the arm can do besides its joints' speeds.

    Attributes:
        acceleration_mm_s2, acceleration_deg_s2: of the TCP on straight moves.
        rotation_speed_deg_s: of the TCP on straight moves.
        joint_acceleration_s: seconds in which a joint reaches its top speed.
    """

    acceleration_mm_s2: float = 2000.0
    acceleration_deg_s2: float = 600.0
    rotation_speed_deg_s: float = 180.0
    joint_acceleration_s: float = 0.35


@dataclass(frozen=True)
class Path:
    """Samples over the path parameter.

    Attributes:
        poses: base_T_tcp as x, y, z in millimetres and a unit quaternion, w first, shape (N, 7).
        joints_deg: shape (N, 6).
        speed: greatest ds/dt in 1/s.
        acceleration: greatest d2s/dt2 in 1/s^2.
        length_mm: of the TCP's way.
    """

    poses: Array
    joints_deg: Array
    speed: float
    acceleration: float
    length_mm: float

    @classmethod
    def through(cls, matrices: Array, joints_deg: Array, speed: float, acceleration: float) -> Self:
        """Return the path through 4x4 poses of shape (N, 4, 4)."""
        quaternions = Rotation.from_matrix(matrices[:, :3, :3]).as_quat(scalar_first=True)
        # neighbours on the same half of the sphere, so that they can be interpolated
        flips = np.sign(np.einsum("ij,ij->i", quaternions[1:], quaternions[:-1]))
        quaternions[1:] *= np.cumprod(flips)[:, None]
        positions = matrices[:, :3, 3]
        length_mm = float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum())
        return cls(np.hstack([positions, quaternions]), joints_deg, speed, acceleration, length_mm)

    def pose(self, s: float) -> Array:
        """Return base_T_tcp at ``s`` as position and unit quaternion, shape (7,)."""
        at = min(max(s, 0.0), 1.0) * (len(self.poses) - 1)
        low = min(int(at), len(self.poses) - 2)
        share = at - low
        pose = (1.0 - share) * self.poses[low] + share * self.poses[low + 1]
        pose[3:] /= math.sqrt(float(pose[3:] @ pose[3:]))
        return np.asarray(pose)

    def joints(self, s: float) -> Array:
        """Return the joint angles at ``s`` in degrees, shape (6,)."""
        at = min(max(s, 0.0), 1.0) * (len(self.poses) - 1)
        low = min(int(at), len(self.poses) - 2)
        return np.asarray(self.joints_deg[low] + (at - low) * (self.joints_deg[low + 1] - self.joints_deg[low]))


def linear_path(
    kinematics: Kinematics, limits: MotionLimits, joints_deg: Array, start: Array, target: Array, speed_mm_s: float
) -> Path:
    """Return the straight path from ``start`` to ``target`` (4x4 base_T_tcp).

    The path speed is lowered where it would ask too much of a joint.

    Raises:
        MotionRefusedError: a pose on the way is out of reach, outside joint limits, or singular.
    """
    s = np.linspace(0.0, 1.0, _SAMPLES)
    turn = Rotation.from_matrix(start[:3, :3].T @ target[:3, :3])
    poses = np.tile(np.eye(4), (_SAMPLES, 1, 1))
    poses[:, :3, 3] = start[:3, 3] + s[:, None] * (target[:3, 3] - start[:3, 3])
    rotvec = turn.as_rotvec()
    if turn.magnitude() < np.deg2rad(_STILL_DEG):
        poses[:, :3, :3] = target[:3, :3]
    else:
        poses[:, :3, :3] = start[:3, :3] @ Rotation.from_rotvec(s[:, None] * rotvec).as_matrix()
    if not kinematics.reaches(target):
        raise MotionRefusedError("MOTN-018 Position not reachable")
    path_joints = kinematics.follow(poses, joints_deg)
    _check_joints(path_joints)
    length_mm = float(np.linalg.norm(target[:3, 3] - start[:3, 3]))
    angle_deg = float(np.rad2deg(turn.magnitude()))
    joint_rate = np.abs(np.diff(path_joints, axis=0)).max(axis=0) * (_SAMPLES - 1)
    speed = min(
        speed_mm_s / max(length_mm, _STILL_MM),
        limits.rotation_speed_deg_s / max(angle_deg, _STILL_DEG),
        float((JOINT_SPEEDS_DEG_S / np.maximum(joint_rate, _STILL_DEG)).min()),
    )
    acceleration = min(
        limits.acceleration_mm_s2 / max(length_mm, _STILL_MM), limits.acceleration_deg_s2 / max(angle_deg, _STILL_DEG)
    )
    return Path.through(poses, path_joints, speed, acceleration)


def joint_path(
    kinematics: Kinematics, limits: MotionLimits, joints_deg: Array, target: Array, speed_percent: float
) -> Path:
    """Return the path on which all joints start and stop together, to ``target`` (4x4 base_T_tcp).

    Raises:
        MotionRefusedError: the target is out of reach or outside joint limits.
    """
    end_deg = kinematics.inverse(target, joints_deg)
    if end_deg is None:
        if kinematics.reaches(target):
            raise MotionRefusedError("MOTN-017 Limit error")
        raise MotionRefusedError("MOTN-018 Position not reachable")
    return joints_path(kinematics, limits, joints_deg, end_deg, speed_percent)


def joints_path(
    kinematics: Kinematics, limits: MotionLimits, joints_deg: Array, end_deg: Array, speed_percent: float
) -> Path:
    """Return the path on which all joints start and stop together, to the joint angles ``end_deg``.

    Raises:
        MotionRefusedError: an angle is beyond its limits.
    """
    low, high = JOINT_LIMITS_DEG.T
    if ((end_deg < low) | (end_deg > high)).any():
        raise MotionRefusedError("MOTN-017 Limit error")
    s = np.linspace(0.0, 1.0, _SAMPLES)
    path_joints = joints_deg + s[:, None] * (end_deg - joints_deg)
    poses = kinematics.forward(path_joints)
    way = np.maximum(np.abs(end_deg - joints_deg), _STILL_DEG)
    speed = float((JOINT_SPEEDS_DEG_S * speed_percent / _PERCENT / way).min())
    acceleration = float((JOINT_SPEEDS_DEG_S / limits.joint_acceleration_s / way).min())
    return Path.through(poses, path_joints, speed, acceleration)


def _check_joints(joints_deg: Array) -> None:
    if not np.isfinite(joints_deg).all():
        raise MotionRefusedError("MOTN-018 Position not reachable on the way")
    low, high = JOINT_LIMITS_DEG.T
    if ((joints_deg < low) | (joints_deg > high)).any():
        raise MotionRefusedError("MOTN-017 Limit error on the way")
    steps = np.abs(np.diff(joints_deg, axis=0))
    if np.abs(joints_deg[:, 4]).min() < _SINGULAR_J5_DEG or (steps > _MAX_JOINT_STEP_DEG).any():
        raise MotionRefusedError("MOTN-023 In singularity")


class Motion:
    """One run along a path, advanced in small steps of time.

    Attributes:
        path: the way.
        s: where on it.
        stopped: whether it ended, or is about to end, before the target.
        done: whether it has ended.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.s = 0.0
        self.stopped = False
        self.done = False
        self._rate = 0.0

    def advance(self, seconds: float, override: float) -> None:
        """Go on for ``seconds``; ``override`` (0 to 1) scales the path speed."""
        if self.done:
            return
        limit = self.path.acceleration
        wanted = 0.0 if self.stopped else self.path.speed * override
        before, most = self._rate, limit * seconds
        # the greatest rate after this step from which the rest of the way is enough to stop
        rest = most * most - 4.0 * (most * before - 2.0 * limit * (1.0 - self.s))
        wanted = min(wanted, max((math.sqrt(max(rest, 0.0)) - most) / 2.0, 0.0))
        self._rate = max(before + min(max(wanted - before, -most), most), 0.0)
        self.s += (before + self._rate) / 2.0 * seconds
        if self.s >= 1.0 - self.path.acceleration * seconds * seconds:
            self.s, self.done, self.stopped = 1.0, True, False
        elif self.stopped and self._rate == 0.0:
            self.done = True

    def stop(self) -> None:
        """Decelerate to a stand."""
        self.stopped = not self.done

    def halt(self, back_mm: float) -> None:
        """Stop at once and give way by ``back_mm`` along the path: what a collision makes the controller do."""
        self.s = max(0.0, self.s - back_mm / max(self.path.length_mm, back_mm))
        self._rate, self.stopped, self.done = 0.0, True, True
