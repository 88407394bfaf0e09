"""The cell's own problem: slots from perceived workpieces, ties, obstacles, fingers, a buffer place found."""

import dataclasses
import math

import numpy as np
import pytest

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.planning import (
    CellPlan,
    FingerGeometry,
    HeightOrder,
    PlanningParameters,
    RankGoal,
    Workspace,
    footprint_centroid_mm,
    plan_relocation,
    table_problem,
    validate,
)
from srvs_cell.scene import UNKNOWN_KIND, PlanStatus
from tests.planning.problems import workpiece

WORKSPACE = Workspace(300.0, 700.0, -250.0, 250.0)
PARAMETERS = PlanningParameters(home_mm=(450.0, 0.0))


def _goal_of(answer: CellPlan) -> dict[int, tuple[float, float]]:
    return {goal.workpiece: goal.point_mm for goal in answer.goals}


def test_the_highest_goes_to_the_largest_y() -> None:
    parts = [workpiece(3, (450, -100), 60), workpiece(5, (450, 0), 40), workpiece(8, (450, 100), 20)]
    answer = plan_relocation(parts, PARAMETERS, WORKSPACE)
    assert answer.relocation.status is PlanStatus.SOLVED
    goals = _goal_of(answer)
    assert goals[3] == pytest.approx((450, 100))
    assert goals[5] == pytest.approx((450, 0))
    assert goals[8] == pytest.approx((450, -100))
    assert [move.workpiece for move in answer.moves] in ([3, 8, 3], [8, 3, 8])
    assert answer.moves[0].to_mm == answer.buffers_mm[0] == answer.moves[2].from_mm


def test_the_buffer_place_is_clear_inside_and_near() -> None:
    parts = [workpiece(0, (450, -100), 60, yaw_deg=30), workpiece(1, (500, 60), 20, yaw_deg=-20)]
    answer = plan_relocation(parts, PARAMETERS, WORKSPACE)
    (buffer_mm,) = answer.buffers_mm
    assert WORKSPACE.contains(*buffer_mm)
    assert all(math.dist(buffer_mm, part.position_mm[:2]) > 40 for part in parts)
    # A detour through it is hardly longer than the straight way between the two slots.
    straight_mm = math.dist((450, -100), (500, 60))
    assert math.dist((450, -100), buffer_mm) + math.dist(buffer_mm, (500, 60)) < straight_mm + 20
    assert validate(answer.table.problem, answer.relocation.moves) == []


def test_parts_in_order_stay_and_need_no_buffer_place() -> None:
    full = Workspace(420.0, 480.0, -60.0, 60.0)
    parts = [workpiece(0, (450, 40), 60), workpiece(1, (450, -40), 20)]
    answer = plan_relocation(parts, PARAMETERS, full)
    assert not answer.moves
    assert not answer.buffers_mm
    assert _goal_of(answer)[0] == pytest.approx((450, 40))


def test_heights_within_the_tolerance_may_stand_in_either_order() -> None:
    parts = [workpiece(0, (450, 100), 38.5), workpiece(1, (450, -100), 40.0)]
    assert plan_relocation(parts, PARAMETERS, WORKSPACE).moves == ()
    strict = PlanningParameters(home_mm=(450.0, 0.0), height_tolerance_mm=1.0)
    assert len(plan_relocation(parts, strict, WORKSPACE).moves) == 3


def test_equal_y_is_decided_by_the_smaller_x() -> None:
    points = [(500.0, 1.0), (400.0, 0.0), (300.0, 9.0)]
    assert HeightOrder(place_tolerance_mm=3.0).order(points) == (2, 1, 0)
    assert HeightOrder(place_tolerance_mm=0.5).order(points) == (2, 0, 1)
    assert HeightOrder(place_tolerance_mm=3.0, left_first=False).order(points) == (2, 0, 1)


def test_a_chain_of_small_steps_is_not_one_group() -> None:
    points = [(500.0 - 100 * i, -2.0 * i) for i in range(3)]
    assert HeightOrder(place_tolerance_mm=3.0).order(points) == (1, 0, 2)


def test_a_full_table_has_no_buffer_place() -> None:
    small = Workspace(420.0, 480.0, -60.0, 60.0)
    parts = [workpiece(0, (450, -40), 60), workpiece(1, (450, 40), 20)]
    with pytest.raises(AlarmError) as caught:
        table_problem(parts, PARAMETERS, small)
    assert caught.value.alarm is Alarm.NO_BUFFER_PLACE
    assert "x 420 to 480 mm" in caught.value.detail
    assert "workpiece 0" in caught.value.detail
    assert "workpiece 1" in caught.value.detail


def test_a_configured_buffer_place_is_used() -> None:
    configured = PlanningParameters(home_mm=(450.0, 0.0), buffer_places_mm=((350.0, 0.0),))
    parts = [workpiece(0, (450, -100), 60), workpiece(1, (450, 100), 20)]
    answer = plan_relocation(parts, configured, WORKSPACE)
    assert answer.buffers_mm == ((350.0, 0.0),)
    assert answer.moves[0].to_mm == (350.0, 0.0)


def test_what_cannot_be_taken_is_an_obstacle_and_is_named() -> None:
    parts = [
        workpiece(0, (450, -100), 60),
        workpiece(1, (450, 100), 20),
        workpiece(2, (450, 0), 80, kind=UNKNOWN_KIND),
        workpiece(3, (550, 0), 90, refusal="wider than the gripper opens"),
    ]
    answer = plan_relocation(parts, PARAMETERS, WORKSPACE)
    assert answer.relocation.status is PlanStatus.SOLVED
    assert answer.table.workpieces == (0, 1)
    assert answer.table.static == (2, 3)
    assert set(_goal_of(answer)) == {0, 1}
    assert "workpiece 2 (unknown, 80.0 mm high) stays where it is: its shape is in no library" in (
        answer.relocation.reasons
    )
    assert any("wider than the gripper opens" in reason for reason in answer.relocation.reasons)
    assert all(math.dist(answer.buffers_mm[0], part.position_mm[:2]) > 35 for part in parts)


def test_a_part_out_of_the_workspace_is_out_of_reach() -> None:
    parts = [workpiece(0, (450, -300), 60), workpiece(1, (450, 100), 20)]
    answer = plan_relocation(parts, PARAMETERS, WORKSPACE)
    assert answer.relocation.status is PlanStatus.INFEASIBLE
    assert not answer.goals
    assert not answer.moves
    assert any(reason.startswith("workpiece 0") and "out of reach" in reason for reason in answer.relocation.reasons)


def test_fingers_that_a_static_neighbour_blocks_make_it_infeasible() -> None:
    # Gripped along y; something that cannot be moved stands where a finger must come down.
    parts = [
        workpiece(0, (450, -100), 60),
        workpiece(1, (450, 100), 20),
        workpiece(2, (450, -70), 30, size_mm=(20, 10), refusal="too small"),
    ]
    answer = plan_relocation(parts, PARAMETERS, WORKSPACE)
    assert answer.relocation.status is PlanStatus.INFEASIBLE
    assert any("(450.0, -70.0) is in the way of the hand" in reason for reason in answer.relocation.reasons)
    slim = PlanningParameters(
        home_mm=(450.0, 0.0), fingers=FingerGeometry(thickness_mm=4.0, width_mm=8.0, clearance_mm=3.0)
    )
    assert plan_relocation(parts, slim, WORKSPACE).relocation.status is PlanStatus.SOLVED


def test_a_movable_neighbour_in_the_way_of_the_fingers_leaves_first() -> None:
    # Part 2 belongs where it stands, but part 0 cannot be gripped beside it.
    parts = [
        workpiece(0, (450, -100), 60, yaw_deg=90),
        workpiece(1, (450, 150), 20, yaw_deg=90),
        workpiece(2, (490, -100), 40, size_mm=(40, 20)),
    ]
    answer = plan_relocation(parts, PARAMETERS, WORKSPACE)
    assert answer.relocation.status is PlanStatus.SOLVED
    assert len(answer.moves) > 3
    assert answer.moves[0].workpiece != 0


def test_a_part_keeps_its_yaw_where_it_is_put() -> None:
    # A long part turned by 90 degrees does not fit between two neighbours where its predecessor did.
    long_mm = (90.0, 20.0)
    parts = [
        workpiece(0, (450, 0), 20, yaw_deg=0, size_mm=long_mm),
        workpiece(1, (450, 40), 40, yaw_deg=0, size_mm=long_mm),
        workpiece(2, (450, -150), 30, yaw_deg=90, size_mm=long_mm),
        workpiece(3, (450, -40), 10, yaw_deg=0, size_mm=long_mm),
    ]
    answer = plan_relocation(
        parts,
        PlanningParameters(home_mm=(450.0, 0.0), fingers=FingerGeometry(thickness_mm=2.0, clearance_mm=1.0)),
        WORKSPACE,
    )
    assert answer.relocation.status is PlanStatus.INFEASIBLE
    assert any("workpiece 2" in reason and "does not fit" in reason for reason in answer.relocation.reasons)


def test_no_workpieces_is_a_plan_without_moves() -> None:
    answer = plan_relocation([], PARAMETERS, WORKSPACE)
    assert answer.relocation.status is PlanStatus.SOLVED
    assert not answer.goals
    assert not answer.moves


def test_the_reference_point_is_the_footprints_centroid() -> None:
    wedge_seen_whole = np.array([[0.0, 0.0], [30.0, 0.0], [0.0, 30.0]])
    assert footprint_centroid_mm(wedge_seen_whole) == pytest.approx((10.0, 10.0))
    assert footprint_centroid_mm(np.array([[1.0, 2.0], [3.0, 4.0]])) == pytest.approx((2.0, 3.0))


def test_slots_are_ranked_by_y() -> None:
    parts = [workpiece(0, (450, -100), 60), workpiece(1, (450, 100), 20)]
    assert table_problem(parts, PARAMETERS, WORKSPACE).problem.goal == RankGoal((1, 0), 2.0)


@pytest.mark.parametrize(
    ("fingers", "outer_mm"),
    [
        (FingerGeometry(thickness_mm=10.0, clearance_mm=8.0), 15.0 + 8.0 + 10.0),
        (FingerGeometry(thickness_mm=10.0, clearance_mm=8.0, open_mm=84.0), 42.0 + 10.0),
    ],
)
def test_fingers_need_the_room_from_closed_to_open(fingers: FingerGeometry, outer_mm: float) -> None:
    parameters = PlanningParameters(fingers=fingers)
    (item,) = table_problem([workpiece(0, (450, 0), 60)], parameters, WORKSPACE, exact=True).problem.objects
    (grip,) = item.grips
    assert grip.inner_mm == 15.0
    assert grip.inner_mm + grip.thick_mm == outer_mm
    assert grip.yaw_deg == 90.0


def test_the_found_buffer_place_is_where_the_whole_plan_is_shortest() -> None:
    parts = [workpiece(i, (400.0 + 70.0 * i, (-1) ** i * 100.0), 20.0 + 10.0 * i) for i in range(4)]
    answer = plan_relocation(parts, PARAMETERS, WORKSPACE)
    (found_mm,) = answer.buffers_mm
    first = table_problem(parts, PARAMETERS, WORKSPACE).problem
    as_found = plan_relocation(
        parts,
        dataclasses.replace(PARAMETERS, buffer_places_mm=((first.places[-1].x_mm, first.places[-1].y_mm),)),
        WORKSPACE,
    )
    assert answer.relocation.travel_mm <= as_found.relocation.travel_mm
    around = [(found_mm[0] + dx, found_mm[1] + dy) for dx in (-50.0, 0.0, 50.0) for dy in (-50.0, 0.0, 50.0)]
    for point in around:
        other = plan_relocation(parts, dataclasses.replace(PARAMETERS, buffer_places_mm=(point,)), WORKSPACE)
        if other.relocation.moves and len(other.moves) == len(answer.moves):
            assert answer.relocation.travel_mm <= other.relocation.travel_mm * 1.05
