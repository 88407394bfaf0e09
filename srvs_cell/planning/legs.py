"""How high the hand has to travel: the highest thing under each leg of a plan.

A leg is straight and level. What it sweeps is taken as a strip: every point that is nearer to the straight line between
both ends than hand and carried part reach, however they are turned meanwhile.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.planning.clearance import hand_solids, outer_radius_mm, too_close
from srvs_cell.planning.problem import Polygon

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from srvs_cell.planning.problem import Footprint, Problem, ProblemObject
    from srvs_cell.scene import Move, Point2


@dataclass(frozen=True)
class LegTops:
    """Heights above the table that are certainly not exceeded by what stands under the three legs of a move.

    Attributes:
        to_pick_mm: the empty leg to the workpiece, which is itself under its end.
        carried_mm: the leg with the workpiece in the hand.
        away_mm: the empty leg to the next workpiece; for the last move what stands round its place.
    """

    to_pick_mm: float
    carried_mm: float
    away_mm: float


def tallest_mm(problem: Problem) -> float:
    """Return the height above the table that nothing exceeds."""
    tops = [item.top_mm for item in problem.objects] + [obstacle.top_mm for obstacle in problem.obstacles]
    return max(tops, default=0.0)


def leg_tops(problem: Problem, moves: Sequence[Move], *, looks_between: bool) -> tuple[LegTops, ...]:
    """Return the heights under the legs of each move of a plan.

    A leg that comes from where the cell has looked from passes above everything; before it looks the hand goes straight
    up. That is so before the first move and after the last one, and with ``looks_between`` for every move.
    """
    points = [(place.x_mm, place.y_mm) for place in problem.places]
    table = _Table(problem)
    stands = [item.start for item in problem.objects]
    carried, away = [], []
    for number, move in enumerate(moves):
        origin, target = points[move.from_place], points[move.to_place]
        carried.append(table.highest_mm(stands, origin, target, problem.objects[move.object]))
        stands[move.object] = move.to_place
        looks = looks_between or number + 1 == len(moves)
        following = move.to_place if looks else moves[number + 1].from_place
        away.append(table.highest_mm(stands, target, points[following], None))
    to_pick = [tallest_mm(problem)] * len(moves) if looks_between else [tallest_mm(problem), *away]
    return tuple(LegTops(*heights) for heights in zip(to_pick, carried, away, strict=False))


class _Table:
    """What stands on the table, and what passes above it."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        # Tips and palm of the widest hand; what the palm passes above may be higher by the fingers' length.
        solids = [
            (outer_radius_mm(shape), bottom_mm - grip.bottom_mm)
            for item in problem.objects
            for grip in item.grips
            for shape, bottom_mm in hand_solids(grip)
        ]
        longer = {length_mm: 0.0 for _, length_mm in solids} | {0.0: 0.0}
        for radius_mm, length_mm in solids:
            longer[length_mm] = max(longer[length_mm], radius_mm)
        self._hand = longer

    def highest_mm(self, stands: Sequence[int], begin: Point2, end: Point2, held: ProblemObject | None) -> float:
        """Return what is highest under a leg; what is held takes no part."""
        part_mm = 0.0 if held is None else outer_radius_mm(held.footprint)
        highest_mm = 0.0
        for footprint, point, top_mm in self._things(stands, held):
            for length_mm, radius_mm in self._hand.items():
                reach_mm = max(radius_mm, part_mm) if length_mm == 0.0 else radius_mm
                if top_mm - length_mm > highest_mm and self._is_under(footprint, point, begin, end, reach_mm):
                    highest_mm = top_mm - length_mm
        return highest_mm

    def _things(self, stands: Sequence[int], held: ProblemObject | None) -> Iterator[tuple[Footprint, Point2, float]]:
        for item in self._problem.objects:
            if item is not held:
                place = self._problem.places[stands[item.id]]
                yield item.at(place.id).footprint, (place.x_mm, place.y_mm), item.top_mm
        for obstacle in self._problem.obstacles:
            yield obstacle.footprint, (obstacle.x_mm, obstacle.y_mm), obstacle.top_mm

    def _is_under(self, footprint: Footprint, point: Point2, begin: Point2, end: Point2, reach_mm: float) -> bool:
        strip = Polygon(((0.0, 0.0), (end[0] - begin[0], end[1] - begin[1])))
        if math.hypot(*strip.vertices_mm[1]) == 0.0:
            strip = Polygon(((0.0, 0.0),))
        displacement = np.array([[point[0] - begin[0], point[1] - begin[1]]])
        return bool(too_close(strip, footprint, displacement, reach_mm + self._problem.clearance_mm)[0])
