"""Nothing is put where no look would see it: buffer places, goals; a bin is not looked at."""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.planning import CellPlan, ElementChange, HeightOrder, PlanningParameters, Workspace, plan_relocation
from srvs_cell.scene import PlanStatus, Workpiece
from tests.planning.problems import workpiece
from tests.planning.test_heights import HAND, PARAMETERS

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Below:
    """A view that ends at an x, nearer for what is high, and still nearer for a look from aside."""

    x_mm: float
    aside_mm: float = 15.0

    def sees(self, points_mm: Array, *, from_aside: bool) -> NDArray[np.bool_]:
        end_mm = self.x_mm - points_mm[..., 2] - (self.aside_mm if from_aside else 0.0)
        seen: NDArray[np.bool_] = points_mm[..., 0] <= end_mm
        return seen


def _plan(parts: list[Workpiece], x_mm: float, parameters: PlanningParameters = PARAMETERS) -> CellPlan:
    workspace = Workspace(300.0, 700.0, -250.0, 250.0, Below(x_mm))
    return plan_relocation(parts, parameters, workspace, hand=HAND)


def test_a_buffer_place_is_found_where_every_look_sees_the_part() -> None:
    parts = [workpiece(0, (400, -150), 60), workpiece(1, (400, 150), 20)]

    def farthest_mm(made: CellPlan) -> float:
        """Return how far the view must reach from aside for the part that waits: its side, and more by its height."""
        (buffer_mm,) = made.buffers_mm
        (waits,) = [move.workpiece for move in made.moves if move.to_mm == buffer_mm]
        return buffer_mm[0] + 20.0 + {0: 60.0, 1: 20.0}[waits] + 15.0

    wanted_mm = farthest_mm(_plan(parts, 5000.0))
    for end_mm in (wanted_mm + 5.0, wanted_mm - 5.0, wanted_mm - 10.0):
        assert farthest_mm(_plan(parts, end_mm)) <= end_mm


def test_without_any_place_in_view_the_refusal_says_so() -> None:
    with pytest.raises(AlarmError) as caught:
        _plan([workpiece(0, (450, -100), 60), workpiece(1, (450, 100), 20)], 300.0)
    assert caught.value.alarm is Alarm.NO_BUFFER_PLACE
    assert "is clear and in view of every look for any of" in caught.value.detail


def test_a_goal_that_no_look_would_see_is_refused_by_name() -> None:
    parts = [workpiece(0, (400, -100), 60), workpiece(1, (500, 100), 20)]
    assert _plan(parts, 590.0).relocation.status is PlanStatus.SOLVED
    answer = _plan(parts, 575.0).relocation
    assert answer.status is PlanStatus.INFEASIBLE
    assert any(
        "cannot be put down on place 1 (500.0, 100.0): no look would see it there" in line for line in answer.reasons
    )


def test_a_configured_buffer_place_is_not_for_a_part_that_would_not_be_seen_there() -> None:
    parts = [workpiece(0, (400, -100), 60), workpiece(1, (400, 100), 20)]
    beyond = dataclasses.replace(PARAMETERS, buffer_places_mm=((520.0, 0.0),))
    made = _plan(parts, 590.0, beyond)
    assert [move.workpiece for move in made.moves if move.to_mm == (520.0, 0.0)] == [1]


def test_a_bin_may_be_where_nobody_looks() -> None:
    rule = ElementChange(
        height_mm=(30.0, 100.0), bin_mm=(650.0, 0.0), substitute_kind="cuboid", stock_mm=((400, -200),)
    )
    parts = [workpiece(0, (400, 100), 20), workpiece(1, (400, -200), 60)]
    workspace = Workspace(300.0, 700.0, -250.0, 250.0, Below(520.0))
    made = plan_relocation(parts, PARAMETERS, workspace, rule, hand=HAND)
    assert [move.to_mm for move in made.moves] == [(650.0, 0.0), (400.0, 100.0)]


def test_where_a_part_stands_it_has_been_seen() -> None:
    parts = [workpiece(0, (600, 100), 60), workpiece(1, (400, -100), 20)]
    workspace = Workspace(300.0, 700.0, -250.0, 250.0, Below(520.0))
    assert plan_relocation(parts, PARAMETERS, workspace, HeightOrder(), hand=HAND).moves == ()
