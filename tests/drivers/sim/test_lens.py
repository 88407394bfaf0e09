from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.sim.lens import Lens

LENSES = st.builds(
    Lens,
    fx=st.floats(700.0, 900.0),
    fy=st.floats(700.0, 900.0),
    cx=st.floats(300.0, 340.0),
    cy=st.floats(220.0, 260.0),
    distortion=st.tuples(
        st.floats(-0.15, 0.05),
        st.floats(-0.05, 0.08),
        st.floats(-1e-3, 1e-3),
        st.floats(-1e-3, 1e-3),
        st.floats(-0.02, 0.02),
    ),
)


def _grid(lens: Lens) -> np.ndarray:
    v, u = np.mgrid[0.0 : lens.height : 60, 0.0 : lens.width : 80]
    return np.stack([u, v], axis=-1)


def _points(rays: np.ndarray) -> np.ndarray:
    return np.concatenate([rays, np.ones((*rays.shape[:-1], 1))], axis=-1)


@settings(max_examples=30)
@given(LENSES)
def test_projecting_a_pixels_ray_gives_the_pixel(lens: Lens) -> None:
    pixels = _grid(lens)
    rays, _ = lens.rays(pixels)
    assert np.abs(lens.project(_points(rays)) - pixels).max() < 1e-9


@settings(max_examples=30)
@given(LENSES)
def test_projection_is_opencvs(lens: Lens) -> None:
    points = np.random.default_rng(1).uniform((-0.3, -0.2, 0.9), (0.3, 0.2, 1.1), (50, 3))
    matrix = np.array([[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]])
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(lens.distortion))
    assert np.abs(lens.project(points) - theirs[:, 0]).max() < 1e-9


@settings(max_examples=30)
@given(LENSES)
def test_the_rays_derivative_predicts_sub_pixel_rays(lens: Lens) -> None:
    pixels = _grid(lens)
    rays, slope = lens.rays(pixels)
    step = np.array([0.5, -0.5])
    exact, _ = lens.rays(pixels + step)
    assert np.abs(rays + slope @ step - exact).max() * lens.fx < 1e-3
