"""Write random stereo scenes with exact truth, of the make of the rendered scenes but by the project's own renderer.

    python benchmarks/random_scenes.py OUT [--levels L1 L2] [--count 12] [--seed 0]

They are what vision may be tuned on: levels, tags and the files of a scene are those that the README of the rendered
scenes describes, so that `perceive_rendered.py OUT` judges them. Each scene has one of the tags, in turn. What is
not the same: textures, labels and the lamp are the simulator's own.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import mujoco
import numpy as np
import yaml

from drivers.sim.gripper_geometry import GripperGeometry
from drivers.sim.lens import Lens
from drivers.sim.parts import CUBOID, CYLINDER, KINDS, PRISM, WEDGE, Part, prism_across_flats_mm
from drivers.sim.renderer import Lighting, Renderer, RenderParameters
from drivers.sim.sensor import Sensor
from drivers.sim.world import Snapshot, World
from srvs_cell.geometry import Transform, Xyzwpr, axis_rotation

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array

LEVELS = ("L0", "L1", "L2")
TAGS = (
    "plain",
    "same_grey",
    "dark_on_dark",
    "bright_on_bright",
    "label",
    "untextured",
    "touching",
    "cropped",
    "crowded",
    "occluded",
)
_CENTRE_MM = np.array([750.0, 0.0])
_FAR_AWAY = Xyzwpr(-600.0, -600.0, 1800.0, 180.0, 0.0, 0.0)
"""Where the gripper is not in the picture."""
_GAP_MM = 12.0
_UNLIKE = 0.2
"""Share of the table's reflectance by which a part's differs, except where the tag wants them alike."""
_GRID = np.linspace(-0.999, 0.999, 15)
_TRIES = 4000
_LAMP_MM = 1500.0
_CUT_SIGMAS = 2.5


@dataclass(frozen=True)
class Rig:
    """A camera, its two poses over the table, and the table's height in the base frame."""

    table_z_mm: float
    lens: Lens
    mount: Transform
    left: Transform
    right: Transform


def draw_parts(tag: str, table_albedo: float, rig: Rig, random: np.random.Generator) -> tuple[Part, ...]:
    """Return parts that stand in both pictures, at least 12 mm apart except where the tag says otherwise."""
    count = int(random.integers(8, 11)) if tag == "crowded" else int(random.integers(3, 8))
    same = float(random.uniform(0.2, 0.85)) if tag == "same_grey" else None
    special = int(random.integers(count))
    parts: list[Part] = []
    for number in range(count):
        for _ in range(_TRIES):
            part = _draw_part(tag, table_albedo, random, special=number == special)
            if same is not None:
                part = replace(part, albedo=same * float(random.uniform(0.99, 1.01)))
            if tag == "touching" and number == 1:
                part = _beside(parts[0], part, random)
            elif tag == "occluded" and number == 1:
                part = _behind(parts[0], part, rig, random)
            touching = tag == "touching" and number == 1
            if tag == "touching" and number == 0 and part.kind != CUBOID:
                continue
            inside = _inside(part, rig)
            wanted = 0.3 < inside < 0.9 if tag == "cropped" and number == special else inside == 1.0
            others = parts[1:] if touching else parts
            if wanted and all(_apart(part, other) for other in others):
                parts.append(part)
                break
    return tuple(parts)


def _draw_part(tag: str, table_albedo: float, random: np.random.Generator, *, special: bool) -> Part:
    kind = str(random.choice(KINDS, p=(0.5, 0.17, 0.23, 0.1)))
    if tag == "label" and special:
        kind = CUBOID
    height = float(random.uniform(15.0, 50.0 if tag == "crowded" else 110.0))
    longest = 50.0 if tag == "crowded" else 70.0
    width, length = np.sort(random.uniform(25.0, longest, 2)).tolist()
    low = height
    if kind == CYLINDER:
        length = width
    elif kind == PRISM:
        width = prism_across_flats_mm(length)
    elif kind == WEDGE:
        if random.random() < 0.3:
            length, width = width, length  # the slope runs along the short side
        low = height - length * float(np.tan(np.deg2rad(random.uniform(10.0, 35.0))))
        if low < 5.0:
            height, low = max(height - low, 15.0), 0.0
    albedo = table_albedo
    while abs(albedo / table_albedo - 1.0) < _UNLIKE:
        albedo = float(random.uniform(0.08, 0.9))
    if tag in {"dark_on_dark", "bright_on_bright"} and (special or random.random() < 0.5):
        albedo = table_albedo * (1.0 + float(random.choice([-1.0, 1.0])) * float(random.uniform(0.07, _UNLIKE)))
    x, y = _CENTRE_MM + random.uniform(-210.0, 210.0, 2)
    return Part(
        kind=kind,
        length_mm=length,
        width_mm=width,
        height_mm=height,
        low_height_mm=low,
        x_mm=float(x),
        y_mm=float(y),
        yaw_deg=float(random.uniform(0.0, 360.0)),
        albedo=float(np.clip(albedo, 0.05, 0.92)),
        label=tag == "label" and (special or random.random() < 0.5),
    )


def _beside(first: Part, part: Part, random: np.random.Generator) -> Part:
    """Return a cuboid that stands against a side of the first one, lower or higher by 8 mm at least."""
    height = first.height_mm
    while abs(height - first.height_mm) < 8.0:
        height = float(random.uniform(15.0, 110.0))
    turn = axis_rotation("z", first.yaw_deg)[:2, :2]
    gap = (first.length_mm + part.length_mm) / 2.0 + float(random.uniform(0.0, 0.2))
    place = turn @ (gap, float(random.uniform(-8.0, 8.0))) + (first.x_mm, first.y_mm)
    return replace(
        part,
        kind=CUBOID,
        height_mm=height,
        low_height_mm=height,
        yaw_deg=first.yaw_deg,
        x_mm=float(place[0]),
        y_mm=float(place[1]),
    )


def _behind(first: Part, part: Part, rig: Rig, random: np.random.Generator) -> Part:
    """Return a low part where a tall first one hides some of its top from a camera."""
    eye = (rig.left @ rig.mount).matrix[:2, 3]
    away = np.array([first.x_mm, first.y_mm]) - eye
    away /= max(float(np.linalg.norm(away)), 1.0)
    reach = (first.length_mm + part.length_mm) / 2.0 + float(random.uniform(2.0, 12.0))
    place = np.array([first.x_mm, first.y_mm]) + away * reach
    return replace(part, x_mm=float(place[0]), y_mm=float(place[1]))


def _apart(part: Part, other: Part) -> bool:
    """Whether two parts' footprints are the least gap apart (by their outlines' points)."""
    distances = []
    for one, two in ((part, other), (other, part)):
        outline = (two.footprint_mm() + np.array([two.x_mm, two.y_mm])).astype(np.float32)
        points = one.footprint_mm() + np.array([one.x_mm, one.y_mm])
        distances += [cv2.pointPolygonTest(outline, (float(x), float(y)), measureDist=True) for x, y in points]
    return -max(distances) > _GAP_MM


def _inside(part: Part, rig: Rig) -> float:
    """Return the share of the part's corners that both pictures show."""
    turn = axis_rotation("z", part.yaw_deg)
    points = part.vertices_mm() @ turn.T + (part.x_mm, part.y_mm, 0.0)
    points[:, 2] += rig.table_z_mm
    shares = [_in_picture(points, rig, pose) for pose in (rig.left, rig.right)]
    return float(np.mean(np.logical_and(*shares)))


def _in_picture(points_mm: Array, rig: Rig, base_T_tcp: Transform) -> Array:
    camera_T_base = np.linalg.inv((base_T_tcp @ rig.mount).matrix)
    seen = points_mm @ camera_T_base[:3, :3].T + camera_T_base[:3, 3]
    pixel = rig.lens.project(seen)
    size = np.array([rig.lens.width - 1.0, rig.lens.height - 1.0])
    return np.asarray(((pixel > 2.0) & (pixel < size - 2.0)).all(axis=1))


def draw_rig(random: np.random.Generator, level: str) -> tuple[Rig, Rig]:
    """Return the rig as it is, and as calibration and poses tell it."""
    table_z_mm = float(random.choice([0.0, 0.0, -120.0, 35.0]))
    focal = float(random.uniform(780.0, 885.0))
    lens = Lens(
        fx=focal,
        fy=focal * (1.0 + float(random.uniform(-4e-4, 4e-4))),
        cx=float(random.uniform(308.0, 332.0)),
        cy=float(random.uniform(230.0, 250.0)),
        distortion=(
            float(random.uniform(-0.2, 0.04)),
            float(random.uniform(0.0, 0.13)),
            *(random.uniform(-8e-4, 8e-4, 2).tolist()),
            float(random.uniform(-0.03, 0.03)),
        ),
    )
    mount_place = random.uniform(-80.0, 80.0, 3)
    mount_turn = random.uniform(-2.5, 2.5, 3) + np.array([0.0, 0.0, random.choice([0.0, 90.0, 180.0, -90.0])])
    mount = Transform.from_xyzwpr("tcp", "camera", Xyzwpr(*mount_place, *mount_turn))
    tilt, heading = np.deg2rad(random.uniform(0.0, 8.0)), random.uniform(0.0, 2.0 * np.pi)
    down = axis_rotation("x", 180.0) @ axis_rotation("z", float(random.uniform(-180.0, 180.0)))
    lean = axis_rotation("x", float(np.rad2deg(tilt * np.cos(heading)))) @ axis_rotation(
        "y", float(np.rad2deg(tilt * np.sin(heading)))
    )
    rotation = lean @ down
    height = float(random.uniform(420.0, 620.0))
    # the optical axis meets the table at the middle of the parts
    eye = np.array([*_CENTRE_MM, table_z_mm]) - rotation[:, 2] / -rotation[2, 2] * height
    baseline = float(random.uniform(20.0, 60.0) if random.random() < 0.15 else 30.0)
    places = [eye - rotation[:, 0] * baseline / 2.0, eye + rotation[:, 0] * baseline / 2.0]
    left, right = (Transform.from_parts("base", "camera", rotation, place) @ mount.inverse() for place in places)
    true = Rig(table_z_mm, lens, mount, left, right)
    if level != "L2":
        return true, true
    focal_error = 1.0 + 0.001 * _normal(random, 1)[0]
    told_lens = replace(
        lens,
        fx=lens.fx * focal_error * (1.0 + 0.0002 * _normal(random, 1)[0]),
        fy=lens.fy * focal_error,
        cx=lens.cx + 0.5 * _normal(random, 1)[0],
        cy=lens.cy + 0.5 * _normal(random, 1)[0],
        distortion=tuple((np.array(lens.distortion) + _normal(random, 5) * (3e-3, 6e-3, 4e-5, 4e-5, 3e-3)).tolist()),
    )
    told_mount = mount @ _small(random, "camera", 0.3, 0.05)
    return replace(true, right=right @ _small(random, "tcp", 0.03, 0.005)), replace(
        true, lens=told_lens, mount=told_mount
    )


def _normal(random: np.random.Generator, count: int) -> Array:
    return np.asarray(np.clip(random.standard_normal(count), -_CUT_SIGMAS, _CUT_SIGMAS))


def _small(random: np.random.Generator, frame: str, millimetres: float, degrees: float) -> Transform:
    shift, turn = millimetres * _normal(random, 3), degrees * _normal(random, 3)
    rotation = axis_rotation("x", turn[0]) @ axis_rotation("y", turn[1]) @ axis_rotation("z", turn[2])
    return Transform.from_parts(frame, frame, rotation, shift)


def write_scene(folder: Path, level: str, tag: str, seed: int) -> None:
    """Write one scene: pictures, calibration, poses and truth."""
    random = np.random.default_rng([seed, LEVELS.index(level), TAGS.index(tag)])
    rig, told = draw_rig(random, level)
    table_albedo = {"dark_on_dark": random.uniform(0.08, 0.14), "bright_on_bright": random.uniform(0.55, 0.7)}.get(
        tag, random.uniform(0.2, 0.55)
    )
    parts = draw_parts(tag, float(table_albedo), rig, random)
    world = World(
        parts,
        GripperGeometry(),
        (*_CENTRE_MM.tolist(), rig.table_z_mm),
        Transform.from_xyzwpr("base", "tcp", _FAR_AWAY).matrix,
    )
    azimuth, slant = random.uniform(0.0, 2.0 * np.pi), np.deg2rad(random.uniform(10.0, 35.0))
    beam = np.array([np.sin(slant) * np.cos(azimuth), np.sin(slant) * np.sin(azimuth), np.cos(slant)])
    lamp = _LAMP_MM * beam + np.array([*_CENTRE_MM, rig.table_z_mm])
    renderer = Renderer(
        world,
        rig.lens,
        rig.mount.matrix,
        float(table_albedo),
        seed,
        RenderParameters(lighting=Lighting(lamp_mm=tuple(lamp.tolist()))),
        textured=tag != "untextured",
    )
    sensor = (
        Sensor()
        if level == "L0"
        else Sensor(
            blur_px=float(random.uniform(0.6, 0.9)),
            vignette=float(random.uniform(0.05, 0.2)),
            full_well_e=8000.0,
            read_noise=1.2,
        )
    )
    qpos = world.snapshot().qpos
    images = [
        sensor.expose(renderer.render(Snapshot(0.0, qpos, pose.matrix)), random) for pose in (rig.left, rig.right)
    ]
    save_scene(folder, {"level": level, "seed": seed, "tags": [tag]}, world, (rig, told), images)


def save_scene(
    folder: Path, labels: dict[str, Any], world: World, rigs: tuple[Rig, Rig], images: Sequence[NDArray[np.uint8]]
) -> None:
    """Write the files of a scene.

    Args:
        folder: where to; made if need be.
        labels: what the truth says besides its objects.
        world: the parts where they stand.
        rigs: as it is, and as calibration and poses tell it.
        images: left and right, uint8, shape (H, W).
    """
    rig, told = rigs
    folder.mkdir(parents=True, exist_ok=True)
    for side, image in zip(("left", "right"), images, strict=True):
        cv2.imwrite(str(folder / f"{side}.png"), image)
    (folder / "calibration.yaml").write_text(
        yaml.safe_dump(calibration_content(told), sort_keys=False), encoding="utf-8"
    )
    poses = {side: list(pose.to_xyzwpr().as_tuple()) for side, pose in (("left", told.left), ("right", told.right))}
    (folder / "poses.json").write_text(json.dumps({**poses, "table_z_mm": rig.table_z_mm}), encoding="utf-8")
    qpos = world.snapshot().qpos
    truth = {**labels, "objects": [_truth(number, world, rig, qpos) for number in range(len(world.parts))]}
    (folder / "truth.json").write_text(json.dumps(truth, indent=1), encoding="utf-8")


def calibration_content(rig: Rig) -> dict[str, Any]:
    """Return the content of the calibration file that tells a rig."""
    lens, mount = rig.lens, rig.mount.to_xyzwpr().as_tuple()
    return {
        "schema_version": 1,
        "camera": {
            "width": lens.width,
            "height": lens.height,
            **{name: float(getattr(lens, name)) for name in ("fx", "fy", "cx", "cy")},
            "distortion": [float(value) for value in lens.distortion],
        },
        "tcp_T_camera": {"xyz_mm": [float(v) for v in mount[:3]], "wpr_deg": [float(v) for v in mount[3:]]},
    }


def _truth(number: int, world: World, rig: Rig, qpos: Array) -> dict[str, Any]:
    part, pose = world.parts[number], world.part_poses()[number].base_T_part
    slope = (part.low_height_mm - part.height_mm) / part.length_mm
    normal = pose[:3, :3] @ np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    length, width, yaw = part.length_mm, part.width_mm, float(np.rad2deg(np.arctan2(pose[1, 0], pose[0, 0])))
    if part.kind in {CUBOID, WEDGE} and width > length:
        length, width, yaw = width, length, yaw + 90.0
    shares = [_seen_share(number, world, rig, camera, qpos) for camera in (rig.left, rig.right)]
    return {
        "id": number,
        "kind": part.kind,
        "position_mm": (pose[:3, :3] @ part.top_centre_mm + pose[:3, 3]).tolist(),
        "height_mm": part.height_mm,
        "yaw_deg": yaw % 180.0 if part.kind in {CUBOID, WEDGE} else None,
        "size_mm": [length, width],
        "fully_visible": min(shares) == 1.0,
        "visible_fraction": shares,
        "face_normal": normal.tolist(),
        "albedo": part.albedo,
        **({"low_height_mm": part.low_height_mm} if part.kind == WEDGE else {}),
    }


def _seen_share(number: int, world: World, rig: Rig, base_T_tcp: Transform, qpos: Array) -> float:
    """Return the share of points of a part's top face that a picture shows."""
    part, pose = world.parts[number], world.part_poses()[number].base_T_part
    u, v = (axis.ravel() for axis in np.meshgrid(_GRID * part.length_mm / 2.0, _GRID * part.width_mm / 2.0))
    outline = part.outline_mm().astype(np.float32)
    on_face = [cv2.pointPolygonTest(outline, point, measureDist=False) >= 0 for point in zip(u, v, strict=True)]
    u, v = u[on_face], v[on_face]
    rise = part.height_mm + (u / part.length_mm + 0.5) * (part.low_height_mm - part.height_mm)
    points = np.column_stack([u, v, rise]) @ pose[:3, :3].T + pose[:3, 3]
    shown = _in_picture(points, rig, base_T_tcp)
    eye = (base_T_tcp @ rig.mount).matrix[:3, 3]
    data = mujoco.MjData(world.model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(world.model, data)
    geom, distance = np.empty(len(points), dtype=np.int32), np.empty(len(points))
    rays = np.ascontiguousarray(points - eye).ravel() * 1e-3
    mujoco.mj_multiRay(
        world.model, data, eye * 1e-3, rays, None, True, -1, geom, distance, None, len(points), mujoco.mjMAXVAL
    )
    return float(np.mean(shown & (distance > 1.0 - 1e-4)))


def main() -> None:
    """Write the scenes."""
    parser = argparse.ArgumentParser(description="Write random stereo scenes with exact truth.")
    parser.add_argument("out", type=Path)
    parser.add_argument("--levels", nargs="*", default=list(LEVELS), choices=LEVELS)
    parser.add_argument("--count", type=int, default=2 * len(TAGS), help="scenes of each level")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    for level in arguments.levels:
        for number in range(arguments.count):
            folder = arguments.out / level / f"{number:03d}"
            write_scene(folder, level, TAGS[number % len(TAGS)], arguments.seed + number)
            print(folder)


if __name__ == "__main__":
    main()
