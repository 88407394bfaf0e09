"""The cell's YAML: every key typed, bounded and known; made of the parameters that each room owns."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.calibration import Calibration
from srvs_cell.config.cell_parameters import CellParameters
from srvs_cell.config.drivers import (
    ROLES,
    SIMULATED_DRIVER,
    DeviceConfig,
    installed_drivers,
    load_driver,
)
from srvs_cell.config.object_library import ObjectLibrary, built_in_library, load_library
from srvs_cell.config.validation import validate
from srvs_cell.config.yaml_text import read_yaml
from srvs_cell.planning import PlanningParameters, taught_places
from srvs_cell.vision.parameters import VisionParameters

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

SCHEMA_VERSION = 1
_UNPRIVILEGED_PORT = 1024
_LAST_PORT = 65535


class _DeviceSection(BaseModel):
    """A device: its driver's name, and keys that belong to the driver."""

    model_config = ConfigDict(extra="allow")

    driver: Annotated[str, Field(description="name of an installed driver")]


class _DevicesSection(BaseModel):
    """The four devices of a cell."""

    model_config = ConfigDict(extra="forbid")

    clock: _DeviceSection = Field(default_factory=lambda: _DeviceSection(driver="system"))
    camera: _DeviceSection
    arm: _DeviceSection
    gripper: _DeviceSection


class ServiceConfig(BaseModel):
    """Where the daemon listens and keeps what it must not lose. Relative paths start at the config file's folder."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    socket: Annotated[Path, Field(description="unix socket for commands")] = Path("/run/srvs-cell/api.sock")
    tcp_port: Annotated[
        int | None, Field(ge=_UNPRIVILEGED_PORT, le=_LAST_PORT, description="loopback port of the page; null: none")
    ] = None
    state_dir: Annotated[Path, Field(description="journal and run folders")] = Path("/var/lib/srvs-cell")
    keep_runs: Annotated[
        int, Field(ge=10, le=100_000, description="run folders that are kept; the oldest are removed when a job begins")
    ] = 200


class _File(BaseModel):
    """The whole file."""

    model_config = ConfigDict(extra="forbid")

    schema_version: Literal[1]
    cell: CellParameters
    vision: VisionParameters = Field(default_factory=VisionParameters)
    planning: PlanningParameters = Field(default_factory=PlanningParameters)
    devices: _DevicesSection
    calibration: Annotated[Path, Field(description="calibration file, relative to this file")]
    object_library: Annotated[
        Path | None, Field(description="kinds of objects, relative to this file; null: the built-in kinds")
    ] = None
    service: ServiceConfig = Field(default_factory=ServiceConfig)


@dataclass(frozen=True)
class DevicesConfig:
    """The four devices with their drivers."""

    clock: DeviceConfig
    camera: DeviceConfig
    arm: DeviceConfig
    gripper: DeviceConfig

    def __iter__(self) -> Iterator[DeviceConfig]:
        return iter((self.clock, self.camera, self.arm, self.gripper))


@dataclass(frozen=True)
class CellConfig:
    """A valid configuration; paths are absolute where the file's place is known.

    Attributes:
        source: the file, for messages.
        cell, vision, planning: the rooms' parameters.
        devices: drivers and their settings.
        calibration: the calibration file.
        object_library: the library of object kinds; None for the built-in ones.
        service: socket, port, state folder.
    """

    source: str
    cell: CellParameters
    vision: VisionParameters
    planning: PlanningParameters
    devices: DevicesConfig
    calibration: Path
    object_library: Path | None
    service: ServiceConfig

    @property
    def simulation(self) -> bool:
        """Whether any device is simulated; fixed at start-up and shown in every status."""
        return any(device.driver == SIMULATED_DRIVER for device in self.devices)

    def load_calibration(self) -> Calibration:
        """Return the calibration; raises `AlarmError` CALIBRATION_INVALID naming the file and what is wrong with it."""
        try:
            data = read_yaml(self.calibration.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise AlarmError(Alarm.CALIBRATION_INVALID, f"{self.calibration}: {_one_line(error)}.") from error
        if not isinstance(data, dict):
            raise AlarmError(Alarm.CALIBRATION_INVALID, f"{self.calibration}: a mapping of keys is expected.")
        return Calibration.from_mapping(data, str(self.calibration))

    def load_library(self) -> ObjectLibrary:
        """Return the kinds of objects; raises `AlarmError` CONFIG_INVALID naming the file and what is wrong with it."""
        if self.object_library is None:
            return built_in_library()
        library = load_library(self.object_library)
        library.check(self.vision.recognition)
        return library


def load_config(path: Path | str) -> CellConfig:
    """Return the configuration of a file; raises `AlarmError` as `parse_config`, also where it cannot be read."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise AlarmError(Alarm.CONFIG_INVALID, f"{path}: {_one_line(error)}.") from error
    return parse_config(text, str(path), folder=path.resolve().parent)


def parse_config(text: str, source: str, folder: Path | None = None) -> CellConfig:
    """Return the configuration that a YAML text says.

    Args:
        text: the YAML.
        source: its name, for messages.
        folder: where relative paths start; without it they stay relative.

    Raises:
        AlarmError: CONFIG_INVALID naming file, key, value and bound; DRIVER_UNKNOWN listing the installed drivers.
    """
    try:
        data = read_yaml(text)
    except yaml.YAMLError as error:
        raise AlarmError(Alarm.CONFIG_INVALID, f"{source}: not YAML: {_one_line(error)}.") from error
    if not isinstance(data, dict):
        raise AlarmError(Alarm.CONFIG_INVALID, f"{source}: a mapping of keys is expected, got {type(data).__name__}.")
    file = validate(_File, data, source)
    _check_buffer_places(file, source)
    _check_goal_rule(file, source)
    devices = {role: _device(role, getattr(file.devices, role), source) for role in ROLES}
    service = file.service
    return CellConfig(
        source=source,
        cell=file.cell,
        vision=file.vision,
        planning=file.planning,
        devices=DevicesConfig(**devices),
        calibration=_resolve(file.calibration, folder),
        object_library=None if file.object_library is None else _resolve(file.object_library, folder),
        service=service.model_copy(
            update={"socket": _resolve(service.socket, folder), "state_dir": _resolve(service.state_dir, folder)}
        ),
    )


def config_to_mapping(config: CellConfig) -> dict[str, Any]:
    """Return the whole configuration with every default filled in, as plain values that `parse_config` accepts."""
    return {
        "schema_version": SCHEMA_VERSION,
        "cell": _plain(CellParameters, config.cell),
        "vision": _plain(VisionParameters, config.vision),
        "planning": _plain(PlanningParameters, config.planning),
        "devices": {
            device.role: {"driver": device.driver, **device.settings.model_dump(mode="json")}
            for device in config.devices
        },
        "calibration": str(config.calibration),
        "object_library": None if config.object_library is None else str(config.object_library),
        "service": config.service.model_dump(mode="json"),
    }


def config_schema() -> dict[str, Any]:
    """Return the JSON Schema of the config, with the keys of every installed driver, for editors."""
    schema = _File.model_json_schema()
    schema["title"] = "srvs_cell configuration"
    devices = schema["$defs"]["_DevicesSection"]["properties"]
    for role in ROLES:
        options = [_driver_schema(role, driver, schema["$defs"]) for driver in installed_drivers(role)]
        devices[role] = {"oneOf": options, "description": f"the {role} and its driver's keys"}
    del schema["$defs"]["_DeviceSection"]
    return schema


def _device(role: str, section: _DeviceSection, source: str) -> DeviceConfig:
    try:
        spec = load_driver(role, section.driver)
    except AlarmError as error:
        raise AlarmError(error.alarm, f"{source}: {error.detail}") from error
    settings = validate(spec.config_model, section.model_extra, source, ("devices", role))
    return DeviceConfig(role=role, driver=section.driver, settings=settings, spec=spec)


def _check_buffer_places(file: _File, source: str) -> None:
    """Refuse buffer places that the TCP may not go to; the two keys belong to different rooms."""
    for i, place_mm in enumerate(file.planning.buffer_places_mm):
        _check_inside(file, f"buffer_places_mm.{i}", place_mm, source)


def _check_goal_rule(file: _File, source: str) -> None:
    """Refuse a goal rule that cannot be made, or whose places the TCP may not go to."""
    if not file.planning.names_a_rule:
        return
    try:
        places = taught_places(file.planning.rule, file.planning.rule_settings)
    except AlarmError as error:
        raise AlarmError(error.alarm, f"{source}: {error.detail}") from error
    for place in places:
        _check_inside(file, f"rule_settings.{place.key}", place.point_mm, source)


def _check_inside(file: _File, key: str, place_mm: tuple[float, float], source: str) -> None:
    box = file.cell.workspace
    for name, value_mm, (least_mm, greatest_mm) in zip("xy", place_mm, (box.x_mm, box.y_mm), strict=True):
        if not least_mm <= value_mm <= greatest_mm:
            raise AlarmError(
                Alarm.CONFIG_INVALID,
                f"{source}: planning.{key} = {list(place_mm)}: {name} = {value_mm} mm is outside "
                f"cell.workspace.{name}_mm = {least_mm} to {greatest_mm} mm.",
            )


def _driver_schema(role: str, driver: str, definitions: dict[str, Any]) -> dict[str, Any]:
    try:
        model: type[BaseModel] = load_driver(role, driver).config_model
    except AlarmError as error:
        return {"properties": {"driver": {"const": driver}}, "required": ["driver"], "$comment": error.detail}
    schema = model.model_json_schema()
    definitions.update(schema.pop("$defs", {}))
    name: Mapping[str, Any] = {"driver": {"const": driver, "description": schema.get("description", driver)}}
    schema["properties"] = {**name, **schema.get("properties", {})}
    schema["required"] = ["driver", *schema.get("required", [])]
    return schema


def _plain(model: Any, value: object) -> Any:
    return TypeAdapter(model).dump_python(value, mode="json")


def _resolve(path: Path, folder: Path | None) -> Path:
    return path if folder is None else folder / path


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
