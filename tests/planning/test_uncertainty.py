"""Room for three sigma: gaps that are narrower count as blocked, and the plan says so."""

import dataclasses

import numpy as np
import pytest

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.planning import FingerGeometry, PlanningParameters, Polygon, Workspace, plan_relocation
from srvs_cell.planning.clearance import signed_distance_mm
from srvs_cell.planning.uncertainty import finger_growth_mm, footprint_growth_mm, grown, sigma_mm
from srvs_cell.scene import PlanStatus, Workpiece
from tests.planning.problems import workpiece

WORKSPACE = Workspace(300.0, 700.0, -250.0, 250.0)
PARAMETERS = PlanningParameters(
    home_mm=(450.0, 0.0), fingers=FingerGeometry(thickness_mm=4.0, width_mm=8.0, clearance_mm=3.0)
)


def _known_to(part: Workpiece, sigma: float) -> Workpiece:
    return dataclasses.replace(part, covariance_mm2=np.diag([sigma**2, 0.01, 0.01]))


def test_the_worst_direction_counts() -> None:
    part = dataclasses.replace(workpiece(0, (0, 0), 20), covariance_mm2=np.array([[2.0, 1.0, 0], [1, 2, 0], [0, 0, 9]]))
    assert sigma_mm(part) == pytest.approx(3.0**0.5)


def test_the_clearance_already_holds_some_of_it() -> None:
    assert footprint_growth_mm(_known_to(workpiece(0, (0, 0), 20), 0.5), 5.0) == 0.0
    assert footprint_growth_mm(_known_to(workpiece(0, (0, 0), 20), 2.0), 5.0) == pytest.approx(3.5)


def test_fingers_hold_three_sigma_of_both() -> None:
    mine, other = _known_to(workpiece(0, (0, 0), 20), 0.3), _known_to(workpiece(1, (50, 0), 20), 0.4)
    assert finger_growth_mm(mine, [mine, other]) == pytest.approx(1.5)


def test_a_grown_polygon_holds_everything_nearer_than_the_growth() -> None:
    square = Polygon(((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)))
    points = np.random.default_rng(1).uniform(-8.0, 18.0, (500, 2))
    away = signed_distance_mm(points, np.array(square.vertices_mm))
    outside = signed_distance_mm(points, np.array(grown(square, 3.0).vertices_mm)) > 0.0
    assert not outside[away < 3.0].any()
    assert outside[away > 3.3].all()
    assert grown(square, 0.0) is square


def test_a_grasp_beside_an_uncertain_neighbour_is_blocked_and_that_is_said() -> None:
    # Gripped along y; a part that cannot be moved stands 5 mm behind the open finger.
    parts = [
        workpiece(0, (450, -100), 60),
        workpiece(1, (450, 100), 20),
        workpiece(2, (450, -68), 30, size_mm=(20, 10), refusal="too small"),
    ]
    assert plan_relocation(parts, PARAMETERS, WORKSPACE).relocation.status is PlanStatus.SOLVED
    vague = [parts[0], parts[1], _known_to(parts[2], 4.0)]
    with pytest.raises(AlarmError) as caught:
        plan_relocation(vague, PARAMETERS, WORKSPACE)
    assert caught.value.alarm is Alarm.UNCERTAIN_POSITION
    assert "Blocked by the vision's uncertainty" in caught.value.detail
    assert "workpiece 2 (cuboid, 30.0 mm high): its place is known to 12.0 mm (3 sigma) only" in caught.value.detail


def test_a_table_that_uncertainty_fills_up_is_said_to_be_that() -> None:
    narrow = Workspace(420.0, 560.0, -170.0, 170.0)
    parts = [workpiece(0, (450, -100), 60), workpiece(1, (450, 100), 20)]
    assert plan_relocation(parts, PARAMETERS, narrow).relocation.status is PlanStatus.SOLVED
    with pytest.raises(AlarmError) as caught:
        plan_relocation([_known_to(part, 30.0) for part in parts], PARAMETERS, narrow)
    assert caught.value.alarm is Alarm.UNCERTAIN_POSITION
    assert "no point of the workspace" in caught.value.detail


def test_a_covariance_that_is_not_finite_takes_no_room() -> None:
    part = dataclasses.replace(workpiece(0, (0, 0), 20), covariance_mm2=np.full((3, 3), np.nan))
    assert sigma_mm(part) == 0.0


def test_out_of_reach_says_by_how_much() -> None:
    parts = [workpiece(0, (450, -264), 60), workpiece(1, (450, 100), 20)]
    answer = plan_relocation(parts, PARAMETERS, WORKSPACE).relocation
    assert any(
        reason.startswith("workpiece 0") and reason.endswith("out of reach by 14 mm") for reason in answer.reasons
    )


@pytest.mark.parametrize(
    ("heights_mm", "sigma", "known"),
    [((66.1, 65.9), 3.7, False), ((66.1, 65.9), 0.5, True), ((90.0, 65.9), 3.7, True), ((66.1, 65.9), np.inf, False)],
)
def test_nothing_is_sorted_by_heights_that_do_not_tell_the_order(
    heights_mm: tuple[float, float], sigma: float, *, known: bool
) -> None:
    # 2 mm may stand in either order: parts of one height that are well known are sorted as they stand
    parts = [workpiece(0, (450, -100), heights_mm[0]), workpiece(1, (450, 100), heights_mm[1])]
    vague = dataclasses.replace(parts[0], covariance_mm2=np.diag([0.01, 0.01, sigma**2]))
    if known:
        assert plan_relocation([vague, parts[1]], PARAMETERS, WORKSPACE).relocation.status is PlanStatus.SOLVED
        return
    with pytest.raises(AlarmError) as caught:
        plan_relocation([vague, parts[1]], PARAMETERS, WORKSPACE)
    assert caught.value.alarm is Alarm.UNCERTAIN_POSITION
    assert "workpieces 0 (66.1 mm) and 1 (65.9 mm)" in caught.value.detail


def test_a_part_that_is_not_sorted_needs_no_known_height() -> None:
    parts = [
        workpiece(0, (450, -100), 60),
        workpiece(1, (450, 100), 20),
        workpiece(2, (600, 0), 30, size_mm=(20, 10), refusal="too small"),
    ]
    vague = dataclasses.replace(parts[2], covariance_mm2=np.diag([0.01, 0.01, 25.0]))
    assert plan_relocation([*parts[:2], vague], PARAMETERS, WORKSPACE).relocation.status is PlanStatus.SOLVED
