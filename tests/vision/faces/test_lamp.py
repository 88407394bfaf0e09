"""Where the lamp stands, in painted pictures with shadows."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from srvs_cell.vision.faces.edge_fit import EdgeField
from srvs_cell.vision.faces.lamp import FoundLamps, find_lamps
from srvs_cell.vision.faces.profile_fit import measure_lamp
from srvs_cell.vision.faces.profiles import Pictures
from tests.vision.painted import SHADOW_GREY, TABLE_GREY, TABLE_Z_MM, Part, cuboid, cylinder, paint, prism, rig, wedge

if TYPE_CHECKING:
    from srvs_cell.vision.faces.shadows import Lamp

PARTS = [
    cuboid(440.0, 20.0, 60.0, 20.0, (50.0, 36.0), 200),
    cylinder(560.0, 10.0, 40.0, 40.0, 60),
    prism(540.0, 110.0, 70.0, 15.0, 44.0, 160),
    wedge(440.0, 120.0, 15.0, 45.0, 70.0, (50.0, 40.0), 90),
]
LAMPS_MM = [(900.0, 350.0, 1300.0), (480.0, -550.0, 1500.0), (100.0, 90.0, 2500.0), (640.0, 160.0, 900.0)]


def look_for(
    parts: list[Part], known: list[Part], lamp_mm: tuple[float, float, float] | None, seed: int = 0
) -> tuple[FoundLamps, Pictures]:
    left, right = paint(parts, rig(), noise=1.5, seed=seed, lamp_mm=lamp_mm)
    found = find_lamps([part.face for part in known], EdgeField.of(left), left, rig(), TABLE_Z_MM)
    return found, Pictures.of(left, right)


def find(
    parts: list[Part], known: list[Part], lamp_mm: tuple[float, float, float] | None, seed: int = 0
) -> Lamp | None:
    found, pictures = look_for(parts, known, lamp_mm, seed)
    return found.certain or measure_lamp(found.likely, [part.face for part in known], pictures, rig(), TABLE_Z_MM)


def errors_mm(lamp: Lamp, lamp_mm: tuple[float, float, float], parts: list[Part]) -> list[float]:
    """Return how far off the shadows of the parts' middles are."""
    middles = np.array([(part.face.x_mm, part.face.y_mm, part.face.z_mm) for part in parts])
    place = np.array(lamp_mm)
    thrown = place + (middles - place) * ((place[2] - TABLE_Z_MM) / (place[2] - middles[:, 2]))[:, None]
    off = lamp.shadows_mm(middles.T).T - thrown[:, :2]
    return [float(error) for error in np.hypot(*off.T)]


@pytest.mark.parametrize("lamp_mm", LAMPS_MM)
def test_the_shadows_of_known_parts_tell_the_lamp(lamp_mm: tuple[float, float, float]) -> None:
    lamp = find(PARTS, PARTS, lamp_mm)
    assert lamp is not None
    assert max(errors_mm(lamp, lamp_mm, PARTS)) < 0.3
    assert lamp.shade == pytest.approx(SHADOW_GREY / TABLE_GREY, abs=0.03)


@pytest.mark.parametrize("number", range(3))
def test_one_part_tells_its_own_shadow(number: int) -> None:
    part = PARTS[number]
    lamp = find([part], [part], LAMPS_MM[0])
    assert lamp is not None
    assert max(errors_mm(lamp, LAMPS_MM[0], [part])) < 0.5


def test_a_part_known_wrongly_does_not_lead_the_others_astray() -> None:
    wrong = replace(PARTS[3], face=replace(PARTS[3].face, z_mm=PARTS[3].face.z_mm + 15.0))
    lamp = find(PARTS, [*PARTS[:3], wrong], LAMPS_MM[0])
    assert lamp is not None
    assert max(errors_mm(lamp, LAMPS_MM[0], PARTS)) < 0.6


@pytest.mark.parametrize("seed", range(3))
def test_where_nothing_throws_a_shadow_no_lamp_is_found(seed: int) -> None:
    assert find(PARTS, PARTS, None, seed) is None


def test_shadows_of_parts_that_are_not_known_tell_nothing() -> None:
    elsewhere = [replace(part, face=replace(part.face, x_mm=part.face.x_mm + 30.0)) for part in PARTS]
    assert find(PARTS, elsewhere, LAMPS_MM[0]) is None
    assert find(PARTS, [], LAMPS_MM[0]) is None


@pytest.mark.parametrize("lamp_mm", LAMPS_MM)
def test_where_all_shadows_meet_an_edge_the_lamp_is_certain(lamp_mm: tuple[float, float, float]) -> None:
    found, _ = look_for(PARTS[:3], PARTS[:3], lamp_mm)
    assert found.certain is not None
    assert found.likely == ()
    assert max(errors_mm(found.certain, lamp_mm, PARTS[:3])) < 0.3


def test_where_shadows_of_faces_meet_nothing_no_lamp_is_certain() -> None:
    larger = replace(PARTS[0], face=replace(PARTS[0].face, length_mm=80.0, width_mm=60.0))
    found, _ = look_for(PARTS, [larger, *PARTS[1:]], LAMPS_MM[0])
    assert found.certain is None
    assert len(found.likely) >= 1


@pytest.mark.parametrize("seed", range(3))
def test_no_lamp_is_certain_where_nothing_throws_a_shadow(seed: int) -> None:
    found, _ = look_for(PARTS, PARTS, None, seed)
    assert found.certain is None


def test_a_lamp_that_explains_less_than_none_is_not_taken() -> None:
    left, right = paint(PARTS, rig(), noise=1.5, lamp_mm=LAMPS_MM[0])
    faces, pictures = [part.face for part in PARTS], Pictures.of(left, right)
    true = find(PARTS, PARTS, LAMPS_MM[0])
    assert true is not None
    opposite = replace(true, lean=(-true.lean[0], -true.lean[1]))
    assert measure_lamp([opposite], faces, pictures, rig(), TABLE_Z_MM) is None
    assert measure_lamp([opposite, true], faces, pictures, rig(), TABLE_Z_MM) is true
