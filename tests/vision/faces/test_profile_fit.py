"""Faces fitted to the grey values across their outlines, in painted pictures."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from srvs_cell.vision.faces.face import Face, Figure
from srvs_cell.vision.faces.profile_fit import BLURS_PX, REACH, SETTLE, fit_profiles, measure_blur
from srvs_cell.vision.faces.profiles import USUAL_BLUR_PX, Pictures
from srvs_cell.vision.faces.shadows import Lamp
from tests.vision.painted import SHADOW_GREY, TABLE_GREY, TABLE_Z_MM, Part, cuboid, paint, rig

if TYPE_CHECKING:
    from collections.abc import Sequence

BOX = cuboid(500.0, 50.0, 50.0, 20.0, (60.0, 40.0), 200)


def pictures_of(parts: list[Part], *, noise: float, seed: int = 0) -> Pictures:
    left, right = paint(parts, rig(), noise=noise, seed=seed)
    return Pictures.of(left, right)


def faint(grey: int = 114) -> Part:
    """Return a part of nearly the table's grey, 110, whose side faces have just the table's."""
    return replace(BOX, top_grey=grey, side_grey=110)


def test_a_faint_face_is_found_from_three_pixels_off_to_tenths_of_a_millimetre() -> None:
    true = BOX.face
    # a pixel is 0.55 mm up there
    start = replace(true, x_mm=true.x_mm + 1.2, y_mm=true.y_mm - 1.0, z_mm=true.z_mm + 4.0)
    errors, sigmas = [], []
    for seed in range(3):
        (fit,) = fit_profiles([start], [False], pictures_of([faint()], noise=1.5, seed=seed), rig(), TABLE_Z_MM, REACH)
        assert fit is not None
        errors.append([fit.face.x_mm - true.x_mm, fit.face.y_mm - true.y_mm, fit.face.z_mm - true.z_mm])
        sigmas.append(np.sqrt(np.diag(fit.covariance_mm2)))
        assert (fit.face.length_mm, fit.face.width_mm) == pytest.approx((true.length_mm, true.width_mm), abs=0.6)
    assert np.abs(np.array(errors)[:, :2]).max() < 0.4
    assert np.abs(np.array(errors)[:, 2]).max() < 4.0
    # of the right order: neither ten times too sure nor ten times too modest
    ratio = np.sqrt(np.mean((np.array(errors) / np.array(sigmas)) ** 2))
    assert 0.1 < ratio < 4.0


def test_where_a_fit_comes_to_rest_is_not_where_it_began() -> None:
    """Cut short, these would stay half a millimetre apart."""
    pictures = pictures_of([faint()], noise=1.0)
    z_mm = BOX.face.z_mm + 6.0
    starts = [
        replace(BOX.face, x_mm=BOX.face.x_mm + off_mm, length_mm=BOX.face.length_mm + longer_mm, z_mm=z_mm)
        for off_mm, longer_mm in ((2.0, 3.0), (2.5, 4.0), (3.0, 5.0), (1.5, 6.0))
    ]
    fits = fit_profiles(starts, [False] * len(starts), pictures, rig(), TABLE_Z_MM, SETTLE)
    rest = np.array([[fit.face.x_mm, fit.face.length_mm] for fit in fits if fit is not None])
    assert len(rest) == len(starts)
    assert np.ptp(rest, axis=0).max() < 0.1


def test_noise_widens_the_covariance() -> None:
    calm, loud = (
        fit_profiles([BOX.face], [False], pictures_of([faint()], noise=noise), rig(), TABLE_Z_MM, SETTLE)[0]
        for noise in (1.0, 3.0)
    )
    assert calm is not None
    assert loud is not None
    assert np.trace(loud.covariance_mm2) > 4.0 * np.trace(calm.covariance_mm2)


@pytest.mark.parametrize("height_mm", [8.0, 15.0])
def test_a_sliver_of_dark_side_face_does_not_pull_the_face(height_mm: float) -> None:
    part = replace(cuboid(500.0, 20.0, height_mm, 10.0, (60.0, 40.0), 150), side_grey=20)
    (fit,) = fit_profiles([part.face], [False], pictures_of([part], noise=1.0), rig(), TABLE_Z_MM, SETTLE)
    assert fit is not None
    assert (fit.face.x_mm, fit.face.y_mm) == pytest.approx((part.face.x_mm, part.face.y_mm), abs=0.15)
    assert (fit.face.length_mm, fit.face.width_mm) == pytest.approx((60.0, 40.0), abs=0.4)
    assert fit.face.z_mm == pytest.approx(part.face.z_mm, abs=1.0)


LOW = replace(cuboid(500.0, 20.0, 15.0, 10.0, (60.0, 40.0), 180), side_grey=90)


def with_shadow(azimuth_deg: float, lean: float, parts: Sequence[Part] = (LOW,)) -> tuple[Pictures, Lamp]:
    """Return pictures of a low part with a strip of shadow beside it, one to four pixels wide, and what throws it."""
    turn, height_mm = np.deg2rad(azimuth_deg), 1200.0
    x, y = lean * np.cos(turn), lean * np.sin(turn)
    place = (500.0 + x * height_mm, 20.0 + y * height_mm, TABLE_Z_MM + height_mm)
    pictures = Pictures.of(*paint(list(parts), rig(), noise=1.0, lamp_mm=place))
    return pictures, Lamp((500.0, 20.0), (x, y), 1.0 / height_mm, TABLE_Z_MM, SHADOW_GREY / TABLE_GREY)


@pytest.mark.parametrize("azimuth_deg", range(0, 360, 30))
@pytest.mark.parametrize("lean", [0.1, 0.2])
def test_a_strip_of_shadow_does_not_pull_the_face(azimuth_deg: float, lean: float) -> None:
    pictures, lamp = with_shadow(azimuth_deg, lean)
    (fit,) = fit_profiles([LOW.face], [False], replace(pictures, lamp=lamp), rig(), TABLE_Z_MM, SETTLE)
    assert fit is not None
    assert fit.face.z_mm == pytest.approx(LOW.face.z_mm, abs=0.7)
    assert (fit.face.x_mm, fit.face.y_mm) == pytest.approx((LOW.face.x_mm, LOW.face.y_mm), abs=0.15)
    assert fit.rms_px < 0.05


def test_a_strip_of_shadow_of_which_nothing_is_known_pulls_it() -> None:
    pictures, _ = with_shadow(270.0, 0.2)
    (fit,) = fit_profiles([LOW.face], [False], pictures, rig(), TABLE_Z_MM, SETTLE)
    assert fit is not None
    assert abs(fit.face.z_mm - LOW.face.z_mm) > 1.5


def with_strip(azimuth_deg: float) -> Face:
    """Return a figure that takes the strip of shadow beside the low part for a part of its face.

    In both pictures it ends about where the shadow does at a height between the table's and the face's.
    """
    turn, strip_mm = np.deg2rad(azimuth_deg + 180.0) - LOW.face.angle_rad, 6.5
    away = np.array([[np.cos(turn) / LOW.face.length_mm, np.sin(turn) / LOW.face.width_mm]]) * strip_mm
    x_mm, y_mm, _ = (float(value) for value in LOW.face.place(away)[0])
    grown = replace(LOW.face, x_mm=x_mm, y_mm=y_mm, z_mm=12.0)
    if abs(np.cos(turn)) > 0.5:
        return replace(grown, length_mm=grown.length_mm + strip_mm)
    return replace(grown, width_mm=grown.width_mm + strip_mm)


def judged_px(face: Face, pictures: Pictures, lamp: Lamp | None) -> float:
    """Return the misfit of a face where it is."""
    effort = replace(SETTLE, widths=(1.0,))
    (fit,) = fit_profiles([face], [False], replace(pictures, lamp=lamp), rig(), TABLE_Z_MM, effort)
    assert fit is not None
    return fit.rms_px


# straight across one of its sides, so that the shadow beside it is as wide all along
@pytest.mark.parametrize("azimuth_deg", [10.0, 100.0, 190.0, 280.0])
def test_a_shadow_taken_for_part_of_the_face_is_held_against_a_figure(azimuth_deg: float) -> None:
    pictures, lamp = with_shadow(azimuth_deg, 0.45)
    assert judged_px(LOW.face, pictures, lamp) < 0.1
    grown = with_strip(azimuth_deg)
    assert judged_px(grown, pictures, lamp) > judged_px(grown, pictures, None) + 0.3


@pytest.mark.parametrize("azimuth_deg", [10.0, 100.0, 190.0, 280.0])
def test_a_face_as_dark_as_a_shadow_of_its_shadow_is_not_taken_for_one(azimuth_deg: float) -> None:
    pictures, lamp = with_shadow(azimuth_deg, 0.45, [replace(LOW, top_grey=SHADOW_GREY**2 // TABLE_GREY)])
    assert judged_px(LOW.face, pictures, lamp) < 0.15


# the light comes from the printed side, or falls on the other
@pytest.mark.parametrize(("azimuth_deg", "grey"), [(100.0, SHADOW_GREY**2 // TABLE_GREY), (280.0, 120)])
def test_print_along_a_side_is_not_taken_for_shadow(azimuth_deg: float, grey: int) -> None:
    x_mm, y_mm, _ = (float(value) for value in LOW.face.place(np.array([[0.0, 0.8]]))[0])
    printed = replace(LOW, face=replace(LOW.face, x_mm=x_mm, y_mm=y_mm, width_mm=8.0), top_grey=grey)
    pictures, lamp = with_shadow(azimuth_deg, 0.45, [LOW, printed])
    assert judged_px(LOW.face, pictures, lamp) < judged_px(LOW.face, pictures, None) + 0.05


def test_a_good_fit_is_told_from_a_bad_one() -> None:
    pictures = pictures_of([BOX], noise=1.0)
    elsewhere = replace(BOX.face, x_mm=BOX.face.x_mm - 80.0)
    there, nowhere = fit_profiles([BOX.face, elsewhere], [False, False], pictures, rig(), TABLE_Z_MM, SETTLE)
    assert there is not None
    assert nowhere is not None
    assert there.rms_px < 0.15
    assert there.support > 0.95
    assert nowhere.support < 0.5


def test_an_outline_behind_the_camera_gives_no_fit() -> None:
    pictures = pictures_of([BOX], noise=1.0)
    above = replace(BOX.face, z_mm=700.0)
    fits = fit_profiles([above, BOX.face], [False, False], pictures, rig(), TABLE_Z_MM, SETTLE)
    assert fits[0] is None
    assert fits[1] is not None
    assert fit_profiles([], [], pictures, rig(), TABLE_Z_MM) == []


def test_the_blur_that_was_painted_is_picked() -> None:
    clean = paint([BOX], rig(), noise=0.0)
    picked = []
    # painted: pixel area (variance 1/12), and a Gaussian of 0.7
    for more in (0.0, 0.8):
        blurred = [cv2.GaussianBlur(image, (0, 0), more) if more else image for image in clean]
        pictures = Pictures.of(*(np.asarray(image, dtype=np.uint8) for image in blurred))
        picked.append(measure_blur([BOX.face], pictures, rig(), TABLE_Z_MM))
        painted = float(np.sqrt(0.7**2 + more**2 + 1.0 / 12.0))
        # reading between pixels widens a border a little
        nearest = sorted(BLURS_PX, key=lambda blur: abs(blur - painted))[:3]
        assert picked[-1] in nearest
    assert picked[0] < picked[1]
    assert measure_blur([], pictures, rig(), TABLE_Z_MM) == USUAL_BLUR_PX


def test_the_noise_is_measured() -> None:
    assert pictures_of([BOX], noise=2.0).noise == pytest.approx(2.0, rel=0.25)
    assert pictures_of([BOX], noise=0.0).noise == 0.5


def test_no_step_leads_an_inclined_face_into_the_table() -> None:
    # where nothing is seen nothing but the table holds it
    pictures = pictures_of([], noise=0.0)
    start = Face(Figure.RECTANGLE, 500.0, 50.0, TABLE_Z_MM + 4.0, 0.3, 40.0, 30.0, 0.6)
    assert start.lowest_mm < TABLE_Z_MM - 5.0
    (fit,) = fit_profiles([start], [True], pictures, rig(), TABLE_Z_MM)
    assert fit is not None
    assert fit.face.lowest_mm > TABLE_Z_MM - 1.1
