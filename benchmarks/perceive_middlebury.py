"""Plane matching on Middlebury's pairs and on indoor pairs: a table against the published truth.

Usage: python benchmarks/perceive_middlebury.py DATA [--faithful]

DATA is the folder that holds ``middlebury2001``, ``middlebury2003`` and ``stereodemo_oakd``. One set of parameters for
all pairs but for the greatest disparity; nothing is tuned to a pair. The truth is stored in eighths of a pixel, that of
tsukuba in whole ones and that of teddy in quarters, so that agreement below 0.1, 0.3 and 0.1 px proves nothing.
Pixels that the other camera does not see count as the others do.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision import VisionParameters, perceive

if TYPE_CHECKING:
    from numpy.typing import NDArray

TRUTH_SCALE = 8.0
SAWTOOTH_VIEWS = ("im2.ppm", "im6.ppm", "disp2.pgm")
TSUKUBA_VIEWS = ("scene1.row3.col3.ppm", "scene1.row3.col4.ppm", "truedisp.row3.col3.pgm")
SETS = {
    "middlebury2001/sawtooth": (SAWTOOTH_VIEWS, TRUTH_SCALE, 32.0),
    "middlebury2001/venus": (SAWTOOTH_VIEWS, TRUTH_SCALE, 32.0),
    "middlebury2001/poster": (SAWTOOTH_VIEWS, TRUTH_SCALE, 32.0),
    "middlebury2001/tsukuba": (TSUKUBA_VIEWS, 16.0, 16.0),
    "middlebury2003/teddy": (("im2.png", "im6.png", "disp2.png"), 4.0, 64.0),
}
"""Left and right picture and truth, grey values of the truth per pixel of disparity, greatest disparity."""
ROW = "{:<18}{:>9}{:>10}{:>12}{:>15}{:>11}"


def read(path: Path, mode: int = cv2.IMREAD_COLOR) -> NDArray[np.uint8]:
    """Return an image; raises `FileNotFoundError` where there is none."""
    image = cv2.imread(str(path), mode)
    if image is None:
        raise FileNotFoundError(path)
    return np.asarray(image, dtype=np.uint8)


def middlebury(data: Path, parameters: VisionParameters) -> None:
    """Print a row for each set with truth."""
    for folder, (names, scale, max_disparity_px) in SETS.items():
        left, right, stored = (data / folder / name for name in names)
        images = [read(left), read(right)]
        perception = perceive(images[0], images[1], replace(parameters, max_disparity_px=max_disparity_px))
        truth = read(stored, cv2.IMREAD_GRAYSCALE) / scale
        known = truth > 0.0
        both = known & np.isfinite(perception.disparity_px)
        error = np.abs(perception.disparity_px - truth)[both]
        within = f"{np.mean(error <= 1.0):.1%}" if error.size else "-"
        median = f"{np.median(error):.3f}" if error.size else "-"
        covered = f"{both.sum() / known.sum():.1%}"
        name = Path(folder).name
        print(ROW.format(name, len(perception.matches), covered, within, median, milliseconds(images, parameters)))


def indoor(folder: Path, parameters: VisionParameters) -> None:
    """Print a row for each pair without truth."""
    for left in sorted(folder.glob("*_left.png")):
        images = [read(left), read(left.with_name(left.name.replace("_left", "_right")))]
        perception = perceive(images[0], images[1], replace(parameters, max_disparity_px=96.0))
        covered = f"({np.isfinite(perception.disparity_px).mean():.1%})"
        name = left.stem.removesuffix("_left")
        print(ROW.format(name, len(perception.matches), covered, "-", "-", milliseconds(images, parameters)))


def milliseconds(images: list[NDArray[np.uint8]], parameters: VisionParameters) -> str:
    """Return the time of one perception on one thread."""
    start = time.perf_counter()
    perceive(images[0], images[1], parameters)
    return f"{1000.0 * (time.perf_counter() - start):.0f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    root = os.environ.get("SRVS_DATA") or str(Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("data", type=Path, nargs="?", default=Path(root), help="$SRVS_DATA, or ../shared/data")
    parser.add_argument("--faithful", action="store_true", help="the paper's steps alone")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    parameters = VisionParameters.faithful() if options.faithful else VisionParameters()
    print(ROW.format("pair", "matched", "covered", "within 1 px", "median error", "ms"))
    middlebury(options.data, parameters)
    indoor(options.data / "stereodemo_oakd", parameters)


if __name__ == "__main__":
    main()
