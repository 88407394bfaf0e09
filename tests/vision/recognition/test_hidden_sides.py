"""Top faces of which a higher part hides a side, or throws its shadow on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from srvs_cell.geometry import Transform, Xyzwpr
from srvs_cell.vision.faces.edge_fit import FaceFit
from srvs_cell.vision.faces.face import Face, Figure
from srvs_cell.vision.faces.shadows import Lamp
from srvs_cell.vision.recognition.hidden_sides import with_hidden_sides
from srvs_cell.vision.recognition.tops import Top
from srvs_cell.vision.rectification import RectifiedRig

EYE_MM = (0.0, 0.0, 600.0)
BASELINE_MM = 30.0
# the left camera looks straight down; its x axis is the base's
RIG = RectifiedRig(
    800.0, 320.0, 240.0, BASELINE_MM, Transform.from_xyzwpr("base", "camera_left", Xyzwpr(*EYE_MM, 180.0, 0.0, 0.0))
)
HIGH = Face(Figure.RECTANGLE, 80.0, 0.0, 80.0, 0.0, 40.0, 60.0)
"""From x = 60 mm to a wall at x = 100 mm."""
LOW_Z_MM = 40.0
LOW_END_MM = 150.0
FROM_LEFT_MM = 100.0 * (EYE_MM[2] - LOW_Z_MM) / (EYE_MM[2] - HIGH.z_mm)
"""Where the left camera sees the low face from, over the edge of the high one."""


def low(from_mm: float, to_mm: float = LOW_END_MM) -> Face:
    return Face(Figure.RECTANGLE, (from_mm + to_mm) / 2.0, 0.0, LOW_Z_MM, 0.0, to_mm - from_mm, 50.0)


def seen(face: Face, *others: Face, lamp: Lamp | None = None) -> FaceFit:
    tops = [Top(FaceFit(one, 0.01 * np.eye(3), 0.1, 1.0), ()) for one in (face, *others)]
    return with_hidden_sides(tops, RIG, lamp)[0].fit


def start_mm(face: Face) -> float:
    return face.x_mm - face.length_mm / 2.0


def test_a_side_that_a_higher_part_hides_is_likely_half_way_to_the_wall() -> None:
    fit = seen(low(FROM_LEFT_MM), HIGH)
    assert start_mm(fit.face) == pytest.approx((FROM_LEFT_MM + 100.0) / 2.0, abs=0.5)
    # the other sides stay where they are
    assert fit.face.x_mm + fit.face.length_mm / 2.0 == pytest.approx(LOW_END_MM)
    assert (fit.face.y_mm, fit.face.width_mm, fit.face.z_mm) == (0.0, 50.0, LOW_Z_MM)


@pytest.mark.parametrize("true_start_mm", [100.0, 102.0, 105.0, FROM_LEFT_MM])
def test_the_doubt_holds_wherever_the_hidden_side_is(true_start_mm: float) -> None:
    fit = seen(low(FROM_LEFT_MM), HIGH)
    off_mm = np.array([fit.face.x_mm - low(true_start_mm).x_mm, 0.0, 0.0])
    assert off_mm @ np.linalg.solve(fit.covariance_mm2, off_mm) < chi2.ppf(0.95, df=3)
    # and no more than along the way it may go on
    assert np.sqrt(fit.covariance_mm2[0, 0]) < (FROM_LEFT_MM - 100.0) / 4.0
    np.testing.assert_allclose(fit.covariance_mm2[1:, 1:], 0.01 * np.eye(2), atol=1e-9)


def test_a_wedge_goes_on_along_its_slope() -> None:
    wedge = replace(low(FROM_LEFT_MM), slope_u=-0.2)
    fit = seen(wedge, HIGH)
    assert fit.face.slope_u == wedge.slope_u
    assert fit.face.z_mm - wedge.z_mm == pytest.approx(-0.2 * (fit.face.x_mm - wedge.x_mm))
    assert fit.face.highest_mm > wedge.highest_mm + 0.4


@pytest.mark.parametrize(
    "face",
    [
        # the cameras see down the wall between the two: nothing is hidden on that side
        Face(Figure.RECTANGLE, 40.0, 0.0, LOW_Z_MM, 0.0, 39.0, 50.0),
        # a gap of table is seen between the low part and what the high one hides
        low(FROM_LEFT_MM + 6.0),
        # its other sides tell where the hidden part of a circle is
        Face(Figure.CIRCLE, FROM_LEFT_MM + 20.0, 0.0, LOW_Z_MM, 0.0, 40.0, 40.0),
        # nothing lower hides anything
        replace(low(FROM_LEFT_MM), z_mm=90.0),
        # beside the high one, so that the ways to the cameras run along its wall
        replace(low(FROM_LEFT_MM), y_mm=80.0),
        # far from the high one
        replace(low(FROM_LEFT_MM), y_mm=200.0),
    ],
)
def test_what_is_seen_stays_as_it_is(face: Face) -> None:
    fit = seen(face, HIGH)
    assert fit.face == face
    np.testing.assert_array_equal(fit.covariance_mm2, 0.01 * np.eye(3))


def test_one_of_two_beside_each_other_ends_at_the_nearer_one() -> None:
    # what is hidden by the high part is where a third one stands
    third = Face(Figure.RECTANGLE, 102.0, 0.0, 60.0, 0.0, 4.0, 60.0)
    fit = seen(low(FROM_LEFT_MM), HIGH, third)
    assert start_mm(fit.face) == pytest.approx((FROM_LEFT_MM + 104.0) / 2.0, abs=0.5)


@pytest.mark.parametrize("nearness_per_mm", [0.0, 1.0 / 1500.0])
def test_a_face_may_go_on_in_a_shadow(nearness_per_mm: float) -> None:
    lamp = Lamp((100.0, 0.0), (-0.5, 0.0), nearness_per_mm, 0.0)
    edge = np.array([[100.0], [0.0], [HIGH.z_mm - LOW_Z_MM]])
    end_mm = float(lamp.shadows_mm(edge)[0, 0])
    assert end_mm > FROM_LEFT_MM + 5.0
    fit = seen(low(end_mm), HIGH, lamp=lamp)
    assert start_mm(fit.face) == pytest.approx((end_mm + 100.0) / 2.0, abs=1.0)
    # a lamp that is not known hides nothing
    assert seen(low(end_mm), HIGH).face == low(end_mm)


def test_a_side_within_a_shadow_is_its_own() -> None:
    lamp = Lamp((100.0, 0.0), (-0.5, 0.0), 0.0, 0.0)
    face = low(FROM_LEFT_MM + 6.0)
    assert seen(face, HIGH, lamp=lamp).face == face
