"""Kinematics, paths and their timing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.sim.controlled_arm import MotionRefusedError
from drivers.sim.kinematics import JOINT_LIMITS_DEG, JOINT_SPEEDS_DEG_S, Kinematics
from drivers.sim.motion import Motion, MotionLimits, Path, joint_path, linear_path
from srvs_cell.geometry import Array, Transform, Xyzwpr

KINEMATICS = Kinematics(240.0)
LIMITS = MotionLimits()
STEP_S = 0.002


def _matrix(x: float, y: float, z: float, r: float = 0.0, w: float = 180.0) -> Array:
    return Transform.from_xyzwpr("base", "tcp", Xyzwpr(x, y, z, w, 0.0, r)).matrix


def _joints(pose: Array) -> Array:
    joints = KINEMATICS.inverse(pose, np.zeros(6))
    assert joints is not None
    return joints


def _run(path: Path, override: float = 1.0) -> float:
    motion, steps = Motion(path), 0
    while not motion.done:
        motion.advance(STEP_S, override)
        steps += 1
    return steps * STEP_S


def test_stretched_out_the_flange_is_where_the_link_lengths_put_it() -> None:
    pose = KINEMATICS.forward(np.zeros((1, 6)))[0]
    assert pose[:3, 3] == pytest.approx([150.0 + 640.0 + 100.0 + 240.0, 0.0, 600.0 + 200.0])


@settings(max_examples=40)
@given(st.floats(550, 950), st.floats(-300, 300), st.floats(-40, 450), st.floats(-170, 170))
def test_forward_undoes_inverse(x: float, y: float, z: float, r: float) -> None:
    pose = _matrix(x, y, z, r)
    joints = _joints(pose)
    assert (joints >= JOINT_LIMITS_DEG[:, 0]).all()
    assert (joints <= JOINT_LIMITS_DEG[:, 1]).all()
    assert np.abs(KINEMATICS.forward(joints[None])[0] - pose).max() < 1e-6


@settings(max_examples=20)
@given(st.floats(20, 300), st.floats(30, 500))
def test_a_straight_move_takes_the_time_of_its_trapezoid(length: float, speed: float) -> None:
    start = _matrix(700.0, -150.0, 300.0)
    path = linear_path(KINEMATICS, LIMITS, _joints(start), start, _matrix(700.0, -150.0 + length, 300.0), speed)
    a = LIMITS.acceleration_mm_s2
    top = min(speed, np.sqrt(a * length))
    expected = length / top + top / a
    assert _run(path) == pytest.approx(expected, abs=0.02, rel=0.02)


def test_half_override_takes_twice_as_long() -> None:
    start, end = _matrix(700.0, -150.0, 300.0), _matrix(700.0, 150.0, 300.0)
    path = linear_path(KINEMATICS, LIMITS, _joints(start), start, end, 100.0)
    assert _run(path, 0.5) == pytest.approx(2.0 * _run(path), rel=0.03)


def test_a_straight_move_is_straight_and_no_joint_is_too_fast() -> None:
    start, end = _matrix(600.0, -300.0, 100.0, -90.0), _matrix(900.0, 300.0, 300.0, 80.0)
    path = linear_path(KINEMATICS, LIMITS, _joints(start), start, end, 4000.0)
    motion = Motion(path)
    last, fastest = path.joints(0.0), np.zeros(6)
    way = end[:3, 3] - start[:3, 3]
    while not motion.done:
        motion.advance(STEP_S, 1.0)
        joints = path.joints(motion.s)
        fastest = np.maximum(fastest, np.abs(joints - last) / STEP_S)
        last = joints
        from_line = np.cross(path.pose(motion.s)[:3] - start[:3, 3], way) / np.linalg.norm(way)
        assert np.linalg.norm(from_line) < 1e-6
    assert (fastest <= JOINT_SPEEDS_DEG_S * 1.01).all()


def test_a_joint_move_ends_at_its_target_with_the_slowest_joint_at_its_share_of_speed() -> None:
    start, end = _matrix(600.0, -300.0, 100.0, -90.0), _matrix(900.0, 300.0, 300.0, 80.0)
    joints = _joints(start)
    path = joint_path(KINEMATICS, LIMITS, joints, end, 20.0)
    assert path.pose(1.0)[:3] == pytest.approx(end[:3, 3])
    travel = np.abs(path.joints(1.0) - joints)
    at_least = (travel / (0.2 * JOINT_SPEEDS_DEG_S)).max()
    assert at_least < _run(path) < at_least + LIMITS.joint_acceleration_s


def test_a_stop_decelerates_on_the_path_and_ends_short() -> None:
    start, end = _matrix(700.0, -150.0, 300.0), _matrix(700.0, 150.0, 300.0)
    motion = Motion(linear_path(KINEMATICS, LIMITS, _joints(start), start, end, 200.0))
    while motion.s < 0.5:
        motion.advance(STEP_S, 1.0)
    motion.stop()
    at = motion.s
    while not motion.done:
        motion.advance(STEP_S, 1.0)
    assert motion.stopped
    braking_mm = (motion.s - at) * 300.0
    assert braking_mm == pytest.approx(200.0**2 / 2.0 / LIMITS.acceleration_mm_s2, abs=0.6)


def test_what_is_out_of_reach_is_refused() -> None:
    start, far = _matrix(700.0, 0.0, 300.0), _matrix(1600.0, 0.0, 300.0)
    with pytest.raises(MotionRefusedError, match="MOTN-018"):
        linear_path(KINEMATICS, LIMITS, _joints(start), start, far, 100.0)
    with pytest.raises(MotionRefusedError, match="MOTN-018"):
        joint_path(KINEMATICS, LIMITS, _joints(start), far, 20.0)


def test_a_straight_move_across_the_end_of_j1_behind_the_robot_is_refused() -> None:
    start, end = _matrix(-700.0, 100.0, 300.0), _matrix(-700.0, -100.0, 300.0)
    near = np.array([172.0, 0.0, 0.0, 0.0, -90.0, 0.0])
    joints = KINEMATICS.inverse(start, near)
    assert joints is not None
    with pytest.raises(MotionRefusedError, match="MOTN-017"):
        linear_path(KINEMATICS, LIMITS, joints, start, end, 100.0)


def test_a_straight_move_through_the_wrist_singularity_is_refused() -> None:
    start = KINEMATICS.forward(np.array([[0.0, 0.0, 0.0, 0.0, -20.0, 0.0]]))[0]
    end = KINEMATICS.forward(np.array([[0.0, 0.0, 0.0, 0.0, 20.0, 0.0]]))[0]
    with pytest.raises(MotionRefusedError, match="MOTN-023"):
        linear_path(KINEMATICS, LIMITS, np.array([0.0, 0.0, 0.0, 0.0, -20.0, 0.0]), start, end, 100.0)
