"""Where the TCP goes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis.strategies import floats, sampled_from

from srvs_cell.cell.manipulator import turning_stops
from srvs_cell.cell.motion import HeldPart, held_part
from srvs_cell.geometry import Xyzwpr, fanuc_rotation, wrap_angle_deg
from srvs_cell.planning import Approach, Carry, CellMove, LegTops
from srvs_cell.planning.hand import tool_rotation_deg
from srvs_cell.scene import Grasp
from tests.cell.support import PARAMETERS, seen, three_blocks

from drivers.sim.doubles import World  # isort: skip

ANGLE = floats(-360.0, 360.0)


@given(yaw_deg=ANGLE, present_deg=ANGLE, axis=sampled_from(["x", "y"]))
def test_the_jaws_close_along_the_grasps_yaw(yaw_deg: float, present_deg: float, axis: str) -> None:
    r_deg = tool_rotation_deg(yaw_deg, axis, present_deg)
    assert abs(r_deg - present_deg) <= 90.0 + 1e-9
    rotation = fanuc_rotation(180.0, 0.0, r_deg)
    jaws = rotation[:, "xy".index(axis)]
    yaw = np.deg2rad(yaw_deg)
    assert abs(jaws @ np.array([np.cos(yaw), np.sin(yaw), 0.0])) == pytest.approx(1.0, abs=1e-9)
    assert rotation[:, 2] == pytest.approx([0.0, 0.0, -1.0])


@given(at_z_mm=floats(0.0, 300.0), travel_z_mm=floats(0.0, 500.0), approach_mm=floats(1.0, 200.0))
def test_an_approach_only_goes_down(at_z_mm: float, travel_z_mm: float, approach_mm: float) -> None:
    at = Xyzwpr(1.0, 2.0, at_z_mm, 180.0, 0.0, 30.0)
    way = Approach.of(at, travel_z_mm, approach_mm)
    assert way.at.z_mm <= way.near.z_mm <= way.above.z_mm
    assert {(pose.x_mm, pose.y_mm, pose.r_deg) for pose in (way.at, way.near, way.above)} == {(1.0, 2.0, 30.0)}


HAND = replace(PARAMETERS.hand(), table_z_mm=10.0, release_gap_mm=1.5, clearance_mm=30.0, approach_mm=40.0)
TOPS = LegTops(60.0, 80.0, 20.0)


def test_a_part_is_let_go_as_far_from_its_grasp_as_it_was_moved() -> None:
    workpiece = seen(World(three_blocks())).workpieces[1]
    assert workpiece.grasp is not None
    at = HAND.grasp_pose(Carry((300.0, 0.0), (310.0, -5.0)).grasp(workpiece.grasp))
    assert (at.x_mm, at.y_mm, at.z_mm) == (310.0, -5.0, 30.0)
    part = held_part(workpiece, CellMove(1, (310.0, -5.0), (250.0, 100.0), TOPS), at, HAND)
    assert (part.place.x_mm, part.place.y_mm, part.place.z_mm, part.place.r_deg) == (250.0, 100.0, 31.5, at.r_deg)
    assert part.hang_mm == 20.0
    assert HeldPart.from_json(part.as_json()) == part


@given(seen_deg=ANGLE, turn_deg=floats(-90.0, 90.0))
def test_a_part_that_is_turned_is_let_go_where_its_grasp_then_is(seen_deg: float, turn_deg: float) -> None:
    move = CellMove(1, (300.0, 0.0), (250.0, 100.0), TOPS, turn_deg=turn_deg)
    grasp = Grasp((312.0, 5.0, 30.0), seen_deg, 30.0)
    at = HAND.grasp_pose(grasp, turn_deg)
    release = HAND.release_pose(at, move.carry)
    wanted = HAND.grasp_pose(move.carry.grasp(grasp))
    assert (release.x_mm, release.y_mm) == pytest.approx((wanted.x_mm, wanted.y_mm))
    # The part turns with the hand, by that much and no half turn more; nowhere does the wrist go farther than it must.
    assert release.r_deg - at.r_deg == pytest.approx(turn_deg)
    assert abs(wrap_angle_deg(release.r_deg - wanted.r_deg, 180.0)) == pytest.approx(0.0, abs=1e-6)
    assert max(abs(at.r_deg), abs(release.r_deg)) <= 90.0 + abs(turn_deg) / 2.0 + 1e-6


def test_each_leg_passes_above_what_stands_under_it() -> None:
    at = Xyzwpr(300.0, 0.0, 50.0, 180.0, 0.0, 0.0)
    way, lifted = HAND.pick_way(at, TOPS)
    assert (way.above.z_mm, way.near.z_mm, way.at.z_mm) == (100.0, 90.0, 50.0)
    # What hangs 40 mm below the TCP passes 30 mm above what is 80 mm high.
    assert lifted.z_mm == 10.0 + 80.0 + 30.0 + 40.0
    down, leave = HAND.place_way(at, 40.0, TOPS)
    assert down.above.z_mm == lifted.z_mm
    assert (leave.near.z_mm, leave.above.z_mm) == (60.0, 60.0)


def test_the_tool_never_turns_more_than_a_quarter_from_the_observe_pose() -> None:
    grasp = Grasp((0.0, 0.0, 10.0), 0.0, 30.0)
    turned = replace(HAND, observe=Xyzwpr(0.0, 0.0, 0.0, 180.0, 0.0, -80.0))
    assert turned.grasp_pose(grasp).r_deg == pytest.approx(-90.0)


@given(begin_deg=ANGLE, end_deg=ANGLE)
def test_a_long_turn_stops_so_often_that_its_sense_is_certain(begin_deg: float, end_deg: float) -> None:
    begin, end = Xyzwpr(100.0, 0.0, 50.0, 180.0, 0.0, begin_deg), Xyzwpr(200.0, 50.0, 80.0, 180.0, 0.0, end_deg)
    way = [begin, *turning_stops(begin, end)]
    assert way[-1] == end
    turns_deg = np.diff([pose.r_deg for pose in way])
    assert np.abs(turns_deg).max() <= 150.0 + 1e-9
    assert turns_deg.sum() == pytest.approx(end_deg - begin_deg, abs=1e-9)
    steps_mm = np.diff([pose.as_tuple()[:3] for pose in way], axis=0)
    assert np.allclose(steps_mm, np.array([100.0, 50.0, 30.0]) / len(steps_mm))
    assert len(way) == 2 or abs(end_deg - begin_deg) > 150.0
