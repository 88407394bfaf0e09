"""Shadows on the table, against rays followed one by one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from srvs_cell.vision.faces.face import HEXAGON_RATIO, Face, Figure
from srvs_cell.vision.faces.outlines import Outlines
from srvs_cell.vision.faces.shadows import Lamp, reach_px
from tests.vision.painted import TABLE_Z_MM, rig

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array

CENTRE_MM = (490.0, 60.0)
LAMP = Lamp(CENTRE_MM, (0.35, -0.2), 1.0 / 1200.0, TABLE_Z_MM)
FACES = (
    Face(Figure.RECTANGLE, 505.0, 40.0, TABLE_Z_MM + 60.0, 0.3, 60.0, 30.0),
    Face(Figure.RECTANGLE, 470.0, 60.0, TABLE_Z_MM + 30.0, 1.0, 60.0, 30.0, 0.6),
    Face(Figure.HEXAGON, 500.0, 40.0, TABLE_Z_MM + 40.0, 0.2, 50.0, 50.0 * HEXAGON_RATIO),
    Face(Figure.CIRCLE, 520.0, 80.0, TABLE_Z_MM + 50.0, 0.0, 40.0, 40.0),
)


def lamp_mm(lamp: Lamp) -> Array:
    height_mm = 1.0 / lamp.nearness_per_mm
    x_mm, y_mm = np.array(lamp.centre_mm) + np.array(lamp.lean) * height_mm
    return np.array([x_mm, y_mm, TABLE_Z_MM + height_mm])


def test_a_shadow_lies_where_the_line_from_the_lamp_meets_the_table() -> None:
    points = np.random.default_rng(3).uniform((400.0, -50.0, 5.0), (600.0, 150.0, 120.0), (40, 3)).T
    shadows = np.vstack([LAMP.shadows_mm(points), np.full((1, 40), TABLE_Z_MM)])
    lamp = lamp_mm(LAMP)[:, None]
    assert np.cross(points - lamp, shadows - lamp, axis=0) == pytest.approx(np.zeros((3, 40)), abs=1e-6)


def test_the_light_of_a_far_lamp_is_parallel() -> None:
    sun = Lamp(CENTRE_MM, (0.5, 0.1), 0.0, TABLE_Z_MM)
    points = np.array([[400.0, 600.0], [0.0, 90.0], [TABLE_Z_MM + 20.0, TABLE_Z_MM + 40.0]])
    assert sun.shadows_mm(points) - points[:2] == pytest.approx(np.array([[-10.0, -20.0], [-2.0, -4.0]]))


def test_how_shadows_move_with_the_lamp_is_told() -> None:
    points = np.random.default_rng(4).uniform((400.0, -50.0, 5.0), (600.0, 150.0, 120.0), (20, 3)).T
    by_lean, by_nearness = LAMP.changes_mm(points)
    for axis in range(2):
        step = np.eye(3)[axis] * 1e-4
        moved = (LAMP.moved(step).shadows_mm(points) - LAMP.moved(-step).shadows_mm(points)) / 2e-4
        assert moved[axis] == pytest.approx(by_lean[0], abs=1e-5)
        assert moved[1 - axis] == pytest.approx(np.zeros(20), abs=1e-9)
    step = np.array([0.0, 0.0, 1e-7])
    moved = (LAMP.moved(step).shadows_mm(points) - LAMP.moved(-step).shadows_mm(points)) / 2e-7
    assert moved == pytest.approx(by_nearness, rel=1e-4)


def test_no_lamp_stands_in_the_cell() -> None:
    assert LAMP.moved(np.array([0.0, 0.0, 1.0])).nearness_per_mm == 1.0 / 400.0
    assert LAMP.moved(np.array([0.0, 0.0, -1.0])).nearness_per_mm == 0.0


def is_shaded(face: Face, places_mm: Array) -> NDArray[np.bool_]:
    """Return which places on the table, (N, 2), are under the part or in its shadow: their rays are followed."""
    lamp = lamp_mm(LAMP)
    # all heights that the part could have on the way to the lamp, the foot first
    rise = np.linspace(0.0, 110.0 / (lamp[2] - TABLE_Z_MM), 1500)[:, None, None]
    places = np.column_stack([places_mm, np.full(len(places_mm), TABLE_Z_MM)])
    on_way = places + rise * (lamp - places)
    x, y = on_way[..., 0] - face.x_mm, on_way[..., 1] - face.y_mm
    cos, sin = np.cos(face.angle_rad), np.sin(face.angle_rad)
    u, v = x * cos + y * sin, y * cos - x * sin
    if face.figure is Figure.RECTANGLE:
        within = (np.abs(u) <= face.length_mm / 2.0) & (np.abs(v) <= face.width_mm / 2.0)
    elif face.figure is Figure.CIRCLE:
        within = np.hypot(u, v) <= face.length_mm / 2.0
    else:
        turns = np.deg2rad([30.0, 90.0, 150.0])
        within = np.all([np.abs(u * np.cos(a) + v * np.sin(a)) <= face.width_mm / 2.0 for a in turns], axis=0)
    return np.asarray((within & (on_way[..., 2] <= face.z_mm + face.slope_u * u)).any(axis=0))


@pytest.mark.parametrize("face", FACES, ids=lambda face: f"{face.figure} {face.slope_u}")
def test_shadows_reach_as_far_outside_of_a_border_as_rays_tell(face: Face) -> None:
    cameras = rig()
    outlines = Outlines.of([face], [face.slope_u != 0.0], 36)
    borders = outlines.seen(cameras)
    reach, side = reach_px(outlines, borders, cameras, LAMP)[:, 0], outlines.side_px(borders, cameras, TABLE_Z_MM)[:, 0]
    from_table = np.linalg.inv(
        cameras.projections @ np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, TABLE_Z_MM], [0.0, 0.0, 1.0]])
    )
    step_px = 0.1
    outside_px = np.arange(0.0, 50.0, step_px)
    slack_px = 0.3 if face.figure is Figure.CIRCLE else 2.0 * step_px
    with_shadow = 0
    for eye, sample in np.ndindex(2, 36):
        pixels = borders.points_px[eye, 0, :, sample] + outside_px[:, None] * borders.normals[eye, 0, :, sample]
        places = np.column_stack([pixels, np.ones(len(pixels))]) @ from_table[eye].T
        shaded = is_shaded(face, places[:, :2] / places[:, 2:])
        # what the part hides is not asked
        foot_px = max(float(side[eye, sample]), 0.0)
        ends_px = float(outside_px[shaded & (outside_px > foot_px)].max(initial=foot_px))
        assert max(float(reach[eye, sample]), foot_px) == pytest.approx(ends_px, abs=slack_px)
        with_shadow += ends_px > foot_px + 1.0
    assert with_shadow > 10
