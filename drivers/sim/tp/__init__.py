"""An interpreter of FANUC TP programs (.LS), as much of the language as the robot's programs of this cell use."""

from drivers.sim.tp.errors import TpAlarm, TpError
from drivers.sim.tp.machine import TpMachine
from drivers.sim.tp.parser import load, parse, shipped_sources
from drivers.sim.tp.task import ArmedDevices

__all__ = ["ArmedDevices", "TpAlarm", "TpError", "TpMachine", "load", "parse", "shipped_sources"]
