"""Line-support regions on pictures whose edges are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray  # noqa: TC002 - read by people and mypy

from srvs_cell.vision.edges import EdgeParameters, extract_edges, gradient_2x2, strong_gradient


def step_image(angle_deg: float, size: int = 64, contrast: float = 80.0) -> NDArray[np.uint8]:
    y, x = np.indices((size, size)) - size / 2.0
    turn = np.deg2rad(angle_deg)
    distance = x * np.cos(turn) + y * np.sin(turn)
    return np.asarray(60.0 + contrast * (distance > 0.0), dtype=np.uint8)


def test_the_gradient_of_a_ramp_is_its_slope_in_grey_values_per_pixel() -> None:
    y, x = np.indices((8, 9))
    gradient = gradient_2x2(np.asarray(3.0 * x - 2.0 * y, dtype=np.float32))
    for slope, expected in zip(gradient, (3.0, -2.0), strict=True):
        assert np.allclose(slope[:-1, :-1], expected)
        assert not slope[-1].any()
        assert not slope[:, -1].any()


def test_an_edge_of_any_direction_is_found_whole_also_on_the_border_of_a_partition() -> None:
    for angle_deg in np.arange(0.0, 180.0, 7.5):
        image = step_image(float(angle_deg))
        mask = extract_edges(image, EdgeParameters()).mask
        y, x = np.indices(image.shape) - 31.5
        distance = x * np.cos(np.deg2rad(angle_deg)) + y * np.sin(np.deg2rad(angle_deg))
        inner = np.hypot(x, y) < 28.0
        # every place along the edge has an edge pixel near it, and there is none elsewhere
        along = -x * np.sin(np.deg2rad(angle_deg)) + y * np.cos(np.deg2rad(angle_deg))
        covered = np.unique(np.floor(along[mask & inner] / 2.0))
        assert covered.size >= 27, angle_deg
        assert np.abs(distance[mask & inner]).max() < 5.0, angle_deg


def test_a_constant_image_has_no_edge() -> None:
    assert not extract_edges(np.full((32, 40), 90, dtype=np.uint8), EdgeParameters()).mask.any()


def test_noise_alone_makes_few_edges_and_raises_the_threshold_within_its_bounds() -> None:
    generator = np.random.default_rng(1)
    noisy = np.asarray(np.clip(generator.normal(100.0, 2.0, (120, 160)), 0, 255), dtype=np.uint8)
    found = extract_edges(noisy, EdgeParameters())
    assert found.mask.mean() < 0.01
    assert EdgeParameters().min_gradient < found.threshold <= EdgeParameters().max_gradient
    assert strong_gradient(np.full((4, 4), 100.0, dtype=np.float32), EdgeParameters(max_gradient=3.0)) == 3.0


def test_a_short_weak_region_is_no_edge_and_a_short_strong_one_is() -> None:
    weak = np.full((40, 40), 100, dtype=np.uint8)
    weak[18:21, 18:21] = 104
    strong = weak.copy()
    strong[18:21, 18:21] = 250
    parameters = EdgeParameters(min_gradient=1.0, max_gradient=1.0, min_length_px=12.0)
    assert not extract_edges(weak, parameters).mask.any()
    assert extract_edges(strong, parameters).mask.any()


def test_a_picture_as_small_as_it_gets_is_no_trouble() -> None:
    assert extract_edges(np.zeros((1, 1), dtype=np.uint8), EdgeParameters()).mask.shape == (1, 1)


def test_no_arc_of_a_circle_is_dropped_whatever_its_radius_and_place() -> None:
    y, x = np.indices((110, 110)).astype(np.float64)
    for number in range(24):
        radius_px, middle_px = 30.0 + 0.4 * number, 55.0 + 0.13 * number
        distance = np.hypot(x - middle_px, y - middle_px) - radius_px
        image = np.asarray(np.rint(100.0 - 40.0 * np.clip(0.5 - distance / 2.0, 0.0, 1.0)), dtype=np.uint8)
        rows, columns = np.nonzero(extract_edges(image, EdgeParameters()).mask)
        turn_deg = np.rad2deg(np.arctan2(rows + 0.5 - middle_px, columns + 0.5 - middle_px)) % 360.0
        assert np.unique(np.floor(turn_deg / 5.0)).size == 72, radius_px
