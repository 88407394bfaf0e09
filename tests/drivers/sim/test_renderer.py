"""Pictures show what the world is, to a small part of a pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from drivers.sim.gripper_geometry import CameraMount, GripperGeometry
from drivers.sim.lens import Lens
from drivers.sim.parts import CUBOID, CYLINDER, Part
from drivers.sim.renderer import Renderer
from drivers.sim.sensor import Sensor
from drivers.sim.simulation import OBSERVE_POSE, TABLE_CENTRE_MM
from drivers.sim.world import World
from srvs_cell.geometry import Array, Transform, axis_rotation
from tests.drivers.sim.stepping import make_simulation

if TYPE_CHECKING:
    from pathlib import Path

LENS = Lens(distortion=(-0.06, 0.02, 0.0005, -0.0003, 0.0))
BASE_T_TCP = Transform.from_xyzwpr("base", "tcp", OBSERVE_POSE)
BASE_T_CAMERA = BASE_T_TCP @ CameraMount().transform()


def _part(kind: str, yaw_deg: float = 0.0, size_mm: float = 60.0) -> Part:
    return Part(
        kind=kind,
        length_mm=size_mm,
        width_mm=size_mm,
        height_mm=60.0,
        low_height_mm=60.0,
        x_mm=755.0,
        y_mm=10.0,
        yaw_deg=yaw_deg,
        albedo=0.8,
        label=False,
    )


def _picture(part: Part) -> Array:
    world = World((part,), GripperGeometry(), TABLE_CENTRE_MM, BASE_T_TCP.matrix)
    renderer = Renderer(world, LENS, CameraMount().transform().matrix, 0.1, 0, textured=False)
    return renderer.render(world.snapshot())


def _pixels(points_mm: Array) -> Array:
    return LENS.project(BASE_T_CAMERA.inverse().apply(points_mm))


def _top(part: Part) -> Array:
    corners = part.vertices_mm()[-len(part.outline_mm()) :]
    return corners @ axis_rotation("z", part.yaw_deg).T + (part.x_mm, part.y_mm, TABLE_CENTRE_MM[2])


def test_edges_are_where_they_project_to_without_bias() -> None:
    part = _part(CUBOID, yaw_deg=7.0)
    image, errors = _picture(part), []
    top = _top(part)
    bright = 0.5 * image.max()
    for index in range(4):
        a, b = top[index], top[(index + 1) % 4]
        edge = _pixels(a + np.linspace(0.0, 1.0, 400)[:, None] * (b - a))
        if abs(edge[-1, 0] - edge[0, 0]) > abs(edge[-1, 1] - edge[0, 1]):
            continue
        low, high = sorted((edge[0, 1], edge[-1, 1]))
        order = np.argsort(edge[:, 1])
        for row in range(int(low) + 4, int(high) - 3):
            exact = float(np.interp(row, edge[order, 1], edge[order, 0]))
            left, right = round(exact) - 5, round(exact) + 6
            strip = image[row, left:right]
            dark_side, light_side = strip[0], strip[-1]
            if max(dark_side, light_side) < bright:
                continue
            share = (strip - dark_side).sum() / (light_side - dark_side)
            errors.append(right - 0.5 - share - exact)
    assert len(errors) > 60
    assert abs(np.mean(errors)) < 0.01
    assert np.std(errors) < 0.04


def test_a_cylinders_top_has_its_true_area_and_centre() -> None:
    part = _part(CYLINDER, size_mm=50.0)
    image = _picture(part)
    outline = _pixels(_top(part))
    x, y = outline.T
    area = 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    exact_area = area * np.pi / (len(x) / 2.0 * np.sin(2.0 * np.pi / len(x)))
    level = image.max()
    top = image > 0.9 * level
    v, u = np.nonzero(top)
    centre = _pixels(np.array([[part.x_mm, part.y_mm, TABLE_CENTRE_MM[2] + part.height_mm]]))[0]
    assert top.sum() == pytest.approx(exact_area, rel=0.05)
    assert (u.mean(), v.mean()) == pytest.approx(tuple(centre), abs=0.25)


def test_the_lamp_throws_a_shadow_beside_the_part_and_nothing_else_is_dark() -> None:
    image = _picture(_part(CUBOID))
    table_lit = np.median(image)
    shadow = image < 0.75 * table_lit
    assert 0.005 < shadow.mean() < 0.08


def test_the_fingers_are_not_in_view_at_the_observe_pose() -> None:
    world = World((), GripperGeometry(), TABLE_CENTRE_MM, BASE_T_TCP.matrix)
    renderer = Renderer(world, LENS, CameraMount().transform().matrix, 0.4, 0, textured=False)
    image = renderer.render(world.snapshot())
    assert image.min() > 0.6 * image.max()


def test_the_picture_of_an_exposure_is_always_the_same(tmp_path: Path) -> None:
    simulation = make_simulation(tmp_path, level="real")
    here = simulation.view_now()
    first, again = simulation.pictures.picture(here), simulation.pictures.picture(here)
    assert first.dtype == np.uint8
    assert first.shape == (480, 640)
    assert np.array_equal(first, again)
    assert 20 < first.mean() < 160


@pytest.mark.parametrize("level", [0.25, 0.5])
def test_noise_is_about_two_grey_levels_at_mid_grey(level: float) -> None:
    sensor = Sensor(full_well_e=8000.0, read_noise=1.2)
    grey = sensor.expose(np.full((200, 200), level), np.random.default_rng(0)).astype(float)
    assert grey.mean() == pytest.approx(level * 255.0, abs=0.1)
    assert 1.4 < grey.std() < 2.6


def test_rounding_is_dithered_so_that_a_level_between_two_greys_keeps_its_mean() -> None:
    grey = Sensor().expose(np.full((200, 200), 76.3 / 255.0), np.random.default_rng(0)).astype(float)
    assert grey.mean() == pytest.approx(76.3, abs=0.02)


def test_vignetting_darkens_the_corners_and_blur_keeps_the_mean() -> None:
    image = np.full((60, 80), 0.5)
    image[20:40, 30:50] = 0.8
    grey = Sensor(blur_px=0.8, vignette=0.2).expose(image, np.random.default_rng(0)).astype(float)
    assert grey[0, 0] == pytest.approx(0.5 * 255.0 * 0.8, abs=1.5)
    assert Sensor(blur_px=0.8).expose(image, np.random.default_rng(0)).mean() == pytest.approx(
        image.mean() * 255.0, abs=0.1
    )
