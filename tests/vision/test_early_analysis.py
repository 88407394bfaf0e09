"""The left image, analysed while the arm travels: the same result, and refused where the arm came elsewhere."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from srvs_cell.calibration import Calibration, CameraIntrinsics, HandEye, plan_right_pose
from srvs_cell.geometry import Transform, Xyzwpr
from srvs_cell.vision import LeftAnalysis, StereoView, VisionParameters, analyse_image, analyse_left, perceive
from tests.vision.pictures import Face, render, square

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.scene import Perception

SHAPE = (240, 320)
CALIBRATION = Calibration(
    camera=CameraIntrinsics(width=320, height=240, fx=400.0, fy=400.0, cx=159.5, cy=119.5, distortion=(0.0,) * 5),
    hand_eye=HandEye(xyz_mm=(0.0, 0.0, 0.0), wpr_deg=(0.0, 0.0, 0.0)),
)
LEFT = Transform.from_xyzwpr("base", "tcp", Xyzwpr(500.0, 0.0, 500.0, 180.0, 0.0, 0.0))
RIGHT = plan_right_pose(CALIBRATION, LEFT, 30.0)
VIEW = StereoView(CALIBRATION, LEFT, RIGHT, table_z_mm=0.0)
FACES = [
    square(90.0, 80.0, 60.0, 150.0, 26.25),
    Face(((170.0, 120.0), (250.0, 120.0), (250.0, 190.0), (170.0, 190.0)), 200.0, (0.0, 0.0, 28.6)),
]
PARAMETERS = VisionParameters()


@pytest.fixture(scope="module")
def pictures() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    return render(FACES, shape=SHAPE, noise=1.0)


def same(one: Perception, other: Perception) -> bool:
    return (
        one.matches == other.matches
        and [part.position_mm for part in one.workpieces] == [part.position_mm for part in other.workpieces]
        and np.array_equal(one.left.labels, other.left.labels)
        and np.array_equal(one.disparity_px, other.disparity_px, equal_nan=True)
    )


def test_an_early_analysis_changes_nothing_but_the_work(
    pictures: tuple[NDArray[np.uint8], NDArray[np.uint8]],
) -> None:
    early = analyse_left(pictures[0], PARAMETERS, VIEW)
    plain = perceive(*pictures, PARAMETERS, view=VIEW)
    reused = perceive(*pictures, PARAMETERS, view=VIEW, early=early)
    assert len(plain.matches) >= 2
    assert same(plain, reused)


def test_it_is_used_where_the_arm_came_a_hair_off_the_plan(
    pictures: tuple[NDArray[np.uint8], NDArray[np.uint8]],
) -> None:
    early = analyse_left(pictures[0], PARAMETERS, VIEW)
    marked = replace(early, image=replace(early.image, planes=(), labels=np.zeros_like(early.image.labels)))
    reported = replace(VIEW, base_T_tcp_right=RIGHT @ Transform.from_xyzwpr("tcp", "tcp", Xyzwpr(0, 0.01, 0, 0, 0, 0)))
    # an analysis that saw nothing leaves nothing to match: so it shows that it was taken
    assert perceive(*pictures, PARAMETERS, view=reported, early=marked).matches == ()


def test_it_is_refused_where_the_reported_pose_turns_the_picture(
    pictures: tuple[NDArray[np.uint8], NDArray[np.uint8]],
) -> None:
    early = analyse_left(pictures[0], PARAMETERS, VIEW)
    marked = replace(early, image=replace(early.image, planes=(), labels=np.zeros_like(early.image.labels)))
    # a millimetre aside on a baseline of 30 turns the rectified rows by two degrees
    aside = RIGHT @ Transform.from_xyzwpr("tcp", "tcp", Xyzwpr(0.0, 1.0, 0.0, 0.0, 0.0, 0.0))
    reported = replace(VIEW, base_T_tcp_right=aside)
    assert same(
        perceive(*pictures, PARAMETERS, view=reported, early=marked), perceive(*pictures, PARAMETERS, view=reported)
    )


def test_an_analysis_without_calibration_is_refused_where_there_is_one(
    pictures: tuple[NDArray[np.uint8], NDArray[np.uint8]],
) -> None:
    bare = LeftAnalysis(analyse_image(np.zeros(SHAPE, dtype=np.uint8), PARAMETERS), None)
    assert same(perceive(*pictures, PARAMETERS, view=VIEW, early=bare), perceive(*pictures, PARAMETERS, view=VIEW))
