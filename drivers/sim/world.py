"""The physical world: steps MuJoCo, leads the hand, works the gripper, feels collisions, tells what is where.

Not thread-safe by itself: everything is called under the simulation's one lock (`SimTime.lock`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from drivers.sim.world_model import MM, TIMESTEP_S, build_model

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.sim.gripper_geometry import GripperGeometry
    from drivers.sim.parts import Part
    from srvs_cell.geometry import Array

_AT_END_MM: Final = 1.0
_HELD_FORCE_N: Final = 5.0
_REST_SPEED: Final = 2e-3
_REST_STEPS: Final = 150
_FIRST_REST_STEPS: Final = 500
_FREE_QPOS: Final = 7
_FREE_DOFS: Final = 6
_SIX: Final = 6


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Where everything was at an instant.

    Attributes:
        time_s: simulated seconds.
        qpos: MuJoCo's positions.
        base_T_tcp: true pose of the TCP, 4x4, millimetres.
    """

    time_s: float
    qpos: Array
    base_T_tcp: Array  # noqa: N815 - the notation of transforms


@dataclass(frozen=True, eq=False)
class PartPose:
    """The true pose of a part: base_T_part, 4x4, millimetres."""

    base_T_part: Array  # noqa: N815 - the notation of transforms

    @property
    def tilt_deg(self) -> float:
        """Angle of the part's own up axis against the vertical."""
        return float(np.rad2deg(np.arccos(np.clip(self.base_T_part[2, 2], -1.0, 1.0))))

    @property
    def yaw_deg(self) -> float:
        """Direction of the part's own x axis, from base x towards base y, modulo 180."""
        return float(np.rad2deg(np.arctan2(self.base_T_part[1, 0], self.base_T_part[0, 0])) % 180.0)


class World:
    """Table, parts and gripper under physics.

    Args:
        parts: what stands on the table.
        gripper: the tool.
        table_centre_mm: centre of the table's top, base frame.
        base_T_tcp: where the hand begins, 4x4, millimetres.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        gripper: GripperGeometry,
        table_centre_mm: tuple[float, float, float],
        base_T_tcp: Array,
    ) -> None:
        self.parts = tuple(parts)
        self.gripper = gripper
        self.table_z_mm = table_centre_mm[2]
        self.model = build_model(parts, gripper, table_centre_mm)
        self.time_s = 0.0
        self._data = mujoco.MjData(self.model)
        self._part_bodies = [self.model.body(f"part{i}").id for i in range(len(self.parts))]
        self._part_geoms = {self.model.geom(f"part{i}").id: i for i in range(len(self.parts))}
        self._finger_geoms = [self.model.geom(f"finger{i}").id for i in range(2)]
        self._finger_qpos = [int(self.model.joint(f"finger{i}").qposadr[0]) for i in range(2)]
        self._hand_qpos = int(self.model.body("hand").jntadr[0])
        self._hand_qpos = int(self.model.jnt_qposadr[self._hand_qpos])
        self._part_dofs = _FREE_DOFS * len(self.parts)
        self._tcp = pose_vector(base_T_tcp)
        self._closing = False
        self._rest_steps = 0
        self._place_hand()
        self._command_jaws()
        for _ in range(_FIRST_REST_STEPS):
            mujoco.mj_step(self.model, self._data)
        self._data.qvel[:] = 0.0
        mujoco.mj_forward(self.model, self._data)
        self.start_poses = self.part_poses()

    @property
    def base_T_tcp(self) -> Array:
        """True pose of the TCP, 4x4, millimetres."""
        return pose_matrix(self._tcp)

    @property
    def opening_mm(self) -> float:
        """Distance between the inner faces of the fingers."""
        return float(sum(self._data.qpos[i] for i in self._finger_qpos) / MM)

    @property
    def fully_open(self) -> bool:
        """What the sensor at the open end says."""
        return self.opening_mm > self.gripper.max_opening_mm - _AT_END_MM

    @property
    def fully_closed(self) -> bool:
        """What the sensor at the closed end says."""
        return self.opening_mm < _AT_END_MM

    def close_jaws(self) -> None:
        """Let the fingers press together with the grip force."""
        self._closing = True
        self._command_jaws()

    def open_jaws(self) -> None:
        """Let the fingers move apart to their ends."""
        self._closing = False
        self._command_jaws()

    def held_part(self) -> int | None:
        """Return the part that both fingers press on, or None."""
        if not self._closing:
            return None
        force = np.zeros(_SIX)
        pressed = np.zeros((len(self.parts), 2))
        for index in range(self._data.ncon):
            pair = self._data.contact[index].geom
            for own, other in ((pair[0], pair[1]), (pair[1], pair[0])):
                if own in self._finger_geoms and other in self._part_geoms:
                    mujoco.mj_contactForce(self.model, self._data, index, force)
                    pressed[self._part_geoms[int(other)], self._finger_geoms.index(own)] += force[0]
        held = np.flatnonzero(pressed.min(axis=1) > _HELD_FORCE_N) if len(self.parts) else np.array([], dtype=int)
        return int(held[0]) if len(held) else None

    def lead(self, pose: Array) -> None:
        """Set where the arm has the TCP from now on: position in millimetres and quaternion, shape (7,)."""
        self._tcp = pose
        self._data.mocap_pos[0] = pose[:3] * MM
        self._data.mocap_quat[0] = pose[3:]
        self._rest_steps = 0

    def step(self) -> None:
        """Advance by one time step; while nothing moves, only time does."""
        self.time_s += TIMESTEP_S
        if self._rest_steps > _REST_STEPS:
            return
        mujoco.mj_step(self.model, self._data)
        if abs(self._data.qvel).max() < _REST_SPEED:
            self._rest_steps += 1
        else:
            self._rest_steps = 0

    def force_on_hand_n(self) -> float:
        """Force between arm and hand: what the parts and the table do to the tool, the arm's own weight left out."""
        x, y, z = self._data.efc_force[:3].tolist()
        return math.sqrt(x * x + y * y + z * z)

    def part_poses(self) -> tuple[PartPose, ...]:
        """Return the true pose of every part."""
        poses = []
        for body in self._part_bodies:
            pose = np.eye(4)
            pose[:3, :3] = self._data.xmat[body].reshape(3, 3)
            pose[:3, 3] = self._data.xpos[body] / MM
            poses.append(PartPose(pose))
        return tuple(poses)

    def put_part(self, index: int, base_T_part: Array) -> None:
        """Put a part somewhere else, as a person's hand would."""
        joint = int(self.model.body(self._part_bodies[index]).jntadr[0])
        start = int(self.model.jnt_qposadr[joint])
        self._data.qpos[start : start + _FREE_QPOS] = _qpos(pose_vector(base_T_part))
        self._data.qvel[_FREE_DOFS * index : _FREE_DOFS * (index + 1)] = 0.0
        mujoco.mj_forward(self.model, self._data)
        self._rest_steps = 0

    def snapshot(self) -> Snapshot:
        """Return where everything is now."""
        return Snapshot(self.time_s, self._data.qpos.copy(), pose_matrix(self._tcp))

    def _command_jaws(self) -> None:
        self._data.ctrl[:] = 0.0 if self._closing else self.gripper.max_opening_mm * MM / 2.0
        self._rest_steps = 0

    def _place_hand(self) -> None:
        self.lead(self._tcp)
        self._data.qpos[self._hand_qpos : self._hand_qpos + _FREE_QPOS] = _qpos(self._tcp)
        for address in self._finger_qpos:
            self._data.qpos[address] = self.gripper.max_opening_mm * MM / 2.0
        mujoco.mj_forward(self.model, self._data)


def pose_vector(matrix: Array) -> Array:
    """Return position in millimetres and unit quaternion, w first, shape (7,), of a 4x4 pose."""
    return np.concatenate([matrix[:3, 3], Rotation.from_matrix(matrix[:3, :3]).as_quat(scalar_first=True)])


def pose_matrix(vector: Array) -> Array:
    """Return the 4x4 pose of a `pose_vector`."""
    matrix = np.eye(4)
    matrix[:3, 3] = vector[:3]
    matrix[:3, :3] = Rotation.from_quat(vector[3:], scalar_first=True).as_matrix()
    return matrix


def _qpos(vector: Array) -> Array:
    """Return a `pose_vector` as MuJoCo has it, in metres."""
    return np.concatenate([vector[:3] * MM, vector[3:]])
