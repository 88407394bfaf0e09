"""The plan picture."""

import numpy as np

from srvs_cell.service.pictures import PlanArrow, PlanPart, draw_plan


def square(number: int, x_mm: float, y_mm: float, side_mm: float) -> PlanPart:
    half = side_mm / 2.0
    corners = tuple((x_mm + half * u, y_mm + half * v) for u, v in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    return PlanPart(number, (x_mm, y_mm), 10.0, corners)


def test_the_picture_is_seen_from_above_not_mirrored() -> None:
    """A part at larger base y is drawn further left, one at larger base x further up."""
    here = square(0, 0.0, 0.0, 30.0)
    there = square(1, 100.0, 100.0, 60.0)
    picture = draw_plan([here, there], [])
    rows, columns = np.nonzero((picture == (205, 170, 120)).all(axis=2))
    weight_left_top = np.count_nonzero((columns < picture.shape[1] / 2) & (rows < picture.shape[0] / 2))
    assert weight_left_top > 0.7 * len(rows)


def test_an_empty_table_and_no_moves_are_drawn_too() -> None:
    assert draw_plan([], []).shape[2] == 3


def test_moves_are_drawn() -> None:
    part = square(0, 0.0, 0.0, 30.0)
    arrow = PlanArrow(0, (0.0, 0.0), (200.0, 50.0))
    assert np.count_nonzero((draw_plan([part], [arrow]) == (40, 60, 210)).all(axis=2)) > 200


def test_a_very_short_move_can_be_drawn() -> None:
    part = square(0, 0.0, 0.0, 30.0)
    assert draw_plan([part], [PlanArrow(0, (0.0, 0.0), (3.0, 2.0))]).any()
