"""The whole way from pictures of an independent renderer to workpieces, held against exact truth."""

import os
from pathlib import Path

import pytest

from benchmarks.perceive_rendered import evaluate, summary

ROOT = Path(os.environ.get("SRVS_DATA", Path(__file__).resolve().parents[3] / "shared" / "data")) / "rendered_scenes"
SCENES = ("L0/001", "L1/004", "L1/006")


@pytest.mark.slow
@pytest.mark.skipif(not ROOT.is_dir(), reason=f"no rendered scenes: set SRVS_DATA or provide {ROOT.name}")
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
