"""What the fingers touch decides what moves."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from drivers.sim.controlled_arm import MotionRefusedError
from drivers.sim.gripper_geometry import GripperGeometry
from drivers.sim.parts import CUBOID, WEDGE, Part
from drivers.sim.truth import truth
from drivers.sim.world import World
from srvs_cell.geometry import Transform, Xyzwpr, axis_rotation, pose_difference, wrap_angle_deg
from tests.drivers.sim.stepping import above, finish_motion, go, grasp_pose, grip, make_simulation, offset, pass_time

if TYPE_CHECKING:
    from pathlib import Path

HELD, FULLY_OPEN, CLOSED_EMPTY = 1, 2, 3


@pytest.mark.parametrize("seed", [0, 2])
def test_centred_grasps_carry_every_kind_of_part_and_put_it_back(tmp_path: Path, seed: int) -> None:
    simulation = make_simulation(tmp_path, objects=4, seed=seed)
    arm = simulation.arm
    for index in range(4):
        pose = grasp_pose(simulation, index)
        go(simulation, above(pose))
        go(simulation, pose, 80.0)
        grip(simulation, close=True)
        assert arm.input(HELD)
        go(simulation, above(pose), 200.0)
        assert truth(simulation)["parts"][index]["base_mm"][2] > simulation.world.table_z_mm + 20.0
        assert simulation.world.held_part() == index
        go(simulation, offset(above(pose), 30.0, 0.0))
        go(simulation, above(pose))
        go(simulation, offset(pose, 0.0, 1.0), 80.0)
        grip(simulation, close=False)
        assert arm.input(FULLY_OPEN)
        assert not arm.input(HELD)
        go(simulation, above(pose), 200.0)
    for part in truth(simulation)["parts"]:
        assert part["tilt_deg"] < 0.5
        assert np.linalg.norm(np.subtract(part["position_mm"], part["start"]["position_mm"])) < 0.5
    assert arm.fault is None


def test_a_wedge_that_is_put_down_the_wrong_way_round_has_the_same_yaw_and_rises_the_other_way(tmp_path: Path) -> None:
    simulation = make_simulation(tmp_path, objects=3, seed=0)
    kinds = [part.kind for part in simulation.world.parts]
    assert [part["rise_deg"] is None for part in truth(simulation)["parts"]] == [kind != WEDGE for kind in kinds]
    number = kinds.index(WEDGE)
    wedge = simulation.world.parts[number]
    x_mm, y_mm, _ = wedge.vertices_mm()[np.argmax(wedge.vertices_mm()[:, 2])]
    high_mm = axis_rotation("z", wedge.yaw_deg)[:2, :2] @ (x_mm, y_mm)
    before = truth(simulation)["parts"][number]
    rise = np.deg2rad(before["rise_deg"])
    # along the rise the high corner is half a length away from the middle
    assert high_mm @ (np.cos(rise), np.sin(rise)) == pytest.approx(wedge.length_mm / 2.0, abs=0.1)

    pose = grasp_pose(simulation, number)
    go(simulation, above(pose))
    go(simulation, pose, 80.0)
    grip(simulation, close=True)
    for turn_deg in (0.0, 90.0, 180.0):
        go(simulation, replace(above(pose), r_deg=pose.r_deg + turn_deg))
    go(simulation, replace(offset(pose, 0.0, 1.0), r_deg=pose.r_deg + 180.0), 80.0)
    grip(simulation, close=False)
    after = truth(simulation)["parts"][number]
    assert wrap_angle_deg(after["yaw_deg"] - before["yaw_deg"], 180.0) == pytest.approx(0.0, abs=1.0)
    assert abs(wrap_angle_deg(after["rise_deg"] - before["rise_deg"], 360.0)) == pytest.approx(180.0, abs=1.0)


def _steel_bar() -> Part:
    """1.3 kg at the density of the parts, so long that an off-centre grip has a long lever."""
    return Part(
        kind=CUBOID,
        length_mm=240.0,
        width_mm=50.0,
        height_mm=100.0,
        low_height_mm=100.0,
        x_mm=750.0,
        y_mm=0.0,
        yaw_deg=0.0,
        albedo=0.6,
        label=False,
    )


@pytest.mark.parametrize(("along_mm", "tips"), [(0.0, False), (80.0, True)])
def test_an_off_centre_grasp_tips_a_heavy_part(along_mm: float, tips: bool) -> None:
    start = Transform.from_xyzwpr("base", "tcp", Xyzwpr(750.0 + along_mm, 0.0, 38.0, 180.0, 0.0, 180.0)).matrix
    world = World((_steel_bar(),), GripperGeometry(), (750.0, 0.0, -50.0), start)
    pose = np.array([750.0 + along_mm, 0.0, 38.0, 0.0, 0.0, 1.0, 0.0])
    world.close_jaws()
    for _ in range(300):
        world.step()
    assert world.held_part() == 0
    for _ in range(700):
        pose = pose + np.array([0, 0, 0.1, 0, 0, 0, 0])
        world.lead(pose)
        world.step()
    assert (world.part_poses()[0].tilt_deg > 3.0) == tips


def test_closing_beside_the_parts_is_felt_as_closed_and_empty(tmp_path: Path) -> None:
    simulation = make_simulation(tmp_path)
    grip(simulation, close=True)
    assert simulation.arm.input(CLOSED_EMPTY)
    assert not simulation.arm.input(HELD)
    assert not simulation.arm.input(FULLY_OPEN)


def test_fingers_that_land_on_a_part_make_the_controller_stop_in_a_fault(tmp_path: Path) -> None:
    simulation = make_simulation(tmp_path)
    arm = simulation.arm
    grip(simulation, close=True)
    tallest = max(range(3), key=lambda i: simulation.world.parts[i].height_mm)
    pose = grasp_pose(simulation, tallest)
    go(simulation, above(pose))
    arm.start_linear(pose, 80.0)
    finish_motion(simulation)
    assert "SRVO-050" in str(truth(simulation)["arm"]["fault"])
    assert arm.stopped_short
    assert arm.pose.z_mm > pose.z_mm + 5.0
    pass_time(simulation, 0.2)
    arm.reset_fault()
    go(simulation, above(pose))
    assert truth(simulation)["arm"]["fault"] is None
    assert arm.pose.z_mm == pytest.approx(above(pose).z_mm)


@pytest.mark.parametrize("into", ["table", "part"])
def test_after_the_reset_the_arm_may_rise_from_what_it_was_driven_into_but_not_press_deeper(
    tmp_path: Path, into: str
) -> None:
    simulation = make_simulation(tmp_path)
    arm = simulation.arm
    grip(simulation, close=True)
    pose = grasp_pose(simulation, 0)
    if into == "table":
        pose = replace(pose, y_mm=pose.y_mm + 150.0, z_mm=simulation.world.table_z_mm - 20.0)
    go(simulation, above(pose))
    go(simulation, pose, 500.0)
    assert "SRVO-050" in str(arm.fault)
    pass_time(simulation, 0.3)
    assert simulation.world.force_on_hand_n() > 100.0, "the arm has not stopped clear of it"

    arm.reset_fault()
    stuck_z_mm = arm.pose.z_mm
    go(simulation, pose, 50.0)
    assert "SRVO-050" in str(arm.fault)
    assert arm.pose.z_mm == pytest.approx(stuck_z_mm, abs=1.0)

    arm.reset_fault()
    go(simulation, above(pose), 80.0)
    assert arm.fault is None
    assert arm.pose.z_mm == pytest.approx(above(pose).z_mm)


@pytest.mark.parametrize(
    ("forces_n", "stops"),
    [
        ([0.0, 90.0], False),
        ([0.0, 110.0], True),
        ([300.0, 310.0, 200.0, 100.0, 0.0], False),
        ([300.0, 410.0], True),
        ([300.0, 200.0, 310.0], True),
        ([300.0, 0.0, 110.0], True),
    ],
)
def test_the_collision_guard_counts_from_the_least_force_since_the_motion_began(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, forces_n: list[float], stops: bool
) -> None:
    simulation = make_simulation(tmp_path)
    arm = simulation.arm
    force_n = forces_n[0]
    monkeypatch.setattr(simulation.world, "force_on_hand_n", lambda: force_n)
    arm.start_linear(offset(arm.pose, 0.0, 50.0), 80.0)
    for force_n in forces_n:  # noqa: B007 - what the lambda above returns
        pass_time(simulation, 0.02)
    assert (arm.fault is not None) == stops
    assert arm.moving == (not stops)


def test_nothing_moves_by_itself(tmp_path: Path) -> None:
    simulation = make_simulation(tmp_path, objects=6, seed=4)
    pass_time(simulation, 4.0)
    for part in truth(simulation)["parts"]:
        assert np.linalg.norm(np.subtract(part["position_mm"], part["start"]["position_mm"])) < 0.01


def test_a_part_that_is_pushed_wakes_and_moves(tmp_path: Path) -> None:
    simulation = make_simulation(tmp_path)
    world = simulation.world
    pass_time(simulation, 2.0)
    grip(simulation, close=True)
    part = max(range(3), key=lambda i: world.parts[i].height_mm)
    beside = offset(grasp_pose(simulation, part), -70.0, 0.0)
    beside = Xyzwpr(beside.x_mm, beside.y_mm, world.table_z_mm + 10.0, *beside.as_tuple()[3:])
    go(simulation, above(beside))
    go(simulation, beside, 80.0)
    go(simulation, offset(beside, 60.0, 0.0), 80.0)
    moved = truth(simulation)["parts"][part]
    assert np.linalg.norm(np.subtract(moved["base_mm"], moved["start"]["base_mm"])) > 10.0


def test_true_and_reported_pose_differ_by_the_repeatability(tmp_path: Path) -> None:
    simulation = make_simulation(tmp_path, level="real")
    differences = []
    for y_mm in (10.0, -10.0) * 10:
        go(simulation, Xyzwpr(675.0, y_mm, 400.0, 180.0, 0.0, 0.0))
        true = Transform("base", "tcp", simulation.world.base_T_tcp)
        differences.append(pose_difference(true, Transform.from_xyzwpr("base", "tcp", simulation.arm.pose)))
    distance_mm, angle_deg = np.array(differences).T
    assert 0.02 < np.sqrt((distance_mm**2).mean() / 3.0) < 0.045
    assert 0.003 < np.sqrt((angle_deg**2).mean() / 3.0) < 0.008


def test_an_emergency_stop_stops_the_arm_and_refuses_until_reset(tmp_path: Path) -> None:
    simulation = make_simulation(tmp_path)
    target = Xyzwpr(700.0, 100.0, 300.0, 180.0, 0.0, 0.0)
    simulation.arm.start_linear(target, 100.0)
    pass_time(simulation, 0.5)
    simulation.arm.raise_fault("SRVO-001 Operator panel E-stop", servo_off=True)
    assert not simulation.arm.moving
    assert simulation.arm.stopped_short
    assert not simulation.arm.servo_on
    with pytest.raises(MotionRefusedError, match="SRVO-001"):
        simulation.arm.start_linear(target, 100.0)
    simulation.arm.reset_fault()
    go(simulation, target)
    assert simulation.arm.pose.y_mm == pytest.approx(100.0)
