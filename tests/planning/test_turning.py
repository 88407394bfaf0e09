"""Parts that are put down turned: rules, conflicts, validator, arm and time agree on how they stand."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from srvs_cell.planning import (
    AssignGoal,
    Carry,
    CellPlan,
    FingerGrip,
    HeightOrder,
    NominalPlace,
    Polygon,
    PositionCorrection,
    Problem,
    ProblemObject,
    Rule,
    footprint_centroid_mm,
    plan,
    plan_relocation,
    plan_svg,
    validate,
)
from srvs_cell.planning.carrying import turn_to_deg, turned, turned_deg
from srvs_cell.planning.clearance import conflict_table
from srvs_cell.planning.timing import cell_timing
from srvs_cell.scene import Move, Place, PlaceKind, PlanStatus, Workpiece
from tests.planning.problems import workpiece
from tests.planning.test_heights import ARM, HAND, PARAMETERS, WORKSPACE

ANGLE = st.floats(-180.0, 180.0)
COORDINATE = st.floats(-60.0, 60.0)


def _plan(parts: list[Workpiece], rule: Rule, **changes: object) -> CellPlan:
    parameters = dataclasses.replace(PARAMETERS, **changes)  # type: ignore[arg-type]
    hand = dataclasses.replace(HAND, looks_between=True)
    return plan_relocation(parts, parameters, WORKSPACE, rule, hand=hand)


@pytest.mark.parametrize(
    ("size_mm", "seen_deg", "wanted_deg", "turn_deg"),
    [((40, 30), 10.0, 170.0, -20.0), ((40, 30), 10.0, 80.0, 70.0), ((31, 30), 10.0, 80.0, -20.0)],
)
def test_a_part_is_turned_by_the_least_that_looks_the_same(
    size_mm: tuple[float, float], seen_deg: float, wanted_deg: float, turn_deg: float
) -> None:
    part = workpiece(0, (450, 0), 60, size_mm=size_mm, yaw_deg=seen_deg)
    assert turn_to_deg(part, wanted_deg) == pytest.approx(turn_deg)
    assert turn_to_deg(dataclasses.replace(part, yaw_deg=None), wanted_deg) == 0.0


def _wedge(number: int, xy_mm: tuple[float, float], rise_deg: float, **more: float) -> Workpiece:
    part = workpiece(number, xy_mm, 60, yaw_deg=rise_deg % 180.0, kind="wedge", **more)  # type: ignore[arg-type]
    return dataclasses.replace(part, rise_deg=rise_deg)


@pytest.mark.parametrize(
    ("rise_deg", "wanted_deg", "turn_deg"), [(10.0, 190.0, 180.0), (350.0, 10.0, 20.0), (100.0, -90.0, 170.0)]
)
def test_an_inclined_part_is_turned_until_it_rises_where_it_should(
    rise_deg: float, wanted_deg: float, turn_deg: float
) -> None:
    part = _wedge(0, (450, 0), rise_deg)
    assert abs(turn_to_deg(part, wanted_deg)) == pytest.approx(turn_deg)
    put_down = turned(part, turn_to_deg(part, wanted_deg))
    assert turned_deg(put_down, dataclasses.replace(part, rise_deg=wanted_deg)) == pytest.approx(0.0)
    # Where one of two looks has not seen the slope, both are compared as level parts are.
    assert turned_deg(part, dataclasses.replace(part, rise_deg=None, yaw_deg=rise_deg + 180.0)) == pytest.approx(0.0)


def test_a_wedge_that_stands_the_wrong_way_round_is_put_back() -> None:
    places = (NominalPlace(kind="wedge", x_mm=450.0, y_mm=0.0, yaw_deg=30.0),)
    rule = PositionCorrection(places=places)
    assert _plan([_wedge(0, (450, 0), 31.0)], rule).moves == ()
    made = _plan([_wedge(0, (450, 0), 211.0)], rule)
    assert [abs(round(move.turn_deg)) for move in made.moves if move.turn_deg] == [179]


def test_a_carry_moves_the_footprint_and_the_grasp_alike() -> None:
    before = workpiece(0, (450, 0), 60, yaw_deg=10.0)
    after = workpiece(0, (500, 80), 60, yaw_deg=55.0)
    assert before.grasp is not None
    assert after.grasp is not None
    carry = Carry((450.0, 0.0), (500.0, 80.0), 45.0)
    moved = [carry.point((float(x), float(y))) for x, y in before.footprint_mm]
    assert np.array(moved) == pytest.approx(after.footprint_mm)
    assert carry.grasp(before.grasp).position_mm == pytest.approx(after.grasp.position_mm)
    assert carry.grasp(before.grasp).yaw_deg == pytest.approx(after.grasp.yaw_deg)
    assert Carry((0.0, 0.0), (450.0, 0.0), 5.0).then(carry) == Carry((0.0, 0.0), (500.0, 80.0), 50.0)


def _pair(turn_deg: float, at_mm: tuple[float, float], other_turn_deg: float) -> Problem:
    """Return an oblong that is to be put down turned beside another one, which itself may be turned."""
    grip = FingerGrip("across", (4.0, 0.0), 90.0, 15.0, 12.0, 16.0)
    oblong = Polygon(((-30.0, -10.0), (30.0, -10.0), (30.0, 10.0), (-30.0, 10.0)))
    places = [(300.0, 0.0), (0.0, 0.0), (600.0, 0.0), at_mm]
    return Problem(
        id="pair",
        places=tuple(Place(i, *point, PlaceKind.SLOT) for i, point in enumerate(places)),
        objects=(
            ProblemObject(0, 30.0, oblong, 0, (grip,), "moved", turns_deg=((1, turn_deg),)),
            ProblemObject(1, 30.0, oblong, 2, (grip,), "other", turns_deg=((3, other_turn_deg),)),
        ),
        obstacles=(),
        goal=AssignGoal((frozenset({1}), frozenset({3})), frozenset()),
        home_mm=(0.0, 0.0),
        clearance_mm=3.0,
    )


@given(turn_deg=ANGLE, x_mm=COORDINATE, y_mm=COORDINATE, other_turn_deg=ANGLE)
@settings(max_examples=300, deadline=None)
def test_the_conflict_table_and_the_validator_agree_on_turned_parts(
    turn_deg: float, x_mm: float, y_mm: float, other_turn_deg: float
) -> None:
    problem = _pair(turn_deg, (x_mm, y_mm), other_turn_deg)
    table = conflict_table(problem)
    standing = table.bit(1, 3)
    refused = validate(problem, [Move(1, 2, 3), Move(0, 0, 1)])
    assert bool(table.blocked_by[0][1] & standing) is any("footprint_conflict" in line for line in refused)
    if not table.blocked_by[0][1] & standing:
        assert bool(table.grip_blocked_by[0][1][0] & standing) is any("gripper_blocked" in line for line in refused)


def test_a_turned_part_fits_where_it_would_not_as_it_stood() -> None:
    assert validate(_pair(0.0, (0.0, 24.0), 0.0), [Move(1, 2, 3), Move(0, 0, 1)]) != []
    # Both upright, side by side along x.
    assert validate(_pair(90.0, (42.0, 0.0), 90.0), [Move(1, 2, 3), Move(0, 0, 1)]) == []
    assert validate(_pair(0.0, (42.0, 0.0), 90.0), [Move(1, 2, 3), Move(0, 0, 1)]) != []


def test_position_correction_turns_a_part_where_it_stands() -> None:
    rule = PositionCorrection(places=(NominalPlace(kind="cuboid", x_mm=450.0, y_mm=0.0, yaw_deg=30.0),))
    assert _plan([workpiece(0, (450, 0), 60, yaw_deg=27.0)], rule).moves == ()
    (move,) = _plan([workpiece(0, (450, 0), 60, yaw_deg=175.0)], rule).moves
    assert move.to_mm == (450.0, 0.0)
    assert move.turn_deg == pytest.approx(35.0)
    round_one = dataclasses.replace(workpiece(0, (450, 0), 60), kind="cuboid", yaw_deg=None)
    assert _plan([round_one], rule).moves == ()


def test_a_taught_yaw_that_has_no_room_is_refused_and_another_has() -> None:
    parts = [workpiece(0, (600, 200), 60, size_mm=(80, 20)), workpiece(1, (450, 48), 60, kind="other", refusal="no")]

    def answer(yaw_deg: float) -> CellPlan:
        place = NominalPlace(kind="cuboid", x_mm=450.0, y_mm=0.0, yaw_deg=yaw_deg)
        return _plan([parts[0], parts[1]], PositionCorrection(places=(place,)))

    assert answer(90.0).relocation.status is PlanStatus.INFEASIBLE
    assert answer(0.0).relocation.status is PlanStatus.SOLVED


def test_a_part_keeps_its_yaw_in_a_buffer_place_and_gets_the_rules_in_the_end() -> None:
    parts = [workpiece(0, (450, -100), 60, yaw_deg=20.0), workpiece(1, (450, 100), 20, yaw_deg=40.0)]
    made = _plan(parts, HeightOrder(yaw_deg=0.0))
    assert made.relocation.status is PlanStatus.SOLVED
    assert {goal.workpiece: goal.point_mm[1] for goal in made.goals} == pytest.approx({0: 100.0, 1: -100.0})
    turns_deg = {number: sum(m.turn_deg for m in made.moves if m.workpiece == number) for number in (0, 1)}
    assert turns_deg == pytest.approx({0: -20.0, 1: -40.0})
    assert [m.turn_deg for m in made.moves if m.to_mm in made.buffers_mm] == [0.0]
    assert plan_svg(made.table.problem, made.relocation.moves, "turned").count('class="end"') == 2


def test_without_a_turned_part_its_place_is_given_up() -> None:
    # The first stands beyond the arm's joints, so that nobody can take its place; without it the rest is in order.
    parts = [workpiece(0, (450, -200), 60, yaw_deg=30.0), workpiece(1, (450, 50), 50), workpiece(2, (450, 200), 20)]
    narrow = dataclasses.replace(ARM, joint_limits_deg=((-25.0, 25.0), *ARM.joint_limits_deg[1:]))
    made = _plan([parts[2], parts[1], parts[0]], HeightOrder(yaw_deg=0.0), arm=narrow)
    assert made.relocation.status is PlanStatus.SOLVED
    narrow = dataclasses.replace(ARM, joint_limits_deg=((-20.0, 25.0), *ARM.joint_limits_deg[1:]))
    refused = _plan(parts, HeightOrder(yaw_deg=0.0), arm=narrow).relocation
    assert refused.status is PlanStatus.INFEASIBLE
    assert any("workpiece 0" in line and "taken off the table" in line for line in refused.reasons)


def test_parts_in_order_and_at_the_rules_yaw_stay() -> None:
    parts = [workpiece(0, (450, 100), 60, yaw_deg=3.0), workpiece(1, (450, -100), 20, yaw_deg=178.0)]
    assert _plan(parts, HeightOrder(yaw_deg=0.0)).moves == ()
    (move,) = _plan(parts, HeightOrder(yaw_deg=180.0, tolerance_deg=2.5)).moves
    assert move.workpiece == 0
    assert move.turn_deg == pytest.approx(-3.0)


def test_the_wrists_limit_counts_where_the_part_is_put_down() -> None:
    # The observe pose stands in the middle of joint 6, and jaws along y grip a part of yaw 0 without any turn.
    parts = [workpiece(0, (450, 0), 60)]
    rule = PositionCorrection(places=(NominalPlace(kind="cuboid", x_mm=450.0, y_mm=150.0, yaw_deg=80.0),))
    assert _plan(parts, rule, arm=ARM).relocation.status is PlanStatus.SOLVED
    narrow = dataclasses.replace(ARM, joint_limits_deg=(*ARM.joint_limits_deg[:5], (-40.0, 40.0)))
    refused = _plan(parts, rule, arm=narrow).relocation
    assert refused.status is PlanStatus.INFEASIBLE
    assert "joint 6 beyond its limit" in refused.reasons[0]


def test_a_long_turn_between_two_moves_is_no_reason_to_refuse_a_plan() -> None:
    places = (
        NominalPlace(kind="cuboid", x_mm=450.0, y_mm=150.0, yaw_deg=130.0),
        NominalPlace(kind="wedge", x_mm=600.0, y_mm=150.0, yaw_deg=135.0),
    )
    # The second part takes the first one's place: the wrist comes from +130 deg and has to be at -130 deg.
    parts = [workpiece(0, (600, 150), 60, yaw_deg=45.0), workpiece(1, (600, -150), 60, kind="wedge", yaw_deg=50.0)]
    rule = PositionCorrection(places=places)
    straight = dataclasses.replace(HAND, looks_between=False)
    assert len(plan_relocation(parts, PARAMETERS, WORKSPACE, rule, hand=straight).moves) == 2
    # But the joints' limits hold all the way.
    narrow = dataclasses.replace(ARM, joint_limits_deg=(*ARM.joint_limits_deg[:5], (-100.0, 100.0)))
    refused = plan_relocation(parts, dataclasses.replace(PARAMETERS, arm=narrow), WORKSPACE, rule, hand=straight)
    assert refused.relocation.status is PlanStatus.INFEASIBLE
    assert "joint 6 beyond its limit" in "; ".join(refused.relocation.reasons)


def test_the_turn_takes_its_time() -> None:
    parts = [workpiece(0, (450, 0), 60)]
    turned = PositionCorrection(places=(NominalPlace(kind="cuboid", x_mm=450.0, y_mm=10.0, yaw_deg=80.0),))
    made = _plan(parts, turned, wrist_speed_deg_s=10.0)
    timing = cell_timing(made.table.problem, parts, dataclasses.replace(HAND, looks_between=True), PARAMETERS)
    (move,) = made.relocation.moves
    to_s, with_s, back_s = timing.turns_s[0][move.from_place][move.to_place]
    # The jaws stand right for the grasp; the part is turned on its way, and the hand back after it.
    assert to_s == 0.0
    assert with_s == pytest.approx(back_s)
    assert made.relocation.time_s is not None
    kept = _plan(parts, PositionCorrection(places=(NominalPlace(kind="cuboid", x_mm=450.0, y_mm=10.0),)))
    assert kept.relocation.time_s is not None
    assert made.relocation.time_s > kept.relocation.time_s + 8.0


@pytest.mark.parametrize("seed", range(5))
def test_many_parts_are_turned_on_their_way_too(seed: int) -> None:
    choose = np.random.default_rng(seed)
    points = [(60.0 * i, 60.0 * j) for i in range(4) for j in range(3)]
    order = choose.permutation(12).tolist()
    oblong = Polygon(((-24.0, -8.0), (24.0, -8.0), (24.0, 8.0), (-24.0, 8.0)))
    places = [Place(i, *point, PlaceKind.SLOT) for i, point in enumerate(points)]
    places += [Place(12 + i, x + 6.0, y, PlaceKind.SLOT) for i, (x, y) in enumerate(points)]
    places += [Place(24 + i, 400.0 + 100.0 * i, 300.0, PlaceKind.BUFFER) for i in range(4)]
    problem = Problem(
        id="turned",
        places=tuple(places),
        objects=tuple(
            ProblemObject(
                i, 30.0, oblong, i, (), f"object {i}", turns_deg=((12 + order[i], float(choose.uniform(-90, 90))),)
            )
            for i in range(12)
        ),
        obstacles=(),
        goal=AssignGoal(tuple(frozenset({12 + order[i]}) for i in range(12)), frozenset()),
        home_mm=(0.0, -100.0),
        clearance_mm=2.0,
    )
    answer = plan(problem)
    assert math.isfinite(answer.travel_mm)
    if answer.moves:
        assert validate(problem, answer.moves) == []
    else:
        assert answer.status is PlanStatus.INFEASIBLE


def test_the_centroid_stays_on_the_place_however_a_part_is_turned() -> None:
    part = workpiece(0, (450, 0), 60)
    rule = PositionCorrection(places=(NominalPlace(kind="cuboid", x_mm=500.0, y_mm=50.0, yaw_deg=60.0),))
    (move,) = _plan([part], rule).moves
    moved = np.array([move.carry.point((float(x), float(y))) for x, y in part.footprint_mm])
    assert footprint_centroid_mm(moved) == pytest.approx((500.0, 50.0))
