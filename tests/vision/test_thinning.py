"""Zhang-Suen thinning."""

from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from srvs_cell.vision.thinning import thin


def components(mask: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> int:
    return int(cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)[0]) - 1


def test_a_bar_becomes_a_line_in_its_middle() -> None:
    mask = np.zeros((15, 40), dtype=np.bool_)
    mask[5:10, 3:37] = True
    line = thin(mask)
    columns = line[:, 8:32]
    assert (columns.sum(axis=0) == 1).all()
    assert set(np.nonzero(columns)[0].tolist()) == {7}


def test_a_ring_stays_one_closed_ring() -> None:
    y, x = np.indices((41, 41)) - 20
    radius = np.hypot(x, y)
    line = thin((radius > 10) & (radius < 16))
    assert components(line) == 1
    inside = cv2.connectedComponents((~line).astype(np.uint8), connectivity=4)[0] - 1
    assert inside == 2


@settings(max_examples=60)
@given(arrays(np.bool_, (12, 14), elements=st.booleans()))
def test_thinning_only_removes_and_thins_no_further(mask: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> None:
    line = thin(mask)
    assert not (line & ~mask).any()
    assert np.array_equal(thin(line), line)


def test_smooth_shapes_keep_their_number() -> None:
    generator = np.random.default_rng(3)
    blurred = cv2.GaussianBlur(generator.normal(size=(80, 80)).astype(np.float32), (0, 0), 4.0)
    mask = np.asarray(blurred > 0.02)
    # Zhang and Suen's known fault: a 2x2 block vanishes
    large = mask & (cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)
    large = cv2.dilate(large.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    assert components(thin(large)) == components(large)
