import numpy as np
import pytest

from srvs_cell.vision.faces import HEXAGON_RATIO, Face, Figure
from srvs_cell.vision.outlines import Outlines
from tests.vision.painted import rig

FACES = [
    Face(Figure.RECTANGLE, 500.0, 40.0, 60.0, 0.4, 52.0, 30.0),
    Face(Figure.RECTANGLE, 480.0, -20.0, 40.0, 1.9, 30.0, 44.0, 0.35),
    Face(Figure.CIRCLE, 510.0, 10.0, 30.0, 0.0, 36.0, 36.0),
    Face(Figure.HEXAGON, 450.0, 90.0, 80.0, 0.2, 40.0, 40.0 * HEXAGON_RATIO),
]
INCLINED = [False, True, False, False]


def test_faces_come_back_as_they_went_in() -> None:
    assert Outlines.of(FACES, INCLINED, 48).faces() == FACES


def test_every_outline_has_its_samples_on_the_figure() -> None:
    outlines = Outlines.of(FACES, INCLINED, 48)
    points = outlines.points_mm()
    assert points.shape == (3, 4, 48)
    for number, face in enumerate(FACES):
        placed = face.place(outlines.unit[:, number].T)
        assert points[:, number] == pytest.approx(placed.T)
    assert (outlines.first.sum(axis=1) == [4, 4, 1, 6]).all()


def test_outlines_are_seen_where_the_cameras_project_them() -> None:
    outlines, cameras = Outlines.of(FACES, INCLINED, 48), rig()
    borders = outlines.seen(cameras)
    x, y, disparity = cameras.project_px(np.moveaxis(outlines.points_mm(), 0, -1))
    assert borders.x_px == pytest.approx(np.stack([x, x - disparity]))
    assert borders.y_px == pytest.approx(np.stack([y, y]))
    assert np.hypot(borders.normal_x, borders.normal_y) == pytest.approx(np.ones((2, 4, 48)))
    from_middle = (
        borders.x_px - borders.x_px.mean(axis=-1, keepdims=True),
        borders.y_px - borders.y_px.mean(axis=-1, keepdims=True),
    )
    assert (from_middle[0] * borders.normal_x + from_middle[1] * borders.normal_y > 0.0).all()
    assert borders.in_front.all()


def test_derivatives_are_those_of_the_samples_along_the_normals() -> None:
    outlines, cameras = Outlines.of(FACES, INCLINED, 48), rig()
    borders = outlines.seen(cameras)
    assert borders.by_parameter.shape == (2, 4, 7, 48)
    for parameter in range(7):
        step = np.zeros((4, 7))
        step[:, parameter] = 1e-5
        ahead, behind = outlines.moved(step).seen(cameras), outlines.moved(-step).seen(cameras)
        moved_x, moved_y = (ahead.x_px - behind.x_px) / 2e-5, (ahead.y_px - behind.y_px) / 2e-5
        outwards = moved_x * borders.normal_x + moved_y * borders.normal_y
        assert borders.by_parameter[:, :, parameter] == pytest.approx(outwards, abs=1e-5)


def test_the_points_of_the_table_under_an_outline_are_seen_where_they_lie() -> None:
    outlines, cameras = Outlines.of(FACES, INCLINED, 48), rig()
    feet = np.moveaxis(outlines.points_mm(), 0, -1) * (1.0, 1.0, 0.0) + (0.0, 0.0, 5.0)
    x, y, disparity = cameras.project_px(feet)
    feet_x, feet_y = outlines.feet_px(cameras, 5.0)
    assert feet_x == pytest.approx(np.stack([x, x - disparity]))
    assert feet_y == pytest.approx(np.stack([y, y]))


def test_a_figure_behind_the_cameras_is_told() -> None:
    cameras = rig()
    high = Face(Figure.CIRCLE, 510.0, 10.0, float(cameras.base_T_camera.translation_mm[2]) + 50.0, 0.0, 36.0, 36.0)
    assert Outlines.of([FACES[0], high], [False, False], 48).seen(cameras).in_front.tolist() == [True, False]


def test_what_is_held_does_not_move() -> None:
    moved = Outlines.of(FACES, INCLINED, 48).moved(np.full((4, 7), 0.1)).faces()
    assert moved[0].slope_u == 0.0
    assert moved[1].slope_u == pytest.approx(0.45)
    assert moved[2].angle_rad == 0.0
    assert moved[3].width_mm == pytest.approx(40.1 * HEXAGON_RATIO)
