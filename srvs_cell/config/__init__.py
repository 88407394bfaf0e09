"""The cell's configuration: YAML, typed and bounded, composed of the parameters that each room owns."""

from srvs_cell.config.cell_parameters import (
    CellParameters,
    LookParameters,
    MotionParameters,
    PoseParameters,
    RetryParameters,
    ToleranceParameters,
    WorkspaceBox,
)
from srvs_cell.config.drivers import DeviceConfig, installed_drivers, load_driver
from srvs_cell.config.loader import (
    CellConfig,
    DevicesConfig,
    ServiceConfig,
    config_schema,
    config_to_mapping,
    load_config,
    parse_config,
)
from srvs_cell.config.object_library import ObjectLibrary, built_in_library, load_library, parse_library

__all__ = [
    "CellConfig",
    "CellParameters",
    "DeviceConfig",
    "DevicesConfig",
    "LookParameters",
    "MotionParameters",
    "ObjectLibrary",
    "PoseParameters",
    "RetryParameters",
    "ServiceConfig",
    "ToleranceParameters",
    "WorkspaceBox",
    "built_in_library",
    "config_schema",
    "config_to_mapping",
    "installed_drivers",
    "load_config",
    "load_driver",
    "load_library",
    "parse_config",
    "parse_library",
]
