"""Planes of a published pair of pictures against its published truth."""

import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.perceive_middlebury import TRUTH_SCALE, read
from srvs_cell.vision import VisionParameters, perceive

DATA = Path(os.environ.get("SRVS_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
VENUS = DATA / "middlebury2001" / "venus"


@pytest.mark.skipif(not VENUS.is_dir(), reason="no Middlebury pictures: set SRVS_DATA or provide middlebury2001")
def test_venus_is_seen_to_a_pixel_over_most_of_its_area() -> None:
    left, right = read(VENUS / "im2.ppm"), read(VENUS / "im6.ppm")
    perception = perceive(left, right, replace(VisionParameters(), max_disparity_px=32.0))
    truth = read(VENUS / "disp2.pgm", cv2.IMREAD_GRAYSCALE) / TRUTH_SCALE
    known = truth > 0.0
    both = known & np.isfinite(perception.disparity_px)
    error_px = np.abs(perception.disparity_px - truth)[both]
    assert both.sum() >= 0.5 * known.sum()
    assert np.mean(error_px <= 1.0) >= 0.85
    assert np.median(error_px) < 0.2
