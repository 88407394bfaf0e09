"""Poses and frames: FANUC's convention, equation (1), and loud failure on mismatched frames."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from srvs_cell.geometry import (
    FrameMismatchError,
    Transform,
    Xyzwpr,
    equation_1,
    fanuc_angles_deg,
    fanuc_rotation,
    pose_difference,
    wrap_angle_deg,
)

angles = st.floats(-180, 180)
lengths = st.floats(-2000, 2000)
poses = st.builds(Xyzwpr, lengths, lengths, lengths, angles, angles, angles)


@given(angles, angles, angles)
def test_fanuc_rotation_is_about_fixed_axes(w: float, p: float, r: float) -> None:
    expected = Rotation.from_euler("xyz", [w, p, r], degrees=True).as_matrix()  # lower case: extrinsic
    assert np.allclose(fanuc_rotation(w, p, r), expected, atol=1e-12)


@given(angles, st.sampled_from([-90.0, 90.0, 89.9999, 12.0, 180.0]), angles)
def test_fanuc_angles_give_the_same_rotation_back(w: float, p: float, r: float) -> None:
    rotation = fanuc_rotation(w, p, r)
    assert np.allclose(fanuc_rotation(*fanuc_angles_deg(rotation)), rotation, atol=1e-9)


def test_equation_1_is_rx_ry_rz_and_not_fanucs_order() -> None:
    expected = Rotation.from_euler("XYZ", [10, 20, 30], degrees=True).as_matrix()  # upper case: intrinsic
    matrix = equation_1(1, 2, 3, 10, 20, 30)
    assert np.allclose(matrix[:3, :3], expected)
    assert matrix[:3, 3].tolist() == [1, 2, 3]
    assert not np.allclose(matrix[:3, :3], fanuc_rotation(10, 20, 30), atol=1e-3)


@given(poses)
def test_inverse_undoes(pose: Xyzwpr) -> None:
    base_T_tcp = Transform.from_xyzwpr("base", "tcp", pose)
    distance_mm, angle_deg = pose_difference(base_T_tcp @ base_T_tcp.inverse(), Transform.identity("base", "base"))
    assert distance_mm < 1e-9
    assert angle_deg < 1e-5


def test_mismatched_frames_fail_loudly() -> None:
    a = Transform.identity("base", "tcp")
    with pytest.raises(FrameMismatchError, match="'tcp' is not frame 'base'"):
        a @ a


def test_a_matrix_that_shears_is_refused() -> None:
    matrix = np.eye(4)
    matrix[0, 1] = 0.1
    with pytest.raises(ValueError, match="base_T_tcp is not a rigid transform"):
        Transform("base", "tcp", matrix)


@given(st.floats(-1e4, 1e4), st.sampled_from([180.0, 360.0]))
def test_wrapped_angles_lie_in_the_half_open_interval(angle: float, period: float) -> None:
    wrapped = wrap_angle_deg(angle, period)
    assert -period / 2 < wrapped <= period / 2 + 1e-9
    assert abs((wrapped - angle) / period - round((wrapped - angle) / period)) < 1e-9
