"""What the relief over the table says of top faces that the edges told."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from srvs_cell.scene import UNKNOWN_KIND, PlaneImage
from srvs_cell.vision.faces.edge_fit import FaceFit
from srvs_cell.vision.faces.profile_fit import fit_profiles
from srvs_cell.vision.recognition import RecognitionParameters, recognise
from srvs_cell.vision.recognition.evidence import Evidence
from srvs_cell.vision.recognition.face_sources import Sources
from srvs_cell.vision.recognition.tops import Top
from srvs_cell.vision.recognition.verification import _bench_for, verify_tops
from srvs_cell.vision.rectification import RectifiedPair
from srvs_cell.vision.refinement import GreyPair
from srvs_cell.vision.relief import measure_relief
from tests.vision.painted import SIZE, TABLE_Z_MM, cuboid, cylinder, paint, planes, rig

if TYPE_CHECKING:
    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces.face import Face
    from srvs_cell.vision.rectification import RectifiedRig
    from tests.vision.painted import Part

BOX = cuboid(490.0, 80.0, 40.0, 20.0, (60.0, 40.0), 180)
SHADOW = cuboid(520.0, 0.0, 0.0, 40.0, (50.0, 40.0), 70)


# print has no side faces
LABEL = replace(cuboid(490.0, 80.0, 40.0, 20.0, (22.0, 18.0), 70), side_grey=180)


def verified(parts: list[Part], tops: list[Top], cameras: RectifiedRig | None = None) -> tuple[list[Top], list[Array]]:
    """Verify tops against the picture of parts; no plane was found in it."""
    cameras = cameras or rig()
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


def in_two_lights(shaded_mm: float) -> list[Part]:
    """Return a part and the shadow on its near end, whose only side that would be painted on the part faces away."""
    along = np.array([np.cos(np.deg2rad(110.0)), np.sin(np.deg2rad(110.0))])
    x_mm, y_mm = (float(value) for value in (490.0, 80.0) - along * (30.0 - shaded_mm / 2.0))
    shade = replace(cuboid(x_mm, y_mm, 40.0, 110.0, (shaded_mm, 40.0), 70), side_grey=90)
    return [cuboid(490.0, 80.0, 40.0, 110.0, (60.0, 40.0), 180), shade]


def lit(part: Part, shade: Part) -> Face:
    """Return what is left of the part's top."""
    shaded_mm = shade.face.length_mm
    x_mm, y_mm, _ = part.face.place(np.array([[shaded_mm / 60.0, 0.0]]))[0]
    return replace(part.face, x_mm=float(x_mm), y_mm=float(y_mm), length_mm=60.0 - shaded_mm)


def test_the_search_begins_at_the_height_that_what_rises_tells(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the other heights only the lowest is left, 80 mm below."""
    monkeypatch.setattr("srvs_cell.vision.recognition.rising_faces._HEIGHTS", 1)
    part = cylinder(500.0, 60.0, 90.0, 40.0, 150)
    standing, unseen = verified([part], [])
    (face,) = [one.fit.face for one in standing]
    assert face.z_mm == pytest.approx(part.face.z_mm, abs=1.0)
    assert face.length_mm == pytest.approx(40.0, abs=0.5)
    assert unseen == []


def test_the_search_also_begins_without_the_side_faces(monkeypatch: pytest.MonkeyPatch) -> None:
    part = cylinder(600.0, 110.0, 100.0, 28.0, 200)
    begun: list[tuple[float, float, float]] = []
    elsewhere_mm = np.array([[370.0, -300.0], [400.0, -340.0], [430.0, -300.0], [400.0, -260.0]])

    def recorded(starts: list[Face], *arguments: Any) -> list[FaceFit | None]:
        begun.extend((face.x_mm, face.y_mm, face.z_mm) for face in starts)
        return fit_profiles(starts, *arguments)

    monkeypatch.setattr("srvs_cell.vision.recognition.rising_faces.fit_profiles", recorded)
    monkeypatch.setattr("srvs_cell.vision.recognition.rising_faces.without_sides", lambda *_: elsewhere_mm)
    verified([part], [])
    assert any(np.allclose(place, (400.0, -300.0, part.face.z_mm), atol=3.0) for place in begun)


def test_a_top_that_is_not_certain_tells_the_blur_where_no_other_does(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[int] = []

    def measured(faces: list[Face], *_: object) -> float:
        told.append(len(faces))
        return 0.85

    monkeypatch.setattr("srvs_cell.vision.recognition.verification.measure_blur", measured)
    verified([BOX], [top(BOX.face, 0.3, 0)])
    assert told == [1]


def test_a_shadow_on_a_top_makes_no_second_part_of_it() -> None:
    part, shade = in_two_lights(22.0)
    standing, unseen = verified([part, shade], [top(lit(part, shade), 0.05, 3), top(shade.face, 0.05, 4)])
    ((face, surfaces),) = [(one.fit.face, one.surfaces) for one in standing]
    assert (face.x_mm, face.y_mm, face.z_mm) == pytest.approx((490.0, 80.0, TABLE_Z_MM + 40.0), abs=0.5)
    assert sorted((face.length_mm, face.width_mm)) == pytest.approx([40.0, 60.0], abs=0.5)
    assert sorted(surfaces) == [3, 4]
    assert unseen == []


def test_two_parts_of_one_size_stay_two() -> None:
    part, shade = in_two_lights(30.0)
    standing, _ = verified([part, shade], [top(lit(part, shade), 0.05, 3), top(shade.face, 0.05, 4)])
    assert sorted(one.surfaces for one in standing) == [(3,), (4,)]


def test_a_part_that_the_picture_cuts_off_is_not_taken_for_a_whole_one() -> None:
    # the picture ends within the part: what is seen of it is a rectangle, too
    cameras = rig(tilt_deg=0.0, yaw_deg=0.0)
    level = cameras.plane_disparity(np.array([0.0, 0.0, 1.0]), TABLE_Z_MM + 40.0)[2]
    ends = cameras.points_mm(np.full(3, 320.0), np.array([5.0, 20.0, 72.0]), np.full(3, level))
    x_mm, y_mm = (float(value) for value in ends[1, :2])
    seen_mm = float(np.linalg.norm(ends[2] - ends[0]))
    part = cuboid(x_mm, y_mm, 40.0, 0.0, (60.0, 2.0 * float(np.linalg.norm(ends[2] - ends[1]))), 180)
    face = replace(part.face, y_mm=float(ends[[0, 2], 1].mean()), width_mm=seen_mm)
    three_sides = FaceFit(face, 0.01 * np.eye(3), 0.3, 0.75)
    standing, unseen = verified([part], [Top(three_sides, (0,))], cameras)
    assert standing == []
    assert unseen


@pytest.mark.parametrize(("min_support", "least"), [(0.7, 0.55), (1.0, 0.786), (0.42, 0.33)])
def test_what_explains_what_rises_may_lack_more_of_its_outline_the_more_others_may(
    min_support: float, least: float
) -> None:
    left, right = paint([BOX], rig())
    nothing = np.zeros((SIZE[1], SIZE[0]), np.int32)
    seen = np.ones((SIZE[1], SIZE[0]), dtype=np.bool_)
    relief = measure_relief(RectifiedPair(left, right, seen, seen, rig()), GreyPair.of(left, right), TABLE_Z_MM, None)
    images = (PlaneImage(left, nothing, ()), PlaneImage(right, nothing, ()))
    evidence = Evidence.of(*images, rig(), TABLE_Z_MM, RecognitionParameters(min_support=min_support))
    lenient = Sources((), relief, evidence, _bench_for([], evidence, 0.5))._lenient
    possible = [lenient.possible(FaceFit(BOX.face, 0.01 * np.eye(3), 0.1, least + off)) for off in (0.005, -0.005)]
    assert possible == [True, False]
