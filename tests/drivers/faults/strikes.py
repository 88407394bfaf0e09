"""What strikes a cell in each row of the table, and what takes it away again."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Final

from drivers.fanuc.modbus import FanucModbusArm
from drivers.sim.karel_controller import KarelController
from drivers.sim.karel_server import KarelFault
from drivers.sim.modbus_controller import ModbusController
from drivers.sim.modbus_server import WireFault
from drivers.sim.rmi_controller import RmiController
from drivers.sim.rmi_server import RmiFault
from srvs_cell.cell import Command
from srvs_cell.ports import PortError, RobotMode
from tests.drivers.fanuc.bench import Bench
from tests.drivers.fanuc.karel_bench import KarelBench
from tests.drivers.fanuc.karel_bench import make_arm as make_karel_arm
from tests.drivers.fanuc.rmi_bench import make_arm
from tests.drivers.stepped import SteppedClock

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from drivers.fanuc.karel import FanucKarelArm
    from drivers.fanuc.rmi import FanucRmiArm
    from tests.drivers.faults.cell import WireCell

_HASTY_S: Final = 0.1
"""A wire time-out, from the fault on, where a time-out is what ends it."""


def _hasten(c: WireCell) -> None:
    if isinstance(c.b, Bench):
        client = c.b.arm._wire._client
        if client is not None:
            client.ctx.comm_params.timeout_connect = _HASTY_S
    else:
        c.b.arm._session._timeout_s = _HASTY_S


def _break(c: WireCell, modbus: WireFault, rmi: RmiFault, karel: KarelFault) -> None:
    if isinstance(c.b, Bench):
        c.b.controller.server.fault = modbus
    elif isinstance(c.b, KarelBench):
        c.b.controller.wire.fault = karel
    else:
        c.b.controller.server.fault = rmi


def _slow_down(c: WireCell, times: float) -> None:
    """Let the move under way go on so many times slower."""
    point = c.point
    way_mm = point._way_mm()
    point._speed_mm_s /= times
    point._begun_s = c.b.time.now_s() - way_mm / point._speed_mm_s


def mend(c: WireCell) -> None:
    """Take away whatever was done."""
    _break(c, WireFault.NONE, RmiFault.NONE, KarelFault.NONE)
    point, controller = c.point, c.b.controller
    point.mode, point.pendant_enabled, point.servo_on = RobotMode.AUTO, False, True
    if isinstance(controller, ModbusController):
        controller.heartbeat_frozen = False
    if isinstance(c.b, KarelBench):
        c.b.controller.frozen = False
    if isinstance(c.b, Bench):
        return
    c.b.arm._session._timeout_s = 10.0


async def cut(c: WireCell) -> None:
    if isinstance(c.b, KarelBench) and c.b.carrier == "serial":
        await silence(c)
    elif isinstance(c.b, KarelBench):
        c.b.controller.wire.cut()
    else:
        c.b.controller.server.cut()


async def half_a_packet(c: WireCell) -> None:
    if isinstance(c.b, KarelBench):
        _hasten(c)
    _break(c, WireFault.HALF_PACKET, RmiFault.HALF_PACKET, KarelFault.HALF_LINE)


async def silence(c: WireCell) -> None:
    _hasten(c)
    _break(c, WireFault.DEAF, RmiFault.DEAF, KarelFault.DEAF)


async def reply_for_another(c: WireCell) -> None:
    _hasten(c)
    _break(c, WireFault.LATE, RmiFault.WRONG_SEQUENCE, KarelFault.WRONG_SEQUENCE)


async def duplicate_reply(c: WireCell) -> None:
    _break(c, WireFault.DUPLICATE, RmiFault.DUPLICATE, KarelFault.DUPLICATE)


async def nonsense(c: WireCell) -> None:
    _hasten(c)
    _break(c, WireFault.NONSENSE, RmiFault.NONSENSE, KarelFault.NONSENSE)


async def emergency_stop(c: WireCell) -> None:
    c.point.stop()
    c.point.fault, c.point.servo_on = "SRVO-001 Operator panel E-stop", False


async def collision(c: WireCell) -> None:
    c.point.collide_after_mm = 0.0


async def override_lowered(c: WireCell) -> None:
    _slow_down(c, 4.0)
    c.point.override_percent = 25


async def switched_to_t1(c: WireCell) -> None:
    c.point.mode, c.point.pendant_enabled = RobotMode.T1, True


async def rebooted(c: WireCell) -> None:
    c.b.controller.reboot()


async def second_client(c: WireCell) -> None:
    clock = SteppedClock(c.b.time)
    other: FanucModbusArm | FanucRmiArm | FanucKarelArm
    if isinstance(c.b, Bench):
        other = FanucModbusArm(c.b.arm._config.model_copy(update={"timeout_s": _HASTY_S}), clock)
    elif isinstance(c.b, KarelBench):
        other = make_karel_arm(clock, c.b.carrier, c.b.address, timeout_s=_HASTY_S)
    else:
        other = make_arm(clock, port=c.b.port, timeout_s=_HASTY_S)
    with contextlib.suppress(PortError):
        await other.connect()
        raise AssertionError("two clients hold one controller")


async def another_writes_commands(c: WireCell) -> None:
    assert isinstance(c.b.controller, ModbusController)
    c.b.controller.write_words(12030, [29])


async def part_lost(c: WireCell) -> None:
    c.point.world.lose()


async def robot_heartbeat_frozen(c: WireCell) -> None:
    if isinstance(c.b, KarelBench):
        _hasten(c)
        c.b.controller.frozen = True
        return
    assert isinstance(c.b.controller, ModbusController)
    c.b.controller.heartbeat_frozen = True
    _slow_down(c, 50.0)  # long enough for the driver's patience


async def started_without_heartbeat(c: WireCell) -> None:
    assert isinstance(c.b.controller, ModbusController)
    c.b.controller.heartbeat_frozen = True
    await c.cell.give(Command.START)


async def started_after_a_pause(c: WireCell) -> None:
    """The process has hung for longer than the robot's watchdog bears."""
    c.b.time.advance_to(c.b.time.now_s() + 2.5)
    await c.quiet()
    await c.cell.give(Command.START)


async def pc_heartbeat_frozen(c: WireCell) -> None:
    """The process hangs: it neither counts nor reads."""
    if isinstance(c.b, KarelBench):
        _slow_down(c, 50.0)
        c.b.time.advance_to(c.b.time.now_s() + 2.5)
        return
    assert isinstance(c.b, Bench)
    heartbeat = c.b.arm._heartbeat
    assert heartbeat is not None
    heartbeat.cancel()
    _slow_down(c, 50.0)  # long enough for the robot's watchdog


async def paused_on_the_pendant(c: WireCell) -> None:
    controller = c.b.controller
    if isinstance(controller, RmiController):
        controller.pause()
    elif isinstance(controller, KarelController):
        controller.hold()
    else:
        c.point.stop()
        controller._robot.machine.paused = True


STRIKES: Final[dict[str, Callable[[WireCell], Coroutine[None, None, None]]]] = {
    strike.__name__: strike
    for strike in (
        cut, half_a_packet, silence, reply_for_another, duplicate_reply, nonsense, emergency_stop, collision,
        override_lowered, switched_to_t1, rebooted, second_client, another_writes_commands, part_lost,
        robot_heartbeat_frozen, started_without_heartbeat, started_after_a_pause, pc_heartbeat_frozen,
        paused_on_the_pendant,
    )
}  # fmt: skip
