"""CPU time of every step of the perception, beside OpenCV's semi-global matcher on the same pair.

    python benchmarks/perception_time.py [DATA] [--scenes L0/001 L1/004 L2/001] [--repeats 5]

DATA is the folder of the rendered scenes ($SRVS_DATA/rendered_scenes, or ../shared/data/rendered_scenes beside the
repository). One thread, process time, median of the repeats; every step also as a share of the matcher's time. The
matcher yields disparities alone, the perception workpieces too: the sum is given for the steps from edges to plane
parameters of both images, without recognition, and whole. The rectification's maps are kept between pairs from the same
place; what the first pair from a place costs more is printed beside.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import yaml

from benchmarks.perceive_rendered import data_folder
from srvs_cell.calibration import Calibration
from srvs_cell.geometry import Transform, Xyzwpr
from srvs_cell.vision import StereoView, VisionParameters, perceive
from srvs_cell.vision.rectification import rectification_maps

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

SCENES = ("L0/001", "L1/004", "L2/001")
DISPARITIES = 64
BLOCK = 5
EARLY = ("edges", "filtering", "thinning", "tracking", "region_growing", "plane_parameters")


def read_scene(folder: Path) -> tuple[list[NDArray[np.uint8]], StereoView]:
    """Return the two images of a scene and where they were taken from."""
    source = folder / "calibration.yaml"
    calibration = Calibration.from_mapping(yaml.safe_load(source.read_text(encoding="utf-8")), str(source))
    poses = json.loads((folder / "poses.json").read_text(encoding="utf-8"))
    left, right = (Transform.from_xyzwpr("base", "tcp", Xyzwpr(*poses[side])) for side in ("left", "right"))
    images = [
        np.asarray(cv2.imread(str(folder / f"{side}.png"), cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
        for side in ("left", "right")
    ]
    return images, StereoView(calibration, left, right, poses["table_z_mm"])


def matcher_ms(images: list[NDArray[np.uint8]]) -> float:
    """Return the CPU time of one semi-global matching."""
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=DISPARITIES,
        blockSize=BLOCK,
        P1=8 * BLOCK**2,
        P2=32 * BLOCK**2,
        mode=cv2.STEREO_SGBM_MODE_SGBM,
    )
    return elapsed_ms(lambda: matcher.compute(images[0], images[1]))


def elapsed_ms(work: Callable[[], object]) -> float:
    """Return the CPU time of some work."""
    since = time.process_time()
    work()
    return 1000.0 * (time.process_time() - since)


def print_scene(folder: Path, scene: str, repeats: int) -> None:
    """Print the steps of one scene, the matcher and the ratios."""
    images, view = read_scene(folder / scene)
    runs = [
        perceive(images[0], images[1], VisionParameters(), view=view, stopwatch=time.process_time).timings_ms
        for _ in range(repeats)
    ]
    steps = {step: statistics.median(run[step] for run in runs) for step in runs[0]}
    whole = statistics.median(sum(run.values()) for run in runs)
    without = statistics.median(sum(run.values()) - run["recognition"] for run in runs)
    beside = statistics.median(matcher_ms(images) for _ in range(repeats))
    anew = statistics.median(elapsed_ms(partial(maps_anew, view)) for _ in range(repeats))
    height, width = images[0].shape
    print(f"{scene}, {width} x {height} pixels")
    rows = {
        **steps,
        "edges to planes": sum(steps[step] for step in EARLY),
        "without recognition": without,
        "whole": whole,
        "semi-global matcher": beside,
        "maps of a new place": anew,
    }
    for name, milliseconds in rows.items():
        print(f"  {name:<22}{milliseconds:>8.1f} ms{milliseconds / beside:>8.3f} of the matcher")


def maps_anew(view: StereoView) -> None:
    """Compute the maps of the rectification, which `perceive` does once for a place."""
    rectification_maps(view.calibration, view.base_T_tcp_left, view.base_T_tcp_right)


def main() -> None:
    """Print the table of each scene."""
    parser = argparse.ArgumentParser(description="CPU time of the perception beside OpenCV's semi-global matcher.")
    parser.add_argument("data", nargs="?", type=Path, default=data_folder())
    parser.add_argument("--scenes", nargs="*", default=list(SCENES))
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    if not arguments.data.is_dir():
        sys.exit(f"{arguments.data} is not there: give the folder of the rendered scenes")
    cv2.setNumThreads(1)
    for scene in arguments.scenes:
        print_scene(arguments.data, scene, arguments.repeats)


if __name__ == "__main__":
    main()
