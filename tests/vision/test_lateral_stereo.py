import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from srvs_cell.geometry import Transform, Xyzwpr, equation_1
from srvs_cell.scene import PlaneMatch
from srvs_cell.vision.lateral_stereo import (
    equation_2,
    equation_3,
    equation_4,
    equation_5,
    equation_6,
    equations_7_8_9,
    image_coordinates_mm,
    paper_transform,
    place_surface,
    surfaces_from_matches,
)
from srvs_cell.vision.rectification import RectifiedRig
from tests.vision.painted import TABLE_Z_MM, cuboid, paint, planes, rig, wedge

finite = st.floats(allow_nan=False, allow_infinity=False)


def between(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False)


@given(
    pose=st.tuples(*[between(-1000, 1000)] * 3, *[between(-180, 180)] * 3),
    f_px=between(300, 3000),
    baseline_mm=between(5, 200),
    pitch_mm=between(0.001, 0.02),
    x_px=between(0, 639),
    y_px=between(0, 479),
    disparity_px=between(1, 200),
)
def test_the_papers_equations_agree_with_rectified_triangulation(
    pose: tuple[float, float, float, float, float, float],
    f_px: float,
    baseline_mm: float,
    pitch_mm: float,
    x_px: float,
    y_px: float,
    disparity_px: float,
) -> None:
    cameras = RectifiedRig(f_px, 320.0, 240.0, baseline_mm, Transform.from_xyzwpr("base", "camera_left", Xyzwpr(*pose)))
    x, y, d = np.array([x_px]), np.array([y_px]), np.array([disparity_px])
    f = f_px * pitch_mm
    x_L, y_L = image_coordinates_mm(cameras, x, y, pitch_mm)
    x_R, _ = image_coordinates_mm(cameras, x - d, y, pitch_mm)
    paper = np.stack(equations_7_8_9(x_L, y_L, x_R, f, baseline_mm, paper_transform(cameras, f)), axis=-1)
    general = cameras.points_mm(x, y, d)
    camera = cameras.base_T_camera.translation_mm
    assert np.abs(paper - general).max() <= 1e-9 * (np.linalg.norm(general - camera) + np.linalg.norm(camera))


@given(x=between(-300, 300), y=between(-300, 300), z=between(-2000, -100), f=between(2, 30), b=between(5, 100))
def test_equations_4_to_6_invert_2_and_3(x: float, y: float, z: float, f: float, b: float) -> None:
    point = np.array([x]), np.array([y]), np.array([z])
    x_L, y_L = equation_2(*point, f)
    x_R, y_R = equation_3(*point, f, b)
    assert y_L == pytest.approx(y_R, rel=1e-12, abs=1e-12)
    assert equation_4(x_L, x_R, b)[0] == pytest.approx(x, rel=1e-9, abs=1e-9)
    assert equation_5(y_L, x_L, x_R, b)[0] == pytest.approx(y, rel=1e-9, abs=1e-9)
    assert equation_6(x_L, x_R, f, b)[0] == pytest.approx(z, rel=1e-9, abs=1e-9)


def test_equations_7_to_9_are_equation_1_applied_to_4_to_6() -> None:
    T_R_C = equation_1(100.0, -50.0, 400.0, 170.0, 4.0, 30.0)
    x_L, y_L, x_R = np.array([1.2]), np.array([-0.7]), np.array([0.9])
    f, b = 6.0, 30.0
    camera = np.array([equation_4(x_L, x_R, b)[0], equation_5(y_L, x_L, x_R, b)[0], equation_6(x_L, x_R, f, b)[0], 1.0])
    base = np.array(equations_7_8_9(x_L, y_L, x_R, f, b, T_R_C)).ravel()
    assert base == pytest.approx((T_R_C @ camera)[:3], rel=1e-12)


def test_matched_planes_get_their_place_and_normal() -> None:
    cameras = rig()
    parts = [
        cuboid(470.0, 100.0, 60.0, 20.0, (50.0, 30.0), 200),
        wedge(540.0, 10.0, 10.0, 32.0, 70.0, (48.0, 32.0), 210),
    ]
    left, _, matches = planes(parts, cameras, paint(parts, cameras), disparity_noise_px=0.0)
    surfaces = surfaces_from_matches(left, matches, cameras)
    assert [surface.id for surface in surfaces] == [1, 2]
    for surface, part in zip(surfaces, parts, strict=True):
        true = np.array([part.face.x_mm, part.face.y_mm, part.face.z_mm])
        # the middle of a picture of an inclined face is not quite the picture of its middle, but lies on it
        assert np.linalg.norm(np.array(surface.centre_mm) - true) < 2.0
        assert abs(np.dot(surface.normal, np.array(surface.centre_mm) - true)) < 1e-6
        normal = np.array(
            [-part.face.slope_u * np.cos(part.face.angle_rad), -part.face.slope_u * np.sin(part.face.angle_rad), 1.0]
        )
        assert np.array(surface.normal) == pytest.approx(normal / np.linalg.norm(normal), abs=1e-9)
        heights = surface.outline_mm[:, 2]
        assert heights.max() <= part.face.highest_mm + 0.5
        assert heights.min() > TABLE_Z_MM
        assert np.linalg.eigvalsh(surface.covariance_mm2).min() > 0.0


def test_a_match_behind_the_cameras_has_no_place() -> None:
    cameras = rig()
    parts = [cuboid(470.0, 100.0, 60.0, 20.0, (50.0, 30.0), 200)]
    left, _, _ = planes(parts, cameras, paint(parts, cameras), disparity_noise_px=0.0)
    assert surfaces_from_matches(left, [PlaneMatch(1, 1, 0.9, -3.0, (0.0, 0.0, -3.0))], cameras) == ()


def test_without_systematic_errors_the_covariance_is_that_of_pixel_and_disparity() -> None:
    cameras = rig()
    match = PlaneMatch(1, 1, 0.9, 40.0, (0.0, 0.0, 40.0), 0.3)
    border = np.array([[250.0, 150.0], [300.0, 150.0], [300.0, 190.0], [250.0, 190.0]])
    measured = place_surface(border, (275.0, 170.0), match, cameras, systematic=False)
    whole = place_surface(border, (275.0, 170.0), match, cameras)
    assert measured is not None
    assert whole is not None
    causes = cameras.error_budget.point_errors(whole.centre_mm, sigma_x_px=0.3, sigma_d_px=0.3)
    random_mm2 = causes["pixel_x"] + causes["pixel_y"] + causes["disparity"]
    assert measured.covariance_mm2 == pytest.approx(random_mm2, rel=1e-3, abs=1e-6)
    assert (np.diag(whole.covariance_mm2) > np.diag(measured.covariance_mm2)).all()
