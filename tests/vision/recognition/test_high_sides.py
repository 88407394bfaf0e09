"""Wedges that run out on the table: only the border of their high side rises."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from srvs_cell.vision.faces.edge_fit import FaceFit
from srvs_cell.vision.recognition import RecognitionParameters
from srvs_cell.vision.recognition.evidence import Evidence
from srvs_cell.vision.recognition.high_sides import high_sided_wedges
from srvs_cell.vision.recognition.tops import Top
from srvs_cell.vision.recognition.verification import verify_tops
from srvs_cell.vision.rectification import RectifiedPair
from srvs_cell.vision.refinement import GreyPair
from srvs_cell.vision.relief import measure_relief
from tests.vision.painted import SIZE, TABLE_Z_MM, Part, cuboid, paint, planes, rig, wedge

if TYPE_CHECKING:
    from srvs_cell.vision.relief import Relief

YAWS_DEG = (10.0, 40.0, 190.0, 220.0)


def look_at(parts: list[Part]) -> tuple[Relief, Evidence]:
    """Return what rises, and the images with a plane for each top."""
    first, second = images = paint(parts, rig())
    seen = np.ones((SIZE[1], SIZE[0]), dtype=np.bool_)
    relief = measure_relief(
        RectifiedPair(first, second, seen, seen, rig()), GreyPair.of(first, second), TABLE_Z_MM, None
    )
    left, right, _ = planes(parts, rig(), images, disparity_noise_px=0.0)
    return relief, Evidence.of(left, right, rig(), TABLE_Z_MM, RecognitionParameters())


def running_out(yaw_deg: float) -> Part:
    return wedge(500.0, 60.0, 0.0, 14.0, yaw_deg, (40.0, 32.0), 60)


@pytest.mark.parametrize("yaw_deg", YAWS_DEG)
def test_the_side_that_rises_is_the_high_one(yaw_deg: float) -> None:
    starts = high_sided_wedges([], *look_at([running_out(yaw_deg)]))
    towards = []
    for start in starts:
        assert start.rise_deg is not None
        towards.append(float(np.cos(np.deg2rad(start.rise_deg - yaw_deg))))
        assert (start.x_mm, start.y_mm) == pytest.approx((500.0, 60.0), abs=12.0)
        assert start.lowest_mm >= TABLE_Z_MM - 0.01
    # half of a neighbouring side may rise, too: the low one never does
    assert min(towards) > -0.2
    assert sum(one > 0.99 for one in towards) >= 4


@pytest.mark.parametrize("yaw_deg", YAWS_DEG)
def test_a_wedge_of_which_only_the_high_side_rises_is_found(yaw_deg: float) -> None:
    part = running_out(yaw_deg)
    relief, evidence = look_at([part])
    standing, unseen = verify_tops([], (), relief, evidence)
    (face,) = [top.fit.face for top in standing]
    assert (face.x_mm, face.y_mm) == pytest.approx((500.0, 60.0), abs=0.5)
    assert face.highest_mm == pytest.approx(TABLE_Z_MM + 14.0, abs=1.0)
    assert face.inclination_deg == pytest.approx(part.face.inclination_deg, abs=2.0)
    assert unseen == []


def test_what_a_known_top_explains_is_no_wedge_s_high_side() -> None:
    part = running_out(10.0)
    known = Top(FaceFit(part.face, 0.01 * np.eye(3), 0.1, 1.0), (1,))
    assert high_sided_wedges([known], *look_at([part])) == []


def test_print_and_shadows_have_no_high_side() -> None:
    flat = cuboid(500.0, 60.0, 0.0, 20.0, (60.0, 40.0), 60)
    assert high_sided_wedges([], *look_at([flat])) == []
