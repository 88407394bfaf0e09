"""A scene that is moved, turned, mirrored or lit otherwise has the same answer, moved accordingly."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.sim.parts import CYLINDER, PRISM, WEDGE, Part, prism_across_flats_mm
from srvs_cell.geometry import Transform, Xyzwpr, axis_rotation, wrap_angle_deg
from srvs_cell.vision import StereoView, VisionParameters, perceive
from tests.vision.rendered import part, stereo_pair

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.scene import Workpiece

    Scene = tuple[NDArray[np.uint8], NDArray[np.uint8], StereoView]

PARTS = [
    part(size_mm=(62.0, 38.0), height_mm=45.0, at_mm=(710.0, -60.0), yaw_deg=25.0, albedo=0.75),
    part(CYLINDER, (38.0, 38.0), 60.0, (790.0, -45.0), albedo=0.6),
    part(PRISM, (44.0, prism_across_flats_mm(44.0)), 30.0, (715.0, 55.0), 12.0, albedo=0.8),
    part(WEDGE, (60.0, 40.0), 42.0, (795.0, 60.0), 140.0, albedo=0.7, low_height_mm=20.0),
]
CENTRE_MM = np.array([750.0, 0.0])
NEAR_MM = 0.8
"""The grain of table and parts, the noise and the pixels' grid are other ones after a move."""


def see(scene: Scene) -> tuple[Workpiece, ...]:
    left, right, view = scene
    return perceive(left, right, VisionParameters(), view=view).workpieces


def same(one: tuple[Workpiece, ...], other: tuple[Workpiece, ...], base_T_base: Transform, near_mm: float) -> None:
    """Check that the other answer is the one answer moved."""
    assert sorted(workpiece.kind for workpiece in other) == sorted(workpiece.kind for workpiece in one)
    turn_deg = float(np.rad2deg(np.arctan2(base_T_base.rotation[1, 0], base_T_base.rotation[0, 0])))
    for workpiece in one:
        moved = base_T_base.apply(np.array(workpiece.position_mm))
        twin = min(other, key=lambda seen: float(np.linalg.norm(np.array(seen.position_mm) - moved)))
        assert twin.kind == workpiece.kind
        assert np.array(twin.position_mm) == pytest.approx(moved, abs=near_mm)
        assert twin.height_mm == pytest.approx(workpiece.height_mm, abs=near_mm)
        assert twin.size_mm == pytest.approx(workpiece.size_mm, abs=near_mm)
        assert (twin.yaw_deg is None) == (workpiece.yaw_deg is None)
        if twin.yaw_deg is not None and workpiece.yaw_deg is not None:
            assert abs(wrap_angle_deg(twin.yaw_deg - workpiece.yaw_deg - turn_deg, 180.0)) < near_mm


@pytest.fixture(scope="module")
def scene() -> Scene:
    return stereo_pair(PARTS)


@pytest.fixture(scope="module")
def answer(scene: Scene) -> tuple[Workpiece, ...]:
    workpieces = see(scene)
    assert sorted(workpiece.kind for workpiece in workpieces) == ["cuboid", "cylinder", "prism", "wedge"]
    return workpieces


pytestmark = pytest.mark.slow
STILL = Transform.from_xyzwpr("base", "base", Xyzwpr(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


@given(st.floats(0.6, 1.15), st.floats(-5.0, 10.0))
@settings(max_examples=2, derandomize=True)
def test_a_brighter_or_darker_scene_has_the_same_answer(
    scene: Scene, answer: tuple[Workpiece, ...], gain: float, offset: float
) -> None:
    left, right, view = scene
    lit = [np.clip(np.rint(gain * image + offset), 0, 255).astype(np.uint8) for image in (left, right)]
    same(answer, see((lit[0], lit[1], view)), STILL, NEAR_MM / 2.0)


@given(st.floats(-400.0, 400.0), st.floats(-400.0, 400.0), st.floats(-90.0, 90.0), st.floats(-180.0, 180.0))
@settings(max_examples=2, derandomize=True)
def test_another_base_frame_moves_the_answer(
    scene: Scene, answer: tuple[Workpiece, ...], x_mm: float, y_mm: float, z_mm: float, turn_deg: float
) -> None:
    left, right, view = scene
    moved = Transform.from_xyzwpr("base", "base", Xyzwpr(x_mm, y_mm, z_mm, 0.0, 0.0, turn_deg))
    elsewhere = replace(
        view,
        base_T_tcp_left=moved @ view.base_T_tcp_left,
        base_T_tcp_right=moved @ view.base_T_tcp_right,
        table_z_mm=view.table_z_mm + z_mm,
    )
    same(answer, see((left, right, elsewhere)), moved, NEAR_MM / 2.0)


def moved_parts(turn_deg: float, shift_mm: Array) -> list[Part]:
    """Return the parts turned about the middle of the table and shifted."""
    turn = axis_rotation("z", turn_deg)[:2, :2]
    moved = []
    for one in PARTS:
        x_mm, y_mm = turn @ (np.array([one.x_mm, one.y_mm]) - CENTRE_MM) + CENTRE_MM + shift_mm
        moved.append(replace(one, x_mm=float(x_mm), y_mm=float(y_mm), yaw_deg=one.yaw_deg + turn_deg))
    return moved


@pytest.mark.parametrize(("turn_deg", "shift_mm"), [(0.0, (14.3, -11.7)), (90.0, (0.0, 0.0)), (180.0, (-9.0, 6.4))])
def test_parts_that_are_turned_and_shifted_move_the_answer(
    answer: tuple[Workpiece, ...], turn_deg: float, shift_mm: tuple[float, float]
) -> None:
    turn = axis_rotation("z", turn_deg)
    shift = np.append(CENTRE_MM + shift_mm - turn[:2, :2] @ CENTRE_MM, 0.0)
    moved = Transform.from_parts("base", "base", turn, shift)
    same(answer, see(stereo_pair(moved_parts(turn_deg, np.array(shift_mm)))), moved, 2.0 * NEAR_MM)


def test_a_mirrored_scene_has_the_mirrored_answer(scene: Scene, answer: tuple[Workpiece, ...]) -> None:
    """Seen in a mirror the right image becomes the left one; the lens and the path are mirrored, too."""
    left, right, view = scene
    camera = view.calibration.camera
    k1, k2, p1, p2, k3 = camera.distortion
    mirrored = replace(camera, cx=camera.width - 1.0 - camera.cx, distortion=(k1, k2, p1, -p2, k3))
    flipped = [np.ascontiguousarray(image[:, ::-1]) for image in (right, left)]
    seen = see((flipped[0], flipped[1], replace(view, calibration=replace(view.calibration, camera=mirrored))))
    assert len(seen) == len(answer)
    for workpiece in answer:
        x_mm, y_mm, z_mm = workpiece.position_mm
        twin = min(seen, key=lambda one: float(np.hypot(one.position_mm[0] - x_mm, one.position_mm[1] + y_mm)))
        assert twin.kind == workpiece.kind
        assert twin.position_mm == pytest.approx((x_mm, -y_mm, z_mm), abs=NEAR_MM)
        assert twin.size_mm == pytest.approx(workpiece.size_mm, abs=NEAR_MM)
        if twin.yaw_deg is not None and workpiece.yaw_deg is not None:
            assert abs(wrap_angle_deg(twin.yaw_deg + workpiece.yaw_deg, 180.0)) < NEAR_MM
