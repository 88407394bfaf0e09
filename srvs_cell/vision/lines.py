"""The paper's baseline from two images to lines in the base frame: edges, lines, matches, depth.

The steps around it are those of the planes: the same rectification, the same edges, the same triangulation, so that
the two methods can be held against each other. Lines make no surfaces and no workpieces.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from srvs_cell.vision.edges import extract_edges
from srvs_cell.vision.line_matching import LineMatches, LineMatchingParameters, match_lines
from srvs_cell.vision.line_support import LineImage, LineParameters, extract_lines
from srvs_cell.vision.picture_check import check_pair

# the two methods share the check of the images and the stopwatch
from srvs_cell.vision.pipeline import _Steps, before_camera, checked_pair
from srvs_cell.vision.rectification import rectify_pair

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.parameters import VisionParameters
    from srvs_cell.vision.pipeline import StereoView

_SAMPLES_PER_PX = 2.0


@dataclass(frozen=True)
class BaselineParameters:
    """What the baseline has of its own; disparity range and edges are those of `VisionParameters`."""

    lines: LineParameters = field(default_factory=LineParameters)
    matching: LineMatchingParameters = field(default_factory=LineMatchingParameters)


@dataclass(frozen=True, eq=False)
class LinePerception:
    """What the baseline tells of one stereo pair.

    Attributes:
        left, right: rectified images and their lines.
        matches: matched lines.
        ends_mm: the two ends of each matched line in the base frame, shape (M, 2, 3); None without calibration.
        timings_ms: milliseconds per step, in the order of the steps.
    """

    left: LineImage
    right: LineImage
    matches: LineMatches
    ends_mm: Array | None
    timings_ms: dict[str, float]


def perceive_lines(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    parameters: VisionParameters,
    *,
    baseline: BaselineParameters | None = None,
    view: StereoView | None = None,
    stopwatch: Callable[[], float] | None = None,
) -> LinePerception:
    """Extract and match straight lines; with calibration and poses also place them.

    Args:
        left: uint8, shape (H, W) grey or (H, W, 3) BGR; without ``view`` already rectified.
        right: the other image, of the same size.
        parameters: of the vision: edges, and without ``view`` the disparity range.
        baseline: limits, weights and threshold of the lines; the defaults where None.
        view: calibration and poses; None to work in pixels alone.
        stopwatch: returns seconds; None measures no times.

    Raises:
        AlarmError: IMAGE_INVALID where an image is no image, too small, or not of the other's or the calibration's
            size; IMAGE_UNUSABLE where it shows nothing; PAIR_INCONSISTENT where both are one picture, or do not show
            one scene from their poses; BASELINE_INVALID where the poses make no baseline.
    """
    own = baseline or BaselineParameters()
    steps = _Steps(stopwatch)
    greys = list(checked_pair(left, right))
    disparity_range = (parameters.min_disparity_px, parameters.max_disparity_px)
    valid, rig = None, None
    if view is not None:
        pair = rectify_pair(greys[0], greys[1], view.calibration, view.base_T_tcp_left, view.base_T_tcp_right)
        view = before_camera(view, pair.rig, pair.left.shape[1], parameters.recognition.min_height_mm)
        check_pair(pair, view.table_z_mm, view.max_height_mm)
        greys, valid, rig = [pair.left, pair.right], (pair.left_valid, pair.right_valid), pair.rig
        height, width = pair.left.shape
        disparity_range = rig.disparity_range(view.table_z_mm, view.table_z_mm + view.max_height_mm, (width, height))
        steps.done("rectification")
    edges = [extract_edges(grey, parameters.edges).mask for grey in greys]
    if valid is not None:
        edges = [mask & seen for mask, seen in zip(edges, valid, strict=True)]
    steps.done("edges")
    lines = [
        extract_lines(grey, mask, parameters.edges.smoothing_px, own.lines)
        for grey, mask in zip(greys, edges, strict=True)
    ]
    steps.done("line_parameters")
    matches = match_lines(lines[0], lines[1], disparity_range, own.matching)
    steps.done("matching")
    ends_mm = None
    if rig is not None:
        ends_px = np.stack([lines[0].start_px[matches.left], lines[0].end_px[matches.left]], axis=1)
        ends_mm = rig.points_mm(ends_px[..., 0], ends_px[..., 1], matches.disparity_ends_px)
        steps.done("depth")
    return LinePerception(lines[0], lines[1], matches, ends_mm, steps.timings_ms)


def line_disparity_map(perception: LinePerception) -> NDArray[np.float32]:
    """Return the disparity along the matched lines of the left image: float32, shape (H, W), NaN elsewhere."""
    height, width = perception.left.grey.shape
    disparity_px = np.full((height, width), np.nan, dtype=np.float32)
    match, share = line_samples(perception)
    chosen = perception.matches.left[match]
    start, end = perception.left.start_px[chosen], perception.left.end_px[chosen]
    points = np.rint(start + share[:, None] * (end - start)).astype(np.intp)
    # a fitted line may end half a pixel outside
    columns, rows = points[:, 0].clip(0, width - 1), points[:, 1].clip(0, height - 1)
    ends_px = perception.matches.disparity_ends_px[match]
    disparity_px[rows, columns] = ends_px[:, 0] + share * (ends_px[:, 1] - ends_px[:, 0])
    return disparity_px


def line_samples(perception: LinePerception) -> tuple[NDArray[np.intp], Array]:
    """Return points along the matched lines, two a pixel: the match's row, and 0 at its start to 1 at its end."""
    length = perception.left.length_px[perception.matches.left]
    count = np.ceil(_SAMPLES_PER_PX * length).astype(np.intp) + 1
    match = np.repeat(np.arange(count.size), count)
    number = np.arange(match.size) - np.repeat(np.cumsum(count) - count, count)
    return match, number / np.maximum(count - 1, 1)[match]


def lines_to_json(perception: LinePerception) -> dict[str, Any]:
    """Return lines, matches and times as plain values, ids from 1 as those of planes.

    A match has ``left``, ``right``, ``score`` and ``disparity_px`` (at the left line's midpoint) as that of planes has;
    instead of a disparity plane it has the disparities of the line's ends, and with calibration their places.
    """
    matches = perception.matches
    report: dict[str, Any] = {
        "method": "lines",
        "lines_left": _lines(perception.left),
        "lines_right": _lines(perception.right),
        "matches": [
            {
                "left": int(matches.left[row]) + 1,
                "right": int(matches.right[row]) + 1,
                "score": float(matches.score[row]),
                "disparity_px": float(matches.disparity_ends_px[row].mean()),
                "disparity_ends_px": matches.disparity_ends_px[row].tolist(),
                "near_horizontal": bool(matches.near_horizontal[row]),
            }
            for row in range(len(matches))
        ],
        "timings_ms": dict(perception.timings_ms),
    }
    if perception.ends_mm is not None:
        for match, ends_mm in zip(report["matches"], perception.ends_mm.tolist(), strict=True):
            match["ends_mm"] = ends_mm
    return report


def _lines(image: LineImage) -> list[dict[str, Any]]:
    columns = {
        "centre_px": image.centre_px,
        "orientation_deg": image.orientation_deg,
        "length_px": image.length_px,
        "contrast": image.contrast,
        "width_px": image.width_px,
        "steepness": image.steepness,
        "brightness": image.brightness,
        "ends_px": np.stack([image.start_px, image.end_px], axis=1),
    }
    values = {name: column.tolist() for name, column in columns.items()}
    return [{"id": row + 1, **{name: value[row] for name, value in values.items()}} for row in range(len(image))]
