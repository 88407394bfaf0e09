from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from srvs_cell.calibration import TableReference
from srvs_cell.geometry import wrap_angle_deg
from srvs_cell.scene import UNKNOWN_KIND, PlaneImage, Workpiece
from srvs_cell.vision.faces.face import Face, Figure
from srvs_cell.vision.lateral_stereo import surfaces_from_matches
from srvs_cell.vision.recognition import RecognitionParameters, recognise
from srvs_cell.vision.recognition.grasping import GraspParameters, plan_grasp
from srvs_cell.vision.rectification import RectifiedPair
from srvs_cell.vision.refinement import GreyPair
from srvs_cell.vision.relief import measure_relief
from tests.vision.painted import TABLE_Z_MM, Part, cuboid, cylinder, paint, planes, prism, rig, wedge

PARTS = [
    cuboid(470.0, 100.0, 60.0, 20.0, (50.0, 30.0), 200),
    cylinder(560.0, 90.0, 80.0, 36.0, 60),
    prism(440.0, 20.0, 40.0, 10.0, 44.0, 180),
    wedge(540.0, 10.0, 10.0, 32.0, 70.0, (48.0, 32.0), 210),
]


def see(parts: list[Part], parameters: RecognitionParameters | None = None) -> tuple[Workpiece, ...]:
    cameras = rig()
    images = paint(parts, cameras)
    left, right, matches = planes(parts, cameras, images, disparity_noise_px=0.4)
    return recognise(surfaces_from_matches(left, matches, cameras), left, right, cameras, TABLE_Z_MM, parameters)


def see_at(
    at_px: tuple[float, float], reference: TableReference | None = None, *, matched: bool = False
) -> tuple[Part, Workpiece]:
    """Return a cuboid whose top has its middle at a pixel of the left picture, and the one workpiece seen."""
    cameras = rig()
    a, b, c = cameras.plane_disparity(np.array([0.0, 0.0, 1.0]), TABLE_Z_MM + 60.0)
    x, y = at_px
    x_mm, y_mm, _ = cameras.points_mm(np.array([x]), np.array([y]), np.array([a * x + b * y + c]))[0]
    part = cuboid(float(x_mm), float(y_mm), 60.0, 30.0, (50.0, 36.0), 200)
    left, right, matches = planes([part], cameras, paint([part], cameras), disparity_noise_px=0.0)
    everywhere = np.ones(left.grey.shape, dtype=np.bool_)
    pair = RectifiedPair(left.grey, right.grey, everywhere, everywhere, cameras)
    relief = measure_relief(pair, GreyPair.of(left.grey, right.grey), TABLE_Z_MM, None)
    surfaces = surfaces_from_matches(left, matches, cameras) if matched else ()
    (workpiece,) = recognise(surfaces, left, right, cameras, TABLE_Z_MM, reference=reference, relief=relief)
    return part, workpiece


def of_surface(workpieces: tuple[Workpiece, ...], surface: int) -> Workpiece:
    return next(workpiece for workpiece in workpieces if surface in workpiece.surfaces)


@pytest.fixture(scope="module")
def seen() -> tuple[Workpiece, ...]:
    return see(PARTS)


@pytest.mark.parametrize("number", range(1, 5))
def test_kind_place_and_size_of_each_part(seen: tuple[Workpiece, ...], number: int) -> None:
    part = PARTS[number - 1]
    workpiece = of_surface(seen, number)
    true = np.array([part.face.x_mm, part.face.y_mm, part.face.z_mm])
    assert workpiece.kind == part.kind
    assert np.linalg.norm(np.array(workpiece.position_mm) - true) < 0.8
    assert workpiece.height_mm == pytest.approx(part.face.highest_mm - TABLE_Z_MM, abs=1.0)
    assert workpiece.size_mm == pytest.approx((part.face.length_mm, part.face.width_mm), abs=0.7)
    if part.kind in {"cuboid", "wedge"}:
        assert workpiece.yaw_deg is not None
        assert abs(wrap_angle_deg(workpiece.yaw_deg - np.rad2deg(part.face.angle_rad), 180.0)) < 0.6
    else:
        assert workpiece.yaw_deg is None


def test_only_the_wedge_rises_and_it_is_known_where_to(seen: tuple[Workpiece, ...]) -> None:
    rises = [workpiece.rise_deg for workpiece in seen if workpiece.kind != "wedge"]
    assert rises == [None] * 3
    upwards = PARTS[3].face.normal()
    rise_deg = of_surface(seen, 4).rise_deg
    assert rise_deg is not None
    assert abs(wrap_angle_deg(rise_deg - np.rad2deg(np.arctan2(-upwards[1], -upwards[0])), 360.0)) < 0.6


@pytest.mark.parametrize("number", range(1, 5))
def test_brightness_is_that_of_the_top_face_alone(seen: tuple[Workpiece, ...], number: int) -> None:
    # the painter makes side faces half as bright as the top
    assert of_surface(seen, number).brightness == pytest.approx(PARTS[number - 1].top_grey, abs=1.0)


def test_every_part_once_highest_first(seen: tuple[Workpiece, ...]) -> None:
    assert len(seen) == len(PARTS)
    assert [workpiece.id for workpiece in seen] == list(range(len(PARTS)))
    heights = [workpiece.height_mm for workpiece in seen]
    assert heights == sorted(heights, reverse=True)


def test_covariance_is_that_of_the_error_budget_or_more(seen: tuple[Workpiece, ...]) -> None:
    for workpiece in seen:
        assert np.allclose(workpiece.covariance_mm2, workpiece.covariance_mm2.T)
        systematic = rig().error_budget.systematic_mm2(workpiece.position_mm)
        assert workpiece.systematic_mm2 == pytest.approx(systematic)
        # across the line of sight no part is claimed to be known to less than 0.08 px
        mm_per_px = (rig().base_T_camera.translation_mm[2] - workpiece.position_mm[2]) / rig().f_px
        assert np.linalg.eigvalsh(workpiece.covariance_mm2 - systematic).min() > (0.079 * mm_per_px) ** 2
        sigma_z = float(np.sqrt(workpiece.covariance_mm2[2, 2]))
        assert 0.5 < sigma_z < 3.0


def test_flat_print_on_the_table_is_no_workpiece() -> None:
    assert see([cuboid(500.0, 50.0, 0.5, 20.0, (50.0, 30.0), 200)]) == ()


def test_label_printed_on_a_top_belongs_to_it() -> None:
    box = cuboid(500.0, 50.0, 50.0, 20.0, (60.0, 40.0), 200)
    label = Part(
        "label", Face(Figure.RECTANGLE, 500.0, 50.0, TABLE_Z_MM + 50.0, box.face.angle_rad, 24.0, 14.0), 90, 200
    )
    workpieces = see([box, label])
    assert [workpiece.kind for workpiece in workpieces] == ["cuboid"]
    assert workpieces[0].size_mm == pytest.approx((60.0, 40.0), abs=0.7)
    assert set(workpieces[0].surfaces) == {1, 2}
    assert workpieces[0].brightness == pytest.approx(200.0, abs=1.0)


def test_part_without_a_matched_plane_is_recovered_and_can_be_switched_off() -> None:
    parts = [PARTS[0]]
    cameras = rig()
    images = paint(parts, cameras)
    left, right, _ = planes(parts, cameras, images, disparity_noise_px=0.0)
    found = recognise((), left, right, cameras, TABLE_Z_MM)
    assert [workpiece.kind for workpiece in found] == ["cuboid"]
    assert recognise((), left, right, cameras, TABLE_Z_MM, RecognitionParameters(recover=False)) == ()


def test_strange_shape_is_reported_as_unknown_with_its_surface() -> None:
    cameras = rig()
    part = cuboid(500.0, 50.0, 50.0, 20.0, (60.0, 40.0), 200)
    images = paint([part], cameras)
    left, right, matches = planes([part], cameras, images, disparity_noise_px=0.0)
    # no edge of any figure in the pictures: only the surface itself is left
    blank = np.full_like(images[0], 110)
    left, right = (PlaneImage(blank, image.labels, image.planes) for image in (left, right))
    (workpiece,) = recognise(surfaces_from_matches(left, matches, cameras), left, right, cameras, TABLE_Z_MM)
    assert workpiece.kind == UNKNOWN_KIND
    assert workpiece.surfaces == (1,)
    assert workpiece.grasp is None
    assert workpiece.grasp_refusal
    assert workpiece.brightness == 110.0


@pytest.mark.parametrize(
    ("at_px", "cut_off"),
    [
        ((10.0, 240.0), True),
        # wholly in the left picture; the right one shows a third of it
        ((40.0, 240.0), True),
        ((300.0, 470.0), True),
        ((320.0, 4.0), True),
        ((636.0, 240.0), True),
        ((320.0, 240.0), False),
    ],
)
def test_what_a_picture_cuts_off_is_no_smaller_part_and_told_to_be_cut_off(
    at_px: tuple[float, float], *, cut_off: bool
) -> None:
    _, workpiece = see_at(at_px)
    assert workpiece.kind == (UNKNOWN_KIND if cut_off else "cuboid")
    assert ("border cuts it off" in workpiece.grasp_refusal) is cut_off


@pytest.mark.parametrize(("matched", "surfaces"), [(False, ()), (True, (1,))])
def test_what_is_unknown_is_told_with_the_planes_that_were_matched_there(
    surfaces: tuple[int, ...], *, matched: bool
) -> None:
    _, workpiece = see_at((300.0, 470.0), matched=matched)
    assert workpiece.kind == UNKNOWN_KIND
    assert workpiece.surfaces == surfaces


@pytest.mark.parametrize(("at_px", "kind"), [((10.0, 240.0), UNKNOWN_KIND), ((320.0, 240.0), "cuboid")])
def test_the_table_corrects_what_is_known_and_what_is_unknown(at_px: tuple[float, float], kind: str) -> None:
    cameras = rig()
    unmeasured = TableReference.unmeasured(cameras.error_budget, (cameras.cx_px, cameras.cy_px), TABLE_Z_MM, (640, 480))
    # each of the errors half as large as expected
    reference = replace(unmeasured, errors=0.5 * np.sqrt(np.diag(unmeasured.covariance)))
    _, plain = see_at(at_px)
    _, told = see_at(at_px, reference)
    assert plain.kind == told.kind == kind
    correction_mm, systematic_mm2 = reference.at(plain.position_mm)
    assert np.linalg.norm(correction_mm) > 0.3
    assert np.array(told.position_mm) - plain.position_mm == pytest.approx(correction_mm)
    # outlines are single precision
    moved_mm = told.footprint_mm.max(axis=0) - plain.footprint_mm.max(axis=0)
    assert moved_mm == pytest.approx(correction_mm[:2], abs=1e-3)
    assert told.systematic_mm2 == pytest.approx(systematic_mm2)
    assert plain.systematic_mm2 is not None
    random_mm2 = plain.covariance_mm2 - plain.systematic_mm2
    assert told.covariance_mm2 - systematic_mm2 == pytest.approx(random_mm2, abs=2e-5)


@pytest.mark.parametrize("x_px", [60.0, 75.0])
def test_what_only_one_picture_cuts_off_is_known_but_too_unsure_to_be_taken(x_px: float) -> None:
    part, workpiece = see_at((x_px, 240.0))
    assert workpiece.kind == "cuboid"
    assert workpiece.size_mm == pytest.approx((50.0, 36.0), abs=2.0)
    off_mm = np.array(workpiece.position_mm) - (part.face.x_mm, part.face.y_mm, part.face.z_mm)
    assert off_mm @ np.linalg.solve(workpiece.covariance_mm2, off_mm) < chi2.ppf(0.95, df=3)
    assert workpiece.grasp is None
    assert "uncertain" in workpiece.grasp_refusal


def test_jaws_close_along_the_short_side(seen: tuple[Workpiece, ...]) -> None:
    grasp = of_surface(seen, 1).grasp
    assert grasp is not None
    assert abs(wrap_angle_deg(grasp.yaw_deg - (20.0 + 90.0), 180.0)) < 1.0
    assert grasp.opening_mm == pytest.approx(30.0, abs=0.7)
    assert TABLE_Z_MM < grasp.position_mm[2] < TABLE_Z_MM + 60.0


def test_jaws_close_across_the_slope_of_a_wedge() -> None:
    face = Face(Figure.RECTANGLE, 0.0, 0.0, 20.0, 0.0, 30.0, 40.0, slope_u=0.4)
    grasp, refusal = plan_grasp(face, 0.01 * np.eye(3), 0.0, GraspParameters())
    assert refusal == ""
    assert grasp is not None
    assert grasp.yaw_deg == pytest.approx(90.0)
    assert grasp.opening_mm == pytest.approx(40.0)


@pytest.mark.parametrize(
    ("face", "sigma_mm", "reason"),
    [
        (Face(Figure.RECTANGLE, 0.0, 0.0, 30.0, 0.0, 120.0, 100.0), 0.1, "too wide"),
        (Face(Figure.CIRCLE, 0.0, 0.0, 4.0, 0.0, 30.0, 30.0), 0.1, "too low"),
        (Face(Figure.CIRCLE, 0.0, 0.0, 40.0, 0.0, 30.0, 30.0), 3.0, "uncertain"),
    ],
)
def test_refusal_names_the_reason(face: Face, sigma_mm: float, reason: str) -> None:
    grasp, refusal = plan_grasp(face, sigma_mm**2 * np.eye(3), 0.0, GraspParameters())
    assert grasp is None
    assert reason in refusal


@pytest.mark.parametrize("grown_mm", [4.0, 8.0, 12.0])
def test_a_region_with_a_sliver_of_side_face_is_measured_without_it(grown_mm: float) -> None:
    part = cuboid(500.0, 50.0, 50.0, 0.0, (60.0, 40.0), 200)
    cameras = rig()
    left, right, matches = planes([part], cameras, paint([part], cameras), disparity_noise_px=0.1)
    (surface,) = surfaces_from_matches(left, matches, cameras)
    outline = surface.outline_mm + np.where(surface.outline_mm[:, :1] > 500.0, (grown_mm, 0.0, 0.0), 0.0)
    everywhere = np.ones(left.grey.shape, dtype=np.bool_)
    pair = RectifiedPair(left.grey, right.grey, everywhere, everywhere, cameras)
    relief = measure_relief(pair, GreyPair.of(left.grey, right.grey), TABLE_Z_MM, None)
    grown = replace(surface, outline_mm=outline)
    (workpiece,) = recognise([grown], left, right, cameras, TABLE_Z_MM, relief=relief)
    assert workpiece.kind == "cuboid"
    assert workpiece.size_mm == pytest.approx((60.0, 40.0), abs=0.7)


def test_a_steep_false_match_on_the_side_of_a_part_belongs_to_it() -> None:
    part = cuboid(500.0, 50.0, 50.0, 0.0, (60.0, 40.0), 200)
    cameras = rig()
    left, right, matches = planes([part], cameras, paint([part], cameras), disparity_noise_px=0.1)
    (surface,) = surfaces_from_matches(left, matches, cameras)
    normal = (float(np.sin(0.75)), 0.0, float(np.cos(0.75)))
    outline = np.array([[526.0, 30.0, 28.0], [546.0, 30.0, 12.0], [546.0, 70.0, 12.0], [526.0, 70.0, 28.0]])
    outline[:, 2] += TABLE_Z_MM
    side = replace(surface, id=7, centre_mm=(536.0, 50.0, TABLE_Z_MM + 20.0), normal=normal, outline_mm=outline)
    (workpiece,) = recognise([surface, side], left, right, cameras, TABLE_Z_MM)
    assert set(workpiece.surfaces) == {1, 7}
