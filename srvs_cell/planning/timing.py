"""How long the arm takes: straight moves with a trapezoidal speed profile, and what every pick and place costs besides.

The cell stops at every point of a move (above, near, at), so that the time of a plan is a sum over its straight moves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from srvs_cell.planning.legs import tallest_mm
from srvs_cell.planning.travel import Distances, distances

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.planning.hand import HandMotion
    from srvs_cell.planning.parameters import PlanningParameters
    from srvs_cell.planning.problem import Problem, ProblemObject
    from srvs_cell.scene import Grasp, Workpiece


Turns = tuple[float, float, float]


@dataclass(frozen=True)
class Timing:
    """The arm's time as the search uses it.

    Attributes:
        speed_mm_s, acceleration_mm_s2: of straight moves at travel height.
        handling_s: per object, the time of each of its moves besides the level legs: down, grip, up, down, let go, up.
        looks_between: whether the hand goes home, to where the cell looks from, after every move.
        rise_mm: how far above travel height that is.
        turns_s: per object, from place to place, how long the wrist turns on the way to it, with it, and back home;
            empty: it does not turn.
    """

    speed_mm_s: float
    acceleration_mm_s2: float
    handling_s: tuple[float, ...]
    looks_between: bool = False
    rise_mm: float = 0.0
    turns_s: tuple[tuple[tuple[Turns, ...], ...], ...] = ()

    def distances(self, problem: Problem) -> Distances:
        """Return the legs' times, each as the length that the arm goes in that time at travel speed.

        So every search can go on in millimetres. A shorter way never takes longer, and a way by a third place is never
        quicker than the straight one: the time is a concave function of the length.
        """
        straight = distances(problem)

        def equal_mm(length_mm: float) -> float:
            return self.speed_mm_s * straight_s(length_mm, self.speed_mm_s, self.acceleration_mm_s2)

        return Distances(
            tuple(tuple(equal_mm(length_mm) for length_mm in row) for row in straight.between_mm),
            tuple(equal_mm(length_mm) for length_mm in straight.home_mm),
            tuple(self.speed_mm_s * seconds for seconds in self.handling_s),
            self._round_trips_mm(straight) if self.looks_between else (),
        )

    def _round_trips_mm(self, straight: Distances) -> tuple[tuple[tuple[float, ...], ...], ...]:
        """Return what moves cost from home to home: aslant down to the pick, level, straight up, and level home."""

        def straight_move_s(length_mm: float) -> float:
            return straight_s(length_mm, self.speed_mm_s, self.acceleration_mm_s2)

        down_s = [straight_move_s(math.hypot(length_mm, self.rise_mm)) for length_mm in straight.home_mm]
        home_s = [straight_move_s(length_mm) for length_mm in straight.home_mm]
        level_s = [[straight_move_s(length_mm) for length_mm in row] for row in straight.between_mm]
        up_s = straight_move_s(self.rise_mm)
        places = range(len(home_s))
        still = (((0.0, 0.0, 0.0),) * len(places),) * len(places)

        def round_trip_s(p: int, q: int, turns_s: Turns) -> float:
            # The TCP goes straight and turns meanwhile: whichever takes longer.
            to_s, with_s, back_s = turns_s
            return max(down_s[p], to_s) + max(level_s[p][q], with_s) + up_s + max(home_s[q], back_s)

        return tuple(
            tuple(tuple(self.speed_mm_s * round_trip_s(p, q, turns_s[p][q]) for q in places) for p in places)
            for turns_s in (self.turns_s or (still,) * len(self.handling_s))
        )


def straight_s(length: float, speed: float, acceleration: float) -> float:
    """Return the time from stand to stand, of a way in millimetres or a turn in degrees; a short one stays slower."""
    ramps = speed**2 / acceleration
    if length < ramps:
        return 2.0 * math.sqrt(length / acceleration)
    return length / speed + speed / acceleration


def cell_timing(
    problem: Problem, movable: Sequence[Workpiece], hand: HandMotion, parameters: PlanningParameters
) -> Timing:
    """Return the timing of the cell's own problem.

    All legs are taken at the height that passes above everything; the plan's own legs are as high as need be, so that
    the arm is never slower than this.
    """
    acceleration = parameters.acceleration_mm_s2
    top_mm = tallest_mm(problem)

    def way_s(above_mm: float) -> float:
        """Return the time from a height above the point where the gripper acts straight down to it, or up again."""
        slow_mm = min(hand.approach_mm, above_mm)
        fast_s = straight_s(above_mm - slow_mm, hand.travel_speed_mm_s, acceleration)
        return fast_s + straight_s(slow_mm, hand.approach_speed_mm_s, acceleration)

    def turns_s(grasp: Grasp, item: ProblemObject, origin: int, target: int) -> Turns:
        here_deg, carried_deg = item.turn_deg(origin), item.turn_deg(target) - item.turn_deg(origin)
        turned = replace(grasp, yaw_deg=grasp.yaw_deg + here_deg)
        taken_deg = hand.grasp_pose(turned, carried_deg).r_deg - hand.observe.r_deg
        to_s, with_s, back_s = (
            straight_s(abs(turn_deg), parameters.wrist_speed_deg_s, parameters.wrist_acceleration_deg_s2)
            for turn_deg in (taken_deg, carried_deg, taken_deg + carried_deg)
        )
        return to_s, with_s, back_s

    places = range(len(problem.places))
    handling_s, turning_s = [], []
    for item, workpiece in zip(problem.objects, movable, strict=True):
        if workpiece.grasp is None:
            handling_s.append(0.0)
            turning_s.append((((0.0, 0.0, 0.0),) * len(places),) * len(places))
            continue
        at = hand.grasp_pose(workpiece.grasp)
        empty_mm = max(hand.travel_z_mm(top_mm) - at.z_mm, 0.0)
        loaded_mm = max(hand.travel_z_mm(top_mm, hand.hang_mm(at)) - at.z_mm, 0.0)
        handling_s.append(2.0 * (way_s(empty_mm) + way_s(loaded_mm) + parameters.grip_time_s))
        turning_s.append(tuple(tuple(turns_s(workpiece.grasp, item, p, q) for q in places) for p in places))
    return Timing(
        hand.travel_speed_mm_s,
        acceleration,
        tuple(handling_s),
        hand.looks_between,
        max(hand.observe.z_mm - hand.travel_z_mm(top_mm), 0.0),
        tuple(turning_s),
    )
