"""What all pictures of all looks show, against a projection of its own."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
import yaml

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.calibration import Calibration, moved_aside, plan_right_pose
from srvs_cell.config import parse_config
from srvs_cell.config.embedded import embedded_config
from srvs_cell.geometry import Transform
from srvs_cell.ports import FindingLevel
from srvs_cell.service.common_view import CommonView
from srvs_cell.service.doctor import _places
from srvs_cell.service.equipment import make_unit
from tests.cli.test_doctor import CALIBRATION
from tests.planning.problems import workpiece

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from srvs_cell.config import CellConfig

CONFIG = parse_config(embedded_config(), "embedded")
LENSES = {
    "straight": (0.0, 0.0, 0.0, 0.0, 0.0),
    "barrel": (-0.2, 0.05, 0.001, -0.001, 0.0),
    "pincushion": (0.15, 0.0, 0.0, 0.0, 0.0),
}


def _calibration(lens: str = "straight") -> Calibration:
    calibration = Calibration.from_mapping(CALIBRATION, "test")
    return dataclasses.replace(calibration, camera=dataclasses.replace(calibration.camera, distortion=LENSES[lens]))


def _least_margins_px(
    calibration: Calibration, points_mm: NDArray[np.float64], *, from_aside: bool
) -> NDArray[np.float64]:
    """Return, per point (N, 3), how far inside the nearest border it lies in all pictures; negative outside."""
    cell = CONFIG.cell
    observe = Transform.from_xyzwpr("base", "tcp", cell.look.observe_pose.pose())
    lefts = [observe, *([moved_aside(calibration, observe, *cell.look.aside_mm)] if from_aside else [])]
    margins = []
    for left in lefts:
        for pose in (left, plan_right_pose(calibration, left, cell.look.baseline_mm)):
            camera_T_base = (pose @ calibration.tcp_T_camera).inverse()
            seen, _ = cv2.projectPoints(
                camera_T_base.apply(points_mm + np.array([0.0, 0.0, cell.table_z_mm])),
                np.zeros(3),
                np.zeros(3),
                calibration.camera_matrix,
                calibration.distortion,
            )
            x_px, y_px = seen.reshape(-1, 2).T
            width, height = calibration.image_size
            margins += [x_px, width - 1 - x_px, y_px, height - 1 - y_px]
    least: NDArray[np.float64] = np.min(margins, axis=0)
    return least


@pytest.mark.parametrize("from_aside", [False, True])
@pytest.mark.parametrize("lens", LENSES)
def test_what_is_in_view_is_inside_every_picture(lens: str, from_aside: bool) -> None:
    calibration = _calibration(lens)
    view = CommonView.of(CONFIG.cell, calibration)
    x_mm, y_mm, z_mm = np.meshgrid(np.arange(560.0, 960.0, 6.0), np.arange(-260.0, 280.0, 6.0), [0.0, 60.0, 110.0])
    points = np.stack([x_mm, y_mm, z_mm], axis=-1).reshape(-1, 3)
    seen, margin_px = (
        view.sees(points, from_aside=from_aside),
        _least_margins_px(calibration, points, from_aside=from_aside),
    )
    assert 0.2 < seen.mean() < 0.8
    assert margin_px[seen].min() > 2.0
    # Rectified pictures of a barrel lens leave out a part of the lens' own.
    if lens != "barrel":
        assert seen[margin_px > 8.0].mean() > 0.97


def test_a_part_of_the_view_is_lost_to_the_look_from_aside_and_to_height() -> None:
    view = CommonView.of(CONFIG.cell, _calibration())
    grid = np.stack(
        [*np.meshgrid(np.arange(560.0, 960.0, 4.0), np.arange(-260.0, 280.0, 4.0)), np.zeros((135, 100))], -1
    )
    low, aside = (view.sees(grid, from_aside=from_aside) for from_aside in (False, True))
    high = view.sees(grid + np.array([0.0, 0.0, 100.0]), from_aside=False)
    assert not (aside & ~low).any()
    assert not (high & ~low).any()
    assert low.sum() > aside.sum()
    assert low.sum() > high.sum()


def test_what_is_behind_the_camera_or_beside_everything_is_not_in_view() -> None:
    view = CommonView.of(CONFIG.cell, _calibration())
    points = np.array([[750.0, 0.0, 2000.0], [1e7, 0.0, 0.0], [750.0, 0.0, 0.0]])
    assert view.sees(points, from_aside=True).tolist() == [False, False, True]


def test_a_part_that_sticks_out_of_one_picture_is_not_shown() -> None:
    view = CommonView.of(CONFIG.cell, _calibration())
    part = workpiece(0, (750.0, 0.0), 60.0)
    assert view.shows(part)
    assert not view.shows(dataclasses.replace(part, footprint_mm=part.footprint_mm + np.array([0.0, 190.0])))
    assert not view.shows(dataclasses.replace(part, height_mm=400.0))


def _config(tmp_path: Path, place_mm: tuple[float, float]) -> CellConfig:
    return _with_planning(tmp_path, f"buffer_places_mm: [{list(place_mm)}]")


def _with_planning(tmp_path: Path, line: str) -> CellConfig:
    (tmp_path / "calibration.yaml").write_text(yaml.safe_dump(CALIBRATION), encoding="utf-8")
    text = embedded_config().replace("planning:\n", f"planning:\n  {line}\n")
    return parse_config(text, "cell.yaml", folder=tmp_path)


def test_a_buffer_place_that_no_look_sees_is_refused_at_start_and_by_the_doctor(tmp_path: Path) -> None:
    hidden = _config(tmp_path, (899.0, 199.0))
    with pytest.raises(AlarmError) as caught:
        make_unit(hidden, tmp_path)
    assert caught.value.alarm is Alarm.CONFIG_INVALID
    assert "cell.yaml: planning.buffer_places_mm.0 = [899, 199]" in caught.value.detail
    assert _places(hidden, _calibration()).level is FindingLevel.FAILED
    shown = _config(tmp_path, (750.0, 0.0))
    make_unit(shown, tmp_path)
    assert _places(shown, _calibration()).level is FindingLevel.OK


def _correction(place_mm: tuple[float, float]) -> str:
    settings = {"places": [{"kind": "cuboid", "x_mm": 750.0, "y_mm": 0.0}]}
    settings["places"].append({"kind": "cuboid", "x_mm": place_mm[0], "y_mm": place_mm[1]})
    return f"rule: position_correction\n  rule_settings: {settings}"


@pytest.mark.parametrize(
    ("line", "key"),
    [
        (_correction((899.0, 199.0)), "rule_settings.places.1"),
        (
            "rule: element_change\n  rule_settings: {bin_mm: [750, 0], stock_mm: [[899, 199]], substitute_kind: wedge}",
            "rule_settings.stock_mm.0",
        ),
    ],
)
def test_a_rules_place_that_no_look_sees_is_refused_at_start(tmp_path: Path, line: str, key: str) -> None:
    with pytest.raises(AlarmError) as caught:
        make_unit(_with_planning(tmp_path, line), tmp_path)
    assert caught.value.alarm is Alarm.CONFIG_INVALID
    assert f"cell.yaml: planning.{key} = [899, 199]" in caught.value.detail


def test_a_rules_place_in_view_and_a_bin_out_of_it_are_no_matter(tmp_path: Path) -> None:
    make_unit(_with_planning(tmp_path, _correction((760.0, 60.0))), tmp_path)
    in_corner = "rule: element_change\n  rule_settings: {bin_mm: [899, 199], substitute_kind: wedge}"
    make_unit(_with_planning(tmp_path, in_corner), tmp_path)


def test_a_rules_place_outside_the_workspace_is_refused_with_the_config(tmp_path: Path) -> None:
    with pytest.raises(AlarmError) as caught:
        _with_planning(tmp_path, _correction((1200.0, 0.0)))
    assert "planning.rule_settings.places.1 = [1200.0, 0.0]: x = 1200.0 mm is outside" in caught.value.detail
