"""The grey levels of stretches, against the same least squares written out for one stretch after the other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.special import ndtr

from srvs_cell.vision.levels import LevelNormal, by_level, of_stretches
from srvs_cell.vision.profiles import GROUPS, OFFSETS_PX, Model, Profiles

if TYPE_CHECKING:
    from srvs_cell.geometry import Array

NOISE = 1.5
FACES, SAMPLES = 2, 24
TIE = np.array([0.0, -0.5, 0.0, -0.5, 1.0])
"""How a side face's level is held to the mean of what lies behind it in both images."""


def profiles(widths_px: Array) -> Profiles:
    """Return profiles of random grey values where side faces are seen so wide, shape (2, FACES, SAMPLES)."""
    random = np.random.default_rng(1)
    model = Model.of(0.85)
    shape = (len(OFFSETS_PX), 2, FACES, SAMPLES)
    shares, slope = model.at(widths_px)
    grey, weights = (random.uniform(0.0, most, shape).astype(np.float32) for most in (255.0, 1.0))
    return Profiles(grey, weights, model, shares, slope, np.zeros((2, FACES, 7, SAMPLES)))


def columns(seen: Profiles, eye: int, face: int, samples: slice) -> Array:
    """Return what an image of a stretch is expected to show by its five levels: face and background twice, side."""
    side, behind = seen.shares[:, :, eye, face, samples].astype(np.float64)
    own = np.broadcast_to(seen.model.face.astype(np.float64)[:, None], side.shape)
    nothing = np.zeros_like(side)
    both = [own, behind, nothing, nothing] if eye == 0 else [nothing, nothing, own, behind]
    return np.stack([*both, side], axis=-1).reshape(-1, 5)


@pytest.mark.parametrize("widths_px", [(0.0, 0.0), (0.0, 1.2), (2.5, 0.3), (11.0, 11.0)])
def test_levels_and_what_they_explain_are_those_of_the_least_squares(widths_px: tuple[float, float]) -> None:
    seen = profiles(np.broadcast_to(np.array(widths_px)[:, None, None], (2, FACES, SAMPLES)))
    normal = LevelNormal.of(seen, seen.weights, NOISE)
    sums = of_stretches(by_level(seen, seen.weights * seen.grey))
    levels, taken = normal.levels(sums), normal.whitened(sums[:, :, :, None])
    for face in range(FACES):
        explained = 0.0
        for group in range(GROUPS):
            samples = slice(group * SAMPLES // GROUPS, (group + 1) * SAMPLES // GROUPS)
            matrix = 1e-6 * np.eye(5) + (NOISE / 60.0) ** 2 * np.outer(TIE, TIE)
            right = np.zeros(5)
            for eye in range(2):
                design = columns(seen, eye, face, samples)
                weight = seen.weights[:, eye, face, samples].astype(np.float64).ravel()
                matrix += (design * weight[:, None]).T @ design
                right += design.T @ (weight * seen.grey[:, eye, face, samples].ravel())
            solved = np.linalg.solve(matrix, right)
            found = levels[:, :, face, group]
            # what is not seen has no level to speak of, but what is seen is expected alike
            for eye, (own, behind) in enumerate(((0, 1), (2, 3))):
                expected = columns(seen, eye, face, samples)
                same = expected[:, [own, behind, 4]] @ found[:, eye]
                assert same == pytest.approx(expected @ solved, abs=0.05)
            explained += float(right @ solved)
        assert float(taken[face, 0] @ taken[face, 0]) == pytest.approx(explained, rel=1e-4)


def test_the_model_shares_each_value_out_and_knows_how_it_moves() -> None:
    model = Model.of(0.7)
    widths_px = np.linspace(0.0, 12.0, 1201)
    (side, behind), slope = model.at(widths_px)
    total = model.face[:, None] + side + behind
    assert total == pytest.approx(np.ones(total.shape), abs=1e-6)
    assert behind == pytest.approx(ndtr((OFFSETS_PX[:, None] - widths_px) / 0.7), abs=1e-4)
    # a border that moves outwards by a step is what a side face wider by that step ends in
    assert slope == pytest.approx(np.gradient(behind, 0.01, axis=1), abs=0.01)
    assert not side[:, 0].any()
    assert Model.of(0.7) is model
