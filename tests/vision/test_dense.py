"""Every pixel its surface: the choice of planes, of labels, of superpixels, and the filled map."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from srvs_cell.scene import PlaneImage
from srvs_cell.vision import VisionParameters, perceive
from srvs_cell.vision.dense import fill_disparity
from srvs_cell.vision.grouping import group_surfaces
from srvs_cell.vision.hypotheses import choose_planes
from srvs_cell.vision.labelling import choose_labels
from srvs_cell.vision.parameters import DenseParameters
from srvs_cell.vision.photometric import PhotometricCost
from srvs_cell.vision.refinement import GreyPair
from srvs_cell.vision.superpixels import cut_superpixels

HEIGHT, WIDTH = 120, 160
FRONT, BACK = (0.02, -0.01, 14.0), (0.0, 0.0, 6.0)


def textured_pair() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A slanted textured square before a textured wall: left, right and the left image's disparity."""
    generator = np.random.default_rng(3)
    wall, square = (cv2.GaussianBlur(generator.uniform(0, 255, (HEIGHT, WIDTH)), (0, 0), 1.5) for _ in range(2))
    wall, square = (np.clip(4.0 * (each - 127.5) + 127.5, 0, 255).astype(np.float32) for each in (wall, square))
    y, x = np.indices((HEIGHT, WIDTH), dtype=np.float32)
    inside = ((x > 60) & (x < 120) & (y > 30) & (y < 90)).astype(np.float32)
    left = np.where(inside > 0, square, wall)
    right = cv2.remap(wall, x + BACK[2], y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    source = (x + FRONT[1] * y + FRONT[2]) / np.float32(1.0 - FRONT[0])
    covered = cv2.remap(inside, source, y, cv2.INTER_NEAREST) > 0
    right = np.where(covered, cv2.remap(square, source, y, cv2.INTER_LINEAR), right)
    truth = np.where(inside > 0, FRONT[0] * x + FRONT[1] * y + FRONT[2], BACK[2])
    return left.astype(np.uint8), right.astype(np.uint8), truth


def test_the_true_plane_costs_least_and_what_leaves_the_image_is_undecided() -> None:
    left, right, _ = textured_pair()
    true, off = PhotometricCost.of(left, right).of_planes([BACK, (0.0, 0.0, 9.0)])
    assert true[:25, 20:].mean() < 0.05
    assert off[:25, 20:].mean() > 0.3
    assert (off[:, :9] == 0.5).all()


def test_planes_are_chosen_by_what_the_others_leave_unexplained() -> None:
    most = np.array([0.0] * 6 + [0.5] * 4, dtype=np.float32)
    rest = np.array([0.5] * 6 + [0.0] * 4, dtype=np.float32)
    copy = most + np.float32(0.01)
    assert choose_planes(np.array([copy, rest, most]), 0.05) == [2, 1]
    assert choose_planes(np.full((2, 10), 0.5, dtype=np.float32), 0.05) == []


@settings(max_examples=30)
@given(seed=st.integers(0, 10_000), size=st.integers(2, 9))
def test_labels_of_a_chain_have_almost_the_least_energy_and_never_more_than_each_for_itself(
    seed: int, size: int
) -> None:
    generator = np.random.default_rng(seed)
    cost = generator.uniform(0.0, 1.0, (2, size))
    weight = generator.uniform(0.0, 1.0, size - 1)
    one, other = np.arange(size - 1), np.arange(1, size)

    def energy(labels: np.ndarray) -> float:
        return float(cost[labels, np.arange(size)].sum() + weight[labels[one] != labels[other]].sum())

    every = [np.array([number >> bit & 1 for bit in range(size)]) for number in range(2**size)]
    found = choose_labels(cost, one, other, weight, 200)
    assert energy(found) <= energy(np.argmin(cost, axis=0)) + 1e-6
    assert energy(found) <= 1.15 * min(map(energy, every)) + 0.1


def test_superpixels_end_at_a_step_and_cover_the_image() -> None:
    grey = np.full((60, 80), 50, dtype=np.uint8)
    grey[:, 37:] = 180
    pieces = cut_superpixels(grey, 8, 8.0)
    assert set(np.unique(pieces.labels)) <= set(range(pieces.count))
    assert not set(np.unique(pieces.labels[:, :37])) & set(np.unique(pieces.labels[:, 37:]))
    across = pieces.labels[30, 30] != pieces.labels[30, 45]
    assert across
    assert (pieces.one < pieces.other).all()


def test_every_pixel_gets_the_disparity_of_its_surface() -> None:
    left, right, truth = textured_pair()
    parameters = VisionParameters()
    valid = np.ones(left.shape, dtype=np.bool_)
    valid[:5] = False
    begun = [(0.02, -0.01, 14.3), (0.0, 0.0, 5.8), (0.0, 0.0, 20.0)]
    filled = fill_disparity((left, right), begun, parameters.dense, parameters.refinement, valid)
    assert np.isnan(filled[:5]).all()
    error = np.abs(filled - truth)[5:, 20:]
    assert np.isfinite(error).all()
    # hidden beside the square, 9 px wide, there is nothing to see; the rest is right and aligned
    assert np.mean(error < 0.1) > 0.9


def test_a_filled_map_has_no_hole_and_comes_out_the_same_again() -> None:
    left, right, _ = textured_pair()
    parameters = VisionParameters(max_disparity_px=24.0, dense=DenseParameters(enabled=True))
    once, again = (perceive(left, right, parameters).disparity_px for _ in range(2))
    assert np.isfinite(once).all()
    assert np.array_equal(once, again)


def test_without_matches_there_are_no_surfaces_and_nothing_is_filled() -> None:
    blank = np.full((40, 60), 90, dtype=np.uint8)
    image = PlaneImage(blank, np.zeros((40, 60), dtype=np.int32), ())
    parameters = replace(VisionParameters(), dense=DenseParameters(enabled=True))
    assert group_surfaces(image, image, [], GreyPair.of(image.grey, image.grey), parameters).surfaces == ()
    left, right = blank.copy(), blank.copy()
    left[:, 30:], right[:, :30], right[:, 30:] = 220, 150, 20
    assert np.isnan(perceive(left, right, parameters).disparity_px).all()


def test_the_paper_does_not_fill() -> None:
    assert not VisionParameters.faithful().dense.enabled
    assert not VisionParameters.faithful().matching.ordered
