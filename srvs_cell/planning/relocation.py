"""Plan for the cell: workpieces in, validated moves in millimetres out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.planning.access import Access
from srvs_cell.planning.buffers import better_buffer, find_buffer
from srvs_cell.planning.carrying import Carry
from srvs_cell.planning.clearance import conflict_table
from srvs_cell.planning.culprits import is_possible
from srvs_cell.planning.explain import what_would_help
from srvs_cell.planning.legs import LegTops, leg_tops, tallest_mm
from srvs_cell.planning.moves import after, free_grips
from srvs_cell.planning.planner import has_plan, lacks_room, moves_with_room, plan
from srvs_cell.planning.problem import RankGoal
from srvs_cell.planning.rules import make_rule
from srvs_cell.planning.table import TableProblem, accessible, table_problem, with_access
from srvs_cell.planning.timing import cell_timing
from srvs_cell.planning.uncertainty import unordered
from srvs_cell.planning.validator import validate, validate_legs
from srvs_cell.scene import PlaceKind, PlanStatus, Point2, RelocationPlan

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.planning.buffers import Workspace
    from srvs_cell.planning.hand import HandMotion
    from srvs_cell.planning.kept_places import KeptPlaces
    from srvs_cell.planning.parameters import PlanningParameters
    from srvs_cell.planning.problem import Problem
    from srvs_cell.planning.rules import Rule
    from srvs_cell.scene import Move, Workpiece


_MOST_BUFFERS_TRIED = 4
"""Places tried for the buffer after the first: each costs a plan."""


@dataclass(frozen=True)
class CellMove:
    """One pick and place: a workpiece's footprint centroid goes from one point to another.

    Attributes:
        workpiece: `Workpiece.id`.
        from_mm, to_mm: x and y of the footprint's centroid on the table, base frame.
        tops: what the hand passes above on its way.
        grasp: which of the workpiece's grasps is taken, as it was seen: 0 is the best one.
        turn_deg: by how much it is turned on the way, from base x towards base y.
    """

    workpiece: int
    from_mm: Point2
    to_mm: Point2
    tops: LegTops
    grasp: int = 0
    turn_deg: float = 0.0

    @property
    def carry(self) -> Carry:
        """How the workpiece is carried."""
        return Carry(self.from_mm, self.to_mm, self.turn_deg)


@dataclass(frozen=True)
class CellGoal:
    """Where a workpiece's footprint centroid has to be in the end, moved or not.

    Attributes:
        workpiece: `Workpiece.id`.
        point_mm: x and y of the place.
        visible: whether it can be seen there; what lies in a bin is not looked for.
    """

    workpiece: int
    point_mm: Point2
    visible: bool = True


@dataclass(frozen=True)
class CellPlan:
    """A validated plan in the cell's terms.

    Attributes:
        table: the problem that was planned.
        relocation: the planner's answer; its reasons also say which workpieces were left as obstacles.
        moves: the moves in order.
        goals: one per movable workpiece; empty where there is no plan.
        buffers_mm: the buffer places, configured or found.
    """

    table: TableProblem
    relocation: RelocationPlan
    moves: tuple[CellMove, ...]
    goals: tuple[CellGoal, ...]
    buffers_mm: tuple[Point2, ...]

    @property
    def above_all(self) -> LegTops:
        """Legs that pass above everything, wherever it stands by then."""
        tallest = tallest_mm(self.table.problem)
        return LegTops(tallest, tallest, tallest)


def plan_relocation(
    workpieces: Sequence[Workpiece],
    parameters: PlanningParameters,
    workspace: Workspace,
    rule: Rule | None = None,
    hand: HandMotion | None = None,
    kept: KeptPlaces | None = None,
) -> CellPlan:
    """Plan what the goal rule wants for what was perceived, and replay the plan in the validator.

    Where one buffer place that was found is not enough, more are looked for.

    Args:
        workpieces: what was recognised.
        parameters: tolerances, fingers, buffer places, caps.
        workspace: where the hand may go.
        rule: the goal rule; None for the one that the parameters name.
        hand: how the cell moves the hand; None: heights, reach and joint limits play no part.
        kept: the places of a job that has begun already; None: the places where the workpieces stand.

    Returns:
        the plan; an infeasible one is returned, with its reasons, not raised.

    Raises:
        AlarmError: NO_BUFFER_PLACE; UNCERTAIN_POSITION where there is a plan, but not with three sigma of room around
            what was perceived, or where the heights are not known well enough to tell their order; PLAN_INFEASIBLE
            where the arm cannot go the ways of the plan; PLAN_INVALID where the validator refuses the planner's plan.
    """
    if rule is None and parameters.names_a_rule:
        rule = make_rule(parameters.rule, parameters.rule_settings)
    task = _Task(workpieces, parameters, workspace, rule, hand, kept)
    try:
        table = task.with_room(task.table())
    except AlarmError as error:
        if error.alarm is Alarm.NO_BUFFER_PLACE and task.is_solvable_if_exact(1):
            raise _too_uncertain((error.detail.rstrip("."),), ()) from error
        raise
    _check_order(table, workpieces)
    answer = task.plan(table)
    found = _buffers(table)
    if found and not parameters.buffer_places_mm:
        table, answer = task.with_more_buffers(table, answer)
        table, answer = task.with_better_buffer(table, answer)
    if answer.status is PlanStatus.INFEASIBLE and task.is_solvable_if_exact(found):
        raise _too_uncertain(answer.reasons, table.notes)
    made = _cell_plan(table, answer, looks_between=hand is not None and hand.looks_between)
    if hand is not None:
        _check_ways(made, workpieces, hand, Access(hand, parameters.arm, workspace))
    return made


@dataclass(frozen=True)
class _Task:
    """What is to be planned; the arguments of `plan_relocation`."""

    workpieces: Sequence[Workpiece]
    parameters: PlanningParameters
    workspace: Workspace
    rule: Rule | None
    hand: HandMotion | None
    kept: KeptPlaces | None

    def table(self, buffers: int = 1, *, exact: bool = False) -> TableProblem:
        """Return the problem; raises `AlarmError` NO_BUFFER_PLACE."""
        return table_problem(
            self.workpieces,
            self.parameters,
            self.workspace,
            buffers,
            rule=self.rule,
            hand=self.hand,
            kept=self.kept,
            exact=exact,
        )

    def plan(self, table: TableProblem) -> RelocationPlan:
        """Plan for what the config wants to be least."""
        if self.hand is None or self.parameters.objective != "time":
            return plan(table.problem, self.parameters.limits)
        timing = cell_timing(table.problem, self._movable(table), self.hand, self.parameters)
        return plan(table.problem, self.parameters.limits, timing)

    def with_room(self, table: TableProblem) -> TableProblem:
        """Look for more buffer places where it is certain, without any plan, that they save moves."""
        found, limits = _buffers(table), self.parameters.limits
        if not found or self.parameters.buffer_places_mm:
            return table
        needed = moves_with_room(table.problem, limits)
        while needed is not None and found < self.parameters.max_found_buffers:
            if not lacks_room(table.problem, needed, limits):
                break
            try:
                table = self._with_one_more(table)
            except AlarmError:
                break
            found += 1
        return table

    def with_more_buffers(self, table: TableProblem, answer: RelocationPlan) -> tuple[TableProblem, RelocationPlan]:
        """Look for more buffer places while they can save moves, or make a plan possible at all."""
        needed = moves_with_room(table.problem, self.parameters.limits)
        best, wider = (table, answer), table
        for _ in range(_buffers(table), self.parameters.max_found_buffers):
            if needed is None or (has_plan(best[1]) and len(best[1].moves) <= needed):
                break
            try:
                wider = self._with_one_more(wider)
            except AlarmError as error:
                # One place was found before, so that "infeasible" and its reasons say more than the alarm would.
                if not has_plan(best[1]):
                    reasons = (*best[1].reasons, f"no further buffer place: {error.detail}")
                    best = (best[0], replace(best[1], reasons=reasons))
                break
            other = self.plan(wider)
            if not has_plan(best[1]) or (has_plan(other) and len(other.moves) < len(best[1].moves)):
                best = (wider, other)
        return best

    def with_better_buffer(self, table: TableProblem, answer: RelocationPlan) -> tuple[TableProblem, RelocationPlan]:
        """Move the buffer place that was found to where the plan's ways are shortest, and plan anew, while it helps."""
        movable, access = self._movable(table), self._access()
        for _ in range(_MOST_BUFFERS_TRIED):
            # Where the proof fails already, so it will again, and costs as much.
            if table.problem.places[-1].kind is not PlaceKind.BUFFER or not answer.travel_proven:
                break
            moved = better_buffer(
                table.problem,
                answer.moves,
                self.workspace,
                self.parameters.buffer_grid_mm,
                accessible(movable, access),
            )
            if moved is None:
                break
            trial = replace(table, problem=with_access(moved, movable, access, moved.places[-1:]))
            shorter = self.plan(trial)
            if not shorter.moves or _cost(shorter) >= _cost(answer):
                break
            table, answer = trial, shorter
        return table, answer

    def is_solvable_if_exact(self, buffers: int) -> bool:
        """Tell whether there would be a plan without the room that is kept for the vision's uncertainty."""
        try:
            exact = self.table(max(buffers, 1), exact=True)
        except AlarmError:
            return False
        return is_possible(exact.problem, self.parameters.limits.max_moves_search) is True

    def _with_one_more(self, table: TableProblem) -> TableProblem:
        """Return the problem with one more buffer place; raises `AlarmError` NO_BUFFER_PLACE."""
        movable, access = self._movable(table), self._access()
        grid_mm = self.parameters.buffer_grid_mm
        problem = find_buffer(table.problem, self.workspace, grid_mm, accessible(movable, access))
        return replace(table, problem=with_access(problem, movable, access, problem.places[-1:]))

    def _access(self) -> Access | None:
        return None if self.hand is None else Access(self.hand, self.parameters.arm, self.workspace)

    def _movable(self, table: TableProblem) -> list[Workpiece]:
        by_id = {workpiece.id: workpiece for workpiece in self.workpieces}
        return [by_id[identifier] for identifier in table.workpieces]


def _buffers(table: TableProblem) -> int:
    return sum(place.kind is PlaceKind.BUFFER for place in table.problem.places)


def _cost(answer: RelocationPlan) -> tuple[int, float]:
    return len(answer.moves), answer.travel_mm if answer.time_s is None else answer.time_s


def _too_uncertain(reasons: tuple[str, ...], notes: tuple[str, ...]) -> AlarmError:
    said = (
        "Blocked by the vision's uncertainty; were positions exact instead of known to 3 sigma, there would be a plan"
    )
    return AlarmError(Alarm.UNCERTAIN_POSITION, f"{said}: {'; '.join((*reasons, *notes))}.")


def _check_order(table: TableProblem, workpieces: Sequence[Workpiece]) -> None:
    """Raise `AlarmError` UNCERTAIN_POSITION where the order of heights is asked for and not known."""
    goal = table.problem.goal
    if not isinstance(goal, RankGoal):
        return
    sorted_by_height = [workpiece for workpiece in workpieces if workpiece.id in table.workpieces]
    said = [
        f"workpieces {one.id} ({one.height_mm:.1f} mm) and {other.id} ({other.height_mm:.1f} mm): "
        f"the difference is known to {doubt_mm:.1f} mm (two sigma)"
        for one, other, doubt_mm in unordered(sorted_by_height, goal.tolerance_mm)
    ]
    if said:
        raise AlarmError(
            Alarm.UNCERTAIN_POSITION,
            f"Which is the higher one, by more than the {goal.tolerance_mm:.1f} mm that may stand in either order, is "
            f"not known of {'; '.join(said)}.",
        )


def _cell_plan(table: TableProblem, answer: RelocationPlan, *, looks_between: bool) -> CellPlan:
    problem = table.problem
    planned = has_plan(answer)
    if answer.status is PlanStatus.INFEASIBLE:
        helpful = tuple(f"it would help: {change}" for change in what_would_help(problem))
        answer = replace(answer, reasons=(*answer.reasons, *helpful))
    points = [(place.x_mm, place.y_mm) for place in problem.places]
    ends = {item.id: item.start for item in problem.objects}
    ends |= {move.object: move.to_place for move in answer.moves}
    bins = {place.id for place in problem.places if place.kind is PlaceKind.BIN}
    return CellPlan(
        table=table,
        relocation=replace(answer, reasons=(*answer.reasons, *table.notes)),
        moves=_cell_moves(problem, answer.moves, table.workpieces, looks_between=looks_between) if planned else (),
        goals=tuple(CellGoal(table.workpieces[i], points[end], end not in bins) for i, end in ends.items())
        if planned
        else (),
        buffers_mm=tuple(points[place.id] for place in problem.places if place.kind is PlaceKind.BUFFER),
    )


def _cell_moves(
    problem: Problem, moves: Sequence[Move], workpieces: Sequence[int], *, looks_between: bool
) -> tuple[CellMove, ...]:
    """Return moves in the cell's terms, replayed in the validator.

    Args:
        problem: the problem.
        moves: a plan of it.
        workpieces: id of the workpiece behind each object.
        looks_between: whether the hand goes to look after every move.

    Raises:
        AlarmError: PLAN_INVALID where the validator refuses a move, its grip, or the heights of its ways.
    """
    points = [(place.x_mm, place.y_mm) for place in problem.places]
    tops = leg_tops(problem, moves, looks_between=looks_between)
    grips = _grips(problem, moves)
    refusal = [
        *validate(problem, moves, grips),
        *validate_legs(problem, moves, tops, looks_between=looks_between),
    ]
    if refusal:
        raise AlarmError(Alarm.PLAN_INVALID, f"{'; '.join(refusal)}.")
    return tuple(
        CellMove(
            workpieces[move.object],
            points[move.from_place],
            points[move.to_place],
            heights,
            grip,
            problem.objects[move.object].turn_deg(move.to_place)
            - problem.objects[move.object].turn_deg(move.from_place),
        )
        for move, heights, grip in zip(moves, tops, grips, strict=True)
    )


def _grips(problem: Problem, moves: Sequence[Move]) -> list[int]:
    """Return for each move the first of its object's grips that has room where it is taken and where it is left."""
    table = conflict_table(problem)
    arrangement = tuple(item.start for item in problem.objects)
    grips = []
    for move in moves:
        step = (move.object, move.from_place, move.to_place)
        grips.append(next(iter(free_grips(arrangement, step, table)), 0))
        arrangement = after(arrangement, step)
    return grips


def _check_ways(made: CellPlan, workpieces: Sequence[Workpiece], hand: HandMotion, access: Access) -> None:
    """Raise PLAN_INFEASIBLE where the arm cannot go straight from pose to pose of the plan, in one configuration."""
    grasps = {workpiece.id: workpiece.grasp for workpiece in workpieces}
    carried: dict[int, Carry] = {}
    before = hand.observe
    for number, move in enumerate(made.moves, start=1):
        grasp = grasps[move.workpiece]
        if grasp is None:
            raise AlarmError(Alarm.PLAN_INVALID, f"Move {number}: workpiece {move.workpiece} has no grasp.")
        before_it = carried.get(move.workpiece, Carry(move.from_mm, move.from_mm))
        at = hand.grasp_pose(before_it.grasp(grasp.choices[move.grasp]), move.turn_deg)
        pick, lifted = hand.pick_way(at, move.tops)
        place, leave = hand.place_way(hand.release_pose(at, move.carry), hand.hang_mm(at), move.tops)
        way = [before, pick.above, pick.at, lifted, place.above, place.at, leave.above]
        if hand.looks_between or number == len(made.moves):
            way += [replace(leave.above, z_mm=max(hand.observe.z_mm, leave.above.z_mm)), hand.observe]
        if why := access.why_not_way(way):
            raise AlarmError(Alarm.PLAN_INFEASIBLE, f"Move {number}, workpiece {move.workpiece}: {why} on the way.")
        carried[move.workpiece] = before_it.then(move.carry)
        before = way[-1]
