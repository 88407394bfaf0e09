import numpy as np
import pytest

from srvs_cell.calibration import ErrorBudget, Uncertainty
from srvs_cell.geometry import Transform, Xyzwpr

F_PX, BASELINE_MM = 800.0, 30.0
CAMERA = Transform.from_xyzwpr("base", "camera_left", Xyzwpr(500.0, 50.0, 500.0, 177.0, 2.0, 30.0))
POINT = CAMERA.apply([30.0, -20.0, 420.0])
NONE = Uncertainty(
    focal_relative=0.0, principal_point_px=0.0, hand_eye_mm=0.0, hand_eye_deg=0.0, pose_mm=0.0, pose_deg=0.0
)


def budget(uncertainty: Uncertainty) -> ErrorBudget:
    return ErrorBudget(F_PX, BASELINE_MM, CAMERA, (-40.0, 25.0, -12.0), uncertainty)


def along_depth(covariance: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float:
    axis = CAMERA.rotation[:, 2]
    return float(np.sqrt(axis @ covariance @ axis))


def test_disparity_noise_gives_the_textbook_depth_error() -> None:
    covariance = budget(NONE).covariance_mm2(POINT, sigma_x_px=0.0, sigma_d_px=0.1)
    assert along_depth(covariance) == pytest.approx(420.0**2 / (F_PX * BASELINE_MM) * 0.1, rel=1e-6)


def test_focal_length_scales_depth() -> None:
    covariance = budget(Uncertainty(**{**vars_of(NONE), "focal_relative": 0.002})).systematic_mm2(POINT)
    assert along_depth(covariance) == pytest.approx(0.002 * 420.0, rel=1e-5)


def test_unwanted_yaw_costs_what_the_house_plan_says() -> None:
    """0.02 deg of unwanted yaw during a 30 mm move looks like 1.9 mm of depth (f 800 px, Z 400 mm)."""
    point = CAMERA.apply([0.0, 0.0, 400.0])
    covariance = budget(Uncertainty(**{**vars_of(NONE), "pose_deg": 0.02})).systematic_mm2(point)
    assert along_depth(covariance) == pytest.approx(1.9, abs=0.05)


def test_hand_eye_position_shifts_everything_alike() -> None:
    covariance = budget(Uncertainty(**{**vars_of(NONE), "hand_eye_mm": 0.3})).systematic_mm2(POINT)
    assert covariance == pytest.approx(0.09 * np.eye(3), abs=1e-6)


def test_linear_covariance_agrees_with_drawing_errors() -> None:
    model = budget(Uncertainty())
    jacobian = model.jacobian(POINT)
    sigmas = np.array(
        [0.2, 0.2, 0.1, 0.001, 0.5, 0.5, *[0.3] * 3, *[np.deg2rad(0.05)] * 3, *[0.03] * 3, *[np.deg2rad(0.005)] * 3]
    )
    rng = np.random.default_rng(5)
    camera_point = CAMERA.inverse().apply(POINT)
    drawn = np.array([model._estimate(camera_point, rng.normal(0.0, sigmas)) for _ in range(4000)])
    empirical = CAMERA.rotation @ np.cov(drawn.T) @ CAMERA.rotation.T
    linear = model.covariance_mm2(POINT, sigma_x_px=0.2, sigma_d_px=0.1)
    assert linear == pytest.approx((jacobian * sigmas**2) @ jacobian.T, rel=1e-9)
    assert np.linalg.norm(empirical - linear) < 0.1 * np.linalg.norm(linear)


def test_causes_add_up_and_random_ones_are_not_systematic() -> None:
    model = budget(Uncertainty())
    causes = model.point_errors(POINT, sigma_x_px=0.2, sigma_d_px=0.1)
    total = model.covariance_mm2(POINT, sigma_x_px=0.2, sigma_d_px=0.1)
    assert sum(causes.values()) == pytest.approx(total)
    random = causes["pixel_x"] + causes["pixel_y"] + causes["disparity"]
    assert model.systematic_mm2(POINT) == pytest.approx(total - random)


def test_points_together_have_the_covariances_of_each_alone() -> None:
    model = budget(Uncertainty())
    points = CAMERA.apply([[30.0, -20.0, 420.0], [-60.0, 10.0, 510.0]])
    together = model.covariance_mm2(points, sigma_x_px=0.2, sigma_d_px=[0.1, 0.3])
    alone = [
        model.covariance_mm2(point, sigma_x_px=0.2, sigma_d_px=s) for point, s in zip(points, (0.1, 0.3), strict=True)
    ]
    assert together == pytest.approx(np.array(alone))


def vars_of(uncertainty: Uncertainty) -> dict[str, float]:
    names = ("focal_relative", "principal_point_px", "hand_eye_mm", "hand_eye_deg", "pose_mm", "pose_deg")
    return {name: float(getattr(uncertainty, name)) for name in names}
