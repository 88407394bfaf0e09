"""Runs along rows and what is connected, against OpenCV's components."""

from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from srvs_cell.vision.region_growing import grow_between_edges
from srvs_cell.vision.runs import RowRuns, joined, runs_of, touching_runs


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000), share=st.floats(0.05, 0.95), size=st.tuples(st.integers(1, 30), st.integers(2, 30)))
def test_runs_that_touch_join_to_the_components_of_opencv(seed: int, share: float, size: tuple[int, int]) -> None:
    mask = np.random.default_rng(seed).random(size) < share
    mask[:, -1] = False
    pixels = np.flatnonzero(mask)
    if not pixels.size:
        return
    begin = runs_of(pixels, np.zeros(pixels.size - 1, dtype=np.bool_))
    first, last = pixels[begin], pixels[np.append(begin[1:], pixels.size) - 1]
    root = joined(np.arange(begin.size), *touching_runs(first, last, size[1]))
    of_pixel = np.repeat(root, last - first + 1)
    count, components = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    pairs = np.unique(np.stack([of_pixel, np.asarray(components).ravel()[pixels]]), axis=1)
    assert np.unique(root).size == count - 1 == pairs.shape[1]


def test_a_run_of_another_label_is_another_run() -> None:
    pixels = np.array([3, 4, 5, 8, 9])
    assert runs_of(pixels, np.array([False, True, False, False])).tolist() == [0, 2, 3]


def test_groups_that_are_joined_step_by_step_have_their_lowest_thing_as_root() -> None:
    root = joined(np.arange(7), np.array([6, 2]), np.array([5, 3]))
    assert root.tolist() == [0, 1, 2, 2, 4, 5, 5]
    assert joined(root, np.array([6, 4]), np.array([3, 1])).tolist() == [0, 1, 2, 2, 1, 2, 2]


def test_sums_and_new_numbers_of_runs() -> None:
    labels = np.array([[1, 1, 2], [2, 2, 0]], dtype=np.int32)
    runs = RowRuns.of(labels)
    assert runs.sums(np.array([[250, 250, 3], [4, 5, 6]], dtype=np.uint8)).tolist() == [500, 3, 9, 6]
    assert runs.painted(np.array([0, 7, 5], dtype=np.int32), labels.shape).tolist() == [[7, 7, 5], [5, 5, 0]]


@settings(max_examples=30)
@given(seed=st.integers(0, 10_000))
def test_every_region_is_connected_and_every_pixel_belongs_to_one(seed: int) -> None:
    generator = np.random.default_rng(seed)
    edges = np.zeros((90, 110), dtype=np.uint8)
    for _ in range(6):
        ends = generator.integers(0, 90, 4).tolist()
        cv2.line(edges, (ends[0], ends[1]), (ends[2], ends[3]), 1)
    distance = np.asarray(cv2.distanceTransform(1 - edges, cv2.DIST_L2, 3), dtype=np.float32)
    labels = grow_between_edges(distance)
    assert labels.min() == 1
    for label in range(1, int(labels.max()) + 1):
        assert cv2.connectedComponents((labels == label).astype(np.uint8), connectivity=4)[0] == 2
