"""Which of several top faces at one place stands."""

from __future__ import annotations

import numpy as np
import pytest

from srvs_cell.vision.faces.edge_fit import FaceFit
from srvs_cell.vision.faces.face import Face, Figure
from srvs_cell.vision.recognition.tops import Top, best_per_place, is_better, one_per_place


def top(length_mm: float, price_px2: float, *, rms_px: float = 0.3, z_mm: float = 40.0, surface: int = 0) -> Top:
    face = Face(Figure.RECTANGLE, 500.0, 60.0, z_mm, 0.2, length_mm, 0.8 * length_mm)
    return Top(FaceFit(face, np.eye(3), rms_px, 1.0), (surface,), price_px2)


def test_the_cheaper_of_two_tops_stands_whatever_one_fit_of_the_other_says() -> None:
    """The other one is larger, and its better fit is as good as any."""
    right, wrong = top(40.0, 0.63, rms_px=0.45, surface=1), top(47.0, 1.3, rms_px=0.1, surface=2)
    for tops in ([right, wrong], [wrong, right]):
        (stands,) = best_per_place(tops)
        assert stands.fit is right.fit
        assert sorted(stands.surfaces) == [1, 2]


@pytest.mark.parametrize(("price_px2", "stands"), [(0.5, True), (0.7, False)])
def test_a_convincing_face_stands_before_the_print_on_it(price_px2: float, stands: bool) -> None:
    face, label = top(60.0, price_px2), top(20.0, 0.05)
    assert is_better(face, label) is stands
    assert is_better(label, face) is not stands
    (one,) = best_per_place([label, face])
    assert one.fit is (face if stands else label).fit


def test_what_lies_at_another_height_is_no_print() -> None:
    assert not is_better(top(60.0, 0.5), top(20.0, 0.05, z_mm=60.0))


def test_where_only_the_edges_were_asked_the_surest_and_largest_stands() -> None:
    small, large, sure = top(40.0, np.inf), top(47.0, np.inf), top(40.0, np.inf, rms_px=0.1)
    assert [one.fit for one in one_per_place([small, large])] == [large.fit]
    assert [one.fit for one in one_per_place([large, sure])] == [sure.fit]
