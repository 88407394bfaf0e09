"""How the time grows: per pixel from 0.3 to 8 megapixels, and of the matching with the number of planes.

    python benchmarks/growth.py [DATA] [--scene L1/004] [--repeats 3]

DATA is the folder of the rendered scenes ($SRVS_DATA/rendered_scenes, or ../shared/data/rendered_scenes beside the
repository). A rectified pair is laid out side by side and one below the other, 1, 4, 9 and 25 times, so that a pixel
of the large picture has as many edges and regions near it as one of the small picture. One thread, process time, the
least of the repeats. The matching is given planes of random places and sizes, as many in either image: once other
ones in the right image, once the same ones moved by their disparities.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from benchmarks.perceive_rendered import data_folder
from benchmarks.perception_time import EARLY, elapsed_ms, read_scene
from srvs_cell.scene import Plane
from srvs_cell.vision import VisionParameters, perceive
from srvs_cell.vision.matching import match_planes
from srvs_cell.vision.rectification import rectify_pair

if TYPE_CHECKING:
    from numpy.typing import NDArray

SIDES = (1, 2, 3, 5)
PLANE_COUNTS = (100, 300, 1000)
DISPARITY_RANGE_PX = (20.0, 60.0)
MEGAPIXEL = 1e6


def rectified(folder: Path) -> list[NDArray[np.uint8]]:
    """Return the rectified images of a scene."""
    images, view = read_scene(folder)
    pair = rectify_pair(images[0], images[1], view.calibration, view.base_T_tcp_left, view.base_T_tcp_right)
    return [pair.left, pair.right]


def steps_ms(images: list[NDArray[np.uint8]], side: int, repeats: int) -> tuple[float, dict[str, float]]:
    """Return the megapixels of a picture of ``side`` by ``side`` copies, and the least CPU time of every step."""
    left, right = (np.tile(image, (side, side)) for image in images)
    runs = [perceive(left, right, VisionParameters(), stopwatch=time.process_time).timings_ms for _ in range(repeats)]
    return left.size / MEGAPIXEL, {step: min(run[step] for run in runs) for step in runs[0]}


def random_planes(count: int, generator: np.random.Generator) -> list[Plane]:
    """Return planes with all that the matching looks at."""
    centre = generator.uniform((0.0, 0.0), (3200.0, 2400.0), (count, 2))
    side = generator.uniform(8.0, 80.0, count)
    brightness = generator.uniform(20.0, 230.0, count)
    return [
        Plane(
            number + 1,
            (float(x), float(y)),
            float(length**2),
            float(4.0 * length),
            float(length / 2.0),
            float(length * 0.7),
            float(grey),
            (int(x), int(y), int(length), int(length)),
            touches_border=False,
        )
        for number, ((x, y), length, grey) in enumerate(zip(centre, side, brightness, strict=True))
    ]


def print_pixels(images: list[NDArray[np.uint8]], repeats: int) -> None:
    """Print milliseconds per megapixel, a column a picture size, and how the largest compares with the smallest."""
    columns = [steps_ms(images, side, repeats) for side in SIDES]
    print(f"{'ms per megapixel and pair':<28}" + "".join(f"{size:>8.2f} Mpx" for size, _ in columns) + "   growth")
    rows = {step: [times[step] / size for size, times in columns] for step in columns[0][1]}
    rows["edges to planes"] = [sum(times[step] for step in EARLY) / size for size, times in columns]
    rows["all steps"] = [sum(times.values()) / size for size, times in columns]
    for name, values in rows.items():
        print(f"{name:<28}" + "".join(f"{value:>12.1f}" for value in values) + f"{values[-1] / values[0]:>9.2f}")


def seen_again(planes: list[Plane], generator: np.random.Generator) -> list[Plane]:
    """Return the planes as the other image shows them."""
    disparity = generator.uniform(*DISPARITY_RANGE_PX, len(planes))
    return [
        replace(plane, centre_px=(plane.centre_px[0] - shift, plane.centre_px[1]))
        for plane, shift in zip(planes, disparity.tolist(), strict=True)
    ]


def print_matching(repeats: int) -> None:
    """Print what matching takes for several numbers of planes."""
    generator = np.random.default_rng(1)
    parameters = VisionParameters().matching
    print(f"{'planes in either image':<28}{'other ms':>12}{'same ms':>12}")
    for count in PLANE_COUNTS:
        left = random_planes(count, generator)
        taken = [
            min(elapsed_ms(partial(match_planes, left, right, DISPARITY_RANGE_PX, parameters)) for _ in range(repeats))
            for right in (random_planes(count, generator), seen_again(left, generator))
        ]
        print(f"{count:<28}{taken[0]:>12.1f}{taken[1]:>12.1f}")


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description="Growth of the perception's time with pixels and planes.")
    parser.add_argument("data", nargs="?", type=Path, default=data_folder())
    parser.add_argument("--scene", default="L1/004")
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    if not arguments.data.is_dir():
        sys.exit(f"{arguments.data} is not there: give the folder of the rendered scenes")
    cv2.setNumThreads(1)
    print_pixels(rectified(arguments.data / arguments.scene), arguments.repeats)
    print_matching(arguments.repeats)


if __name__ == "__main__":
    main()
