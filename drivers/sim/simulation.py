"""The coupled whole without its wires: world, arm, camera stream and time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from drivers.sim.arm import SimArm
from drivers.sim.camera_stream import CameraStream, Exposure, PictureMaker
from drivers.sim.clock_authority import SimTime
from drivers.sim.gripper_geometry import CameraMount, GripperGeometry
from drivers.sim.imperfections import LEVELS, make_camera
from drivers.sim.kinematics import Kinematics
from drivers.sim.renderer import Renderer
from drivers.sim.scenario import ScenarioParameters, make_scenario
from drivers.sim.world import World
from srvs_cell.geometry import Transform, Xyzwpr

if TYPE_CHECKING:
    from drivers.sim.clock_page import ClockPage

TABLE_CENTRE_MM: Final = (750.0, 0.0, -50.0)
OBSERVE_POSE: Final = Xyzwpr(675.0, 15.0, 410.0, 180.0, 0.0, 0.0)
"""The left end of the lateral path: the camera's x axis is base -y, so the path runs from y = +15 to y = -15 mm."""

BASELINE_MM: Final = 30.0
WORKSPACE_MM: Final = {"x_mm": [560.0, 940.0], "y_mm": [-260.0, 260.0], "z_mm": [-49.0, 500.0]}


@dataclass(frozen=True, kw_only=True)
class SimulationParameters:
    """What a simulated cell is made from.

    Attributes:
        objects: number of parts.
        seed: of everything random.
        speed: how much faster than life time runs while the daemon only waits.
        level: of imperfections, ``none`` or ``real``.
        ties: whether two parts have the same height.
    """

    objects: int = 5
    seed: int = 0
    speed: float = 20.0
    level: str = "real"
    ties: bool = False


class Simulation:
    """The simulated cell.

    Attributes:
        time: simulated time.
        world: physics.
        arm: what controller doubles drive.
        stream: the camera's frames.
        pictures: renders them.
        camera: true lens and mount, and what the calibration says.
    """

    def __init__(self, parameters: SimulationParameters, page: ClockPage) -> None:
        imperfections = LEVELS[parameters.level]
        random = np.random.default_rng([parameters.seed, 3])
        gripper, table = GripperGeometry(), ScenarioParameters()
        self.camera = make_camera(imperfections, CameraMount().transform(), random)
        parts = make_scenario(parameters.objects, parameters.seed, gripper, table, ties=parameters.ties)
        home = Transform.from_xyzwpr("base", "tcp", OBSERVE_POSE).matrix
        self.world = World(parts, gripper, TABLE_CENTRE_MM, home)
        self.stream = CameraStream(self.world, imperfections.frame_lag_s, imperfections.queue_depth)
        self.time = SimTime(self.step, page, parameters.speed)
        self.arm = SimArm(
            self.time,
            self.world,
            Kinematics(gripper.flange_to_tcp_mm),
            OBSERVE_POSE,
            imperfections.repeatability,
            random,
        )
        renderer = Renderer(self.world, self.camera.lens, self.camera.mount.matrix, table.table_albedo, parameters.seed)
        self.pictures = PictureMaker(renderer, imperfections.sensor, parameters.seed)

    def view_now(self) -> Exposure:
        """Return what the camera would see at this instant."""
        with self.time.lock:
            return Exposure(0, self.world.time_s, self.world.snapshot())

    def layout(self) -> dict[str, Any]:
        """Return what a client's config has to say of this cell."""
        return {
            "observe_pose": list(OBSERVE_POSE.as_tuple()),
            "baseline_mm": BASELINE_MM,
            "table_z_mm": self.world.table_z_mm,
            "workspace": WORKSPACE_MM,
            "gripper": {
                "jaw_axis": "y",
                "max_opening_mm": self.world.gripper.max_opening_mm,
                "finger_thickness_mm": self.world.gripper.finger_thickness_mm,
                "finger_width_mm": self.world.gripper.finger_width_mm,
            },
        }

    def step(self) -> float:
        """Advance everything by one time step and return the new time; called under the world's lock."""
        self.arm.step()
        self.world.step()
        self.stream.step()
        return self.world.time_s
