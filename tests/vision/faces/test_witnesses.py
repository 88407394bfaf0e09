"""What two fits of one face, and rival figures for its place, leave of its doubt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from srvs_cell.vision.faces.edge_fit import FaceFit
from srvs_cell.vision.faces.face import Face, Figure
from srvs_cell.vision.faces.witnesses import Witnesses
from srvs_cell.vision.recognition import RecognitionParameters
from srvs_cell.vision.recognition.top_faces import is_top

VARIANCE_MM2 = 0.04


def fit(z_mm: float, rms_px: float = 0.2, slope_u: float = 0.0) -> FaceFit:
    face = Face(Figure.RECTANGLE, 500.0, 0.0, z_mm, 0.0, 40.0, 30.0, slope_u)
    return FaceFit(face, VARIANCE_MM2 * np.eye(3), rms_px, 1.0)


def both(z_mm: float, rms_px: float = 0.2, inner_px2: float = 0.0) -> Witnesses:
    return Witnesses(fit(z_mm, rms_px), fit(z_mm, rms_px), inner_px2, inner_px2)


def test_fits_that_agree_leave_their_own_doubt() -> None:
    assert both(30.0).agreed().covariance_mm2 == pytest.approx(VARIANCE_MM2 * np.eye(3))


@pytest.mark.parametrize(
    ("inner_px2", "edges_inner_px2", "z_mm"),
    [(0.0, 0.0, 36.0), (0.5, 0.0, 30.0), (0.0, 0.5, 36.0), (0.05, 0.0, 36.0)],
)
def test_the_inside_says_which_of_two_fits_is_right(inner_px2: float, edges_inner_px2: float, z_mm: float) -> None:
    agreed = Witnesses(fit(30.0, 0.1), fit(36.0, 0.6), inner_px2, edges_inner_px2).agreed()
    assert agreed.face.z_mm == z_mm


def test_grey_values_that_fit_badly_are_right_where_the_inside_says_so() -> None:
    assert Witnesses(fit(30.0, 0.1), fit(36.0, 0.8), 0.0, 0.0).agreed().face.z_mm == 30.0
    assert Witnesses(fit(30.0, 0.1), fit(36.0, 0.8), 0.0, 0.5).agreed().face.z_mm == 36.0


def test_grey_values_count_more_than_edges_and_the_inside_more_than_both() -> None:
    good_edges = Witnesses(fit(30.0, 0.3), fit(30.0, 0.6), 0.0, 0.0)
    good_grey_values = Witnesses(fit(30.0, 0.6), fit(30.0, 0.3), 0.0, 0.0)
    displaced = Witnesses(fit(30.0, 0.3), fit(30.0, 0.3), 0.27, 0.27)
    assert good_grey_values.misfit_px2 < good_edges.misfit_px2 < displaced.misfit_px2


def test_a_face_whose_inside_contradicts_it_fits_no_better_than_that() -> None:
    assert both(30.0, 0.3).agreed().rms_px == pytest.approx(0.3)
    assert both(30.0, 0.3, inner_px2=0.16).agreed().rms_px == pytest.approx(0.5)


@pytest.mark.parametrize(("edges", "profiles", "unsure"), [(0.6, 0.75, True), (0.6, 0.85, False), (0.9, 0.6, False)])
def test_a_face_of_which_neither_fit_sees_a_side_is_no_surer_than_that(
    edges: float, profiles: float, unsure: bool
) -> None:
    agreed = Witnesses(replace(fit(30.0), support=edges), replace(fit(30.0), support=profiles), 0.0, 0.0).agreed()
    assert agreed.support == max(edges, profiles)
    # a quarter of half the length of 40 mm
    sigma_mm = 5.0 if unsure else 0.2
    assert agreed.covariance_mm2[0, 0] ** 0.5 == pytest.approx(sigma_mm, abs=0.1)
    assert agreed.covariance_mm2[2, 2] == pytest.approx(VARIANCE_MM2)


def test_a_rival_that_suits_as_well_shares_its_distance() -> None:
    agreed = both(30.0).agreed_among([both(40.0)])
    assert agreed.face.z_mm == 30.0
    assert agreed.covariance_mm2[2, 2] == pytest.approx(VARIANCE_MM2 + 100.0 / 2.0)
    assert agreed.covariance_mm2[0, 0] == pytest.approx(VARIANCE_MM2)


def test_a_rival_that_suits_much_worse_counts_for_nothing() -> None:
    agreed = both(30.0).agreed_among([both(40.0, rms_px=1.0)])
    assert agreed.covariance_mm2[2, 2] == pytest.approx(VARIANCE_MM2, abs=1e-3)


def test_a_rival_whose_inside_is_displaced_counts_less() -> None:
    doubted = both(30.0).agreed_among([both(40.0, inner_px2=0.08)])
    assert doubted.covariance_mm2[2, 2] < VARIANCE_MM2 + 0.1 * 100.0


@pytest.mark.parametrize(("twins_rms_px", "doubt_mm"), [(0.2, 7.07), (0.25, 3.8), (2.0, 0.2)])
def test_a_level_face_that_may_be_inclined_is_no_surer_than_the_parts_height(
    twins_rms_px: float, doubt_mm: float
) -> None:
    inclined = Witnesses(fit(30.0, twins_rms_px, 0.5), fit(30.0, twins_rms_px, 0.5), 0.0, 0.0)
    agreed = replace(both(30.0), twin=inclined).agreed()
    # centres coincide, but the highest corner lies half a length times the slope higher
    assert agreed.face.slope_u == 0.0
    assert agreed.covariance_mm2[2, 2] ** 0.5 == pytest.approx(doubt_mm, abs=0.15)
    assert agreed.covariance_mm2[0, 0] == pytest.approx(VARIANCE_MM2)


def test_a_figure_must_suit_clearly_better_and_no_fit_may_speak_against_it() -> None:
    level = both(30.0, 0.4, inner_px2=0.2)
    assert both(31.0, 0.4).suits_better(level, 0.7)
    assert not both(31.0, 0.4, inner_px2=0.15).suits_better(level, 0.7)
    against = Witnesses(fit(31.0, 0.1), fit(31.0, 0.48), 0.0, 0.0)
    assert against.misfit_px2 < 0.7 * level.misfit_px2
    assert not against.suits_better(level, 0.7)


def test_grey_values_that_see_three_sides_do_not_speak_against_a_figure_with_four() -> None:
    whole = Witnesses(fit(31.0, 0.5), fit(31.0, 0.45), 0.0, 0.0)
    three = Witnesses(fit(30.0, 1.2), replace(fit(30.0, 0.2), support=0.75), 0.0, 0.0)
    four = Witnesses(fit(30.0, 1.2), fit(30.0, 0.2), 0.0, 0.0)
    assert whole.suits_better(three, 0.7)
    assert not whole.suits_better(four, 0.7)
    poor = Witnesses(fit(31.0, 0.1), fit(31.0, 0.7), 0.0, 0.0)
    assert not poor.suits_better(three, 0.7)


@pytest.mark.parametrize(
    ("edges_rms_px", "edges_slope", "profiles_rms_px", "inclined"),
    [
        (0.3, 0.2, 0.43, False),  # what one parameter more gains by chance
        (0.3, 0.2, 0.38, True),
        (0.2, 0.01, 0.38, False),  # good edges show a level face
        (0.2, 0.01, 0.3, True),
        (0.2, 0.2, 0.42, True),
    ],
)
def test_a_slope_must_be_worth_its_parameter(
    edges_rms_px: float, edges_slope: float, profiles_rms_px: float, *, inclined: bool
) -> None:
    level = Witnesses(fit(30.0, edges_rms_px), fit(30.0, 0.45), 0.0, 0.0)
    sloped = Witnesses(fit(30.0, edges_rms_px, edges_slope), fit(30.0, profiles_rms_px, 0.2), 0.0, 0.0)
    assert sloped.suits_better(level, 1.0) is inclined
    assert level.suits_better(sloped, 1.0) is not inclined


@pytest.mark.parametrize(("slope_u", "possible"), [(0.5, True), (0.8, False)])
def test_no_face_reaches_into_the_table(slope_u: float, possible: bool) -> None:
    assert is_top(fit(12.0, slope_u=slope_u), 0.0, RecognitionParameters()) is possible


@pytest.mark.parametrize(("slope_u", "possible"), [(0.0, True), (0.05, False), (0.1, True)])
def test_a_face_next_to_level_is_to_be_fitted_as_level(slope_u: float, possible: bool) -> None:
    assert is_top(fit(40.0, slope_u=slope_u), 0.0, RecognitionParameters()) is possible


@pytest.mark.parametrize(
    ("edges_rms_px", "profiles_rms_px", "believed"),
    [(1.1, 0.9, True), (1.3, 0.5, False), (1.25, 0.45, True), (1.9, 0.3, True)],
)
def test_what_the_edges_do_not_confirm_is_believed_where_little_is_left_open(
    edges_rms_px: float, profiles_rms_px: float, *, believed: bool
) -> None:
    both = Witnesses(fit(30.0, edges_rms_px), fit(30.0, profiles_rms_px), 0.0, 0.0)
    assert both.is_believed(1.2) is believed


@pytest.mark.parametrize(
    ("edges_rms_px", "slope", "may"), [(0.3, 0.0, True), (0.5, 0.0, False), (0.5, 0.4, True), (0.9, 0.4, False)]
)
def test_what_the_edges_suit_worse_is_fitted_no_further(edges_rms_px: float, slope: float, *, may: bool) -> None:
    # its misfit is 0.5 px2: an inclined figure may still be its twin
    level = Witnesses(fit(30.0, 0.4), fit(30.0, 0.58), 0.0, 0.0)
    assert level.may_yield_to(fit(30.0, edges_rms_px, slope)) is may
