"""The paper's comparison, side by side on the same edges: plane matching against straight line matching.

    python benchmarks/planes_against_lines.py [DATA] [--repeats 5] [--part time matches angle distortion]

DATA is the folder that holds ``middlebury2001`` and ``rendered_scenes`` ($SRVS_DATA, or ../shared/data beside the
repository). The paper: 42 s against 171 s on an IBM PC/AT, and three drawbacks of lines: distortion, inaccurate
disparity of lines nearly parallel to the motion, time for eight parameters a line. The line matcher is a
reconstruction (docs/explanation/line-matching.md), its thresholds chosen in its favour on these very pictures.

A match is right where the median of its disparity error is at most 1 px: of a plane over its pixels, of a line along
its length. A line lies on the border of two faces, so that the best truth within 3 px to either side counts. Planes are
taken with the default parameters and as the paper has them (`VisionParameters.faithful`).
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from benchmarks.perception_time import read_scene
from benchmarks.scene_truth import depth_mm, true_disparity
from srvs_cell.scene import Perception, PlaneImage
from srvs_cell.vision import VisionParameters, perceive
from srvs_cell.vision.line_matching import LineMatchingParameters
from srvs_cell.vision.lines import BaselineParameters, line_disparity_map, line_samples, perceive_lines
from srvs_cell.vision.rectification import rectify_pair

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.vision import StereoView
    from srvs_cell.vision.lines import LinePerception
    from srvs_cell.vision.rectification import RectifiedRig

    Array = NDArray[np.float64]
    Image = NDArray[np.uint8]

SETS = ("sawtooth", "venus", "poster")
LEVELS = ("L0", "L1")
FOR_MATCHES_ONLY = "L2"
"""The painted truth is right to about a pixel there: the files are not those that the scene was made with."""
TRUTH_SCALE = 8.0
PHOTOGRAPHS_PX, BLOCKS_PX = 32.0, 96.0
"""Greatest disparity where no calibration tells it."""
RIGHT_PX = 1.0
REACH_PX = 3
ANGLES_DEG = (0.0, 5.0, 10.0, 20.0, 45.0, 90.001)
CORNER_SHIFTS_PX = (0.0, 6.0, 24.0)
ROW_SHIFTS_PX = (1, 2, 3)
PAPER_RATIO = 171.0 / 42.0
STAGES = {
    "edges": ("edges",),
    "features": ("filtering", "thinning", "tracking", "region_growing", "plane_parameters", "line_parameters"),
    "matching": ("matching",),
    "to 3-D": ("interpolation", "refinement", "grouping", "depth"),
}
"""Steps of the two methods that do the same for each, from the edges to places in space (with a calibration).

Rectification is common. The lines' matching includes the disparities of their ends; their places have no covariance.
"""
ROWS_ALONE = BaselineParameters(matching=LineMatchingParameters(near_horizontal_deg=0.1))
METHODS = ("planes", "planes, paper", "lines")


@dataclass(frozen=True, eq=False)
class Pair:
    """Two images with the true disparity of the (rectified) left one, NaN where it is unknown."""

    name: str
    left: Image
    right: Image
    truth: Array
    view: StereoView | None = None
    rig: RectifiedRig | None = None
    max_disparity_px: float = PHOTOGRAPHS_PX

    @property
    def group(self) -> str:
        """The set, or the level of a scene."""
        return self.name.split("/", maxsplit=1)[0]


@dataclass(frozen=True)
class Judged:
    """One match: its error, and for a line its angle to the rows."""

    error_px: float
    error_mm: float
    angle_deg: float = 90.0

    @property
    def right(self) -> bool:
        """Whether this is the same thing in both images."""
        return self.error_px <= RIGHT_PX


def middlebury_pair(folder: Path, name: str) -> Pair:
    """Return a Middlebury pair in grey."""
    images = [_read(folder / "middlebury2001" / name / f"{view}.ppm") for view in ("im2", "im6")]
    stored = _read(folder / "middlebury2001" / name / "disp2.pgm").astype(np.float64)
    return Pair(name, images[0], images[1], np.where(stored > 0.0, stored / TRUTH_SCALE, np.nan))


def rendered_pair(folder: Path, scene: str) -> Pair:
    """Return a rendered scene with its painted truth."""
    import json  # noqa: PLC0415 - only here

    place = folder / "rendered_scenes" / scene
    images, view = read_scene(place)
    pair = rectify_pair(images[0], images[1], view.calibration, view.base_T_tcp_left, view.base_T_tcp_right)
    objects = json.loads((place / "truth.json").read_text(encoding="utf-8"))["objects"]
    height, width = pair.left.shape
    truth = true_disparity(objects, view.table_z_mm, pair.rig, (height, width))
    truth[~pair.left_valid] = np.nan
    return Pair(scene, images[0], images[1], truth, view, pair.rig)


def _read(path: Path) -> Image:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        sys.exit(f"{path} is not there or no picture")
    return np.asarray(image, dtype=np.uint8)


def run(method: str, pair: Pair) -> Perception | LinePerception:
    """Perceive a pair by one of the methods."""
    if method == "lines":
        return perceive_lines(pair.left, pair.right, _vision(pair), view=pair.view, stopwatch=time.process_time)
    parameters = _vision(pair, faithful=method == "planes, paper")
    return perceive(pair.left, pair.right, parameters, view=pair.view, stopwatch=time.process_time)


def judge_planes(perception: Perception, pair: Pair) -> list[Judged]:
    """Compare each matched plane with the truth under it; those with little truth are left out."""
    judged = []
    for match in perception.matches:
        mask = perception.left.labels == match.left
        seen, true = perception.disparity_px[mask].astype(np.float64), pair.truth[mask]
        judged += _judge(seen, true, pair.rig, 90.0)
    return judged


def judge_lines(perception: LinePerception, pair: Pair) -> list[Judged]:
    """Compare each matched line with the best truth beside it."""
    rows, share = line_samples(perception)
    chosen = perception.matches.left[rows]
    start, end = perception.left.start_px[chosen], perception.left.end_px[chosen]
    points = start + share[:, None] * (end - start)
    ends_px = perception.matches.disparity_ends_px[rows]
    seen = ends_px[:, 0] + share * (ends_px[:, 1] - ends_px[:, 0])
    turn = np.deg2rad(perception.left.orientation_deg[chosen])
    across = np.column_stack([np.cos(turn), np.sin(turn)])
    height, width = pair.truth.shape
    true = np.full(seen.shape, np.nan)
    for offset in range(-REACH_PX, REACH_PX + 1):
        near = np.rint(points + offset * across).astype(np.intp)
        value = pair.truth[near[:, 1].clip(0, height - 1), near[:, 0].clip(0, width - 1)]
        closer = np.isfinite(value) & ~(np.abs(value - seen) >= np.abs(true - seen))
        true = np.where(closer, value, true)
    span = perception.left.end_px - perception.left.start_px
    angle_deg = np.rad2deg(np.arctan2(np.abs(span[:, 1]), np.abs(span[:, 0])))
    judged = []
    for match, line in enumerate(perception.matches.left.tolist()):
        of_match = rows == match
        judged += _judge(seen[of_match], true[of_match], pair.rig, float(angle_deg[line]))
    return judged


def _judge(seen: Array, true: Array, rig: RectifiedRig | None, angle_deg: float) -> list[Judged]:
    known = np.isfinite(seen) & np.isfinite(true)
    if known.sum() < 0.5 * seen.size or not known.any():
        return []
    seen, true = seen[known], true[known]
    error_mm = float("nan") if rig is None else float(np.median(np.abs(depth_mm(rig, seen) - depth_mm(rig, true))))
    return [Judged(float(np.median(np.abs(seen - true))), error_mm, angle_deg)]


def judge(method: str, pair: Pair) -> list[Judged]:
    """Perceive by a method and judge its matches."""
    perception = run(method, pair)
    return judge_planes(perception, pair) if isinstance(perception, Perception) else judge_lines(perception, pair)


def _vision(pair: Pair, *, faithful: bool = False) -> VisionParameters:
    parameters = VisionParameters.faithful() if faithful else VisionParameters()
    return replace(parameters, max_disparity_px=pair.max_disparity_px)


def print_times(pairs: Sequence[Pair], repeats: int) -> None:
    """CPU time of each method by stages, and the pixels that it gives a disparity."""
    print(f"\nTime, CPU ms a pair, one thread, median of {repeats}; paper: lines / planes = {PAPER_RATIO:.2f}")
    print(f"{'set':<10}{'method':<16}{'found':>7}" + "".join(f"{stage:>11}" for stage in STAGES) + f"{'pixels':>9}")
    ratios = {}
    for group in dict.fromkeys(pair.group for pair in pairs):
        figures = {}
        for method in METHODS:
            measured = [_time(method, pair, repeats) for pair in pairs if pair.group == group]
            figures[method] = count, *times, pixels = np.mean(measured, axis=0).tolist()
            columns = "".join(f"{time_ms:>11.2f}" for time_ms in times)
            print(f"{group:<10}{method:<16}{count:>7.0f}{columns}{pixels:>9.0f}")
        for method in METHODS[:-1]:
            ratios[group, method] = _ratios(figures["lines"], figures[method])
    print("\nTime of the lines over that of the planes")
    print(f"{'set':<10}{'method':<16}{'whole':>11}{'after edges':>13}{'matching':>11}{'a pixel with disparity':>24}")
    for (group, method), (whole, after, matching, pixel) in ratios.items():
        print(f"{group:<10}{method:<16}{whole:>11.2f}{after:>13.2f}{matching:>11.2f}{pixel:>24.2f}")


def _ratios(lines: Sequence[float], planes: Sequence[float]) -> tuple[float, float, float, float]:
    """Return lines over planes: all stages, those after the edges, matching alone, all per pixel with a disparity."""
    (_, *line_ms, line_pixels), (_, *plane_ms, plane_pixels) = lines, planes
    whole, after, matching = (
        sum(line_ms[stages]) / sum(plane_ms[stages]) for stages in (slice(None), slice(1, None), slice(2, 3))
    )
    return whole, after, matching, whole * plane_pixels / line_pixels


def _time(method: str, pair: Pair, repeats: int) -> tuple[float, ...]:
    """Return the features of both images, the ms of each stage, and how many left pixels have a disparity."""
    runs = [run(method, pair) for _ in range(repeats)]
    images = (runs[0].left, runs[0].right)
    count = sum(len(image.planes) if isinstance(image, PlaneImage) else len(image) for image in images)
    found = runs[0].disparity_px if isinstance(runs[0], Perception) else line_disparity_map(runs[0])

    def median(steps: Sequence[str]) -> float:
        return statistics.median(sum(each.timings_ms.get(step, 0.0) for step in steps) for each in runs)

    return float(count), *(median(steps) for steps in STAGES.values()), float(np.isfinite(found).sum())


def print_matches(pairs: Sequence[Pair]) -> None:
    """How many matches are right, and how far those are off."""
    print("\nMatches against the truth")
    _heading("set")
    for group in dict.fromkeys(pair.group for pair in pairs):
        for method in METHODS:
            judged = [one for pair in pairs if pair.group == group for one in judge(method, pair)]
            _row(group, method, judged)


def _heading(first: str) -> None:
    print(
        f"{first:<10}{'method':<20}{'matches':>8}{'right':>8}{'share':>8}{'median px':>10}{'p90 px':>8}"
        f"{'of right':>9}{'mm':>7}"
    )


def _row(first: str, method: str, judged: Sequence[Judged]) -> None:
    errors = np.array([one.error_px for one in judged])
    right = [one for one in judged if one.right]
    near, near_mm = np.array([one.error_px for one in right]), np.array([one.error_mm for one in right])
    if not errors.size:
        print(f"{first:<10}{method:<20}{0:>8}")
        return
    of_right = f"{np.median(near):>9.3f}{_or_dash(near_mm):>7}" if near.size else f"{'-':>9}{'-':>7}"
    print(
        f"{first:<10}{method:<20}{errors.size:>8}{len(right):>8}{len(right) / errors.size:>8.1%}"
        f"{np.median(errors):>10.3f}{np.percentile(errors, 90):>8.2f}{of_right}"
    )


def _or_dash(error_mm: Array) -> str:
    """Return the median; a dash where photographs without a focal length are among the pairs."""
    return f"{np.median(error_mm):.2f}" if np.isfinite(error_mm).all() else "-"


def print_angles(pairs: Sequence[Pair], name: str) -> None:
    """Lines by their angle to the motion, with the disparity as matched and from the rows alone."""
    print(f"\n{name}: lines by their angle to the motion; rows alone: no line's ends are compared")
    _heading("deg")
    for method, baseline in (("lines", None), ("lines, rows alone", ROWS_ALONE)):
        see = partial(perceive_lines, baseline=baseline)
        judged = [
            one
            for pair in pairs
            for one in judge_lines(see(pair.left, pair.right, _vision(pair), view=pair.view), pair)
        ]
        for low, high in pairwise(ANGLES_DEG):
            _row(f"{low:.0f}-{high:.0f}", method, [one for one in judged if low <= one.angle_deg < high])
    _row("all", "planes", [one for pair in pairs for one in judge("planes", pair)])


def print_distortion(pairs: Sequence[Pair], name: str) -> None:
    """The same pairs through a lens that nobody corrects, and with rows that do not correspond."""
    print(f"\n{name}, distorted: px by which a lens moves the corners of both images, or an error the right one's rows")
    _heading("px")
    for shift in CORNER_SHIFTS_PX:
        warped = [distorted(pair, shift) for pair in pairs]
        for method in METHODS:
            _row(f"lens {shift:g}", method, [one for pair in warped for one in judge(method, pair)])
    for rows in ROW_SHIFTS_PX:
        moved = [replace(pair, right=np.roll(pair.right, rows, axis=0)) for pair in pairs]
        for method in METHODS:
            _row(f"rows {rows}", method, [one for pair in moved for one in judge(method, pair)])


def rectified(pair: Pair) -> Pair:
    """Return a scene as a rectified pair without calibration."""
    if pair.view is None:
        return pair
    view = pair.view
    images = rectify_pair(pair.left, pair.right, view.calibration, view.base_T_tcp_left, view.base_T_tcp_right)
    return Pair(pair.name, images.left, images.right, pair.truth, max_disparity_px=BLOCKS_PX)


def distorted(pair: Pair, corner_px: float) -> Pair:
    """Return a rectified pair as a lens with pincushion distortion shows it, with the truth that belongs to it."""
    height, width = pair.truth.shape
    centre = np.array([(width - 1) / 2.0, (height - 1) / 2.0])
    strength = corner_px / np.linalg.norm(centre) ** 3

    def bend(points: Array) -> Array:
        offset = points - centre
        return np.asarray(centre + offset * (1.0 + strength * (offset**2).sum(axis=-1, keepdims=True)))

    y, x = np.mgrid[:height, :width].astype(np.float64)
    seen = np.stack([x, y], axis=-1)
    source = seen.copy()
    for _ in range(20):
        source += seen - bend(source)
    maps = source.astype(np.float32)
    images = [
        np.asarray(cv2.remap(image, maps[..., 0], maps[..., 1], cv2.INTER_LANCZOS4), dtype=np.uint8)
        for image in (pair.left, pair.right)
    ]
    nearest = np.rint(source).astype(np.intp)
    true = pair.truth[nearest[..., 1].clip(0, height - 1), nearest[..., 0].clip(0, width - 1)]
    moved = bend(source - np.stack([true, np.zeros_like(true)], axis=-1))
    return Pair(pair.name, images[0], images[1], seen[..., 0] - moved[..., 0], max_disparity_px=pair.max_disparity_px)


def _scenes(data: Path, levels: Sequence[str]) -> list[Pair]:
    return [
        rendered_pair(data, f"{level}/{folder.name}")
        for level in levels
        for folder in sorted((data / "rendered_scenes" / level).iterdir())
    ]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description="Plane matching against straight line matching on the same edges.")
    root = os.environ.get("SRVS_DATA") or str(Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("data", type=Path, nargs="?", default=Path(root))
    parser.add_argument("--repeats", type=int, default=5)
    parts = ("time", "matches", "angle", "distortion")
    parser.add_argument("--part", nargs="*", choices=parts, default=parts)
    options = parser.parse_args()
    if not options.data.is_dir():
        sys.exit(f"{options.data} is not there: give the folder of the shared data")
    cv2.setNumThreads(1)
    photographs = [middlebury_pair(options.data, name) for name in SETS]
    rendered = _scenes(options.data, LEVELS)
    if "time" in options.part:
        print_times([*photographs, *rendered], options.repeats)
    if "matches" in options.part:
        print_matches([*photographs, *rendered, *_scenes(options.data, (FOR_MATCHES_ONLY,))])
    if "angle" in options.part:
        print_angles(photographs, "Photographs")
        print_angles(rendered, "Rendered blocks")
    if "distortion" in options.part:
        print_distortion(photographs, "Photographs")
        print_distortion([rectified(pair) for pair in rendered], "Rendered blocks")


if __name__ == "__main__":
    main()
