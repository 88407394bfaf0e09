"""What a look says of where everything should stand."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from drivers.sim.doubles import Block, World
from srvs_cell.cell.expectation import Expected, compare
from srvs_cell.config import ToleranceParameters
from tests.cell.support import seen

if TYPE_CHECKING:
    from srvs_cell.scene import Point2, Workpiece

TOLERANCE = ToleranceParameters(verify_mm=5.0, verify_height_mm=8.0, verify_deg=10.0)


def part(
    x_mm: float, y_mm: float, height_mm: float = 40.0, *, yaw_deg: float = 0.0, width_mm: float = 30.0
) -> Workpiece:
    (workpiece,) = seen(World([Block("part", x_mm, y_mm, height_mm, width_mm=width_mm)])).workpieces
    return replace(workpiece, yaw_deg=yaw_deg, id=int(10 * height_mm))


def changes(
    expected: list[tuple[Workpiece, Point2]], looked: list[Workpiece], *, in_bin: bool = False
) -> tuple[str, ...]:
    return compare([Expected(*each, in_bin) for each in expected], looked, TOLERANCE).changes


def test_parts_within_the_tolerances_stand_as_expected() -> None:
    one, other = part(300.0, 0.0), part(400.0, 0.0, 60.0)
    expected = [Expected(one, (300.0, 0.0)), Expected(other, (400.0, 80.0))]
    found = compare(expected, [part(400.0, 84.0, 63.0), part(303.0, 0.0, yaw_deg=178.0)], TOLERANCE)
    assert found.changes == ()
    assert found.errors_mm == {400: 3.0, 600: 4.0}


def test_a_wedge_that_stands_the_wrong_way_round_is_noticed() -> None:
    wedge = replace(part(300.0, 0.0, yaw_deg=20.0), rise_deg=20.0)
    assert not changes([(wedge, (300.0, 0.0))], [replace(wedge, rise_deg=378.0)])
    (change,) = changes([(wedge, (300.0, 0.0))], [replace(wedge, rise_deg=200.0)])
    assert "turned by 180 deg" in change


@pytest.mark.parametrize(
    ("looked", "said"),
    [
        ([part(306.0, 0.0)], "6.0 mm from (300.0, 0.0), at (306.0, 0.0)"),
        ([part(303.0, 0.0, yaw_deg=70.0)], "3.0 mm from (300.0, 0.0), at (303.0, 0.0), turned by 70 deg"),
        ([], "not seen at (300.0, 0.0) or anywhere else"),
    ],
)  # fmt: skip
def test_what_is_not_as_expected_is_named(looked: list[Workpiece], said: str) -> None:
    assert changes([(part(300.0, 0.0), (300.0, 0.0))], looked) == (f"workpiece 400 (cuboid) is {said}",)


def test_a_part_of_another_height_is_another_part() -> None:
    missing, added = changes([(part(300.0, 0.0), (300.0, 0.0))], [part(300.0, 0.0, 70.0)])
    assert "is not seen" in missing
    assert added == "a cuboid part stands at (300.0, 0.0) that was not there"


def test_a_part_whose_slope_was_misjudged_is_the_same_part() -> None:
    level = part(300.0, 0.0)
    sloped = replace(level, kind="wedge", height_mm=level.height_mm + 10.0)
    assert changes([(sloped, (300.0, 0.0))], [level]) == ()


def test_a_nearly_square_part_has_no_long_side_to_be_turned() -> None:
    assert changes([(part(0.0, 0.0, width_mm=38.0), (0.0, 0.0))], [part(0.0, 0.0, yaw_deg=88.0, width_mm=38.0)]) == ()


def test_two_parts_of_one_height_that_changed_places_are_where_they_should_be() -> None:
    expected = [(part(300.0, 0.0), (300.0, 0.0)), (part(400.0, 0.0), (400.0, 0.0))]
    assert changes(expected, [part(400.0, 1.0), part(300.0, 1.0)]) == ()


def test_of_two_parts_that_were_pushed_each_is_taken_for_the_nearer() -> None:
    expected = [(part(300.0, 0.0), (300.0, 0.0)), (part(400.0, 0.0), (400.0, 0.0))]
    assert [line.split(" mm")[0] for line in changes(expected, [part(420.0, 0.0), part(320.0, 0.0)])] == [
        "workpiece 400 (cuboid) is 20.0",
        "workpiece 400 (cuboid) is 20.0",
    ]


@pytest.mark.parametrize("looked", [[], [part(120.0, 20.0, 15.0)], [part(100.0, 0.0)]])
def test_what_lies_in_the_bin_may_be_seen_or_not(looked: list[Workpiece]) -> None:
    assert changes([(part(300.0, 0.0), (100.0, 0.0))], looked, in_bin=True) == ()


def test_nothing_expected_and_nothing_seen_is_no_change() -> None:
    assert compare([], [], TOLERANCE).changes == ()
    assert np.allclose(compare([], [part(1.0, 2.0)], TOLERANCE).added_mm, [(1.0, 2.0)])
