"""Goal rule -> fewest moves -> least travel -> a plan that says what is proven."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from srvs_cell.planning.ample_room import MOST_WITH_ROOM, clear_places, fewest_with_room, with_places
from srvs_cell.planning.clearance import conflict_table
from srvs_cell.planning.detours import cycles_between, nested_detours, steps_of_walk
from srvs_cell.planning.goals import goal_is_possible, goal_rule
from srvs_cell.planning.hole_walk import shortest_walk
from srvs_cell.planning.moves import after, fewest_moves
from srvs_cell.planning.ordering import order_moves
from srvs_cell.planning.parameters import SearchLimits
from srvs_cell.planning.reasons import infeasible_reasons
from srvs_cell.planning.travel import distances, least_travel, travel_mm
from srvs_cell.planning.walk_bound import hole_costs
from srvs_cell.scene import Move, PlaceKind, PlanStatus, RelocationPlan

if TYPE_CHECKING:
    from srvs_cell.planning.clearance import ConflictTable
    from srvs_cell.planning.goals import GoalRule
    from srvs_cell.planning.moves import Arrangement, MoveSearch, Step
    from srvs_cell.planning.problem import Problem
    from srvs_cell.planning.timing import Timing
    from srvs_cell.planning.travel import Distances

GREEDY_WEIGHT = 3.0
"""Weight of the heuristic where the search for the fewest moves has hit its cap: any plan is better than none."""

GREEDY_TRAVEL_WEIGHT = 2.0
"""The same for the search for the least travel."""

_MOST_IN_SEARCH = 9
"""With more objects the fewest moves are found by who must leave before whom, where that is possible."""

_MANY_OBJECTS = f"the least travel is not searched for with more than {_MOST_IN_SEARCH} objects in each other's way"


def plan(problem: Problem, limits: SearchLimits | None = None, timing: Timing | None = None) -> RelocationPlan:
    """Plan a relocation: the fewest moves, and among those plans the least travel.

    Args:
        problem: what to do.
        limits: caps of the search; where one is hit the answer is labelled not proven and carries the bounds.
        timing: the arm's time, which then is what is least; None: the straight way.

    Returns:
        the plan. ``infeasible`` means that every arrangement that can be reached was looked at; ``reasons`` then names
        the cause for each object. ``not_proven`` without moves means that no plan was found within the caps.
    """
    limits = limits or SearchLimits()
    if timing is None:
        return _plan(problem, limits, distances(problem))
    answer = _plan(problem, limits, timing.distances(problem))
    straight = distances(problem)
    steps = tuple((move.object, move.from_place, move.to_place) for move in answer.moves)
    start = tuple(item.start for item in problem.objects)
    return replace(
        answer,
        travel_mm=travel_mm(steps, straight),
        bound_travel_mm=_travel_bound_mm(start, goal_rule(problem), straight),
        time_s=answer.travel_mm / timing.speed_mm_s,
        bound_time_s=answer.bound_travel_mm / timing.speed_mm_s,
    )


def _plan(problem: Problem, limits: SearchLimits, legs: Distances) -> RelocationPlan:
    rule = goal_rule(problem)
    start = tuple(item.start for item in problem.objects)
    target = rule.labelled
    changing_places = target is not None and start != target and set(start) == set(target)
    bound_mm = _travel_bound_mm(start, rule, legs)
    if target is not None and not changing_places and len(start) > _MOST_IN_SEARCH:
        ordering = order_moves(problem, start, target, legs)
        if ordering is not None and ordering.steps is not None:
            return _unproven(ordering.steps, legs, ordering.bound, bound_mm, (_MANY_OBJECTS,))
    table = conflict_table(problem)
    if target is not None and changing_places and table.nothing_in_the_way and not legs.round_trips_mm:
        free = [place for place in range(table.place_count) if place not in start]
        if free:
            return _permutation(start, target, free, table, rule, legs, limits)
    if not goal_is_possible(start, table, rule):
        return _infeasible(rule.lower_bound(start), bound_mm, infeasible_reasons(problem, table, rule, None))
    found = _fewest_moves(start, table, rule, legs, limits)
    capped = f"the search for the fewest moves ended at its cap of {limits.max_moves_search} moves tried"
    if found.steps is None:
        if found.proven:
            return _infeasible(found.bound, bound_mm, infeasible_reasons(problem, table, rule, found.explored))
        return _unproven((), legs, found.bound, bound_mm, (f"no plan found: {capped}",))
    if not found.proven:
        return _unproven(found.steps, legs, found.bound, bound_mm, (capped,))
    search = least_travel(start, len(found.steps), table, rule, legs, limits.max_travel_search)
    if search.steps is None:
        short = _short_plan(start, found.steps, table, rule, legs, limits)
        return _unproven(short, legs, found.bound, search.bound_mm, (_travel_capped(limits),))
    return _solved(search.steps, legs)


def _fewest_moves(
    start: Arrangement, table: ConflictTable, rule: GoalRule, legs: Distances, limits: SearchLimits
) -> MoveSearch:
    """Search for the fewest moves, first as if there were room enough: that is a bound, and often the answer."""
    cap = limits.max_moves_search
    bound, good = 0, []
    if len(start) <= MOST_WITH_ROOM:
        anywhere = fewest_with_room(start, table, rule, len(start), cap)
        if anywhere.proven and anywhere.steps is None:
            return anywhere
        bound = anywhere.bound
        if clear := clear_places(start, table, rule):
            search = fewest_with_room(start, table, rule, len(clear), cap)
            if search.steps is not None:
                good.append(replace(search, steps=with_places(search.steps, start, clear, table, legs)))
        if not good or len(good[0].steps or ()) > bound:
            good.append(fewest_moves(start, table, rule, cap, at_most_twice=True))
        for search in good:
            if search.steps is not None and len(search.steps) <= bound:
                return replace(search, proven=True, bound=bound)
    found = fewest_moves(start, table, rule, cap)
    found = replace(found, bound=max(found.bound, bound))
    if found.steps is not None or found.proven:
        return found
    plans = [search.steps for search in good if search.steps is not None]
    if not plans:
        return replace(found, steps=fewest_moves(start, table, rule, cap, GREEDY_WEIGHT).steps)
    return replace(found, steps=min(plans, key=len))


@lru_cache(maxsize=8)
def moves_with_room(problem: Problem, limits: SearchLimits) -> int | None:
    """Return a bound on the moves that holds with any number of free places; None: there is no plan even so.

    Kept, because it is asked for before and after a plan is made.
    """
    table, rule = conflict_table(problem), goal_rule(problem)
    start = tuple(item.start for item in problem.objects)
    if not goal_is_possible(start, table, rule):
        return None
    if len(start) > MOST_WITH_ROOM:
        return rule.lower_bound(start)
    found = fewest_with_room(start, table, rule, len(start), limits.max_moves_search)
    return None if found.proven and found.steps is None else found.bound


def lacks_room(problem: Problem, needed: int, limits: SearchLimits) -> bool:
    """Tell whether with another free place that is clear of everything certainly fewer moves do.

    Args:
        problem: a problem whose buffer places were found.
        needed: what `moves_with_room` says.
        limits: caps of the search.
    """
    table, rule = conflict_table(problem), goal_rule(problem)
    start = tuple(item.start for item in problem.objects)
    clear = clear_places(start, table, rule)
    if len(start) > MOST_WITH_ROOM or any(
        place.kind is PlaceKind.BUFFER and place.id not in clear for place in problem.places
    ):
        return False
    found = fewest_with_room(start, table, rule, len(clear), limits.max_moves_search)
    return found.proven and (found.steps is None or len(found.steps) > needed)


def _infeasible(bound_moves: int, bound_mm: float, reasons: tuple[str, ...]) -> RelocationPlan:
    return RelocationPlan(
        status=PlanStatus.INFEASIBLE,
        moves=(),
        travel_mm=0.0,
        moves_proven=True,
        travel_proven=True,
        bound_moves=bound_moves,
        bound_travel_mm=bound_mm,
        reasons=reasons,
    )


def _travel_capped(limits: SearchLimits) -> str:
    return f"the search for the least travel ended at its cap of {limits.max_travel_search} moves tried"


def _solved(steps: tuple[Step, ...], legs: Distances) -> RelocationPlan:
    total_mm = travel_mm(steps, legs)
    return RelocationPlan(
        status=PlanStatus.SOLVED,
        moves=tuple(Move(*step) for step in steps),
        travel_mm=total_mm,
        moves_proven=True,
        travel_proven=True,
        bound_moves=len(steps),
        bound_travel_mm=total_mm,
    )


def _permutation(
    start: Arrangement,
    target: Arrangement,
    free: list[int],
    table: ConflictTable,
    rule: GoalRule,
    legs: Distances,
    limits: SearchLimits,
) -> RelocationPlan:
    """Plan where nothing is in the way and the objects only change places: the fewest moves are known beforehand."""
    steps = nested_detours(start, target, free, legs)
    found_mm = travel_mm(steps, legs)
    shorter: tuple[Step, ...] | None = None
    if len(free) == 1:
        costs = hole_costs(cycles_between(start, target), free[0], legs, start)
        walk = shortest_walk(costs, found_mm, limits.max_travel_search)
        bound_mm = walk.bound_mm
        if walk.places is not None:
            shorter = steps_of_walk(walk.places, start)
    else:
        search = least_travel(start, len(steps), table, rule, legs, limits.max_travel_search)
        bound_mm, shorter = search.bound_mm, search.steps
    if shorter is not None:
        return _solved(shorter, legs)
    return _unproven(steps, legs, len(steps), min(bound_mm, found_mm), (_travel_capped(limits),))


def _short_plan(
    start: Arrangement,
    steps: tuple[Step, ...],
    table: ConflictTable,
    rule: GoalRule,
    legs: Distances,
    limits: SearchLimits,
) -> tuple[Step, ...]:
    """Return a plan with as many moves as ``steps`` and shorter travel, where one is found without proof."""
    target = start
    for step in steps:
        target = after(target, step)
    free = [place for place in range(table.place_count) if place not in start and table.single >> place & 1]
    if table.nothing_in_the_way and free and set(start) == set(target):
        other: tuple[Step, ...] | None = nested_detours(start, target, free, legs)
    else:
        other = least_travel(
            start, len(steps), table, rule, legs, limits.max_travel_search, weight=GREEDY_TRAVEL_WEIGHT
        ).steps
    return steps if other is None else min(steps, other, key=lambda plan_steps: travel_mm(plan_steps, legs))


def _unproven(
    steps: tuple[Step, ...], legs: Distances, bound_moves: int, bound_mm: float, reasons: tuple[str, ...]
) -> RelocationPlan:
    return RelocationPlan(
        status=PlanStatus.NOT_PROVEN,
        moves=tuple(Move(*step) for step in steps),
        travel_mm=travel_mm(steps, legs),
        moves_proven=bool(steps) and len(steps) == bound_moves,
        travel_proven=False,
        bound_moves=bound_moves,
        bound_travel_mm=bound_mm,
        reasons=reasons,
    )


def _travel_bound_mm(start: Arrangement, rule: GoalRule, legs: Distances) -> float:
    """Return a lower bound on the travel of any plan.

    Every misplaced object is carried at least to its goal, the hand comes to it from another place or from home, and
    in the end the hand goes home.
    """
    wrong = rule.misplaced(start)
    if not wrong:
        return 0.0
    places = range(len(legs.home_mm))
    parts = [legs.shortest_home_mm]
    for item in wrong:
        origin = start[item]
        parts += [
            min(
                (legs.move_mm(item, origin, place) for place in places if rule.allowed[item] >> place & 1), default=0.0
            ),
            legs.nearest_mm(origin),
        ]
    return math.fsum(parts)


def has_plan(answer: RelocationPlan) -> bool:
    """Tell whether an answer holds a plan; a solved problem may need no move at all."""
    return answer.status is PlanStatus.SOLVED or bool(answer.moves)


def plan_to_json(problem: Problem, answer: RelocationPlan) -> dict[str, Any]:
    """Return the plan as design.md section 9 writes it; ``moves`` and ``travel_mm`` are null without a plan."""
    planned = has_plan(answer)
    bounded = answer.status is not PlanStatus.INFEASIBLE
    return {
        "id": problem.id,
        "status": answer.status.value,
        "moves": len(answer.moves) if planned else None,
        "travel_mm": round(answer.travel_mm, 6) if planned else None,
        "moves_proven": answer.moves_proven,
        "travel_proven": answer.travel_proven,
        "bound_moves": answer.bound_moves if bounded else None,
        "bound_travel_mm": round(answer.bound_travel_mm, 6) if bounded else None,
        "plan": [[move.object, move.from_place, move.to_place] for move in answer.moves],
        "reasons": list(answer.reasons),
    }
