"""Drivers are entry points of the group ``srvs_cell.drivers``, named ``role.driver``, that yield a `DriverSpec`."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.ports import DriverSpec

if TYPE_CHECKING:
    from pydantic import BaseModel

ENTRY_POINT_GROUP = "srvs_cell.drivers"
ROLES = ("clock", "camera", "arm", "gripper")
SIMULATED_DRIVER = "sim"


@dataclass(frozen=True)
class DeviceConfig:
    """One device of the config.

    Attributes:
        role: clock, camera, arm or gripper.
        driver: the driver's name.
        settings: the driver's own keys, validated by its model.
        spec: the driver.
    """

    role: str
    driver: str
    settings: BaseModel
    spec: DriverSpec[Any]


def installed_drivers(role: str) -> tuple[str, ...]:
    """Return the names of the drivers that are installed for a role."""
    prefix = f"{role}."
    names = (entry.name for entry in entry_points(group=ENTRY_POINT_GROUP))
    return tuple(sorted(name.removeprefix(prefix) for name in names if name.startswith(prefix)))


def load_driver(role: str, driver: str) -> DriverSpec[Any]:
    """Return an installed driver; raises `AlarmError` DRIVER_UNKNOWN listing those that are, or why it cannot load."""
    found = entry_points(group=ENTRY_POINT_GROUP, name=f"{role}.{driver}")
    if not found:
        known = ", ".join(installed_drivers(role)) or "none"
        raise AlarmError(Alarm.DRIVER_UNKNOWN, f"devices.{role}.driver = {driver!r} is not installed; {role}: {known}.")
    try:
        spec = next(iter(found)).load()
    except (ImportError, AttributeError) as error:
        raise AlarmError(
            Alarm.DRIVER_UNKNOWN, f"devices.{role}.driver = {driver!r} is installed but cannot be loaded: {error}."
        ) from error
    if not isinstance(spec, DriverSpec):
        raise AlarmError(
            Alarm.DRIVER_UNKNOWN, f"devices.{role}.driver = {driver!r} does not yield a DriverSpec but {spec!r}."
        )
    return spec
