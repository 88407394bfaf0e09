"""The whole way from pictures of an independent renderer to workpieces, held against exact truth."""

import os
from pathlib import Path

import pytest

from benchmarks.perceive_rendered import Found, SceneResult, evaluate, summary

ROOT = Path(os.environ.get("SRVS_DATA", Path(__file__).resolve().parents[3] / "shared" / "data")) / "rendered_scenes"
SCENES = ("L0/001", "L1/004", "L1/006")
needs_scenes = pytest.mark.skipif(not ROOT.is_dir(), reason=f"no rendered scenes: set SRVS_DATA or provide {ROOT.name}")


@pytest.mark.slow
@needs_scenes
def test_rendered_scenes_within_honest_bounds() -> None:
    results = evaluate(ROOT, SCENES)
    figures = summary(results)
    assert figures["objects"] == 15
    assert figures["found"] == 15
    assert figures["kind_right"] >= 14
    assert figures["spurious"] <= 1
    assert figures["error_mean_mm"] < 0.5
    assert figures["error_max_mm"] < 2.5
    assert figures["height_error_mean_mm"] < 0.6
    assert figures["yaw_error_max_deg"] < 0.5


@pytest.mark.slow
@needs_scenes
def test_a_wedge_is_told_from_the_cuboid_that_would_be_five_millimetres_lower() -> None:
    # it is told from one only where what suited better is asked again what else it may be
    results = evaluate(ROOT, ["L2/001"], shaken=range(8))
    assert sum(all(one.seen_kind == one.kind for one in result.objects) for result in results) >= 6
    assert (
        sum(all(one.error_mm is not None and one.error_mm < 2.5 for one in result.objects) for result in results) >= 6
    )


@pytest.mark.slow
@needs_scenes
@pytest.mark.parametrize("scene", ["L1/003", "L1/005"])
def test_where_no_edges_tell_the_lamp_what_was_found_besides_tells_it(scene: str) -> None:
    # a dark wedge that runs out on a dark table; a bright cuboid whose shadow would do as part of its face
    results = evaluate(ROOT, [scene], shaken=range(6))
    assert sum(len(result.spurious) for result in results) == 0
    for result in results:
        assert all(one.seen_kind == one.kind for one in result.objects)
        assert all(one.error_mm is not None and one.error_mm < 3.0 for one in result.objects)


@pytest.mark.slow
@needs_scenes
@pytest.mark.xfail(strict=True, reason="two heights 0.25 mm apart: the wedge's is 0.8 mm off, with a sigma of 2.7 mm")
def test_a_wedge_among_parts_of_its_height_keeps_its_place_in_the_order() -> None:
    results = evaluate(ROOT, ["L2/001"], shaken=range(8))
    assert sum(result.in_order for result in results) >= 6


@pytest.mark.parametrize(
    ("heights_mm", "in_order"),
    [
        ([(20.0, 20.4), (30.0, 29.0), (25.0, 26.0)], True),
        ([(20.0, 26.4), (30.0, 29.0), (25.0, 26.0)], False),
        ([(23.75, 24.2), (23.76, 23.5)], True),
        ([], True),
    ],
)
def test_what_differs_in_height_is_to_be_seen_in_that_order(
    heights_mm: list[tuple[float, float]], *, in_order: bool
) -> None:
    objects = tuple(Found("L0/000", "cuboid", "cuboid", 0.1, heights_mm=both) for both in heights_mm)
    assert SceneResult("L0/000", objects, (), (), 0).in_order is in_order
