"""Random tables: parts that stand apart far enough that the open gripper can pick and place each of them anywhere."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from drivers.sim.parts import CUBOID, CYLINDER, KINDS, PRISM, WEDGE, Part, prism_across_flats_mm
from srvs_cell.geometry import axis_rotation

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from drivers.sim.gripper_geometry import GripperGeometry
    from srvs_cell.geometry import Array

MIN_PARTS, MAX_PARTS = 1, 10
_SHAPE_TRIES = 100
_LAYOUT_TRIES = 60
_CANDIDATES = 400
_DIRECTIONS = 360
_CROWDED_FROM = 7
"""From this many parts on only slender ones fit the table with room for the fingers."""


class ScenarioError(ValueError):
    """No table with these properties was found."""


@dataclass(frozen=True, kw_only=True)
class ScenarioParameters:
    """What a table may look like, lengths in millimetres.

    Attributes:
        view_centre_mm: x and y of the middle of what the camera sees, base frame.
        view_half_mm: half of what both pictures show at the height of the highest top; every part stays inside it at
            every place.
        height_mm: least and greatest height.
        width_mm: least and greatest narrow side.
        length_mm: least and greatest long side.
        height_step_mm: least difference of two heights, except for ties.
        tie_mm: greatest difference of the two heights of a tie.
        gap_mm: least free distance between fully open fingers, or a part, and any other part at any place.
        y_step_mm: least difference of two places in y: which place has the larger y must be plain to see.
        table_albedo: reflectance of the table.
        albedo: ranges of the parts' reflectance: unlike the lit table's, and unlike that of its shadows.
        label_share: share of parts with a printed top.
    """

    view_centre_mm: tuple[float, float] = (750.0, 0.0)
    view_half_mm: tuple[float, float] = (135.0, 166.0)
    height_mm: tuple[float, float] = (15.0, 110.0)
    width_mm: tuple[float, float] = (25.0, 55.0)
    length_mm: tuple[float, float] = (30.0, 70.0)
    height_step_mm: float = 5.0
    tie_mm: float = 1.0
    gap_mm: float = 5.0
    y_step_mm: float = 8.0
    table_albedo: float = 0.42
    albedo: tuple[tuple[float, float], ...] = ((0.24, 0.32), (0.52, 0.62), (0.62, 0.74), (0.74, 0.85))
    label_share: float = 0.35


def make_scenario(
    count: int, seed: int, gripper: GripperGeometry, parameters: ScenarioParameters | None = None, *, ties: bool = False
) -> tuple[Part, ...]:
    """Return ``count`` parts; the same arguments always give the same parts.

    Args:
        count: 1 to 10.
        seed: of the random generator.
        gripper: its fingers need room beside every part.
        parameters: what the table may look like.
        ties: make the heights of two parts equal within ``tie_mm``.

    Raises:
        ScenarioError: the count is out of range, or no layout was found.
    """
    if not MIN_PARTS <= count <= MAX_PARTS:
        raise ScenarioError(f"{count} parts: {MIN_PARTS} to {MAX_PARTS} fit the table")
    parameters = parameters or ScenarioParameters()
    random = np.random.default_rng([seed, count])
    for _ in range(_SHAPE_TRIES):
        shapes = _shapes(count, random, parameters, ties=ties)
        parts = _lay_out(shapes, random, gripper, parameters)
        if parts is not None:
            return parts
    raise ScenarioError(f"no room found for {count} parts with seed {seed}")


def _shapes(count: int, random: np.random.Generator, parameters: ScenarioParameters, *, ties: bool) -> list[Part]:
    heights = _heights(count, random, parameters, ties=ties)
    return [_shape(KINDS[int(random.integers(len(KINDS)))], h, count, random, parameters) for h in heights]


def _heights(count: int, random: np.random.Generator, parameters: ScenarioParameters, *, ties: bool) -> list[float]:
    """Draw heights that are at least a step apart: random gaps between sorted values."""
    low, high = parameters.height_mm
    slack = high - low - parameters.height_step_mm * (count - 1)
    offsets = np.sort(random.uniform(0.0, slack, count))
    heights = low + offsets + parameters.height_step_mm * np.arange(count)
    if ties and count > 1:
        at = int(random.integers(count - 1))
        heights[at + 1] = heights[at] + random.uniform(0.0, parameters.tie_mm)
    return [float(height) for height in random.permutation(heights)]


def _shape(
    kind: str, height_mm: float, count: int, random: np.random.Generator, parameters: ScenarioParameters
) -> Part:
    shrink = 1.0 if count < _CROWDED_FROM else 0.7
    narrow, wide = parameters.width_mm[0], parameters.width_mm[1] * shrink
    # a slender part would tip when the gripper lets go of it
    width = float(random.uniform(max(narrow, min(wide, height_mm * 0.35)), wide))
    longest = parameters.length_mm[1] * shrink
    length = float(random.uniform(min(longest, max(parameters.length_mm[0], width * 1.15)), longest))
    low_height = height_mm
    if kind == CYLINDER:
        length = width
    elif kind == PRISM:
        length, width = width, prism_across_flats_mm(width)
    elif kind == WEDGE:
        if height_mm < parameters.height_mm[0] * 1.6:
            kind = CUBOID
        else:
            low_height = max(parameters.height_mm[0], height_mm - length * float(random.uniform(0.3, 0.55)))
    albedo = float(random.uniform(*parameters.albedo[int(random.integers(len(parameters.albedo)))]))
    label = kind == CUBOID and bool(random.random() < parameters.label_share)
    return Part(
        kind=kind,
        length_mm=length,
        width_mm=width,
        height_mm=height_mm,
        low_height_mm=low_height,
        x_mm=0.0,
        y_mm=0.0,
        yaw_deg=float(random.uniform(0.0, 180.0)),
        albedo=albedo,
        label=label,
    )


def _lay_out(
    shapes: Sequence[Part], random: np.random.Generator, gripper: GripperGeometry, parameters: ScenarioParameters
) -> tuple[Part, ...] | None:
    """Place one part after the other where everybody fits beside everybody; None where there is no room."""
    least_mm = _least_distances_mm(shapes, gripper) + parameters.gap_mm
    widest_mm = max(float(np.linalg.norm(part.outline_mm(), axis=1).max()) for part in shapes)
    centre, half = np.array(parameters.view_centre_mm), np.array(parameters.view_half_mm) - widest_mm
    for _ in range(_LAYOUT_TRIES):
        placed: list[Array] = []
        for _ in shapes:
            candidates = random.uniform(centre - half, centre + half, (_CANDIDATES, 2))
            for other in placed:
                candidates = candidates[_clear(candidates - other, least_mm, parameters.y_step_mm)]
            if not len(candidates):
                break
            placed.append(candidates[0])
        else:
            return tuple(
                replace(part, x_mm=float(x), y_mm=float(y)) for part, (x, y) in zip(shapes, placed, strict=True)
            )
    return None


def _least_distances_mm(shapes: Sequence[Part], gripper: GripperGeometry) -> Array:
    """Return the least distance of two places for each direction of 1 degree, shape (360,).

    Any part may come to stand at any place, so the least distance is the largest one over all ordered pairs of parts:
    part and open fingers of the one against the part of the other.
    """
    bodies = [[part.footprint_mm(), *_fingers_mm(part, gripper)] for part in shapes]
    angle = np.deg2rad(np.arange(_DIRECTIONS))
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    least = np.zeros(_DIRECTIONS)
    for i, own in enumerate(bodies):
        for j, other in enumerate(bodies):
            if i != j:
                for piece in own:
                    least = np.maximum(least, _touching_mm(piece, other[0], direction))
    either = np.maximum(least, np.roll(least, _DIRECTIONS // 2))
    # a direction between two whole degrees
    return np.maximum(either, np.maximum(np.roll(either, 1), np.roll(either, -1)))


def _fingers_mm(part: Part, gripper: GripperGeometry) -> list[Array]:
    near = gripper.max_opening_mm / 2.0
    far, half = near + gripper.finger_thickness_mm, gripper.finger_width_mm / 2.0
    turn = axis_rotation("z", part.grip_yaw_deg)[:2, :2].T
    finger = np.array([[near, -half], [far, -half], [far, half], [near, half]])
    return [finger @ turn, -finger @ turn]


def _touching_mm(a: Array, b: Array, direction: Array) -> Array:
    """Return, for unit directions (N, 2), the greatest displacement of convex b along it that still touches convex a.

    By separating axes: b displaced by t d is apart from a if for some edge normal n the intervals do not meet.
    """
    normals = []
    for polygon in (a, b):
        edge = np.roll(polygon, -1, axis=0) - polygon
        normals.append(np.stack([edge[:, 1], -edge[:, 0]], axis=1))
    normal = np.vstack(normals)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.vstack([normal, -normal])
    reach = (a @ normal.T).max(axis=0) - (b @ normal.T).min(axis=0)
    along = direction @ normal.T
    leave = np.where(along > 1e-9, reach / np.maximum(along, 1e-9), np.inf)  # noqa: PLR2004 - a parallel axis never parts
    return np.asarray(np.maximum(leave.min(axis=1), 0.0))


def _clear(displacement_mm: Array, least_mm: Array, y_step_mm: float) -> NDArray[np.bool_]:
    """Return which displacements (N, 2) of one place from another leave enough room."""
    distance = np.hypot(displacement_mm[:, 0], displacement_mm[:, 1])
    degree = np.rad2deg(np.arctan2(displacement_mm[:, 1], displacement_mm[:, 0])).astype(int) % _DIRECTIONS
    clear: NDArray[np.bool_] = (distance >= least_mm[degree]) & (np.abs(displacement_mm[:, 1]) >= y_step_mm)
    return clear
