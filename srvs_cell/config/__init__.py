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

__all__ = [
    "CellConfig",
    "CellParameters",
    "DeviceConfig",
    "DevicesConfig",
    "LookParameters",
    "MotionParameters",
    "PoseParameters",
    "RetryParameters",
    "ServiceConfig",
    "ToleranceParameters",
    "WorkspaceBox",
    "config_schema",
    "config_to_mapping",
    "installed_drivers",
    "load_config",
    "load_driver",
    "parse_config",
]
