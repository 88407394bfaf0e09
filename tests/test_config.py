"""The cell's YAML: what is right is taken with its defaults, what is wrong names file, key, value and bound."""

from __future__ import annotations

import itertools
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pydantic import BaseModel

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.config import (
    CellConfig,
    config_schema,
    config_to_mapping,
    installed_drivers,
    load_config,
    load_driver,
    parse_config,
)
from srvs_cell.geometry import Transform, Xyzwpr
from srvs_cell.planning.arm import ArmReach
from srvs_cell.ports import DriverSpec

CONFIGS = Path(__file__).parents[1] / "configs"
SIM = (CONFIGS / "cell.sim.yaml").read_text(encoding="utf-8")


def changed(path: str, value: object) -> str:
    """Return the simulation config with one key set, or removed where the value is ``...``."""
    data: dict[str, Any] = yaml.safe_load(SIM)
    *parents, key = path.split(".")
    node = data
    for parent in parents:
        node = node.setdefault(parent, {})
    if value is ...:
        del node[key]
    else:
        node[key] = value
    return yaml.safe_dump(data)


def refusal(text: str) -> AlarmError:
    with pytest.raises(AlarmError) as caught:
        parse_config(text, "cell.yaml")
    assert caught.value.detail.startswith("cell.yaml: ")
    return caught.value


@pytest.mark.parametrize("name", sorted(path.name for path in CONFIGS.glob("*.yaml")))
def test_the_configurations_that_are_shipped_are_valid(name: str) -> None:
    config = load_config(CONFIGS / name)
    assert config.simulation is (name == "cell.sim.yaml")
    assert config.calibration == CONFIGS.resolve() / "calibration.yaml"


@pytest.mark.parametrize(
    "name", sorted(path.name for path in CONFIGS.glob("cell.*.yaml") if path.name != "cell.sim.yaml")
)
def test_the_arm_of_a_shipped_configuration_reaches_its_workspace(name: str) -> None:
    """It is an LR Mate 200iD: 717 mm from axis 1 to the wrist, stretched out, as FANUC has it on its data sheet."""
    config = load_config(CONFIGS / name)
    arm, look, box = config.planning.arm, config.cell.look.observe_pose, config.cell.workspace
    assert arm is not None
    assert config.planning.fingers.length_mm is not None
    assert arm.a1_mm + arm.c2_mm + math.hypot(arm.c3_mm, arm.a2_mm) == pytest.approx(717.0, abs=0.5)
    reach = ArmReach(arm, Xyzwpr(*look.xyz_mm, *look.wpr_deg))
    corners = [look.xyz_mm, *itertools.product(box.x_mm, box.y_mm, box.z_mm)]
    poses = [Transform.from_xyzwpr("base", "tcp", Xyzwpr(*corner, *look.wpr_deg)).matrix for corner in corners]
    assert reach.within(np.array(poses)).all()


def test_what_is_shown_is_the_same_configuration_again() -> None:
    config = parse_config(SIM, "cell.yaml")
    again = parse_config(yaml.safe_dump(config_to_mapping(config)), "shown.yaml")
    assert config_to_mapping(again) == config_to_mapping(config)
    assert (again.cell, again.vision, again.planning) == (config.cell, config.vision, config.planning)


@pytest.mark.parametrize(
    ("path", "value", "named"),
    [
        ("cell.look.baseline_mm", 0, "cell.look.baseline_mm = 0: should be greater than 0"),
        ("cell.look.baseline_mm", 501, "cell.look.baseline_mm = 501: should be less than or equal to 500"),
        ("cell.look.baseline_mm", "30", 'cell.look.baseline_mm = "30": should be a valid number'),
        ("cell.look.baseline_mm", True, "cell.look.baseline_mm = true: should be a valid number"),
        ("cell.look.baseline_mm", float("nan"), "cell.look.baseline_mm = NaN: should be"),
        ("cell.look.baseline_mm", None, "cell.look.baseline_mm = null: should be a valid number"),
        ("cell.look.baseline_mm", ..., "cell.look.baseline_mm: missing"),
        ("cell.look.baseline", 30, "cell.look.baseline: unknown key, did you mean 'baseline_mm'?"),
        ("cell.motion.jaw_axis", "z", "cell.motion.jaw_axis = \"z\": should be 'x' or 'y'"),
        ("cell.motion.travel_speed_mm_s", 501, "travel_speed_mm_s = 501.0 is above speed_limit_mm_s = 500.0"),
        ("cell.retries.grip", 2.5, "cell.retries.grip = 2.5: should be a valid integer"),
        ("cell.retries.grip", 11, "cell.retries.grip = 11: should be less than or equal to 10"),
        ("cell.workspace.x_mm", [900, 560], "x_mm: 900.0 is not less than 560.0"),
        ("cell.workspace.x_mm", [700, 900], "look.observe_pose: X = 675.0 mm is outside 700.0 to 900.0 mm"),
        ("cell.workspace.x_mm", [560], "cell.workspace.x_mm"),
        ("cell.look.observe_pose.wpr_deg", [180, 0], "cell.look.observe_pose.wpr_deg"),
        ("cell.look", "here", "cell.look"),
        ("cell", ..., "cell: missing"),
        ("wibble", 1, "wibble: unknown key"),
        ("schema_version", 2, "schema_version = 2: should be 1"),
        ("schema_version", ..., "schema_version: missing"),
        ("calibration", ..., "calibration: missing"),
        ("calibration", 7, "calibration = 7:"),
        ("vision.wibble", 1, "vision.wibble: unknown key"),
        ("vision.edges.smoothing_px", -1, "vision.edges.smoothing_px = -1: should be greater than or equal to 0"),
        ("planning.fingers.width", 9, "planning.fingers.width: unknown key, did you mean 'width_mm'?"),
        ("planning.height_tolerance_mm", 51, "planning.height_tolerance_mm = 51: should be less than or equal to 50"),
        ("devices.arm.port", 0, "devices.arm.port = 0: should be greater than or equal to 1"),
        ("devices.arm.prot", 502, "devices.arm.prot: unknown key, did you mean 'port'?"),
        ("devices.camera.port", ..., "devices.camera.port: missing"),
        ("devices.gripper.open_output", 1, "close_output and open_output are both 1"),
        ("devices.gripper", ..., "devices.gripper: missing"),
        ("devices.gripper.driver", ..., "devices.gripper.driver: missing"),
        ("devices.laser", {"driver": "sim"}, "devices.laser: unknown key"),
        ("service.tcp_port", 80, "service.tcp_port = 80: should be greater than or equal to 1024"),
        ("service.tcp_port", 65536, "service.tcp_port = 65536: should be less than or equal to 65535"),
        ("service.socket_path", "x", "service.socket_path: unknown key, did you mean 'socket'?"),
    ],
)
def test_a_mistake_is_named(path: str, value: object, named: str) -> None:
    error = refusal(changed(path, value))
    assert error.alarm is Alarm.CONFIG_INVALID
    assert named in error.detail


@pytest.mark.parametrize(("axis", "bound"), [("x", 0), ("x", 1), ("y", 0), ("y", 1)])
def test_a_buffer_place_must_lie_in_the_workspace(axis: str, bound: int) -> None:
    workspace = parse_config(SIM, "cell.yaml").cell.workspace
    ranges_mm = {"x": workspace.x_mm, "y": workspace.y_mm}
    corners = [[x_mm, y_mm] for x_mm in workspace.x_mm for y_mm in workspace.y_mm]
    assert len(parse_config(changed("planning.buffer_places_mm", corners), "cell.yaml").planning.buffer_places_mm) == 4
    outside = [ranges_mm["x"][0], ranges_mm["y"][0]]
    outside["xy".index(axis)] = ranges_mm[axis][bound] + (0.5 if bound else -0.5)
    error = refusal(changed("planning.buffer_places_mm", [corners[0], outside]))
    assert error.alarm is Alarm.CONFIG_INVALID
    least_mm, greatest_mm = ranges_mm[axis]
    assert f"planning.buffer_places_mm.1 = {outside}" in error.detail
    assert f"cell.workspace.{axis}_mm = {least_mm} to {greatest_mm} mm" in error.detail


@pytest.mark.parametrize(
    ("key", "other", "value"),
    [
        ("vision.min_disparity_px", "max_disparity_px", 64.0),
        ("vision.recognition.min_height_mm", "max_height_mm", 300.0),
        ("vision.recognition.min_size_mm", "max_size_mm", 160.0),
        ("vision.recognition.min_inclination_deg", "max_inclination_deg", 60.0),
        ("vision.recognition.grasp.min_opening_mm", "max_opening_mm", 90.0),
        ("vision.edges.min_gradient", "max_gradient", 5.0),
    ],
)
def test_a_least_value_above_its_greatest_one_is_refused_with_both(key: str, other: str, value: float) -> None:
    error = refusal(changed(key, value))
    section, _, own = key.rpartition(".")
    assert error.alarm is Alarm.CONFIG_INVALID
    assert re.search(rf"{section}: {own} = {value:g} is not (less than|at most) {other} = ", error.detail)
    assert f"lower {own} or raise {other}" in error.detail


def test_all_mistakes_are_named_at_once() -> None:
    text = changed("cell.look.baseline_mm", -1).replace("jaw_axis: y", "jaw_axis: w")
    detail = refusal(text).detail
    assert "cell.look.baseline_mm" in detail
    assert "cell.motion.jaw_axis" in detail


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "a mapping of keys is expected, got NoneType"),
        ("- 1", "a mapping of keys is expected, got list"),
        ("a: [1", "not YAML"),
        ("a: 1\na: 2", "the key 'a' is given twice"),
        ("a: !!python/object/apply:os.system [echo]", "not YAML"),
        ("\tcell: 1", "not YAML"),
    ],
)
def test_a_text_that_is_no_configuration_is_refused(text: str, named: str) -> None:
    assert named in refusal(text).detail


def test_numbers_may_be_written_with_an_exponent() -> None:
    text = SIM.replace("baseline_mm: 30.0", "baseline_mm: 3e1")
    assert parse_config(text, "cell.yaml").cell.look.baseline_mm == 30.0


def test_an_unknown_driver_names_those_that_are_installed() -> None:
    error = refusal(changed("devices.camera.driver", "gige"))
    assert error.alarm is Alarm.DRIVER_UNKNOWN
    for name in installed_drivers("camera"):
        assert name in error.detail
    assert "v4l2" in error.detail


def test_a_driver_of_another_role_is_not_taken() -> None:
    assert refusal(changed("devices.gripper.driver", "v4l2")).alarm is Alarm.DRIVER_UNKNOWN


@pytest.mark.parametrize("role", ["clock", "camera", "arm", "gripper"])
def test_every_installed_driver_can_be_loaded(role: str) -> None:
    for name in installed_drivers(role):
        spec = load_driver(role, name)
        assert isinstance(spec, DriverSpec)
        assert issubclass(spec.config_model, BaseModel)
        assert spec.config_model.model_config.get("extra") == "forbid"


@pytest.mark.parametrize("make", ["missing", "folder", "binary"])
def test_a_file_that_cannot_be_read_is_named(tmp_path: Path, make: str) -> None:
    path = tmp_path / "cell.yaml"
    if make == "folder":
        path.mkdir()
    elif make == "binary":
        path.write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(AlarmError, match=r"cell\.yaml") as caught:
        load_config(path)
    assert caught.value.alarm is Alarm.CONFIG_INVALID


def loaded(tmp_path: Path) -> CellConfig:
    path = tmp_path / "cell.yaml"
    path.write_text(SIM, encoding="utf-8")
    return load_config(path)


def test_relative_paths_start_at_the_file(tmp_path: Path) -> None:
    config = loaded(tmp_path)
    assert config.calibration == tmp_path / "calibration.yaml"
    assert config.service.socket == tmp_path / "run" / "api.sock"
    assert config.service.state_dir == tmp_path / "state"


@pytest.mark.parametrize("content", [None, "a: [", "- 1", "schema_version: 1"])
def test_a_calibration_that_cannot_be_used_is_named(tmp_path: Path, content: str | None) -> None:
    config = loaded(tmp_path)
    if content is not None:
        config.calibration.write_text(content, encoding="utf-8")
    with pytest.raises(AlarmError, match=r"calibration\.yaml") as caught:
        config.load_calibration()
    assert caught.value.alarm is Alarm.CALIBRATION_INVALID


def test_the_schema_knows_every_driver_and_its_keys() -> None:
    schema = config_schema()
    assert json.loads(json.dumps(schema)) == schema
    devices = schema["$defs"]["_DevicesSection"]["properties"]
    arms = {option["properties"]["driver"]["const"]: option for option in devices["arm"]["oneOf"]}
    assert "hold_output" in arms["fanuc_modbus"]["properties"]
    assert arms["fanuc_modbus"]["additionalProperties"] is False
    baseline = schema["$defs"]["LookParameters"]["properties"]["baseline_mm"]
    assert (baseline["exclusiveMinimum"], baseline["maximum"]) == (0.0, 500.0)
    assert baseline["description"]


def test_every_reference_of_the_schema_resolves() -> None:
    schema = config_schema()

    def references(node: object) -> list[str]:
        if isinstance(node, dict):
            found = [node["$ref"]] if isinstance(node.get("$ref"), str) else []
            return found + [name for value in node.values() for name in references(value)]
        return [name for value in node for name in references(value)] if isinstance(node, list) else []

    assert {name.removeprefix("#/$defs/") for name in references(schema)} <= set(schema["$defs"])
