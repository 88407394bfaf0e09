import numpy as np
import pytest

from srvs_cell.vision.faces import HEXAGON_RATIO, Face, Figure
from srvs_cell.vision.outlines import Outlines

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
    assert points.shape == (4, 48, 3)
    for face, samples, unit in zip(FACES, points, outlines.unit, strict=True):
        assert samples == pytest.approx(face.place(unit))
    assert (outlines.first.sum(axis=1) == [4, 4, 1, 6]).all()


def test_derivatives_are_those_of_the_samples() -> None:
    outlines = Outlines.of(FACES, INCLINED, 48)
    covectors = np.random.default_rng(1).normal(size=(4, 48, 3))
    derivatives = outlines.change(covectors)
    for parameter in range(7):
        step = np.zeros((4, 7))
        step[:, parameter] = 1e-5
        moved = (outlines.moved(step).points_mm() - outlines.moved(-step).points_mm()) / 2e-5
        assert derivatives[..., parameter] == pytest.approx((moved * covectors).sum(axis=-1), abs=1e-6)


def test_what_is_held_does_not_move() -> None:
    moved = Outlines.of(FACES, INCLINED, 48).moved(np.full((4, 7), 0.1)).faces()
    assert moved[0].slope_u == 0.0
    assert moved[1].slope_u == pytest.approx(0.45)
    assert moved[2].angle_rad == 0.0
    assert moved[3].width_mm == pytest.approx(40.1 * HEXAGON_RATIO)
