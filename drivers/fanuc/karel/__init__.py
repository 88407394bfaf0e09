"""The FANUC driver over the KAREL line protocol: what the entry point ``arm.fanuc_karel`` yields."""

from drivers.fanuc.karel.arm import FanucKarelArm
from drivers.fanuc.karel.config import FanucKarelConfig
from srvs_cell.ports import DriverContext, DriverSpec

__all__ = ["DRIVER", "FanucKarelArm", "FanucKarelConfig"]


def _make(config: FanucKarelConfig, context: DriverContext) -> FanucKarelArm:
    return FanucKarelArm(config, context.clock)


DRIVER = DriverSpec(FanucKarelConfig, _make)
