from __future__ import annotations

import functools
import itertools

import cv2
import numpy as np
import pytest

from drivers.sim.gripper_geometry import CameraMount, GripperGeometry
from drivers.sim.lens import Lens
from drivers.sim.parts import WEDGE, Part
from drivers.sim.scenario import ScenarioError, make_scenario
from drivers.sim.simulation import BASELINE_MM, OBSERVE_POSE, TABLE_CENTRE_MM
from srvs_cell.geometry import Array, Transform, Xyzwpr, axis_rotation

GRIPPER = GripperGeometry()
CASES = [*itertools.product((3, 5, 8), range(4)), (10, 0), (10, 1)]


@functools.cache
def _table(count: int, seed: int) -> tuple[Part, ...]:
    return make_scenario(count, seed, GRIPPER)


def _gap_mm(a: Array, b: Array) -> float:
    """Return how far two convex polygons are apart, 0 where they overlap."""
    overlap, _ = cv2.intersectConvexConvex(a.astype(np.float32), b.astype(np.float32))
    if overlap > 0.0:
        return 0.0
    return min(
        -cv2.pointPolygonTest(first.astype(np.float32), (float(x), float(y)), measureDist=True)
        for first, second in ((a, b), (b, a))
        for x, y in second
    )


def _open_fingers(part: Part) -> list[Array]:
    near, far = GRIPPER.max_opening_mm / 2.0, GRIPPER.max_opening_mm / 2.0 + GRIPPER.finger_thickness_mm
    half = GRIPPER.finger_width_mm / 2.0
    turn = axis_rotation("z", part.yaw_deg + 90.0)[:2, :2].T
    finger = np.array([[near, -half], [far, -half], [far, half], [near, half]])
    return [finger @ turn, -finger @ turn]


@pytest.mark.parametrize(("count", "seed"), [(3, 0), (3, 1), (5, 0), (5, 1), (6, 2)])
def test_every_part_can_be_gripped_at_every_place(count: int, seed: int) -> None:
    parts = _table(count, seed)
    places = [np.array([part.x_mm, part.y_mm]) for part in parts]
    for mine, theirs in itertools.permutations(range(count), 2):
        for me, other in itertools.permutations(parts, 2):
            for body in (me.footprint_mm(), *_open_fingers(me)):
                assert _gap_mm(body + places[mine], other.footprint_mm() + places[theirs]) > 4.0


@pytest.mark.parametrize(("count", "seed"), CASES)
def test_heights_differ_enough_to_be_put_in_order(count: int, seed: int) -> None:
    heights = sorted(part.height_mm for part in _table(count, seed))
    assert min(np.diff(heights)) >= 5.0 - 1e-9
    assert heights[0] >= 15.0
    assert heights[-1] <= 110.0


@pytest.mark.parametrize(("count", "seed"), CASES)
def test_no_two_places_have_nearly_one_y(count: int, seed: int) -> None:
    y_mm = sorted(part.y_mm for part in _table(count, seed))
    assert min(np.diff(y_mm)) >= 8.0


def test_ties_are_two_parts_of_nearly_one_height() -> None:
    heights = sorted(part.height_mm for part in make_scenario(5, 3, GRIPPER, ties=True))
    assert sum(step <= 1.0 for step in np.diff(heights)) == 1


@pytest.mark.parametrize(("count", "seed"), CASES)
def test_every_top_is_whole_in_both_pictures(count: int, seed: int) -> None:
    lens, mount = Lens(), CameraMount().transform()
    for part in _table(count, seed):
        corners = part.vertices_mm()
        top = corners[len(corners) // 2 :]
        world = top @ axis_rotation("z", part.yaw_deg).T + (part.x_mm, part.y_mm, TABLE_CENTRE_MM[2])
        for shift_mm in (0.0, -BASELINE_MM):
            x, y, z, w, p, r = OBSERVE_POSE.as_tuple()
            camera = (Transform.from_xyzwpr("base", "tcp", Xyzwpr(x, y + shift_mm, z, w, p, r)) @ mount).inverse()
            pixels = lens.project(camera.apply(world))
            assert (pixels > 2.0).all()
            assert (pixels < (lens.width - 3.0, lens.height - 3.0)).all()


def test_the_same_seed_gives_the_same_table_and_another_one_another() -> None:
    assert make_scenario(5, 7, GRIPPER) == make_scenario(5, 7, GRIPPER)
    assert make_scenario(5, 7, GRIPPER) != make_scenario(5, 8, GRIPPER)


def test_parts_fit_the_gripper_and_wedges_are_inclined() -> None:
    parts = [part for seed in range(12) for part in _table(5, seed)]
    assert max(part.grip_width_mm for part in parts) < GRIPPER.max_opening_mm - 10.0
    wedges = [part for part in parts if part.kind == WEDGE]
    assert wedges
    assert all(part.low_height_mm < part.height_mm for part in wedges)
    assert len({part.kind for part in parts}) == 4


@pytest.mark.parametrize("count", [0, 11])
def test_too_few_or_too_many_parts_are_refused(count: int) -> None:
    with pytest.raises(ScenarioError, match="1 to 10"):
        make_scenario(count, 0, GRIPPER)
