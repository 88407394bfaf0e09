"""The plan picture."""

import numpy as np

from srvs_cell.service.pictures import PlanArrow, PlanPart, draw_plan, outline_mm


def test_outline_is_the_footprint_in_the_base_frame() -> None:
    corners = outline_mm(PlanPart(0, "cuboid", (100.0, 50.0), 20.0, 90.0, (60.0, 40.0)))
    assert np.allclose(corners.max(axis=0), (120.0, 80.0))
    assert np.allclose(corners.min(axis=0), (80.0, 20.0))


def test_the_picture_is_seen_from_above_not_mirrored() -> None:
    """A part at larger base y is drawn further left, one at larger base x further up."""
    here = PlanPart(0, "cylinder", (0.0, 0.0), 10.0, None, (30.0, 30.0))
    there = PlanPart(1, "cylinder", (100.0, 100.0), 10.0, None, (60.0, 60.0))
    picture = draw_plan([here, there], [])
    rows, columns = np.nonzero((picture == (205, 170, 120)).all(axis=2))
    weight_left_top = np.count_nonzero((columns < picture.shape[1] / 2) & (rows < picture.shape[0] / 2))
    assert weight_left_top > 0.7 * len(rows)


def test_an_empty_table_and_no_moves_are_drawn_too() -> None:
    assert draw_plan([], []).shape[2] == 3


def test_moves_are_drawn() -> None:
    part = PlanPart(0, "cuboid", (0.0, 0.0), 10.0, 0.0, (30.0, 30.0))
    arrow = PlanArrow(0, (0.0, 0.0), (200.0, 50.0))
    assert np.count_nonzero((draw_plan([part], [arrow]) == (40, 60, 210)).all(axis=2)) > 200


def test_a_very_short_move_can_be_drawn() -> None:
    part = PlanPart(0, "cuboid", (0.0, 0.0), 10.0, 0.0, (30.0, 30.0))
    assert draw_plan([part], [PlanArrow(0, (0.0, 0.0), (3.0, 2.0))]).any()
