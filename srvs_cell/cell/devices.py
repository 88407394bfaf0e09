"""The four devices of a cell, made from the config by the installed drivers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NoReturn

from srvs_cell.ports import DigitalIO, DriverContext

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from srvs_cell.config import CellConfig, DeviceConfig
    from srvs_cell.ports import Camera, Clock, Device, Gripper, RobotArm


@dataclass(frozen=True)
class Devices:
    """What the unit works with."""

    clock: Clock
    camera: Camera
    arm: RobotArm
    gripper: Gripper

    def named(self) -> tuple[tuple[str, Device], ...]:
        """Return camera, arm and gripper with what people call them."""
        return ("camera", self.camera), ("arm", self.arm), ("gripper", self.gripper)


def make_devices(config: CellConfig) -> Devices:
    """Return the config's devices, disconnected. The arm's digital I/O, where it has any, is lent to the gripper."""
    devices = config.devices
    clock: Clock = _make(devices.clock, DriverContext(clock=_NoClockYet()))
    context = DriverContext(clock=clock)
    arm: RobotArm = _make(devices.arm, context)
    lent = DriverContext(clock=clock, digital_io=arm if isinstance(arm, DigitalIO) else None)
    return Devices(clock=clock, camera=_make(devices.camera, context), arm=arm, gripper=_make(devices.gripper, lent))


def _make(device: DeviceConfig, context: DriverContext) -> Any:
    return device.spec.factory(device.settings, context)


class _NoClockYet:
    """Stands in the context of the one driver that makes the clock and therefore cannot be given it."""

    def now_s(self) -> float:
        self._refuse()

    async def sleep(self, seconds: float) -> None:
        self._refuse(seconds)

    def working(self) -> AbstractContextManager[None]:
        self._refuse()

    @staticmethod
    def _refuse(*_: object) -> NoReturn:
        raise RuntimeError("a clock driver must not use the context's clock")
