"""A library of one's own on rendered pictures: the very example of docs/reference/object-kinds.md."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pytest

from drivers.sim.parts import CUBOID, CYLINDER, PRISM, Part, prism_across_flats_mm
from srvs_cell.config import parse_library
from srvs_cell.geometry import wrap_angle_deg
from srvs_cell.scene import UNKNOWN_KIND
from srvs_cell.vision import VisionParameters, perceive
from tests.test_object_library import EXAMPLE
from tests.vision.rendered import TABLE_Z_MM, Hull, part, stereo_pair

if TYPE_CHECKING:
    from srvs_cell.scene import Workpiece

NUT = (36.0 / 0.8660254, 36.0)


@dataclass(frozen=True)
class Expected:
    """What is to be seen at a place; opening and yaw of the jaws where it can be gripped."""

    kind: str
    at_mm: tuple[float, float]
    height_mm: float
    opening_mm: float | None
    jaws_deg: float | None = None


def gable(at_mm: tuple[float, float], yaw_deg: float, albedo: float) -> Part:
    """A block 60 by 70 mm, 15 mm high at the eaves and 35 mm at the ridge, which runs along its x axis."""
    eaves = [(x, y, z) for z in (0.0, 15.0) for x in (-30.0, 30.0) for y in (-35.0, 35.0)]
    return Hull(
        kind="gable",
        length_mm=60.0,
        width_mm=70.0,
        height_mm=35.0,
        low_height_mm=35.0,
        x_mm=at_mm[0],
        y_mm=at_mm[1],
        yaw_deg=yaw_deg,
        albedo=albedo,
        label=False,
        corners_mm=(*eaves, (-30.0, 0.0, 35.0), (30.0, 0.0, 35.0)),
    )


def step(at_mm: tuple[float, float], yaw_deg: float, albedo: float) -> list[Part]:
    """A block 80 by 40 mm, one half 45 mm and the other 20 mm high."""
    along = 20.0 * np.array([np.cos(np.deg2rad(yaw_deg)), np.sin(np.deg2rad(yaw_deg))])
    return [
        part(CUBOID, (40.0, 40.0), height, (at_mm[0] + side * along[0], at_mm[1] + side * along[1]), yaw_deg, albedo)
        for side, height in ((-1.0, 45.0), (1.0, 20.0))
    ]


SINGLE = [
    part(CUBOID, (90.0, 18.0), 22.0, (700.0, -90.0), 30.0, 0.7),
    part(CUBOID, (80.0, 62.0), 12.0, (700.0, 60.0), 20.0, 0.62),
    part(CUBOID, (32.0, 31.5), 32.0, (800.0, -60.0), 20.0, 0.8),
    part(CUBOID, (40.0, 39.0), 32.0, (840.0, 110.0), 50.0, 0.8),
    part(PRISM, NUT, 20.0, (810.0, 30.0), 20.0, 0.28),
    part(PRISM, (50.0, prism_across_flats_mm(50.0)), 20.0, (640.0, -30.0), 5.0, 0.7),
    part(CYLINDER, (30.0, 30.0), 60.0, (750.0, 125.0), 0.0, 0.55),
]
SEEN = [
    Expected("bar", (700.0, -90.0), 22.0, 18.0, 120.0),
    Expected("plate", (700.0, 60.0), 12.0, 62.0, 110.0),
    Expected("cube_32", (800.0, -60.0), 32.0, 31.5),
    Expected("cuboid", (840.0, 110.0), 32.0, 39.0),
    Expected("nut_m24", (810.0, 30.0), 20.0, 36.0),
    Expected("prism", (640.0, -30.0), 20.0, 43.3),
    Expected("cylinder", (750.0, 125.0), 60.0, 30.0),
]
SEVERAL = [gable((700.0, 70.0), 145.0, 0.7), *step((800.0, -60.0), 75.0, 0.75)]
SEEN_SEVERAL = [
    Expected("gable", (700.0, 70.0), 35.0, 60.0, 145.0),
    Expected("step", (800.0, -60.0), 45.0, 40.0, 165.0),
]


def see(parts: list[Part], text: str) -> tuple[Workpiece, ...]:
    left, right, view = stereo_pair(parts)
    return perceive(left, right, VisionParameters(), view=view, kinds=parse_library(text, "library").kinds).workpieces


@pytest.mark.parametrize(("parts", "expected"), [(SINGLE, SEEN), (SEVERAL, SEEN_SEVERAL)], ids=["single", "several"])
def test_the_example_of_the_page_on_rendered_parts(parts: list[Part], expected: list[Expected]) -> None:
    workpieces = see(parts, EXAMPLE)
    assert len(workpieces) == len(expected)
    for one in expected:
        workpiece = min(workpieces, key=lambda seen: np.hypot(*np.subtract(seen.position_mm[:2], one.at_mm)))
        assert workpiece.kind == one.kind
        assert np.hypot(*np.subtract(workpiece.position_mm[:2], one.at_mm)) < 0.6
        assert workpiece.height_mm == pytest.approx(one.height_mm, abs=1.5)
        assert workpiece.surfaces
        assert workpiece.grasp is not None, workpiece.grasp_refusal
        assert workpiece.grasp.opening_mm == pytest.approx(one.opening_mm, abs=0.6)
        assert np.hypot(*np.subtract(workpiece.grasp.position_mm[:2], one.at_mm)) < 0.6
        assert TABLE_Z_MM < workpiece.grasp.position_mm[2] < TABLE_Z_MM + one.height_mm
        if one.jaws_deg is not None:
            assert abs(wrap_angle_deg(workpiece.grasp.yaw_deg - one.jaws_deg, 180.0)) < 1.0


def test_without_the_built_in_kinds_what_is_not_in_the_library_is_unknown_with_its_surfaces() -> None:
    workpieces = see(SINGLE[2:5], EXAMPLE.replace("built_in: true", "built_in: false"))
    assert sorted(workpiece.kind for workpiece in workpieces) == ["cube_32", "nut_m24", UNKNOWN_KIND]
    unknown = next(workpiece for workpiece in workpieces if workpiece.kind == UNKNOWN_KIND)
    assert unknown.surfaces
    assert unknown.size_mm == pytest.approx((40.0, 39.0), abs=0.6)
    assert unknown.grasp is None
    assert "in no library" in unknown.grasp_refusal
