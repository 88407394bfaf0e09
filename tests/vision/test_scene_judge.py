"""What a perception of a scene is held to: whole objects, partly hidden ones, pieces of them, and grasps that miss."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.perceive_rendered import judge, summary
from srvs_cell.scene import UNKNOWN_KIND, Grasp, Workpiece


def seen_at(x_mm: float, *, kind: str = "cuboid", grasped: bool = True) -> Workpiece:
    grasp = Grasp((x_mm, 0.0, 20.0), 0.0, 30.0) if grasped else None
    nothing = np.empty((0, 2))
    return Workpiece(0, kind, (x_mm, 0.0, 30.0), 30.0, 0.0, (50.0, 30.0), np.eye(3), nothing, (), grasp)


def stands_at(x_mm: float, *, fully_visible: bool = True) -> dict[str, Any]:
    return {
        "kind": "cuboid",
        "position_mm": [x_mm, 0.0, 30.0],
        "height_mm": 30.0,
        "yaw_deg": 0.0,
        "size_mm": [50.0, 30.0],
        "fully_visible": fully_visible,
        "bound_mm": 0.1,
    }


def test_what_is_partly_hidden_is_told_apart_from_what_is_wholly_seen() -> None:
    objects = [stands_at(0.0), stands_at(100.0, fully_visible=False), stands_at(200.0, fully_visible=False)]
    found = [seen_at(0.5), seen_at(101.0), seen_at(220.0, kind=UNKNOWN_KIND, grasped=False), seen_at(-20.0)]
    judged = judge("L1/000", found, objects)
    assert [one.error_mm for one in judged.objects] == [0.5]
    assert [one.error_mm for one in judged.partly_hidden] == [1.0, None]
    # the third is over the last object, though not near its middle; the fourth over one that is wholly seen
    assert len(judged.spurious) == 2
    assert judged.pieces == 1
    figures = summary([judged])
    assert (figures["objects"], figures["found"], figures["spurious"], figures["pieces"]) == (1, 1, 2, 1)
    assert (figures["partly_hidden"], figures["partly_hidden_recognised"]) == (2, 1)
    assert figures["partly_hidden_error_mean_mm"] == 1.0


@pytest.mark.parametrize(("at_mm", "off"), [(3.9, 0), (4.1, 1), (40.0, 1)])
def test_a_grasp_beside_every_middle_misses(at_mm: float, off: int) -> None:
    objects = [stands_at(0.0), stands_at(100.0)]
    judged = judge("L1/000", [seen_at(at_mm), seen_at(100.0 + at_mm, grasped=False)], objects)
    assert (judged.grasps, judged.grasps_off) == (1, off)


@pytest.mark.parametrize(("at_mm", "inside"), [(0.5, (True, True)), (2.0, (True, False)), (4.0, (False, False))])
def test_the_random_part_of_a_covariance_is_judged_alone(at_mm: float, inside: tuple[bool, bool]) -> None:
    # standard deviations of 1 mm, 0.4 mm of it random
    workpiece = replace(seen_at(at_mm), systematic_mm2=0.84 * np.eye(3))
    (one,) = judge("L1/000", [workpiece], [stands_at(0.0)]).objects
    assert (one.inside_95, one.inside_random_95) == inside


@pytest.mark.parametrize(("kind", "inside"), [("cuboid", True), (UNKNOWN_KIND, None)])
def test_what_is_not_told_apart_or_unknown_is_not_judged(kind: str, *, inside: bool | None) -> None:
    (one,) = judge("L1/000", [seen_at(0.5, kind=kind)], [stands_at(0.0)]).objects
    assert (one.inside_95, one.inside_random_95) == (inside, None)


def test_an_empty_table_has_no_grasps() -> None:
    assert judge("L1/000", [], [stands_at(0.0)]).grasps == 0
    nothing_there = judge("L1/000", [seen_at(0.0)], [])
    assert (nothing_there.grasps, nothing_there.grasps_off, len(nothing_there.spurious)) == (1, 1, 1)
