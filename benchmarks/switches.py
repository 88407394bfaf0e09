"""What each step beyond the paper brings: the paper's steps alone, then one switch more in each row.

    python benchmarks/switches.py [DATA]

DATA is the folder of the pictures and scenes ($SRVS_DATA, or ../shared/data beside the repository). Of the photographs
with truth (sawtooth, venus, poster) the share of the truth that has a disparity and the share of this within 1 px; of
the rendered scenes how many fully visible objects are found, how many with the right kind, what is spurious, and the
mean error of what is found. The order is that of the steps; what a switch brings depends on those before it.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.perceive_middlebury import SETS, read
from benchmarks.perceive_rendered import LEVELS, evaluate, summary
from srvs_cell.vision import VisionParameters, perceive
from srvs_cell.vision.parameters import Maxima

PHOTOGRAPHS = tuple(SETS)[:3]


def stages() -> list[tuple[str, VisionParameters]]:
    """Return the vision's parameters row by row; the last ones are the defaults, and these with filled maps."""
    now = VisionParameters.faithful()
    rows = [("the paper's steps", now)]

    def add(name: str, with_more: VisionParameters) -> VisionParameters:
        rows.append((name, with_more))
        return with_more

    now = add("maxima over the admissible", replace(now, matching=replace(now.matching, maxima=Maxima.ADMISSIBLE)))
    now = add("ordered matching", replace(now, matching=replace(now.matching, ordered=True)))
    now = add("sub-pixel ends", replace(now, interpolation=replace(now.interpolation, sub_pixel=True)))
    now = add("refinement", replace(now, refinement=replace(now.refinement, enabled=True)))
    now = add("grouping", replace(now, grouping=replace(now.grouping, enabled=True)))
    now = add("planes without a partner", replace(now, recognition=replace(now.recognition, recover=True)))
    now = add("table reference (the defaults)", replace(now, table=replace(now.table, enabled=True)))
    add("filled maps", replace(now, dense=replace(now.dense, enabled=True)))
    return rows


def of_photographs(data: Path, parameters: VisionParameters) -> list[str]:
    """Return covered and within 1 px, percent, for each photograph."""
    cells = []
    for folder in PHOTOGRAPHS:
        (*pair, stored), scale, max_disparity_px = SETS[folder]
        images = [read(data / folder / name) for name in pair]
        perception = perceive(images[0], images[1], replace(parameters, max_disparity_px=max_disparity_px))
        truth = read(data / folder / stored, cv2.IMREAD_GRAYSCALE) / scale
        known = truth > 0.0
        both = known & np.isfinite(perception.disparity_px)
        within = np.mean(np.abs(perception.disparity_px - truth)[both] <= 1.0) if both.any() else float("nan")
        cells.append(f"{100.0 * both.sum() / known.sum():.1f} / {100.0 * within:.1f}")
    return cells


def of_scenes(data: Path, parameters: VisionParameters) -> list[str]:
    """Return found, kind right, spurious and mean error in millimetres for each level."""
    cells = []
    for level in LEVELS:
        scenes = [f"{level}/{path.name}" for path in sorted((data / level).iterdir())]
        row = summary(evaluate(data, scenes, parameters=parameters))
        cells.append(f"{row['found']} / {row['kind_right']} / {row['spurious']} / {row['error_mean_mm']:.2f}")
    return cells


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    root = os.environ.get("SRVS_DATA") or str(Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("data", type=Path, nargs="?", default=Path(root))
    data = parser.parse_args().data
    if not (data / "rendered_scenes").is_dir():
        sys.exit(f"{data} has no rendered_scenes: give the folder of the pictures and scenes")
    cv2.setNumThreads(1)
    names = [Path(folder).name for folder in PHOTOGRAPHS]
    print(f"| steps | {' | '.join([*names, *LEVELS])} |")
    print("|---" * (1 + len(names) + len(LEVELS)) + "|")
    for name, parameters in stages():
        cells = of_photographs(data, parameters) + of_scenes(data / "rendered_scenes", parameters)
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
