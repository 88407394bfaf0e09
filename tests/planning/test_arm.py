"""The planner's own kinematics against the simulator's, which are another library's, and its words."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.strategies import floats, integers

from drivers.sim.kinematics import JOINT_LIMITS_DEG, Kinematics
from drivers.sim.simulation import OBSERVE_POSE
from srvs_cell.config import parse_config
from srvs_cell.config.embedded import embedded_config
from srvs_cell.geometry import Transform, Xyzwpr
from srvs_cell.planning.arm import ArmParameters, ArmReach
from srvs_cell.planning.opw import Configuration, OpwGeometry, forward, inverse

TOOL_MM = 240.0


def _arm(**changes: object) -> ArmParameters:
    """Return the simulated cell's arm as its config describes it."""
    arm = parse_config(embedded_config(), "embedded").planning.arm
    assert arm is not None
    return replace(arm, **changes)  # type: ignore[arg-type]


ARM = _arm()
REACH, SIMULATED = ArmReach(ARM, OBSERVE_POSE), Kinematics(TOOL_MM)


def _matrix(pose: Xyzwpr) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return Transform.from_xyzwpr("base", "tcp", pose).matrix[None]


@settings(max_examples=25)
@given(seed=integers(0, 10_000), b=floats(-60.0, 60.0))
def test_one_of_the_eight_solutions_is_the_one_that_led_there(seed: int, b: float) -> None:
    geometry = OpwGeometry(150.0, -200.0, b, 450.0, 600.0, 640.0, 100.0)
    theta = np.random.default_rng(seed).uniform(-np.pi, np.pi, (20, 6))
    poses = forward(theta, geometry)
    nearest = np.full(len(theta), np.inf)
    for choices in itertools.product((True, False), repeat=3):
        found = inverse(poses, geometry, Configuration(*choices))
        reached = np.isfinite(found).all(axis=1)
        assert forward(found[reached], geometry) == pytest.approx(poses[reached], abs=1e-6)
        difference = np.abs((found - theta + np.pi) % (2.0 * np.pi) - np.pi)
        nearest = np.fmin(nearest, difference.max(axis=1))
    assert nearest.max() < 1e-5


def test_the_simulated_arm_stands_as_the_planner_thinks() -> None:
    joints = np.random.default_rng(1).uniform(JOINT_LIMITS_DEG[:, 0], JOINT_LIMITS_DEG[:, 1], (200, 6))
    assert REACH.poses(joints) == pytest.approx(SIMULATED.forward(joints), abs=1e-9)
    assert list(map(tuple, JOINT_LIMITS_DEG)) == list(_arm().joint_limits_deg)


@settings(max_examples=25)
@given(x=floats(500.0, 1000.0), y=floats(-300.0, 300.0), z=floats(-50.0, 400.0), r=floats(-100.0, 100.0))
def test_the_simulated_arm_goes_straight_as_the_planner_thinks(x: float, y: float, z: float, r: float) -> None:
    start = SIMULATED.inverse(_matrix(OBSERVE_POSE)[0], np.zeros(6))
    assert start is not None
    target = _matrix(Xyzwpr(x, y, z, 180.0, 0.0, r))
    way = np.repeat(_matrix(OBSERVE_POSE), 50, axis=0)
    share = np.linspace(0.0, 1.0, 50)[:, None]
    way[:, :3, 3] += share * (target[0, :3, 3] - way[0, :3, 3])
    followed = SIMULATED.follow(way, start)
    assert REACH.joints_deg(way) == pytest.approx(followed, abs=1e-6)


@pytest.mark.parametrize(
    ("way", "changes", "words"),
    [
        ([Xyzwpr(700.0, 0.0, 0.0, 180.0, 0.0, 0.0)], {}, ""),
        ([Xyzwpr(1500.0, 0.0, 0.0, 180.0, 0.0, 0.0)], {}, "out of reach by 122 mm"),
        ([Xyzwpr(160.0, 0.0, -300.0, 180.0, 0.0, 0.0)], {}, "out of reach by 29 mm, too near"),
        ([OBSERVE_POSE, Xyzwpr(1500.0, 0.0, 0.0, 180.0, 0.0, 0.0), OBSERVE_POSE], {}, "out of reach by 122 mm"),
        (
            [Xyzwpr(700.0, 0.0, 0.0, 180.0, 0.0, 80.0)],
            {"joint_limits_deg": (*_arm().joint_limits_deg[:5], (-60.0, 60.0))},
            "joint 6 beyond its limit by 21.0 deg",
        ),
        (
            [Xyzwpr(700.0, 0.0, 0.0, 180.0, 0.0, 0.0), Xyzwpr(700.0, 0.0, 0.0, 180.0, -90.0, 0.0)],
            {},
            "the wrist would pass a singular pose",
        ),
    ],
)
def test_why_the_arm_cannot_go_a_way(way: list[Xyzwpr], changes: dict[str, object], words: str) -> None:
    assert ArmReach(_arm(**changes), OBSERVE_POSE).why_not([way]) == [words]


def test_base_frame_and_tool_are_where_the_config_says() -> None:
    moved = _arm(base_xyz_mm=(100.0, 0.0, 0.0), tool_xyz_mm=(0.0, 0.0, TOOL_MM + 50.0))
    at_home, elsewhere = ArmReach(_arm(), OBSERVE_POSE), ArmReach(moved, Xyzwpr(575.0, 15.0, 360.0, 180.0, 0.0, 0.0))
    pose, same = Xyzwpr(800.0, 50.0, 100.0, 180.0, 0.0, 30.0), Xyzwpr(700.0, 50.0, 50.0, 180.0, 0.0, 30.0)
    assert elsewhere.joints_deg(_matrix(same)) == pytest.approx(at_home.joints_deg(_matrix(pose)))
