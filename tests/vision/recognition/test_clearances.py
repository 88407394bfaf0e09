"""How far the jaws of a grasp are from the neighbours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from srvs_cell.scene import Grasp, Workpiece
from srvs_cell.vision.recognition.clearances import with_clearances

TABLE_Z_MM = -20.0
TURN_DEG = 30.0
"""All of it is turned on the table by this: x and y below are along and across the closing motion."""
TURN = np.array(
    [
        (np.cos(np.deg2rad(TURN_DEG)), np.sin(np.deg2rad(TURN_DEG))),
        (-np.sin(np.deg2rad(TURN_DEG)), np.cos(np.deg2rad(TURN_DEG))),
    ]
)
BOX = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])


def part(x_mm: float, y_mm: float, *, height_mm: float = 40.0, clockwise: bool = False) -> Workpiece:
    """Return a part of 30 x 50 mm; its best grasp closes along x, 12 mm under its top, the other one along y."""
    footprint = (BOX * (30.0, 50.0) + (x_mm, y_mm)) @ TURN + (500.0, 0.0)
    at = ((x_mm, y_mm) @ TURN) + (500.0, 0.0)
    position_mm = (float(at[0]), float(at[1]), TABLE_Z_MM + height_mm - 12.0)
    return Workpiece(
        id=0,
        kind="cuboid",
        position_mm=(position_mm[0], position_mm[1], TABLE_Z_MM + height_mm),
        height_mm=height_mm,
        yaw_deg=TURN_DEG + 90.0,
        size_mm=(50.0, 30.0),
        covariance_mm2=np.eye(3),
        footprint_mm=footprint[::-1] if clockwise else footprint,
        surfaces=(),
        grasp=Grasp(position_mm, TURN_DEG, 30.0, others=(Grasp(position_mm, TURN_DEG + 90.0, 50.0),)),
    )


def clearances(*parts: Workpiece) -> list[float | None]:
    grasp = with_clearances(parts, TABLE_Z_MM)[0].grasp
    assert grasp is not None
    return [choice.clearance_mm for choice in grasp.choices]


def test_without_neighbours_there_is_nothing_to_tell() -> None:
    assert clearances(part(0.0, 0.0)) == [None, None]


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_neighbour_on_either_side_is_in_the_way_of_one_grasp(side: float, clockwise: bool) -> None:
    near, far = part(side * 37.0, 5.0, clockwise=clockwise), part(-side * 41.0, 0.0, clockwise=clockwise)
    assert clearances(part(0.0, 0.0), near, far) == [pytest.approx(7.0, abs=0.01), None]
    above = part(0.0, side * 62.0, clockwise=clockwise)
    assert clearances(part(0.0, 0.0), above) == [None, pytest.approx(12.0, abs=0.01)]


def test_what_touches_leaves_no_room_and_what_overlaps_by_an_error_none_either() -> None:
    assert clearances(part(0.0, 0.0), part(30.0, 0.0))[0] == pytest.approx(0.0, abs=0.01)
    assert clearances(part(0.0, 0.0), part(29.0, 0.0))[0] == 0.0


@pytest.mark.parametrize(("y_mm", "met"), [(32.0, True), (34.0, False)])
def test_a_neighbour_is_met_as_wide_as_the_pad(y_mm: float, met: bool) -> None:
    """Neighbours are 50 mm long and a pad reaches 8 mm beside its middle."""
    assert (clearances(part(0.0, 0.0), part(35.0, y_mm))[0] is not None) is met


@pytest.mark.parametrize(("height_mm", "met"), [(29.0, True), (27.0, False)])
def test_fingers_pass_above_what_is_lower_than_their_tips(height_mm: float, met: bool) -> None:
    assert (clearances(part(0.0, 0.0), part(35.0, 0.0, height_mm=height_mm))[0] is not None) is met


def test_a_part_without_a_grasp_is_a_neighbour_all_the_same() -> None:
    unknown = replace(part(35.0, 0.0), grasp=None, grasp_refusal="its shape is in no library")
    assert clearances(part(0.0, 0.0), unknown)[0] == pytest.approx(5.0, abs=0.01)
    assert with_clearances([unknown, part(0.0, 0.0)], TABLE_Z_MM)[0] is unknown
