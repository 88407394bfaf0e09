"""Following thin edges."""

from __future__ import annotations

import numpy as np

from srvs_cell.vision.parameters import TrackingParameters
from srvs_cell.vision.tracking import drop_short_chains, open_ends, track_edges


def test_short_chains_are_dropped_and_long_ones_kept() -> None:
    edges = np.zeros((20, 20), dtype=np.bool_)
    edges[3, 2:5] = True
    edges[10, 2:15] = True
    kept = drop_short_chains(edges, 5)
    assert kept.sum() == 13
    assert kept[10, 2:15].all()


def test_open_ends_point_on_along_their_edge() -> None:
    edges = np.zeros((20, 30), dtype=np.bool_)
    edges[8, 5:20] = True
    ends, directions = open_ends(edges)
    found = {tuple(end): tuple(np.rint(direction)) for end, direction in zip(ends.tolist(), directions, strict=True)}
    assert found == {(8, 5): (0.0, -1.0), (8, 19): (0.0, 1.0)}


def test_a_gap_in_a_line_is_closed() -> None:
    edges = np.zeros((20, 40), dtype=np.bool_)
    edges[10, 3:15] = edges[10, 20:36] = True
    tracked = track_edges(edges, TrackingParameters(max_gap_px=6))
    assert tracked[10, 3:36].all()


def test_a_gap_wider_than_allowed_stays() -> None:
    edges = np.zeros((20, 40), dtype=np.bool_)
    edges[10, 3:12] = edges[10, 26:36] = True
    tracked = track_edges(edges, TrackingParameters(max_gap_px=6))
    assert not tracked[10, 13:25].any()


def test_a_line_is_prolonged_to_the_border_of_the_image() -> None:
    edges = np.zeros((20, 40), dtype=np.bool_)
    edges[10, 10:36] = True
    assert track_edges(edges, TrackingParameters(max_gap_px=5))[10, 36:].all()


def test_no_edge_is_no_trouble() -> None:
    nothing = np.zeros((16, 16), dtype=np.bool_)
    assert not track_edges(nothing, TrackingParameters()).any()
