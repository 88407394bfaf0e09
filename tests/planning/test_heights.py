"""The third dimension: what stands lower than the fingers, under the palm, under the way; what the arm cannot reach."""

import dataclasses
import itertools

import numpy as np
import pytest

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.geometry import Xyzwpr
from srvs_cell.planning import (
    CellPlan,
    FingerGeometry,
    HandMotion,
    LegTops,
    PlanningParameters,
    Problem,
    Workspace,
    plan_relocation,
    table_problem,
    validate,
)
from srvs_cell.planning.arm import ArmParameters
from srvs_cell.planning.clearance import conflict_table
from srvs_cell.planning.legs import leg_tops
from srvs_cell.planning.validator import validate_legs
from srvs_cell.scene import UNKNOWN_KIND, Move, Place, PlaceKind, PlanStatus, Workpiece
from tests.planning.problems import workpiece

WORKSPACE = Workspace(300.0, 700.0, -250.0, 250.0)
PARAMETERS = PlanningParameters(home_mm=(450.0, 0.0), unknown_height_mm=120.0)
HAND = HandMotion(
    table_z_mm=0.0,
    clearance_mm=30.0,
    approach_mm=60.0,
    release_gap_mm=1.0,
    jaw_axis="y",
    observe=Xyzwpr(450.0, 0.0, 400.0, 180.0, 0.0, 0.0),
    z_mm=(0.0, 500.0),
    travel_speed_mm_s=250.0,
    approach_speed_mm_s=80.0,
)
ARM = ArmParameters(
    a1_mm=150.0,
    a2_mm=-200.0,
    c2_mm=600.0,
    c3_mm=640.0,
    c4_mm=100.0,
    offsets_deg=(0.0, 0.0, -90.0, 0.0, 0.0, 180.0),
    flipped_axes=(False, False, True, True, True, True),
    joint_limits_deg=(
        (-180.0, 180.0),
        (-90.0, 160.0),
        (-180.0, 264.0),
        (-190.0, 190.0),
        (-190.0, 190.0),
        (-360.0, 360.0),
    ),
    tool_xyz_mm=(0.0, 0.0, 240.0),
)


def _plan(parts: list[Workpiece], **changes: object) -> CellPlan:
    parameters = dataclasses.replace(PARAMETERS, **changes)  # type: ignore[arg-type]
    return plan_relocation(parts, parameters, WORKSPACE, hand=HAND)


@pytest.mark.parametrize(("height_mm", "hand", "free"), [(20.0, HAND, True), (60.0, HAND, False), (20.0, None, False)])
def test_fingers_come_down_above_a_low_neighbour(height_mm: float, hand: HandMotion | None, free: bool) -> None:
    # The grasp is at half of 60 mm: the tips are 30 mm above the table, less the clearance of 5 mm.
    parts = [workpiece(0, (450, 0), 60), workpiece(1, (450, 42), height_mm)]
    problem = table_problem(parts, PARAMETERS, WORKSPACE, hand=hand).problem
    aside = Place(len(problem.places), 600.0, -200.0, PlaceKind.BUFFER)
    problem = dataclasses.replace(problem, places=(*problem.places, aside))
    refusal = validate(problem, [Move(0, 0, aside.id)])
    assert any("gripper_blocked" in line for line in refusal) is not free
    assert (conflict_table(problem).grip_blocked_by[0][0][0] == 0) is free


def test_a_high_neighbour_stands_in_the_way_of_the_palm() -> None:
    def made(length_mm: float) -> Problem:
        fingers = FingerGeometry(length_mm=length_mm, palm_mm=(120.0, 60.0))
        parts = [workpiece(0, (450, 0), 30), workpiece(1, (495, 0), 100)]
        parameters = dataclasses.replace(PARAMETERS, fingers=fingers)
        return table_problem(parts, parameters, WORKSPACE, hand=HAND).problem

    # The tips grip 15 mm above the table: with fingers of 80 mm the palm would be lower than the neighbour's top.
    for length_mm, free in ((80.0, False), (100.0, True)):
        problem = made(length_mm)
        aside = Place(len(problem.places), 600.0, -200.0, PlaceKind.BUFFER)
        problem = dataclasses.replace(problem, places=(*problem.places, aside))
        assert any("gripper_blocked" in line for line in validate(problem, [Move(0, 0, aside.id)])) is not free
        assert (conflict_table(problem).grip_blocked_by[0][0][0] == 0) is free


def test_each_leg_passes_above_what_is_under_it_and_no_more() -> None:
    parts = [workpiece(0, (450, -100), 60), workpiece(1, (450, 100), 20), workpiece(2, (650, -240), 110, refusal="no")]
    answer = _plan(parts)
    top = {0: 60.0 + 3 * 0.1**0.5, 1: 20.0 + 3 * 0.1**0.5}
    first, *_, last = answer.moves
    # The first leg comes from the observe pose, above everything.
    assert first.tops.to_pick_mm == pytest.approx(110.0 + 3 * 0.1**0.5)
    assert last.tops.away_mm == pytest.approx(top[last.workpiece])
    assert all(move.tops.carried_mm <= max(top.values()) + 1e-9 for move in answer.moves)
    for before, after in zip(answer.moves, answer.moves[1:], strict=False):
        assert before.tops.away_mm == after.tops.to_pick_mm


def test_what_stands_in_the_middle_is_passed_above_unless_it_is_carried() -> None:
    parts = [workpiece(0, (450, -100), 60), workpiece(1, (450, 0), 110, refusal="no"), workpiece(2, (450, 100), 20)]
    problem = _plan(parts).table.problem
    count = len(problem.places)
    ends = (Place(count, 450.0, 200.0, PlaceKind.BUFFER), Place(count + 1, 650.0, -200.0, PlaceKind.BUFFER))
    problem = dataclasses.replace(problem, places=(*problem.places, *ends))
    across, aside = (leg_tops(problem, [Move(0, 0, count + n)], looks_between=False)[0] for n in (0, 1))
    assert across.carried_mm == pytest.approx(110.0 + 3 * 0.1**0.5)
    assert aside.carried_mm == 0.0
    assert aside.away_mm == pytest.approx(60.0 + 3 * 0.1**0.5)


def test_the_validator_refuses_a_leg_that_is_too_low() -> None:
    answer = _plan([workpiece(0, (450, -100), 60), workpiece(1, (450, 100), 20)])
    problem, moves = answer.table.problem, answer.relocation.moves
    tops = [move.tops for move in answer.moves]
    assert validate_legs(problem, moves, tops, looks_between=False) == []
    for number, leg in itertools.product(range(len(moves)), ("to_pick_mm", "carried_mm", "away_mm")):
        changed = list(tops)
        changed[number] = dataclasses.replace(tops[number], **{leg: getattr(tops[number], leg) - 1.0})
        under_nothing = getattr(tops[number], leg) == 0.0
        first = (number, leg) == (0, "to_pick_mm")  # comes from the observe pose, above more than is under it
        assert under_nothing or first or validate_legs(problem, moves, changed, looks_between=False)


def test_a_hand_that_looks_after_every_move_comes_from_above_everything_and_leaves_straight_up() -> None:
    parts = [workpiece(0, (450, -100), 60), workpiece(1, (450, 100), 110), workpiece(2, (600, 200), 20)]
    looking = dataclasses.replace(HAND, looks_between=True)
    problem, moves = _plan(parts).table.problem, _plan(parts).relocation.moves
    answer = plan_relocation(parts, PARAMETERS, WORKSPACE, hand=looking)
    assert len(answer.moves) > 1
    assert [move.tops.to_pick_mm for move in answer.moves] == pytest.approx([110.0 + 3 * 0.1**0.5] * len(answer.moves))
    tops = leg_tops(problem, moves, looks_between=True)
    assert validate_legs(problem, moves, tops, looks_between=True) == []
    for number, height in enumerate(tops):
        lower = [*tops[:number], dataclasses.replace(height, away_mm=height.away_mm - 1.0), *tops[number + 1 :]]
        assert validate_legs(problem, moves, lower, looks_between=True)


def test_a_part_of_unknown_shape_is_taken_for_as_high_as_any() -> None:
    parts = [workpiece(0, (450, -100), 60), workpiece(1, (600, 200), 20, kind=UNKNOWN_KIND)]
    assert _plan(parts).above_all == LegTops(120.0, 120.0, 120.0)
    assert _plan(parts, unknown_height_mm=10.0).above_all.carried_mm == pytest.approx(60.0 + 3 * 0.1**0.5)


def test_a_height_is_taken_at_three_sigma() -> None:
    vague = dataclasses.replace(workpiece(0, (450, 0), 60), covariance_mm2=np.diag([0.1, 0.1, 25.0]))
    assert _plan([vague]).above_all.carried_mm == pytest.approx(75.0)


def test_what_is_out_of_reach_says_by_how_much() -> None:
    parts = [workpiece(0, (450, -100), 60), workpiece(1, (450, 100), 20)]
    far = dataclasses.replace(ARM, base_xyz_mm=(930.0, 0.0, 0.0))
    answer = _plan(parts, arm=far).relocation
    assert answer.status is PlanStatus.INFEASIBLE
    assert answer.reasons[0].endswith("cannot be gripped on place 0 (450.0, -100.0): out of reach by 46 mm")


def test_a_joint_limit_is_named_and_got_round_where_that_is_possible() -> None:
    parts = [workpiece(0, (450, -100), 60), workpiece(1, (450, 100), 20)]
    narrow = dataclasses.replace(ARM, joint_limits_deg=((-12.0, 12.0), *ARM.joint_limits_deg[1:]))
    answer = _plan(parts, arm=narrow).relocation
    assert "cannot be gripped on place 0 (450.0, -100.0): joint 1 beyond its limit by 1.5 deg" in answer.reasons[0]
    wide = dataclasses.replace(ARM, joint_limits_deg=((-13.6, 13.6), *ARM.joint_limits_deg[1:]))
    made = _plan(parts, arm=wide)
    assert made.relocation.status is PlanStatus.SOLVED
    (buffer_mm,) = made.buffers_mm
    assert abs(np.rad2deg(np.arctan2(buffer_mm[1], buffer_mm[0]))) <= 13.6 - 1.0


def test_a_way_above_the_workspace_is_refused_beforehand() -> None:
    parts = [workpiece(0, (450, -100), 60), workpiece(1, (450, 100), 20)]
    low = dataclasses.replace(HAND, z_mm=(0.0, 100.0), observe=dataclasses.replace(HAND.observe, z_mm=95.0))
    with pytest.raises(AlarmError) as caught:
        plan_relocation(parts, PARAMETERS, WORKSPACE, hand=low)
    assert caught.value.alarm is Alarm.PLAN_INFEASIBLE
    assert "is outside the workspace's 0 to 100 mm on the way" in caught.value.detail
