"""What the relief over the table says of top faces that the edges told."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from srvs_cell.scene import UNKNOWN_KIND, PlaneImage
from srvs_cell.vision.evidence import Evidence
from srvs_cell.vision.face_fit import FaceFit
from srvs_cell.vision.recognition import RecognitionParameters, recognise
from srvs_cell.vision.rectification import RectifiedPair
from srvs_cell.vision.refinement import GreyPair
from srvs_cell.vision.relief import measure_relief
from srvs_cell.vision.tops import Top
from srvs_cell.vision.verification import verify_tops
from tests.vision.painted import SIZE, TABLE_Z_MM, cuboid, paint, planes, rig

if TYPE_CHECKING:
    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces import Face
    from tests.vision.painted import Part

BOX = cuboid(490.0, 80.0, 40.0, 20.0, (60.0, 40.0), 180)
SHADOW = cuboid(520.0, 0.0, 0.0, 40.0, (50.0, 40.0), 70)


# print has no side faces
LABEL = replace(cuboid(490.0, 80.0, 40.0, 20.0, (22.0, 18.0), 70), side_grey=180)


def verified(parts: list[Part], tops: list[Top]) -> tuple[list[Top], list[Array]]:
    """Verify tops against the picture of parts; no plane was found in it."""
    cameras = rig()
    left, right = paint(parts, cameras)
    seen = np.ones((SIZE[1], SIZE[0]), dtype=np.bool_)
    pair = RectifiedPair(left, right, seen, seen, cameras)
    relief = measure_relief(pair, GreyPair.of(left, right), TABLE_Z_MM, None)
    nothing = np.zeros((SIZE[1], SIZE[0]), np.int32)
    images = (PlaneImage(left, nothing, ()), PlaneImage(right, nothing, ()))
    return verify_tops(tops, (), relief, Evidence.of(*images, cameras, TABLE_Z_MM, RecognitionParameters()))


def top(face: Face, rms_px: float, surface: int) -> Top:
    return Top(FaceFit(face, 0.01 * np.eye(3), rms_px, 1.0), (surface,))


def test_a_face_stands_against_the_print_on_it() -> None:
    standing, unseen = verified([BOX, LABEL], [top(LABEL.face, 0.01, 0)])
    (face,) = [one.fit.face for one in standing]
    assert sorted((face.length_mm, face.width_mm)) == pytest.approx([40.0, 60.0], abs=0.5)
    assert unseen == []


def test_a_shadow_that_edges_took_for_a_top_is_dropped() -> None:
    # false matches gave the shadow a height: there it shares its place with no other face
    false = cuboid(520.0, 0.0, 10.0, 40.0, (50.0, 40.0), 70).face
    standing, unseen = verified([BOX, SHADOW], [top(BOX.face, 0.3, 0), top(false, 0.3, 1)])
    assert [one.surfaces for one in standing] == [(0,)]
    assert unseen == []


def test_what_rises_and_is_no_figure_comes_out_as_unknown() -> None:
    """A star that floats over the table has no outline that a top face has."""
    cameras = rig()
    turn = np.arange(10) * np.pi / 5.0
    reach = np.where(np.arange(10) % 2 == 0, 55.0, 18.0)
    star = np.column_stack([500.0 + reach * np.cos(turn), 50.0 + reach * np.sin(turn), np.full(10, TABLE_Z_MM + 50.0)])
    x, y, disparity = cameras.project_px(star)
    images = []
    for side, bare in enumerate(paint([], cameras)):
        corners = np.rint(np.column_stack([x - side * disparity, y]) * 16.0).astype(np.int32)
        cv2.fillPoly(bare, [corners], 190, cv2.LINE_AA, 4)
        images.append(bare)
    seen = np.ones((SIZE[1], SIZE[0]), dtype=np.bool_)
    pair = RectifiedPair(images[0], images[1], seen, seen, cameras)
    relief = measure_relief(pair, GreyPair.of(*images), TABLE_Z_MM, None)
    left, right, _ = planes([], cameras, images, disparity_noise_px=0.0)
    found = recognise((), left, right, cameras, TABLE_Z_MM, None, None, relief)
    assert UNKNOWN_KIND in {workpiece.kind for workpiece in found}
    unknown = next(workpiece for workpiece in found if workpiece.kind == UNKNOWN_KIND)
    assert np.hypot(unknown.position_mm[0] - 500.0, unknown.position_mm[1] - 50.0) < 30.0
    assert unknown.grasp is None


def test_a_top_of_its_shadow_s_grey_is_found_by_two_of_its_borders() -> None:
    # the shadow lies beside one of the top's sides: no region has the top's outline, and what rises tells too little
    dark = cuboid(540.0, 130.0, 80.0, 20.0, (60.0, 44.0), 60)
    shadow = cuboid(575.0, 130.0, 0.0, 20.0, (80.0, 44.0), 60)
    standing, unseen = verified([shadow, dark], [])
    (face,) = [one.fit.face for one in standing]
    assert (face.x_mm, face.y_mm, face.z_mm) == pytest.approx((540.0, 130.0, TABLE_Z_MM + 80.0), abs=0.5)
    assert sorted((face.length_mm, face.width_mm)) == pytest.approx([44.0, 60.0], abs=0.5)
    assert unseen == []
