"""The photometric alignment beside what the noise allows: error, claimed standard deviation, Cramer-Rao bound.

    python benchmarks/alignment_bound.py [--trials 60]

A flat face of a known disparity plane is painted into both images from one smooth function, exact at every part of a
pixel, and white noise and rounding are added to both. The alignment begins 0.3 px off. The error is that of the
disparity in the middle of the face. The bound is that of any unbiased estimate of plane, gain and offset from these
pixels: 2 sigma^2 [J'J]^-1 with J = (g_x u, I, 1), u = (x, y, 1), g_x the true derivative along the row; rounding counts
as noise of 1/12 grey^2. Smoothing before the alignment, robust weights and linear interpolation keep it above.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision import VisionParameters
from srvs_cell.vision.refinement import GreyPair, align_plane

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Texture = Callable[[Array, Array], Array]

HEIGHT, WIDTH = 100, 140
TOP, LEFT, SIDE_PX = 28, 60, 44
PLANE = (0.02, -0.03, 14.3)
BEGIN_OFF_PX = 0.3
ROUNDING_VARIANCE = 1.0 / 12.0
INSIDE = 1.96
WAVES = 200
SHORTEST_WAVE_PX = 6.0
DERIVATIVE_STEP_PX = 1e-3
GREY = 128.0
FACES = (("texture", 20.0), ("texture", 5.0), ("stripe", 60.0), ("stripe", 10.0))
NOISES = (1.0, 3.0)


def texture_of(kind: str, contrast: float, generator: np.random.Generator) -> Texture:
    """Return grey values as a function of x and y: waves of all directions, or one bright stripe with soft edges."""
    if kind == "stripe":
        near, far = LEFT + 0.25 * SIDE_PX, LEFT + 0.75 * SIDE_PX
        return lambda x, y: GREY + 0.5 * contrast * (np.tanh(x - near - 0.1 * (y - TOP)) - np.tanh(x - far))
    turn, phase = generator.uniform(0.0, 2.0 * np.pi, (2, WAVES))
    length = SHORTEST_WAVE_PX / generator.uniform(0.2, 1.0, WAVES)
    k_x, k_y = 2.0 * np.pi * np.array([np.cos(turn), np.sin(turn)]) / length
    height = contrast * np.sqrt(2.0 / WAVES)
    return lambda x, y: GREY + height * np.cos(x[..., None] * k_x + y[..., None] * k_y + phase).sum(axis=-1)


def bound_px(texture: Texture, rows: Array, columns: Array, noise: float) -> float:
    """Return the least standard deviation of the disparity in the middle of the pixels."""
    ahead, behind = (texture(columns + step, rows) for step in (DERIVATIVE_STEP_PX, -DERIVATIVE_STEP_PX))
    slope = (ahead - behind) / (2.0 * DERIVATIVE_STEP_PX)
    one = np.ones_like(columns)
    position = np.stack([columns - columns.mean(), rows - rows.mean(), one])
    jacobian = np.vstack([slope * position, texture(columns, rows), one])
    covariance = 2.0 * (noise**2 + ROUNDING_VARIANCE) * np.linalg.inv(jacobian @ jacobian.T)
    return float(np.sqrt(covariance[2, 2]))


def trial(texture: Texture, noise: float, generator: np.random.Generator) -> tuple[float, float]:
    """Return the error of the disparity in the middle of the face and the standard deviation that is claimed."""
    a, b, c = PLANE
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    pictures = [
        np.clip(np.rint(texture(at, y) + noise * generator.standard_normal(y.shape)), 0, 255).astype(np.uint8)
        # x_R = x_L - (a x_L + b y + c)
        for at in (x, (x + b * y + c) / (1.0 - a))
    ]
    rows, columns = (index.ravel() for index in np.mgrid[TOP : TOP + SIDE_PX, LEFT : LEFT + SIDE_PX])
    begin = (a, b, c + BEGIN_OFF_PX)
    found = align_plane(GreyPair.of(*pictures), rows, columns, begin, VisionParameters().refinement)
    if found is None:
        return BEGIN_OFF_PX, float("nan")
    at_middle = np.array([columns.mean(), rows.mean(), 1.0])
    return float(at_middle @ np.subtract(found.plane, PLANE)), found.sigma_px


def main() -> None:
    """Print a row for each face and noise."""
    parser = argparse.ArgumentParser(description="Error of the photometric alignment beside the Cramer-Rao bound.")
    parser.add_argument("--trials", type=int, default=60)
    trials = parser.parse_args().trials
    heading = ("contrast", "noise", "bound px", "rms px", "bias px", "claimed", "inside 95 %")
    print(f"{'face':<10}" + "".join(f"{name:>12}" for name in heading))
    rows, columns = (index.ravel() for index in np.mgrid[TOP : TOP + SIDE_PX, LEFT : LEFT + SIDE_PX].astype(np.float64))
    for kind, contrast in FACES:
        for noise in NOISES:
            generator = np.random.default_rng(1)
            texture = texture_of(kind, contrast, generator)
            error, sigma = np.array([trial(texture, noise, generator) for _ in range(trials)]).T
            rms, claimed = np.sqrt(np.mean(error**2)), np.nanmedian(sigma)
            inside = 100.0 * np.mean(np.abs(error) <= INSIDE * sigma)
            row = (bound_px(texture, rows, columns, noise), rms, error.mean(), claimed)
            figures = "".join(f"{value:>12.4f}" for value in row)
            print(f"{kind:<10}{contrast:>12.0f}{noise:>12.0f}{figures}{inside:>10.0f} %")


if __name__ == "__main__":
    main()
