"""Judge a demo run against the simulator's own truth. Pure: truth and claims in, a verdict with reasons out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from srvs_cell.geometry import wrap_angle_deg

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

ASSOCIATION_LIMIT_MM = 30.0
"""A claim farther than this from every true part is no claim about any of them."""

PRISM_SYMMETRY_DEG = 60.0
HALF_TURN_DEG = 180.0
WHOLE_TURN_DEG = 360.0


@dataclass(frozen=True)
class Tolerance:
    """What counts as success: the issue's figures for a part at its goal."""

    position_mm: float = 5.0
    angle_deg: float = 5.0
    undisturbed_mm: float = 2.0
    height_order_mm: float = 2.0


@dataclass(frozen=True)
class TruePart:
    """One part as the simulator knows it.

    Attributes:
        id: the simulator's number.
        kind: cuboid, cylinder, wedge or prism.
        position_mm: centre of the top (wedge: inclined) face, base frame.
        height_mm: highest point above the table when upright.
        yaw_deg: direction of the long side; None where it means nothing.
        tilt_deg: angle of the part's own up axis against the vertical.
        rise_deg: direction in which a wedge's top rises; None for all others.
    """

    id: int
    kind: str
    position_mm: tuple[float, float, float]
    height_mm: float
    yaw_deg: float | None
    tilt_deg: float
    rise_deg: float | None = None

    @classmethod
    def from_truth(cls, part: Mapping[str, Any]) -> TruePart:
        """Read one part of the simulator's answer to ``{"op": "truth"}``."""
        x, y, z = part["position_mm"]
        yaw, rise = part["yaw_deg"], part["rise_deg"]
        return cls(
            int(part["id"]),
            str(part["kind"]),
            (float(x), float(y), float(z)),
            float(part["height_mm"]),
            None if yaw is None else float(yaw),
            float(part["tilt_deg"]),
            None if rise is None else float(rise),
        )

    @property
    def xy_mm(self) -> NDArray[np.float64]:
        """The part's place on the table, shape (2,)."""
        return np.array(self.position_mm[:2])


@dataclass(frozen=True)
class Goal:
    """Where the plan wants a workpiece to end, base frame."""

    workpiece_id: int
    xy_mm: tuple[float, float]


@dataclass(frozen=True)
class PartVerdict:
    """What became of one part.

    Attributes:
        part: the part before the run.
        workpiece_id: the claim that was about it, None if it was not seen.
        position_error_mm: length of perceived minus true position before the first pick.
        grasp_offset_mm: the horizontal part of that error: how far from its centre the part was gripped.
        placement_error_mm: horizontal distance between where it ended and its goal.
        angle_error_deg: turn against its orientation before.
        tilt_deg: tilt at the end.
        goal_xy_mm: its goal: the true start place of the part that stood there.
        reasons: why this part fails; empty where it does not.
    """

    part: TruePart
    workpiece_id: int | None
    position_error_mm: float | None
    grasp_offset_mm: float | None
    placement_error_mm: float | None
    angle_error_deg: float
    tilt_deg: float
    goal_xy_mm: tuple[float, float] | None
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class Grade:
    """The verdict on a run."""

    parts: tuple[PartVerdict, ...]
    spurious: tuple[int, ...]
    reasons: tuple[str, ...]

    @property
    def success(self) -> bool:
        """Whether the simulator's truth agrees that the job is done."""
        return not self.reasons and all(not part.reasons for part in self.parts)

    def error_summary(self, name: str) -> dict[str, float | None]:
        """Return mean and max of a `PartVerdict` figure over the parts that have it; None where none has."""
        values = [value for part in self.parts if (value := getattr(part, name)) is not None]
        return {"mean": float(np.mean(values)), "max": float(np.max(values))} if values else {"mean": None, "max": None}


def associate(claims: NDArray[np.float64], truth: NDArray[np.float64], limit_mm: float) -> dict[int, int]:
    """Pair rows of ``claims`` (N, 2) with rows of ``truth`` (M, 2), least total distance, no pair beyond the limit."""
    if not len(claims) or not len(truth):
        return {}
    distance_mm = np.linalg.norm(claims[:, None] - truth[None], axis=2)
    rows, columns = linear_sum_assignment(np.minimum(distance_mm, limit_mm))
    return {int(r): int(c) for r, c in zip(rows, columns, strict=True) if distance_mm[r, c] < limit_mm}


def _angle_error_deg(before: TruePart, after: TruePart) -> float:
    """Turn between two poses of a part, modulo the symmetry of its kind; 0 for a part without direction."""
    if before.rise_deg is not None and after.rise_deg is not None:
        return abs(wrap_angle_deg(after.rise_deg - before.rise_deg, WHOLE_TURN_DEG))
    if before.yaw_deg is None or after.yaw_deg is None:
        return 0.0
    period_deg = PRISM_SYMMETRY_DEG if before.kind == "prism" else HALF_TURN_DEG
    return abs(wrap_angle_deg(after.yaw_deg - before.yaw_deg, period_deg))


def _order_reasons(
    before: Sequence[TruePart], after: Mapping[int, TruePart], places: NDArray[np.float64], tolerance: Tolerance
) -> list[str]:
    """Say which parts stand in the wrong order: the highest belongs at the place with the largest y."""
    standing = associate(np.array([after[part.id].xy_mm for part in before]), places, ASSOCIATION_LIMIT_MM)
    by_place = {place: before[index] for index, place in standing.items()}
    order = [by_place[place] for place in np.argsort(-places[:, 1]) if place in by_place]
    return [
        f"part {low.id} ({low.height_mm:.1f} mm) stands before the higher part {high.id} ({high.height_mm:.1f} mm)"
        for index, low in enumerate(order)
        for high in order[index + 1 :]
        if high.height_mm > low.height_mm + tolerance.height_order_mm
    ]


def grade(
    before: Sequence[TruePart],
    after: Sequence[TruePart],
    perceived_mm: Mapping[int, tuple[float, float, float]],
    goals: Sequence[Goal],
    moved: frozenset[int],
    tolerance: Tolerance | None = None,
) -> Grade:
    """Judge a run.

    Args:
        before: truth before the first pick.
        after: truth at the end.
        perceived_mm: workpiece id to perceived position before the first pick.
        goals: the plan's goals; a goal's true place is the true start place nearest to it.
        moved: workpieces that the plan moves; every other part must be where it was.
        tolerance: the figures that count as success.
    """
    tolerance = tolerance or Tolerance()
    ids = list(perceived_mm)
    places = np.array([part.xy_mm for part in before])
    claims = np.array([perceived_mm[i][:2] for i in ids]).reshape(-1, 2)
    pairs = associate(claims, places, ASSOCIATION_LIMIT_MM)
    claim_of = {part: ids[claim] for claim, part in pairs.items()}
    goal_places = associate(np.array([goal.xy_mm for goal in goals]).reshape(-1, 2), places, ASSOCIATION_LIMIT_MM)
    place_of_workpiece = {goals[goal].workpiece_id: place for goal, place in goal_places.items()}
    later = {part.id: part for part in after}

    verdicts = []
    for index, part in enumerate(before):
        end = later[part.id]
        workpiece_id = claim_of.get(index)
        reasons = []
        goal_xy = position_error = grasp_offset = placement_error = None
        if workpiece_id is None:
            reasons.append("not seen")
        else:
            error_mm = np.subtract(perceived_mm[workpiece_id], part.position_mm)
            position_error, grasp_offset = float(np.linalg.norm(error_mm)), float(np.linalg.norm(error_mm[:2]))
            place = place_of_workpiece.get(workpiece_id)
            if place is None:
                reasons.append("the plan has no goal for it")
            else:
                goal_xy = (float(places[place, 0]), float(places[place, 1]))
                placement_error = float(np.linalg.norm(end.xy_mm - places[place]))
                if placement_error > tolerance.position_mm:
                    reasons.append(f"ended {placement_error:.1f} mm from its goal")
        drift_mm = float(np.linalg.norm(end.xy_mm - part.xy_mm))
        if workpiece_id not in moved and drift_mm > tolerance.undisturbed_mm:
            reasons.append(f"was disturbed by {drift_mm:.1f} mm though no move was planned for it")
        angle_error = _angle_error_deg(part, end)
        if angle_error > tolerance.angle_deg:
            reasons.append(f"turned by {angle_error:.1f} deg")
        if end.tilt_deg > tolerance.angle_deg:
            reasons.append(f"does not stand upright: tilt {end.tilt_deg:.1f} deg")
        verdicts.append(
            PartVerdict(
                part,
                workpiece_id,
                position_error,
                grasp_offset,
                placement_error,
                angle_error,
                end.tilt_deg,
                goal_xy,
                tuple(reasons),
            )
        )
    spurious = tuple(i for i in ids if i not in claim_of.values())
    reasons = [f"workpiece {i} is no part of the cell" for i in spurious]
    reasons += _order_reasons(before, later, places, tolerance)
    return Grade(tuple(verdicts), spurious, tuple(reasons))
