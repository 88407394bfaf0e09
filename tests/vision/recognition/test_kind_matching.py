"""Which top faces are one object, and of which kind."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from srvs_cell.vision.faces.face import Face, Figure
from srvs_cell.vision.recognition.grasping import GraspParameters, plan_joint_grasp
from srvs_cell.vision.recognition.kind_matching import FaceGroup, gap_mm, group_faces
from srvs_cell.vision.recognition.kinds import BUILT_IN_KINDS, FacePattern, FaceRelation, ObjectKind

TABLE_Z_MM = 5.0
HEXAGON = Face(Figure.HEXAGON, 0.0, 0.0, 40.0, 0.0, 40.0, 34.641)
CIRCLE = Face(Figure.CIRCLE, 0.0, 0.0, 40.0, 0.0, 40.0, 40.0)


def block(x_mm: float = 0.0, y_mm: float = 0.0, z_mm: float = 45.0, turn_deg: float = 0.0, slope: float = 0.0) -> Face:
    return Face(Figure.RECTANGLE, x_mm, y_mm, z_mm, float(np.deg2rad(turn_deg)), 60.0, 40.0, slope)


def kind(name: str = "mine", **limits: tuple[float, float]) -> ObjectKind:
    pattern: dict[str, Any] = {"outline": Figure.RECTANGLE, **limits}
    return ObjectKind(name=name, faces={"top": FacePattern(**pattern)})


STEP = ObjectKind(
    name="step",
    faces={"upper": FacePattern(outline=Figure.RECTANGLE), "lower": FacePattern(outline=Figure.RECTANGLE)},
    relations=(FaceRelation(between=("upper", "lower"), step_mm=(10.0, 30.0), turn_deg=(0.0, 5.0)),),
)


def names(faces: list[Face], *kinds: ObjectKind) -> list[str | None]:
    return [None if group.kind is None else group.kind.name for group in group_faces(faces, TABLE_Z_MM, kinds)]


@pytest.mark.parametrize(
    ("face", "name"),
    [(block(), "cuboid"), (block(slope=0.3), "wedge"), (CIRCLE, "cylinder"), (HEXAGON, "prism")],
)
def test_the_built_in_kinds_are_told_by_outline_and_inclination(face: Face, name: str) -> None:
    assert names([face], *BUILT_IN_KINDS) == [name]


@pytest.mark.parametrize(
    ("key", "value"), [("length_mm", 60.0), ("width_mm", 40.0), ("aspect", 1.5), ("height_mm", 40.0)]
)
def test_both_ends_of_a_range_belong_to_it_and_nothing_beyond(key: str, value: float) -> None:
    for least, greatest, name in (
        (value, value + 1.0, "mine"),
        (value - 0.4, value, "mine"),
        (value + 0.1, value + 1.0, None),
        (value - 0.4, value - 0.1, None),
    ):
        assert names([block()], kind("mine", **{key: (least, greatest)})) == [name]


def test_inclination_is_a_range_too() -> None:
    gentle = block(slope=float(np.tan(np.deg2rad(12.0))))
    assert names([gentle], kind(inclination_deg=(11.0, 13.0))) == ["mine"]
    assert names([gentle], kind(inclination_deg=(13.0, 30.0))) == [None]
    assert names([gentle], kind()) == [None]


def test_the_first_kind_that_fits_wins() -> None:
    assert names([block()], kind("one"), kind("two")) == ["one"]
    assert names([block()], kind("one", aspect=(1.0, 1.2)), kind("two")) == ["two"]


def test_two_faces_that_lie_as_a_kind_says_are_one_object() -> None:
    upper, lower = block(), block(x_mm=62.0, z_mm=25.0)
    for faces, members in (([upper, lower], (0, 1)), ([lower, upper], (1, 0))):
        assert group_faces(faces, TABLE_Z_MM, [*BUILT_IN_KINDS, STEP]) == [FaceGroup(STEP, members)]


@pytest.mark.parametrize(
    "lower",
    [
        block(x_mm=70.0, z_mm=25.0),
        block(x_mm=62.0, z_mm=10.0),
        block(x_mm=62.0, z_mm=40.0),
        block(x_mm=64.0, z_mm=25.0, turn_deg=8.0),
    ],
    ids=["too far", "too low", "too high", "turned"],
)
def test_two_faces_that_lie_otherwise_are_two_objects(lower: Face) -> None:
    assert names([block(), lower], *BUILT_IN_KINDS, STEP) == ["cuboid", "cuboid"]


def test_of_several_partners_the_closest_is_right() -> None:
    upper, near, far = block(), block(x_mm=61.0, z_mm=25.0), block(x_mm=-63.0, z_mm=25.0)
    groups = group_faces([far, upper, near], TABLE_Z_MM, [*BUILT_IN_KINDS, STEP])
    assert [(group.kind and group.kind.name, group.members) for group in groups] == [("cuboid", (0,)), ("step", (1, 2))]


def test_the_angle_between_normals_is_measured_in_space() -> None:
    # two roof sides of 30 degrees that meet at a ridge along y
    slope = float(np.tan(np.deg2rad(30.0)))
    west, east = block(x_mm=-30.0, slope=slope), block(x_mm=30.0, slope=-slope)
    roof = FacePattern(outline=Figure.RECTANGLE, inclination_deg=(20.0, 40.0))
    for limits, name in (((59.9, 60.1), "gable"), ((60.1, 90.0), None)):
        relation = FaceRelation(between=("a", "b"), angle_deg=limits)
        gable = ObjectKind(name="gable", faces={"a": roof, "b": roof}, relations=(relation,))
        assert names([west, east], gable)[0] == name


def test_the_gap_of_outlines() -> None:
    assert gap_mm(block(), block(x_mm=70.0)) == pytest.approx(10.0, abs=1e-3)
    assert gap_mm(block(), block(x_mm=63.0, y_mm=44.0)) == pytest.approx(5.0, abs=1e-3)
    assert gap_mm(block(), block(turn_deg=90.0)) == 0.0
    assert gap_mm(block(), replace(CIRCLE, y_mm=45.0)) == pytest.approx(5.0, abs=0.2)


KINDS = [kind("flat", height_mm=(0.0, 30.0)), kind("long", length_mm=(50.0, 100.0)), STEP]


@given(st.lists(st.tuples(*[st.integers(0, 4)] * 4), max_size=6))
@settings(max_examples=60)
def test_every_face_belongs_to_exactly_one_object_that_fits_it(drawn: list[tuple[int, int, int, int]]) -> None:
    faces = [block(31.0 * x, 41.0 * y, 20.0 + 8.0 * z, 45.0 * turn) for x, y, z, turn in drawn]
    groups = group_faces(faces, TABLE_Z_MM, KINDS)
    assert sorted(member for group in groups for member in group.members) == list(range(len(faces)))
    for group in groups:
        if group.kind is None:
            assert faces[group.members[0]].length_mm == 60.0
        else:
            assert group.kind in KINDS
            assert len(group.members) == len(group.kind.faces)


def test_a_joint_grasp_closes_over_the_middle_and_as_deep_as_the_lowest_wall_allows() -> None:
    faces = [block(-30.0, z_mm=45.0), block(30.0, z_mm=25.0)]
    body = Face(Figure.RECTANGLE, 0.0, 0.0, 45.0, 0.0, 120.0, 40.0)
    grasp, refusal = plan_joint_grasp(body, faces, 0.01 * np.eye(3), TABLE_Z_MM, GraspParameters(depth_mm=12.0))
    assert refusal == ""
    assert grasp is not None
    assert grasp.position_mm == pytest.approx((0.0, 0.0, 25.0 - 12.0))
    assert grasp.yaw_deg == pytest.approx(90.0)
    assert grasp.opening_mm == pytest.approx(40.0)


def test_a_joint_grasp_is_refused_where_there_is_no_wall() -> None:
    # an L: the middle of two of its sides is air
    faces = [block(0.0, 0.0), block(50.0, 50.0, turn_deg=90.0)]
    body = Face(Figure.RECTANGLE, 20.0, 30.0, 45.0, 0.0, 100.0, 100.0)
    grasp, refusal = plan_joint_grasp(body, faces, 0.01 * np.eye(3), TABLE_Z_MM, GraspParameters(max_opening_mm=150.0))
    assert grasp is None
    assert "too low: the gripped wall is 0.0 mm" in refusal
