"""The controller doubles that a simulated cell can have, one to a wire, and what goes wrong on each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol

from drivers.sim.karel_controller import KarelController
from drivers.sim.karel_server import KarelFault, PtyCarrier, TcpCarrier
from drivers.sim.modbus_controller import ModbusController
from drivers.sim.modbus_server import WireFault
from drivers.sim.rmi_controller import RmiController
from drivers.sim.rmi_server import RmiFault

if TYPE_CHECKING:
    from collections.abc import Callable
    from enum import Enum

    from drivers.sim.controlled_arm import ControlledArm, ControllerTime

_HOST: Final = "127.0.0.1"


class Controller(Protocol):
    """What the simulated cell needs of a double."""

    @property
    def motions_started(self) -> int:
        """How many motions the arm was told to begin."""
        ...

    def reboot(self) -> None:
        """Power off and on."""
        ...

    def close(self) -> None:
        """End."""
        ...


@dataclass(frozen=True)
class WiredController:
    """A double, and what only its wire can tell.

    Attributes:
        controller: the double.
        start: lets it serve; returns what listens where, and under ``arm`` what a daemon's config says of it.
        faults: what can go wrong on the wire, by its name.
        set_fault: lets it go wrong so from now on.
        cut: cuts the wire.
        set_heartbeat: lets the robot's program stand still (False) or go on; None where there is no heartbeat.
    """

    controller: Controller
    start: Callable[[], dict[str, Any]]
    faults: type[Enum]
    set_fault: Callable[[Any], None]
    cut: Callable[[], None]
    set_heartbeat: Callable[[bool], None] | None


def over_modbus(arm: ControlledArm, time: ControllerTime, port: int) -> WiredController:
    """Return a controller with R553."""
    controller = ModbusController(arm, time, port)
    server = controller.server

    def start() -> dict[str, Any]:
        bound = controller.start()
        return {"modbus_port": bound, "arm": {"driver": "fanuc_modbus", "host": _HOST, "port": bound}}

    def set_fault(fault: WireFault) -> None:
        server.fault = fault

    def set_heartbeat(on: bool) -> None:
        controller.heartbeat_frozen = not on

    return WiredController(controller, start, WireFault, set_fault, server.cut, set_heartbeat)


def over_rmi(arm: ControlledArm, time: ControllerTime, port: int) -> WiredController:
    """Return a controller with R912; as on a real one the session's port is the next one, where that is free."""
    controller = RmiController(arm, time, port, port + 1 if port else 0)
    server = controller.server

    def start() -> dict[str, Any]:
        bound = controller.start()
        session = server.session_port
        return {
            "rmi_port": bound,
            "rmi_session_port": session,
            "arm": {"driver": "fanuc_rmi", "host": _HOST, "port": bound},
        }

    def set_fault(fault: RmiFault) -> None:
        server.fault = fault

    return WiredController(controller, start, RmiFault, set_fault, server.cut, None)


def over_karel(arm: ControlledArm, time: ControllerTime, port: int) -> WiredController:
    """Return a controller with KAREL, on Ethernet."""
    return _over_lines(
        KarelController(arm, time, TcpCarrier(port)),
        lambda bound: {"karel_port": int(bound), "arm": {"tcp": {"host": _HOST, "port": int(bound)}}},
    )


def over_karel_serial(arm: ControlledArm, time: ControllerTime, _port: int) -> WiredController:
    """Return a controller with KAREL, on a serial line."""
    return _over_lines(
        KarelController(arm, time, PtyCarrier()),
        lambda device: {"karel_device": device, "arm": {"serial": {"device": device}}},
    )


def _over_lines(controller: KarelController, listens: Callable[[str], dict[str, Any]]) -> WiredController:
    wire = controller.wire

    def start() -> dict[str, Any]:
        line = listens(controller.start())
        return {**line, "arm": {"driver": "fanuc_karel", **line["arm"]}}

    def set_fault(fault: KarelFault) -> None:
        wire.fault = fault

    def set_heartbeat(on: bool) -> None:
        controller.frozen = not on

    return WiredController(controller, start, KarelFault, set_fault, wire.cut, set_heartbeat)


WIRES: Final[dict[str, Callable[[ControlledArm, ControllerTime, int], WiredController]]] = {
    "modbus": over_modbus,
    "rmi": over_rmi,
    "karel": over_karel,
    "karel-serial": over_karel_serial,
}
