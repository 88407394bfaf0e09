import numpy as np
import pytest

from srvs_cell.vision.faces.face import HEXAGON_RATIO, Face, Figure
from srvs_cell.vision.faces.outlines import Outlines, newton_steps
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
    assert points.shape == (4, 3, 48)
    for number, face in enumerate(FACES):
        placed = face.place(outlines.unit[number, :2].T)
        assert points[number] == pytest.approx(placed.T)
    assert (outlines.last.sum(axis=1) == [4, 4, 1, 6]).all()


def test_outlines_are_seen_where_the_cameras_project_them() -> None:
    outlines, cameras = Outlines.of(FACES, INCLINED, 48), rig()
    borders = outlines.seen(cameras)
    x, y, disparity = cameras.project_px(np.moveaxis(outlines.points_mm(), 1, -1))
    assert borders.points_px[:, :, 0] == pytest.approx(np.stack([x, x - disparity]))
    assert borders.points_px[:, :, 1] == pytest.approx(np.stack([y, y]))
    assert np.hypot(*np.moveaxis(borders.normals, 2, 0)) == pytest.approx(np.ones((2, 4, 48)))
    from_middle = borders.points_px - borders.points_px.mean(axis=-1, keepdims=True)
    assert ((from_middle * borders.normals).sum(axis=2) > 0.0).all()
    # perspective spaces the samples of a side a little unevenly
    apart = np.hypot(*np.moveaxis(np.diff(borders.points_px), 2, 0))
    inner = ~outlines.last[:, :-1]
    assert borders.spacing_px[:, :, :-1][:, inner] == pytest.approx(apart[:, inner], rel=0.02)
    assert borders.in_front.all()


def test_derivatives_are_those_of_the_samples_along_the_normals() -> None:
    outlines, cameras = Outlines.of(FACES, INCLINED, 48), rig()
    borders = outlines.seen(cameras)
    assert borders.by_parameter.shape == (2, 4, 7, 48)
    for parameter in range(7):
        step = np.zeros((4, 7))
        step[:, parameter] = 1e-5
        ahead, behind = outlines.moved(step).seen(cameras), outlines.moved(-step).seen(cameras)
        moved = (ahead.points_px - behind.points_px) / 2e-5
        outwards = (moved * borders.normals).sum(axis=2)
        assert borders.by_parameter[:, :, parameter] == pytest.approx(outwards, abs=1e-5)


def test_the_points_of_the_table_under_an_outline_are_seen_where_they_lie() -> None:
    outlines, cameras = Outlines.of(FACES, INCLINED, 48), rig()
    borders = outlines.seen(cameras)
    feet = np.moveaxis(outlines.points_mm(), 1, -1) * (1.0, 1.0, 0.0) + (0.0, 0.0, 5.0)
    x, y, disparity = cameras.project_px(feet)
    away = np.stack([np.stack([x, y], axis=1), np.stack([x - disparity, y], axis=1)]) - borders.points_px
    expected = (away * borders.normals).sum(axis=2)
    assert outlines.side_px(borders, cameras, 5.0) == pytest.approx(expected, abs=1e-6)


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


def test_room_is_that_of_the_lowest_corner_and_only_an_inclined_figure_can_lack_it() -> None:
    outlines = Outlines.of(FACES, INCLINED, 48)
    room_mm, by_parameter = outlines.room_above(10.0)
    assert room_mm[1] == pytest.approx(FACES[1].lowest_mm - 10.0)
    assert np.isinf(room_mm[[0, 2, 3]]).all()
    assert not by_parameter[[0, 2, 3]].any()
    step = np.array([1.0, 1.0, 0.3, -0.2, 0.01, 0.5, 0.004])
    after = outlines.moved(np.tile(step, (4, 1))).room_above(10.0)[0][1]
    assert after - room_mm[1] == pytest.approx(by_parameter[1] @ step, abs=1e-3)


@pytest.mark.parametrize("room_mm", [-0.5, 0.4, 50.0])
def test_a_step_that_lacks_room_is_the_best_one_that_has_it(room_mm: float) -> None:
    random = np.random.default_rng(3)
    roots = random.normal(size=(7, 9))
    normal, gradient = roots @ roots.T, random.normal(size=7)
    by_parameter = random.normal(size=7)
    # down the direction that takes room away
    gradient -= 3.0 * normal @ by_parameter
    room = (np.array([room_mm]), by_parameter[None])
    (step,), _ = newton_steps(normal[None], gradient[None], 0.0, room)
    (free,), _ = newton_steps(normal[None], gradient[None], 0.0)
    left_mm = room_mm + by_parameter @ step
    if room_mm + by_parameter @ free >= 0.0:
        assert step == pytest.approx(free)
    else:
        assert left_mm == pytest.approx(0.0, abs=1e-9)
        # what still pulls runs along the limit's normal, towards the forbidden side (Karush, Kuhn and Tucker)
        pull = gradient - normal @ step
        assert pull == pytest.approx(by_parameter * (pull @ by_parameter) / (by_parameter @ by_parameter))
        assert pull @ by_parameter < 0.0
