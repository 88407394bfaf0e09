"""The simulated arm: what every controller double drives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from drivers.sim.controlled_arm import MotionRefusedError
from drivers.sim.motion import Motion, MotionLimits, joint_path, joints_path, linear_path
from drivers.sim.world import pose_matrix, pose_vector
from drivers.sim.world_model import TIMESTEP_S
from srvs_cell.geometry import Transform, Xyzwpr
from srvs_cell.ports import RobotMode

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.sim.clock_authority import SimTime
    from drivers.sim.kinematics import Kinematics
    from drivers.sim.world import World
    from srvs_cell.geometry import Array

CLOSE_OUTPUT, OPEN_OUTPUT = 1, 2
HELD_INPUT, OPEN_INPUT, CLOSED_INPUT = 1, 2, 3
_PERCENT: Final = 100.0
_COLLISION_N: Final = 100.0
_COLLISION_STEPS: Final = 2
_GIVE_WAY_MM: Final = 2.0
_COLLISION_FAULT: Final = "SRVO-050 Collision Detect alarm"


@dataclass(frozen=True)
class Repeatability:
    """How far the true pose is from the reported one, one standard deviation per axis, normal, cut at 2.5 sigma."""

    position_mm: float = 0.0
    angle_deg: float = 0.0
    cut: float = 2.5

    def draw(self, random: np.random.Generator) -> Array:
        """Return an error as (x, y, z) in millimetres and a rotation vector in degrees, shape (6,)."""
        unit = np.clip(random.standard_normal(6), -self.cut, self.cut)
        return np.asarray(unit * np.repeat([self.position_mm, self.angle_deg], 3))


class SimArm:
    """Arm, gripper valve and sensors behind one controller. All calls are thread-safe.

    What it reports is what the controller believes; the true pose differs by the repeatability.

    Args:
        time: simulated time, whose lock guards the world.
        world: what the arm moves in.
        kinematics: of arm and tool.
        home: where it begins; the world's hand must be there.
        repeatability: error of the true pose.
        random: of the errors.
        limits: what it can do besides its joints' speeds.

    Attributes:
        mode, pendant_enabled, servo_on: switches of the controller.
        override_percent: speed override, 1 to 100, acts at once.
        fault: the controller's alarm as on the pendant, or None.
    """

    def __init__(
        self,
        time: SimTime,
        world: World,
        kinematics: Kinematics,
        home: Xyzwpr,
        repeatability: Repeatability,
        random: np.random.Generator,
        limits: MotionLimits | None = None,
    ) -> None:
        self.mode = RobotMode.AUTO
        self.pendant_enabled = False
        self.servo_on = True
        self.override_percent = 100
        self.fault: str | None = None
        self._time, self._world, self._kinematics = time, world, kinematics
        self._repeatability, self._random = repeatability, random
        self._limits = limits or MotionLimits()
        start = Transform.from_xyzwpr("base", "tcp", home).matrix
        self._reported = pose_vector(start)
        joints = kinematics.inverse(start, np.zeros(6))
        if joints is None:
            raise ValueError(f"the arm cannot begin at {home}")
        self._joints_deg = joints
        self._motion: Motion | None = None
        self._stopped_short = False
        self._error = self._error_before = self._error_at_target = repeatability.draw(random)
        self._strained_steps = 0
        self._least_force_n = 0.0
        self._outputs: dict[int, bool] = {}
        world.lead(self._true_pose())

    @property
    def moving(self) -> bool:
        """Whether a motion is under way."""
        return self._motion is not None

    @property
    def stopped_short(self) -> bool:
        """Whether the last motion ended before its target."""
        return self._stopped_short

    @property
    def pose(self) -> Xyzwpr:
        """The reported base_T_tcp."""
        with self._time.lock:
            return Transform("base", "tcp", pose_matrix(self._reported)).to_xyzwpr()

    @property
    def joints_deg(self) -> tuple[float, ...]:
        """The joint angles J1 to J6, J3 relative to link 2."""
        with self._time.lock:
            return tuple(float(q) for q in self._joints_deg)

    def start_linear(self, target: Xyzwpr, speed_mm_s: float) -> None:
        """Begin a straight motion; raises `MotionRefusedError` where it cannot be made."""
        with self._time.lock:
            self._check_ready()
            goal = Transform.from_xyzwpr("base", "tcp", target).matrix
            start = pose_matrix(self._reported)
            self._begin(Motion(linear_path(self._kinematics, self._limits, self._joints_deg, start, goal, speed_mm_s)))

    def start_joint(self, target: Xyzwpr, speed_percent: float) -> None:
        """Begin a joint motion; raises `MotionRefusedError` where it cannot be made."""
        with self._time.lock:
            self._check_ready()
            goal = Transform.from_xyzwpr("base", "tcp", target).matrix
            self._begin(Motion(joint_path(self._kinematics, self._limits, self._joints_deg, goal, speed_percent)))

    def start_joints(self, target_deg: Sequence[float], speed_percent: float) -> None:
        """Begin a joint motion to joint angles; raises `MotionRefusedError` where they are beyond their limits."""
        with self._time.lock:
            self._check_ready()
            end_deg = np.array(target_deg)
            self._begin(Motion(joints_path(self._kinematics, self._limits, self._joints_deg, end_deg, speed_percent)))

    def stop(self) -> None:
        """Decelerate to a stand on the path."""
        with self._time.lock:
            if self._motion is not None:
                self._motion.stop()

    def raise_fault(self, fault: str, *, servo_off: bool = False) -> None:
        """Let the controller fall into a fault: the arm stops at once."""
        with self._time.lock:
            self.fault = fault
            self.servo_on = self.servo_on and not servo_off
            self._halt()

    def reset_fault(self) -> None:
        """Clear the fault; power comes back."""
        with self._time.lock:
            self.fault = None
            self.servo_on = True
            self._strained_steps = 0

    def set_output(self, n: int, on: bool) -> None:
        """Switch DO[n]; 1 closes and 2 opens the gripper, the valve keeps its place without either."""
        with self._time.lock:
            self._outputs[n] = on
            if on and n == CLOSE_OUTPUT:
                self._world.close_jaws()
            elif on and n == OPEN_OUTPUT:
                self._world.open_jaws()

    def output(self, n: int) -> bool:
        """Read DO[n]."""
        return self._outputs.get(n, False)

    def input(self, n: int) -> bool:
        """Read DI[n]: 1 part held, 2 gripper fully open, 3 fully closed and empty."""
        with self._time.lock:
            if n == HELD_INPUT:
                return self._world.held_part() is not None
            if n == OPEN_INPUT:
                return self._world.fully_open
            return n == CLOSED_INPUT and self._world.fully_closed

    def step(self) -> None:
        """Go on by one time step and feel for collisions; called under the world's lock before the world's own step."""
        motion = self._motion
        if motion is None:
            return
        if self._collided():
            self.fault = _COLLISION_FAULT
            self._halt()
            return
        motion.advance(TIMESTEP_S, self.override_percent / _PERCENT)
        self._follow(motion)
        if motion.done:
            self._end(motion)

    def _check_ready(self) -> None:
        if self.fault is not None:
            raise MotionRefusedError(self.fault)
        if not self.servo_on:
            raise MotionRefusedError("SRVO-003 Deadman switch released")
        if self._motion is not None:
            raise MotionRefusedError("PRIO-001 The arm is moving")

    def _begin(self, motion: Motion) -> None:
        self._motion, self._stopped_short, self._strained_steps = motion, False, 0
        self._least_force_n = self._world.force_on_hand_n()
        self._error_before, self._error_at_target = self._error, self._repeatability.draw(self._random)

    def _follow(self, motion: Motion) -> None:
        self._reported = motion.path.pose(motion.s)
        self._error = self._error_before + motion.s * (self._error_at_target - self._error_before)
        self._world.lead(self._true_pose())

    def _end(self, motion: Motion) -> None:
        self._joints_deg = motion.path.joints(motion.s)
        self._stopped_short = motion.stopped
        self._motion = None

    def _halt(self) -> None:
        motion = self._motion
        if motion is not None:
            motion.halt(_GIVE_WAY_MM)
            self._follow(motion)
            self._end(motion)

    def _collided(self) -> bool:
        """Feel for a disturbance as a controller's collision guard does.

        What already pressed on the hand when the motion began is no disturbance: after a reset the arm may move away
        from what it has hit (SRVO-050: reset, then move off). It counts from the least force since then, so that
        pressing harder, and any new contact, stop the arm.
        """
        force_n = self._world.force_on_hand_n()
        self._least_force_n = min(self._least_force_n, force_n)
        strained = force_n > self._least_force_n + _COLLISION_N
        self._strained_steps = self._strained_steps + 1 if strained else 0
        return self._strained_steps >= _COLLISION_STEPS

    def _true_pose(self) -> Array:
        if not self._error.any():
            return self._reported
        pose = self._reported.copy()
        pose[:3] += self._error[:3]
        a, b, c = (math.radians(angle) / 2.0 for angle in self._error[3:].tolist())  # tiny: the sine is the angle
        w, x, y, z = pose[3:].tolist()
        pose[3:] = (
            w - a * x - b * y - c * z,
            x + a * w + b * z - c * y,
            y + b * w + c * x - a * z,
            z + c * w + a * y - b * x,
        )
        return pose
