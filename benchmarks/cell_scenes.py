"""Write the stereo scenes that the simulated cell would look at, with exact truth: one look from the observe pose.

    python benchmarks/cell_scenes.py OUT [--parts 5] [--count 20] [--seed 0]

Parts, camera, imperfections and poses are drawn as `srvs-cell sim` draws them; the files are those of the rendered
scenes (level L2: calibration and poses are not quite right), so `perceive_rendered.py OUT --levels L2` judges them.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.random_scenes import Rig, calibration_content, save_scene
from drivers.sim.gripper_geometry import CameraMount, GripperGeometry
from drivers.sim.imperfections import LEVELS, make_camera
from drivers.sim.renderer import Renderer
from drivers.sim.scenario import ScenarioParameters, make_scenario
from drivers.sim.simulation import BASELINE_MM, OBSERVE_POSE, TABLE_CENTRE_MM
from drivers.sim.world import Snapshot, World
from srvs_cell.calibration import Calibration, plan_right_pose
from srvs_cell.geometry import Transform

if TYPE_CHECKING:
    from srvs_cell.geometry import Array

LEVEL = "L2"


def write_scene(folder: Path, parts: int, seed: int) -> None:
    """Write one scene: pictures, calibration, poses and truth."""
    random, imperfections, table = np.random.default_rng([seed, 3]), LEVELS["real"], ScenarioParameters()
    camera = make_camera(imperfections, CameraMount().transform(), random)
    left = Transform.from_xyzwpr("base", "tcp", OBSERVE_POSE)
    told = Rig(TABLE_CENTRE_MM[2], camera.calibrated_lens, camera.calibrated_mount, left, left)
    calibration = Calibration.from_mapping(calibration_content(told), "the simulated cell")
    told = replace(told, right=plan_right_pose(calibration, left, BASELINE_MM))
    reached = [_reached(pose, imperfections.repeatability.draw(random)) for pose in (told.left, told.right)]
    true = replace(told, lens=camera.lens, mount=camera.mount, left=reached[0], right=reached[1])
    world = World(make_scenario(parts, seed, GripperGeometry(), table), GripperGeometry(), TABLE_CENTRE_MM, left.matrix)
    renderer = Renderer(world, camera.lens, camera.mount.matrix, table.table_albedo, seed)
    qpos = world.snapshot().qpos
    images = [
        imperfections.sensor.expose(renderer.render(Snapshot(0.0, qpos, pose.matrix)), random) for pose in reached
    ]
    save_scene(folder, {"level": LEVEL, "seed": seed, "tags": [f"{parts} parts"]}, world, (true, told), images)


def _reached(told: Transform, error: Array) -> Transform:
    """Return the true pose of an arm that errs by millimetres and, as a rotation vector, degrees, shape (6,)."""
    turned = Rotation.from_rotvec(error[3:], degrees=True).as_matrix() @ told.rotation
    return Transform.from_parts("base", "tcp", turned, told.translation_mm + error[:3])


def main() -> None:
    """Write the scenes."""
    parser = argparse.ArgumentParser(description="Write the stereo scenes that the simulated cell would look at.")
    parser.add_argument("out", type=Path)
    parser.add_argument("--parts", type=int, default=5)
    parser.add_argument("--count", type=int, default=20, help="number of scenes")
    parser.add_argument("--seed", type=int, default=0, help="of the first scene")
    arguments = parser.parse_args()
    for number in range(arguments.count):
        folder = arguments.out / LEVEL / f"{number:03d}"
        write_scene(folder, arguments.parts, arguments.seed + number)
        print(folder)


if __name__ == "__main__":
    main()
