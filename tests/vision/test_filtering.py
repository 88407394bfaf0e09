"""The peak and hole filter."""

from __future__ import annotations

import numpy as np

from srvs_cell.vision.filtering import filter_edges
from srvs_cell.vision.parameters import FilterParameters


def bar() -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    mask = np.zeros((20, 30), dtype=np.bool_)
    mask[8:12, 3:27] = True
    return mask


def test_a_lone_pixel_is_cut() -> None:
    mask = bar()
    mask[2, 2] = True
    assert not filter_edges(mask, FilterParameters())[2, 2]


def test_a_peak_on_an_edge_is_cut() -> None:
    mask = bar()
    mask[4:8, 15] = True
    parameters = FilterParameters(passes=1)
    assert not filter_edges(mask, parameters)[4, 15]


def test_a_hole_in_an_edge_is_filled() -> None:
    mask = bar()
    mask[9, 15] = False
    assert filter_edges(mask, FilterParameters())[9, 15]


def test_a_clean_edge_stays_and_no_pass_changes_nothing() -> None:
    assert np.array_equal(filter_edges(bar(), FilterParameters()), bar())
    dirty = bar()
    dirty[2, 2] = True
    assert np.array_equal(filter_edges(dirty, FilterParameters(passes=0)), dirty)
