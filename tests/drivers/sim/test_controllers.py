"""The controller of a simulated cell on each of its wires, with the driver that a daemon's config would name."""

from __future__ import annotations

import contextlib
from importlib.metadata import entry_points
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from drivers.sim.cell import _WIRES
from drivers.sim.control_server import Control, RequestError
from drivers.sim.controllers import WIRES
from srvs_cell.ports import DriverContext, Lifecycle, PortError, RobotArm
from tests.drivers.fanuc.bench import HOME, IMPATIENT_S, PATIENT_S, TARGET
from tests.drivers.stepped import PointArm, SteppedClock, SteppedTime

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

FAULTS = {"modbus": "CUT", "rmi": "CUT", "karel": "CUT", "karel-serial": "NONSENSE"}


def _driver(name: str) -> Any:
    (found,) = entry_points(group="srvs_cell.drivers", name=f"arm.{name}")
    return found.load()


def _busy(arm: Any) -> Callable[[], bool]:
    return lambda: (arm._wire if hasattr(arm, "_wire") else arm._session).busy


@contextlib.contextmanager
def _in_a_hurry(arm: Any) -> Iterator[None]:
    """Do not wait long where only a time-out says that nobody answers: on a serial line."""
    session = getattr(arm, "_session", None)
    if session is None:
        yield
        return
    patient_s, session._timeout_s = session._timeout_s, IMPATIENT_S
    yield
    session._timeout_s = patient_s


def test_the_command_line_knows_every_wire() -> None:
    assert set(_WIRES) == set(WIRES)


@pytest.mark.parametrize("wire", WIRES)
async def test_the_driver_that_the_listing_names_moves_the_arm_and_meets_the_wires_faults(wire: str) -> None:
    time = SteppedTime()
    point = PointArm(time)
    wired = WIRES[wire](point, time, 0)
    listing = wired.start()
    clock = SteppedClock(time)
    driver = _driver(listing["arm"].pop("driver"))
    arm: RobotArm = driver.factory(
        driver.config_model.model_validate({**listing["arm"], "timeout_s": PATIENT_S}), DriverContext(clock)
    )
    clock.busy = _busy(arm)
    try:
        assert {"modbus": "modbus_port", "rmi": "rmi_port", "karel": "karel_port", "karel-serial": "karel_device"}[
            wire
        ] in listing
        await arm.connect()
        await arm.activate()
        assert await arm.move_linear(TARGET, 200.0) == TARGET
        assert wired.controller.motions_started == 1
        wired.set_fault(wired.faults[FAULTS[wire]])
        with pytest.raises(PortError), _in_a_hurry(arm):
            await arm.move_linear(HOME, 200.0)
        wired.set_fault(wired.faults["NONE"])
        assert wired.controller.motions_started == 1
        await arm.disconnect()
        await arm.connect()
        wired.cut()
        wired.controller.reboot()
        with pytest.raises(PortError), _in_a_hurry(arm):
            await arm.status()
        await clock.sleep(1.0)
        assert arm.lifecycle is Lifecycle.DISCONNECTED or wire == "modbus"
    finally:
        await arm.disconnect()
        time.release()
        wired.controller.close()


@pytest.mark.parametrize("wire", WIRES)
def test_a_heartbeat_is_frozen_where_there_is_one(wire: str, nothing: SimpleNamespace) -> None:
    time = SteppedTime()
    wired = WIRES[wire](PointArm(time), time, 0)
    wired.start()
    control = Control(nothing, [wired], nothing, lambda: None)  # type: ignore[arg-type]
    freeze = {"op": "inject", "fault": "heartbeat", "on": False}
    try:
        if wire == "rmi":
            with pytest.raises(RequestError, match="no heartbeat"):
                control.answer(freeze)
        else:
            assert control.answer(freeze)["ok"]
            assert getattr(wired.controller, "heartbeat_frozen", None) or getattr(wired.controller, "frozen", None)
    finally:
        time.release()
        wired.controller.close()


@pytest.fixture
def nothing() -> SimpleNamespace:
    """What a control asks nothing of here but the time."""
    return SimpleNamespace(time=SteppedTime(), arm=None, stream=None)
