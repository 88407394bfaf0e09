"""The arm: a FANUC M-10iA (the Arc Mate 100iC is its welding variant) by its OPW parameters and joint limits.

Numbers: ros-industrial/fanuc, fanuc_m10ia_support, which cites the manual B-82754EN/09 (references/sim.md section 4).
The base frame is FANUC's World: on the height of the J2 axis, 450 mm above the floor plate.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from py_opw_kinematics import KinematicModel, Robot
from scipy.spatial.transform import RigidTransform, Rotation

if TYPE_CHECKING:
    from srvs_cell.geometry import Array

_J2_HEIGHT_MM: Final = 450.0
_MODEL: Final = KinematicModel(
    a1=150.0,
    a2=-200.0,
    b=0.0,
    c1=_J2_HEIGHT_MM,
    c2=600.0,
    c3=640.0,
    c4=100.0,
    offsets=(0.0, 0.0, -90.0, 0.0, 0.0, 180.0),
    flip_axes=(False, False, True, True, True, True),
)
JOINT_LIMITS_DEG: Final = np.array([[-180, 180], [-90, 160], [-180, 264], [-190, 190], [-190, 190], [-360, 360]], float)
JOINT_SPEEDS_DEG_S: Final = np.array([210.0, 190.0, 210.0, 400.0, 400.0, 600.0])
_TURN_DEG: Final = 360.0


class Kinematics:
    """Forward and inverse kinematics of arm and tool.

    Args:
        flange_to_tcp_mm: length of the tool along the flange's axis.
    """

    def __init__(self, flange_to_tcp_mm: float) -> None:
        self._robot = Robot(_MODEL, degrees=True)
        # OPW measures from the floor, the base frame is higher
        self._floor_T_base = RigidTransform.from_translation([0.0, 0.0, _J2_HEIGHT_MM])
        self._base_T_floor = self._floor_T_base.inv()
        self._flange_T_tcp = RigidTransform.from_translation([0.0, 0.0, flange_to_tcp_mm])
        self._tcp_T_flange = self._flange_T_tcp.inv()

    def forward(self, joints_deg: Array) -> Array:
        """Return base_T_tcp, 4x4 matrices in millimetres of shape (N, 4, 4), of joint angles of shape (N, 6)."""
        floor_T_flange = self._robot.batch_forward(np.ascontiguousarray(joints_deg))
        return np.asarray((self._base_T_floor * floor_T_flange * self._flange_T_tcp).as_matrix()).reshape(-1, 4, 4)

    def inverse(self, base_T_tcp: Array, near_deg: Array) -> Array | None:
        """Return the joint angles within limits that are nearest to ``near_deg``, or None where there are none.

        Args:
            base_T_tcp: 4x4, millimetres.
            near_deg: present joint angles, shape (6,).
        """
        return _nearest(self._solutions(base_T_tcp), near_deg)

    def reaches(self, base_T_tcp: Array) -> bool:
        """Return whether the pose could be reached if joint limits did not matter."""
        return len(self._solutions(base_T_tcp)) > 0

    def follow(self, poses: Array, from_deg: Array) -> Array:
        """Return the joint angles along a dense path of poses (N, 4, 4), staying in the configuration of ``from_deg``.

        Whole turns are unwrapped from ``from_deg``; limits are not applied. Shape (N, 6); NaN where a pose is out of
        reach.
        """
        path = self._floor_T_base * RigidTransform.from_matrix(poses) * self._tcp_T_flange
        joints = np.asarray(self._robot.batch_inverse(path, tuple(float(q) for q in from_deg)), dtype=np.float64)
        steps = np.diff(joints, axis=0, prepend=from_deg[None])
        return joints - np.cumsum(np.round(steps / _TURN_DEG), axis=0) * _TURN_DEG

    def _solutions(self, base_T_tcp: Array) -> Array:
        pose = RigidTransform.from_components(
            np.asarray(base_T_tcp)[:3, 3], Rotation.from_matrix(np.asarray(base_T_tcp)[:3, :3])
        )
        found = self._robot.inverse(self._floor_T_base * pose * self._tcp_T_flange)
        solutions = np.array(found, dtype=np.float64).reshape(-1, len(JOINT_LIMITS_DEG))
        return solutions[np.isfinite(solutions).all(axis=1)]


def _nearest(solutions: Array, near_deg: Array) -> Array | None:
    """Choose among solutions, and their whole turns, the one within limits with the least joint travel."""
    if not len(solutions):
        return None
    turned = solutions + _TURN_DEG * np.round((near_deg - solutions) / _TURN_DEG)
    low, high = JOINT_LIMITS_DEG.T
    turned = np.where(turned > high, turned - _TURN_DEG, turned)
    turned = np.where(turned < low, turned + _TURN_DEG, turned)
    inside = ((turned >= low) & (turned <= high)).all(axis=1)
    if not inside.any():
        return None
    cost = np.abs(turned - near_deg).max(axis=1)
    return np.asarray(turned[np.where(inside, cost, np.inf).argmin()])
