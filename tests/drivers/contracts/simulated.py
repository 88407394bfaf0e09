"""The simulated cell's own time, arm and camera stream in this process, behind real sockets."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Protocol, TypeVar, cast

import numpy as np

from drivers.sim.arm import Repeatability, SimArm
from drivers.sim.camera_client import DRIVER as CAMERA_DRIVER
from drivers.sim.camera_server import CameraServer
from drivers.sim.camera_stream import CameraStream, Exposure, PictureMaker
from drivers.sim.clock_authority import SimTime
from drivers.sim.clock_client import SimClock
from drivers.sim.clock_page import ClockPage
from drivers.sim.gripper_geometry import GripperGeometry
from drivers.sim.kinematics import Kinematics
from drivers.sim.scenario import ScenarioParameters, make_scenario
from drivers.sim.simulation import OBSERVE_POSE, TABLE_CENTRE_MM
from drivers.sim.world import World
from srvs_cell.geometry import Transform
from srvs_cell.ports import DriverContext

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from drivers.sim.world import Snapshot
    from srvs_cell.ports import Camera

_STEP_S = 0.002
_ARM_SPEED = 5.0
"""Times faster than life: a robot's watchdog of 2 s must not notice that this machine does something else, too."""
_LAG_S = 0.1
_QUEUE = 4


class _EmptyWorld:
    """Nothing but time."""

    def __init__(self) -> None:
        self.time_s = 0.0

    def snapshot(self) -> Snapshot | None:
        return None


class _GreyPictures:
    """Pictures that need no rendering."""

    def picture(self, exposure: Exposure) -> NDArray[np.uint8]:
        return np.full((48, 64), exposure.sequence % 256, np.uint8)


@contextlib.contextmanager
def simulated_camera(folder: Path) -> Iterator[tuple[Camera, SimClock, CameraStream]]:
    """The frame socket with its lag and its queue, of an empty world."""
    world = _EmptyWorld()
    stream = CameraStream(cast("World", world), _LAG_S, _QUEUE)

    def step() -> float:
        world.time_s += _STEP_S
        stream.step()
        return world.time_s

    page = ClockPage.create(folder / "clock")
    time = SimTime(step, page, 20.0)
    server = CameraServer(stream, cast("PictureMaker", _GreyPictures()), time)
    clock = SimClock(folder / "clock")
    time.start()
    try:
        config = CAMERA_DRIVER.config_model.model_validate({"port": server.start(), "timeout_s": 5.0})
        yield CAMERA_DRIVER.factory(config, DriverContext(clock)), clock, stream
    finally:
        server.close()
        time.close()


_Address_co = TypeVar("_Address_co", covariant=True)


class _Controller(Protocol[_Address_co]):
    def start(self) -> _Address_co: ...
    def close(self) -> None: ...


@contextlib.contextmanager
def simulated_arm(
    folder: Path, make_controller: Callable[[SimArm, SimTime], _Controller[_Address_co]]
) -> Iterator[tuple[_Address_co, SimClock, SimArm]]:
    """The physical arm behind the controller double; yields where it serves."""
    page = ClockPage.create(folder / "clock")
    gripper = GripperGeometry()
    home = Transform.from_xyzwpr("base", "tcp", OBSERVE_POSE).matrix
    world = World(make_scenario(1, 0, gripper, ScenarioParameters(), ties=False), gripper, TABLE_CENTRE_MM, home)

    def step() -> float:
        arm.step()
        world.step()
        return world.time_s

    time = SimTime(step, page, _ARM_SPEED)
    kinematics = Kinematics(gripper.flange_to_tcp_mm)
    arm = SimArm(time, world, kinematics, OBSERVE_POSE, Repeatability(), np.random.default_rng(0))
    controller = make_controller(arm, time)
    time.start()
    try:
        yield controller.start(), SimClock(folder / "clock"), arm
    finally:
        time.close()
        controller.close()
