"""Connecting: every way in which it fails has its own name, and nothing ever moves."""

import asyncio
import errno
import socket
import struct

import pytest

from drivers.fanuc.modbus import DRIVER, FanucModbusArm, FanucModbusConfig
from drivers.sim.modbus_server import ModbusServer, WireFault
from srvs_cell.alarms import Alarm
from srvs_cell.ports import DriverContext, Lifecycle, NotConnectedError, NotReadyError, PortError
from tests.drivers.fanuc.bench import HOME, IMPATIENT_S, TARGET, bench
from tests.drivers.stepped import SteppedClock, SteppedTime


class _Words:
    """A device whose words all read the same."""

    def __init__(self, value: int) -> None:
        self._value = value

    def read_words(self, _address: int, count: int) -> list[int]:
        return [self._value] * count

    def write_words(self, _address: int, _values: list[int]) -> None:
        raise AssertionError("connecting must not write")

    def read_coils(self, _address: int, count: int) -> list[bool]:
        return [False] * count

    def write_coils(self, _address: int, _values: list[bool]) -> None:
        raise AssertionError("connecting must not write")

    read_inputs = read_coils


def _arm(**settings: object) -> FanucModbusArm:
    config = DRIVER.config_model.model_validate({"timeout_s": IMPATIENT_S, **settings})
    arm = DRIVER.factory(config, DriverContext(SteppedClock(SteppedTime())))
    assert isinstance(arm, FanucModbusArm)
    return arm


async def test_connecting_leaves_the_arm_inactive_and_unmoved() -> None:
    async with bench() as b:
        lives = [b.arm.lifecycle]
        await b.arm.connect()
        lives.append(b.arm.lifecycle)
        assert lives == [Lifecycle.DISCONNECTED, Lifecycle.INACTIVE]
        assert (await b.arm.status()).pose == HOME
        with pytest.raises(NotReadyError):
            await b.arm.move_linear(TARGET, 100.0)
        await b.clock.sleep(5.0)
        assert b.controller.motions_started == 0


async def test_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(NotConnectedError) as error:
        await _arm(port=port).connect()
    assert error.value.alarm is Alarm.CONNECTION_REFUSED
    assert str(port) in error.value.detail


async def test_a_name_that_does_not_resolve(monkeypatch: pytest.MonkeyPatch) -> None:
    async def no_such_name(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(asyncio.get_running_loop(), "create_connection", no_such_name)
    with pytest.raises(NotConnectedError) as error:
        await _arm(host="robot-1").connect()
    assert error.value.alarm is Alarm.DEVICE_UNAVAILABLE
    assert "'robot-1' cannot be resolved" in error.value.detail


async def test_no_route(monkeypatch: pytest.MonkeyPatch) -> None:
    async def no_route(*_: object, **__: object) -> None:
        raise OSError(errno.EHOSTUNREACH, "No route to host")

    monkeypatch.setattr(asyncio.get_running_loop(), "create_connection", no_route)
    with pytest.raises(NotConnectedError) as error:
        await _arm().connect()
    assert error.value.alarm is Alarm.DEVICE_UNAVAILABLE
    assert "no route" in error.value.detail


async def test_no_answer_to_the_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    async def never(*_: object, **__: object) -> None:
        await asyncio.Event().wait()

    monkeypatch.setattr(asyncio.get_running_loop(), "create_connection", never)
    with pytest.raises(NotConnectedError) as error:
        await _arm(timeout_s=0.05).connect()
    assert error.value.alarm is Alarm.CONNECTION_TIMEOUT


async def test_a_wrong_unit_id_meets_silence_and_is_suspected() -> None:
    async with bench() as b:
        arm = _arm(port=b.port, unit_id=7)
        with pytest.raises(NotConnectedError) as error:
            await arm.connect()
        assert error.value.alarm is Alarm.CONNECTION_TIMEOUT
        assert "unit id 7" in error.value.detail
        assert arm.lifecycle is Lifecycle.DISCONNECTED


async def test_a_connection_that_somebody_else_holds_is_suspected() -> None:
    async with bench() as b:
        await b.arm.connect()
        with pytest.raises(NotConnectedError) as error:
            await _arm(port=b.port).connect()
        assert "no other program holds" in error.value.detail


@pytest.mark.parametrize(
    ("value", "words"), [(0, "all words read 0"), (4202, "reads 4202, not 4201"), (65535, "reads 65535")]
)
async def test_unmapped_or_foreign_words_are_not_taken_for_a_robot(value: int, words: str) -> None:
    server = ModbusServer(_Words(value), SteppedTime(), 0, 1)
    try:
        arm = _arm(port=server.start())
        with pytest.raises(PortError) as error:
            await arm.connect()
        assert error.value.alarm is Alarm.PROTOCOL_VERSION
        assert words in error.value.detail
        assert arm.lifecycle is Lifecycle.DISCONNECTED
    finally:
        server.close()


async def test_a_robot_that_is_busy_is_refused_and_left_alone() -> None:
    async with bench() as b:
        await b.ready()
        await b.begun_move()
        b.controller.server.cut()
        await b.clock.sleep(0.5)
        await b.arm.disconnect()
        with pytest.raises(NotReadyError) as error:
            await b.arm.connect()
        assert error.value.alarm is Alarm.ROBOT_BUSY
        assert b.point.moving


async def test_a_robot_in_fault_is_reachable_so_that_it_can_be_reset() -> None:
    async with bench() as b:
        await b.ready()
        b.point.collide_after_mm = 10.0
        with pytest.raises(PortError):
            await b.arm.move_linear(TARGET, 100.0)
        await b.arm.disconnect()
        await b.arm.connect()
        assert (await b.arm.status()).fault == "SRVO-050"
        await b.arm.reset_fault()
        await b.arm.activate()


async def test_an_exception_answer_is_named() -> None:
    async with bench() as b:
        b.controller.server.fault = WireFault.EXCEPTION
        with pytest.raises(PortError) as error:
            await b.arm.connect()
        assert error.value.alarm is Alarm.PROTOCOL_ERROR
        assert "exception 4" in error.value.detail


async def test_disconnecting_twice_and_connecting_again() -> None:
    async with bench() as b:
        for _ in range(2):
            await b.ready()
            await b.arm.disconnect()
            await b.arm.disconnect()
        with pytest.raises(NotConnectedError):
            await b.arm.status()
        with pytest.raises(NotConnectedError):
            await b.arm.activate()


@pytest.mark.parametrize(
    ("settings", "named"),
    [({"hots": "10.0.0.2"}, "hots"), ({"port": 0}, "port"), ({"hold_output": 4}, "hold_output and reset_output")],
)
def test_a_wrong_config_names_what_is_wrong(settings: dict[str, object], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        FanucModbusConfig.model_validate(settings)


@pytest.mark.parametrize(
    ("request_pdu", "answer_pdu"),
    [
        (struct.pack(">BHH", 3, 12000, 1), struct.pack(">BBH", 3, 2, 4201)),
        (struct.pack(">BHH", 3, 0, 2), struct.pack(">BBHH", 3, 4, 0, 0)),
        (struct.pack(">BHH", 4, 0, 1), bytes([0x84, 1])),
        (struct.pack(">BHH", 3, 0, 126), bytes([0x83, 3])),
        (struct.pack(">BHHBB", 15, 0, 3, 1, 0b101), struct.pack(">BHH", 15, 0, 3)),
        (struct.pack(">BHH", 1, 0, 9), bytes([1, 2, 0b001, 0])),
        (struct.pack(">BHH", 2, 600, 1), bytes([0x82, 2])),
    ],
)
async def test_the_double_speaks_modbus_to_any_client(request_pdu: bytes, answer_pdu: bytes) -> None:
    """Bytes as in the Modbus application protocol, written by hand."""
    async with bench() as b:
        b.point.outputs[1] = request_pdu[0] == 1
        reader, writer = await asyncio.open_connection("127.0.0.1", b.port)
        writer.write(struct.pack(">HHHB", 77, 0, len(request_pdu) + 1, 1) + request_pdu)
        header = await reader.readexactly(7)
        assert struct.unpack(">HHHB", header) == (77, 0, len(answer_pdu) + 1, 1)
        assert await reader.readexactly(len(answer_pdu)) == answer_pdu
        writer.close()
        await writer.wait_closed()
