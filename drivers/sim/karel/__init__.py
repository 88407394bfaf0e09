"""An interpreter of KAREL (.kl), as much of the language as the robot's program of this cell uses."""

from drivers.sim.karel.built_in import ABORTED, PAUSED, RUNNING, Host
from drivers.sim.karel.errors import KarelAbort, KarelError
from drivers.sim.karel.program import KarelTask, shipped_sources
from drivers.sim.karel.values import FileVariable, Pose

__all__ = [
    "ABORTED",
    "PAUSED",
    "RUNNING",
    "FileVariable",
    "Host",
    "KarelAbort",
    "KarelError",
    "KarelTask",
    "Pose",
    "shipped_sources",
]
