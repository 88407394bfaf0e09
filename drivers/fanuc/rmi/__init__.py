"""The FANUC driver over the Remote Motion Interface: what the entry point ``arm.fanuc_rmi`` yields."""

from drivers.fanuc.rmi.arm import FanucRmiArm
from drivers.fanuc.rmi.config import FanucRmiConfig
from srvs_cell.ports import DriverContext, DriverSpec

__all__ = ["DRIVER", "FanucRmiArm", "FanucRmiConfig"]


def _make(config: FanucRmiConfig, context: DriverContext) -> FanucRmiArm:
    return FanucRmiArm(config, context.clock)


DRIVER = DriverSpec(FanucRmiConfig, _make)
