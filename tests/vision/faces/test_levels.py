"""The grey levels of stretches, against the same least squares written out for one stretch after the other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.special import ndtr

from srvs_cell.vision.faces.levels import LevelNormal, by_level, of_stretches
from srvs_cell.vision.faces.profiles import GROUPS, OFFSETS_PX, Model, Profiles

if TYPE_CHECKING:
    from srvs_cell.geometry import Array

NOISE = 1.5
FACES, SAMPLES = 2, 24


def ties(shade: float | None) -> list[tuple[Array, float]]:
    """Return what is held to be nothing, and to how many grey values.

    The side face is held to the shadow, and this to what the shade leaves of what lies behind in each image.
    """
    left, sigma = (1.0, 60.0) if shade is None else (shade, 10.0)
    return [
        (np.array([0.0, 0.0, 0.0, 0.0, 1.0, -1.0]), 60.0 / np.sqrt(2.0)),
        (np.array([0.0, -left, 0.0, 0.0, 0.0, 1.0]), sigma),
        (np.array([0.0, 0.0, 0.0, -left, 0.0, 1.0]), sigma),
    ]


def profiles(widths_px: tuple[float, float, float, float], shade: float | None) -> Profiles:
    """Return profiles of random grey values where in either image side faces and shadows end so far outside."""
    random = np.random.default_rng(1)
    model = Model.of(0.85)
    shape = (len(OFFSETS_PX), 2, FACES, SAMPLES)
    ends = np.array(widths_px).reshape(2, 2, 1, 1) + np.zeros((FACES, SAMPLES))
    foot, slope = model.beyond(ends[:, 0])
    end, end_slope = model.beyond(ends[:, 1])
    shares = np.stack([model.shares[1, :, None, None, None] - foot, end])
    grey, weights = (random.uniform(0.0, most, shape).astype(np.float32) for most in (255.0, 1.0))
    return Profiles(grey, weights, model, shares, np.stack([slope, end_slope]), shade, np.zeros((2, FACES, 7, SAMPLES)))


def columns(seen: Profiles, eye: int, face: int, samples: slice) -> Array:
    """Return what an image of a stretch is expected to show by its six levels.

    Face and background of the left and of the right image, side face, shadow.
    """
    side, behind = seen.shares[:, :, eye, face, samples].astype(np.float64)
    own = np.broadcast_to(seen.model.shares[0].astype(np.float64)[:, None], side.shape)
    shadow = 1.0 - own - side - behind
    nothing = np.zeros_like(side)
    both = [own, behind, nothing, nothing] if eye == 0 else [nothing, nothing, own, behind]
    return np.stack([*both, side, shadow], axis=-1).reshape(-1, 6)


@pytest.mark.parametrize("shade", [None, 0.6])
@pytest.mark.parametrize(
    "widths_px",
    [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.2, 1.2), (2.5, 2.5, 0.3, 0.3), (11.0, 11.0, 11.0, 11.0), (0.5, 2.0, 0.0, 1.0)],
)
def test_levels_and_what_they_explain_are_those_of_the_least_squares(
    widths_px: tuple[float, float, float, float], shade: float | None
) -> None:
    seen = profiles(widths_px, shade)
    normal = LevelNormal.of(seen, seen.weights, NOISE)
    sums = of_stretches(by_level(seen, seen.weights * seen.grey))
    levels, taken = normal.levels(sums), normal.whitened(sums[:, :, :, None])
    for face in range(FACES):
        explained = 0.0
        for group in range(GROUPS):
            samples = slice(group * SAMPLES // GROUPS, (group + 1) * SAMPLES // GROUPS)
            matrix = 1e-6 * np.eye(6)
            for apart, sigma in ties(shade):
                matrix += (NOISE / sigma) ** 2 * np.outer(apart, apart)
            right = np.zeros(6)
            for eye in range(2):
                design = columns(seen, eye, face, samples)
                weights = seen.weights[:, eye, face, samples].astype(np.float64).ravel()
                matrix += (design * weights[:, None]).T @ design
                right += design.T @ (weights * seen.grey[:, eye, face, samples].ravel())
            solved = np.linalg.solve(matrix, right)
            found = levels[:, :, face, group]
            # what is not seen has no level to speak of, but what is seen is expected alike
            for eye, (own, behind) in enumerate(((0, 1), (2, 3))):
                expected = columns(seen, eye, face, samples)
                same = expected[:, [own, behind, 4, 5]] @ found[:, eye]
                assert same == pytest.approx(expected @ solved, abs=0.05)
            explained += float(right @ solved)
        assert float(taken[face, 0] @ taken[face, 0]) == pytest.approx(explained, rel=1e-4)


def test_the_model_shares_each_value_out_and_knows_how_it_moves() -> None:
    model = Model.of(0.7)
    widths_px = np.linspace(0.0, 12.0, 1201)
    behind, slope = model.beyond(widths_px)
    assert behind == pytest.approx(ndtr((OFFSETS_PX[:, None] - widths_px) / 0.7), abs=1e-4)
    # what lies beyond the border itself is all that is not the face
    assert model.shares[1] == pytest.approx(behind[:, 0], abs=1e-6)
    assert model.shares.sum(axis=0) == pytest.approx(np.ones(len(OFFSETS_PX)), abs=1e-6)
    # a border that moves outwards by a step is what a side face wider by that step ends in
    assert slope == pytest.approx(np.gradient(behind, 0.01, axis=1), abs=0.01)
    # what reaches farther than any profile, or is hidden, makes no difference
    assert np.array_equal(model.beyond(np.array([-3.0, 50.0]))[0], model.beyond(np.array([0.0, 12.0]))[0])
    assert Model.of(0.7) is model
