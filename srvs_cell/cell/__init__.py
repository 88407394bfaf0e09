"""The cell: PackML unit, job steps, recovery policy, interlocks, journal."""

from srvs_cell.cell.devices import Devices, make_devices
from srvs_cell.cell.job import Equipment
from srvs_cell.cell.journal import GripperKnowledge, Journal
from srvs_cell.cell.packml import WAIT_STATES, Command, Mode, State, leads_there
from srvs_cell.cell.recorder import RunRecorder
from srvs_cell.cell.senses import Perceive, Pictures, PlanJob, StereoLook
from srvs_cell.cell.unit import CommandAnswer, Unit

__all__ = [
    "WAIT_STATES",
    "Command",
    "CommandAnswer",
    "Devices",
    "Equipment",
    "GripperKnowledge",
    "Journal",
    "Mode",
    "Perceive",
    "Pictures",
    "PlanJob",
    "RunRecorder",
    "State",
    "StereoLook",
    "Unit",
    "leads_there",
    "make_devices",
]
