"""How much of a face's outline lies on edges of both images."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from srvs_cell.vision.faces.edge_fit import EdgeField, fit_faces
from srvs_cell.vision.faces.glance import shares_on_edges
from srvs_cell.vision.faces.profiles import Pictures
from srvs_cell.vision.faces.witnesses import Bench
from tests.vision.painted import TABLE_Z_MM, cuboid, paint, rig, wedge

if TYPE_CHECKING:
    from srvs_cell.vision.faces.edge_fit import FaceFit
    from srvs_cell.vision.faces.face import Face

CAMERAS = rig()
TOP = cuboid(500.0, 70.0, 60.0, 20.0, (60.0, 40.0), 200)
SLANTED = wedge(430.0, 20.0, 20.0, 50.0, 60.0, (40.0, 30.0), 200)


def fields() -> tuple[EdgeField, EdgeField]:
    left, right = paint([TOP, SLANTED], CAMERAS)
    return EdgeField.of(left), EdgeField.of(right)


def test_a_true_face_lies_on_edges_and_one_elsewhere_does_not() -> None:
    elsewhere = replace(TOP.face, x_mm=430.0, y_mm=140.0)
    higher = replace(TOP.face, z_mm=TOP.face.z_mm + 60.0)
    shares = shares_on_edges([TOP.face, SLANTED.face, elsewhere, higher], fields(), CAMERAS)
    assert shares[:2] == pytest.approx([1.0, 1.0], abs=0.03)
    # noise alone has a gradient of half a grey value per pixel
    assert shares[2] < 0.35
    assert shares[3] < 0.6


def test_each_place_counts_by_the_fainter_of_its_edges() -> None:
    left, right = fields()
    blank = EdgeField.of(np.full(left.smooth.shape, 90, dtype=np.uint8))
    assert shares_on_edges([TOP.face], (left, blank), CAMERAS) == pytest.approx([0.0], abs=1e-3)
    assert shares_on_edges([TOP.face], (blank, right), CAMERAS) == pytest.approx([0.0], abs=1e-3)


def test_half_a_face_has_half_a_share() -> None:
    longer = replace(TOP.face, length_mm=120.0, x_mm=TOP.face.x_mm + 30.0 * np.cos(TOP.face.angle_rad))
    longer = replace(longer, y_mm=TOP.face.y_mm + 30.0 * np.sin(TOP.face.angle_rad))
    (share,) = shares_on_edges([longer], fields(), CAMERAS)
    assert 0.4 < share < 0.75


def test_what_is_behind_the_cameras_has_no_share() -> None:
    assert shares_on_edges([replace(TOP.face, z_mm=900.0)], fields(), CAMERAS) == pytest.approx([0.0])


def test_no_faces_have_no_shares() -> None:
    assert shares_on_edges([], fields(), CAMERAS).shape == (0,)


def test_of_the_faces_that_lines_span_only_those_on_edges_are_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    left, right = paint([TOP, SLANTED], CAMERAS)
    begun: list[Face] = []

    def recorded(starts: list[Face], *arguments: Any) -> list[FaceFit | None]:
        begun.extend(starts)
        return fit_faces(starts, *arguments)

    monkeypatch.setattr("srvs_cell.vision.faces.witnesses.fit_faces", recorded)
    bench = Bench(Pictures.of(left, right), fields(), CAMERAS, TABLE_Z_MM, 0.5, lambda _: True)
    elsewhere = replace(TOP.face, x_mm=430.0, y_mm=140.0)
    larger = replace(TOP.face, length_mm=140.0, width_mm=90.0)
    (found,) = bench.from_lines([elsewhere, TOP.face, larger], 1.2)
    assert begun == [TOP.face]
    assert found.by_profiles.face.z_mm == pytest.approx(TOP.face.z_mm, abs=0.5)
    begun.clear()
    # among faces that all have hardly an edge the best one is not worth a fit either
    assert bench.from_lines([elsewhere, larger], 1.2) == []
    assert begun == []
