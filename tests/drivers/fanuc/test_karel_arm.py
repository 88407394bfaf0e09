"""The KAREL driver where all goes well on the wire: connecting, moving, stopping, faults of the robot, signals."""

import asyncio
import errno
import os
import socket
from collections.abc import Awaitable, Callable
from dataclasses import replace

import pytest
import serial

from drivers.fanuc.karel import FanucKarelConfig
from drivers.fanuc.karel.lines import Reply
from drivers.sim.karel.built_in import CONSTANTS
from drivers.sim.karel_server import TcpCarrier
from srvs_cell.alarms import Alarm
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import (
    CommandRejectedError,
    DeviceFaultError,
    Lifecycle,
    MotionStoppedError,
    NotConnectedError,
    NotReadyError,
    OutcomeUnknownError,
    PortError,
    RobotMode,
)
from tests.drivers.fanuc.bench import HOME, PATIENT_S, SPEED_MM_S, TARGET
from tests.drivers.fanuc.karel_bench import CARRIERS, KarelBench, karel_bench, make_arm
from tests.drivers.fanuc.karel_conversation import Conversation
from tests.drivers.stepped import SteppedClock, SteppedTime

FAR = Xyzwpr(3000.0, 0.0, 400.0, 180.0, 0.0, 0.0)


def _clock() -> SteppedClock:
    return SteppedClock(SteppedTime())


@pytest.mark.parametrize("wires", [{}, {"tcp": {"host": "robot"}, "serial": {"device": "/dev/ttyS0"}}])
def test_a_config_names_exactly_one_wire(wires: dict[str, dict[str, str]]) -> None:
    with pytest.raises(ValueError, match="name one wire"):
        FanucKarelConfig.model_validate(wires)


# -- connecting -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("carrier", CARRIERS)
async def test_connecting_reads_and_moves_nothing(carrier: str) -> None:
    async with karel_bench(carrier) as b:
        await b.arm.connect()
        assert b.arm.lifecycle is Lifecycle.INACTIVE
        assert b.address in b.arm.description
        status = await b.arm.status()
        assert (status.pose, status.mode, status.override_percent, status.servo_on) == (HOME, RobotMode.AUTO, 100, True)
        assert (status.user_frame, status.user_tool, status.moving, status.fault) == (1, 1, False, None)
        await b.clock.sleep(1.0)
        assert b.controller.motions_started == 0
        assert set(b.controller.wire.received) == {"HELO", "STAT", "BEAT"}
        await b.arm.disconnect()
        assert b.controller.wire.received[-1] == "QUIT"


async def test_the_robots_serial_port_is_set_up_as_9600_8n1() -> None:
    async with karel_bench("serial") as b:
        names = {number: name for name, number in CONSTANTS.items()}
        settings = {names[attribute]: value for (_, attribute), value in b.controller.robot.port_settings.items()}
        assert settings.pop("ATR_READAHD") == 2
        assert {name: names[value] for name, value in settings.items()} == {
            "ATR_BAUD": "BAUD_9600",
            "ATR_DBITS": "DBITS_8",
            "ATR_PARITY": "PARITY_NONE",
            "ATR_SBITS": "SBITS_1",
            "ATR_XONOFF": "XF_NOT_USED",
            "ATR_MODEM": "MD_NOT_USED",
        }
        await b.arm.connect()
        port = b.arm._session._link._serial  # type: ignore[attr-defined]
        assert (port.baudrate, port.bytesize, port.parity, port.stopbits) == (9600, 8, "N", 1)
        assert (port.xonxoff, port.rtscts, port.dsrdtr) == (False, False, False)


async def test_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(NotConnectedError) as error:
        await make_arm(_clock(), "tcp", str(port)).connect()
    assert error.value.alarm is Alarm.CONNECTION_REFUSED


async def test_a_port_that_takes_connections_and_says_nothing() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        arm = make_arm(_clock(), "tcp", str(listener.getsockname()[1]), timeout_s=0.05)
        with pytest.raises(NotConnectedError, match="does srvstcp or srvsser run") as error:
            await arm.connect()
    assert error.value.alarm is Alarm.CONNECTION_TIMEOUT
    assert "Asked 3 times" in error.value.detail


@pytest.mark.parametrize(
    ("number", "alarm", "words"),
    [
        (errno.ENOENT, Alarm.DEVICE_UNAVAILABLE, "no such device"),
        (errno.EACCES, Alarm.DEVICE_UNAVAILABLE, "dialout"),
        (errno.EBUSY, Alarm.SESSION_HELD, "another program"),
        (errno.EIO, Alarm.DEVICE_UNAVAILABLE, "Input/output error"),
    ],
)
async def test_why_a_serial_port_cannot_be_opened(
    monkeypatch: pytest.MonkeyPatch, number: int, alarm: Alarm, words: str
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise serial.SerialException(number, os.strerror(number))

    monkeypatch.setattr(serial, "Serial", fails)
    with pytest.raises(NotConnectedError, match=words) as error:
        await make_arm(_clock(), "serial", "/dev/ttyS7").connect()
    assert error.value.alarm is alarm
    assert "/dev/ttyS7" in error.value.detail


async def test_a_serial_port_that_another_program_holds() -> None:
    async with karel_bench("serial") as b:
        await b.arm.connect()
        with pytest.raises(NotConnectedError) as error:
            await make_arm(b.clock, "serial", b.address).connect()
        assert error.value.alarm is Alarm.SESSION_HELD


@pytest.mark.parametrize("refuses", [True, False])
async def test_a_second_client_is_told_and_the_first_one_moves_on(refuses: bool) -> None:
    async with karel_bench() as b:
        await b.ready()
        task = await b.begun_move()
        carrier = b.controller.wire._carrier
        assert isinstance(carrier, TcpCarrier)
        carrier.refuses_second = refuses
        with pytest.raises(NotConnectedError) as error:
            await make_arm(b.clock, "tcp", b.address, timeout_s=PATIENT_S if refuses else 0.1).connect()
        assert error.value.alarm is (Alarm.SESSION_HELD if refuses else Alarm.CONNECTION_TIMEOUT)
        assert "another one is there" in error.value.detail or "no other PC" in error.value.detail
        assert await task == TARGET
        assert b.controller.motions_started == 1


@pytest.mark.parametrize(
    ("answer", "alarm", "words"),
    [
        (b"0:success\n", Alarm.PROTOCOL_ERROR, "0:success"),
        (b"220 FTP server ready.\r\n", Alarm.PROTOCOL_ERROR, "220 FTP"),
        (b"x" * 5000, Alarm.PROTOCOL_ERROR, "xxx' is no reply"),
        (b"<1,OK,4201,0*9101\r\n", Alarm.PROTOCOL_VERSION, "4201"),
        (b"<1,NO,15,4400*%d\r\n", Alarm.PROTOCOL_VERSION, "4400"),
        (b"<9,OK*%d\r\n", Alarm.PROTOCOL_ERROR, "number 9, which was never sent"),
    ],
)
async def test_what_answers_must_be_the_robots_program(answer: bytes, alarm: Alarm, words: str) -> None:
    body = answer.split(b"*")[0]
    low = high = 0
    for character in body:
        low = (low + character) % 255
        high = (high + low) % 255
    answer = b"%b*%d\r\n" % (body, high * 256 + low) if b"*" in answer else answer

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readline()
        writer.write(answer)
        await reader.read()
        writer.close()
        await writer.wait_closed()
        served.set()

    served = asyncio.Event()
    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    arm = make_arm(_clock(), "tcp", str(server.sockets[0].getsockname()[1]), timeout_s=0.3)
    arm._session._sequence = 0
    try:
        with pytest.raises(PortError) as error:
            await arm.connect()
    finally:
        await served.wait()
        server.close()
        await server.wait_closed()
    assert error.value.alarm is alarm
    assert words in error.value.detail
    assert arm.lifecycle is Lifecycle.DISCONNECTED


@pytest.mark.parametrize("carrier", CARRIERS)
async def test_half_a_line_of_whoever_was_there_before_does_no_harm(carrier: str) -> None:
    async with karel_bench(carrier) as b:
        if carrier == "serial":
            with open(b.address, "wb", buffering=0) as before:  # noqa: ASYNC230, PTH123 - a device, not a file
                before.write(b">3,MOVL,600000,0,40")
        await b.ready()
        assert await b.arm.move_linear(TARGET, 100.0) == TARGET


async def test_answers_to_a_process_that_is_gone_are_let_pass_and_its_move_is_ended_for_good() -> None:
    async with karel_bench("serial") as b:
        b.controller.frozen = True
        gone, move = Conversation(), (600_000, 0, 400_000, 180_000, 0, 0, 20_000)
        with open(b.address, "wb", buffering=0) as before:  # noqa: ASYNC230, PTH123 - a device, not a file
            before.write(gone.line("HELO", 4301) + gone.line("ENBL") + gone.line("MOVL", *move))
        await _received(b, ["HELO", "ENBL", "MOVL"])
        connecting = asyncio.create_task(b.arm.connect())
        await _received(b, ["HELO", "ENBL", "MOVL", "HELO"])
        b.controller.frozen = False
        b.controller.take(b"\n")  # it goes on, and answers all that it was asked
        await connecting
        assert b.arm._session._not_ours == 3, "its answers were never there: this is no test of them"
        assert not b.point.moving
        stood = b.point.pose
        await b.arm.activate()
        await b.clock.sleep(1.0)
        assert (b.point.pose, b.controller.motions_started) == (stood, 0)
        assert await b.arm.move_linear(TARGET, 100.0) == TARGET


async def _received(b: KarelBench, commands: list[str]) -> None:
    while b.controller.wire.received != commands:  # noqa: ASYNC110 - a thread has no asyncio event
        await asyncio.sleep(0)


async def test_a_move_that_another_process_has_left_under_way_ends_when_this_one_connects() -> None:
    async with karel_bench("serial") as b:
        await b.ready()
        task = await b.begun_move()
        b.arm._session._end(NotConnectedError(Alarm.CONNECTION_LOST, "This process has died."))
        with pytest.raises(OutcomeUnknownError):
            await task
        assert b.point.moving
        second = make_arm(b.clock, "serial", b.address)
        await second.connect()
        assert not (await second.status()).moving
        assert not b.moving()
        await second.disconnect()


async def test_a_robot_that_says_at_once_that_it_moves_is_let_go_of() -> None:
    async with karel_bench() as b:
        b.arm._session.read = _busy(b.arm._session.read)  # type: ignore[method-assign,assignment]
        with pytest.raises(NotReadyError) as error:
            await b.arm.connect()
        assert error.value.alarm is Alarm.ROBOT_BUSY
        assert b.arm.lifecycle is Lifecycle.DISCONNECTED


def _busy(read: Callable[..., Awaitable[Reply]]) -> Callable[..., Awaitable[Reply]]:
    async def busy(name: str, *values: int) -> Reply:
        reply = await read(name, *values)
        return replace(reply, values=(1, *reply.values[1:])) if name == "STAT" else reply

    return busy


# -- moving -----------------------------------------------------------------------------------------------------------


async def test_the_driver_refuses_to_move_a_robot_that_is_not_ready() -> None:
    async with karel_bench() as b:
        await b.arm.connect()
        for name, value, alarm in (
            ("mode", RobotMode.T1, Alarm.MODE_NOT_AUTO),
            ("pendant_enabled", True, Alarm.MODE_NOT_AUTO),
            ("servo_on", False, Alarm.ROBOT_NOT_READY),
        ):
            good = getattr(b.point, name)
            setattr(b.point, name, value)
            with pytest.raises(NotReadyError) as error:
                await b.arm.activate()
            assert error.value.alarm is alarm
            setattr(b.point, name, good)
        await b.arm.activate()
        b.point.mode = RobotMode.T1
        with pytest.raises(NotReadyError):
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        assert (await b.arm.status()).mode is RobotMode.T1
        assert b.controller.motions_started == 0


async def test_t1_between_reading_and_command_is_refused_by_the_robot() -> None:
    async with karel_bench() as b:
        await b.ready()
        read = b.arm._read

        async def then_t1() -> object:
            status = await read()
            b.point.mode = RobotMode.T1
            return status

        b.arm._read = then_t1  # type: ignore[method-assign,assignment]
        with pytest.raises(NotReadyError, match="code 11"):
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        assert b.controller.motions_started == 0


@pytest.mark.parametrize(
    ("target", "speed", "kind", "words"),
    [
        (Xyzwpr(3001.0, 0.0, 0.0, 0.0, 0.0, 0.0), 10.0, CommandRejectedError, "code 4"),
        (TARGET, 0.5, CommandRejectedError, "code 5"),
        (TARGET, 2500.0, CommandRejectedError, "code 5"),
        (Xyzwpr(1e9, 0.0, 0.0, 0.0, 0.0, 0.0), 10.0, CommandRejectedError, "cannot be sent"),
        (FAR, 100.0, CommandRejectedError, "MOTN-018"),
    ],
)
async def test_a_target_that_is_refused_moves_nothing(
    target: Xyzwpr, speed: float, kind: type[PortError], words: str
) -> None:
    async with karel_bench() as b:
        await b.ready()
        with pytest.raises(kind, match=words):
            await b.arm.move_linear(target, speed)
        assert b.point.pose == HOME
        assert b.controller.motions_started == 0


async def test_another_frame_chosen_on_the_pendant_is_refused() -> None:
    async with karel_bench() as b:
        await b.ready()
        b.controller.robot.user_frame = 3
        with pytest.raises(NotReadyError) as error:
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        assert error.value.alarm is Alarm.FRAME_CHANGED
        assert (await b.arm.status()).user_frame == 3


async def test_an_override_that_changes_in_mid_move_changes_the_time_allowed() -> None:
    async with karel_bench(poll_s=0.5, heartbeat_s=1.0) as b:
        b.point.override_percent = 10
        await b.ready()
        begun_s = b.clock.now_s()
        assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET
        assert b.clock.now_s() - begun_s > 50.0


async def test_a_move_that_does_not_end_in_its_time_is_stopped_and_unknown() -> None:
    async with karel_bench(poll_s=0.5, heartbeat_s=1.0) as b:
        await b.ready()
        task = await b.begun_move()
        b.point._speed_mm_s = 1e-6
        with pytest.raises(OutcomeUnknownError, match="not ended after"):
            await task
        assert b.arm.lifecycle is Lifecycle.INACTIVE
        assert b.controller.wire.received.count("MOVL") == 1


async def test_a_robot_that_arrives_elsewhere_is_noticed() -> None:
    async with karel_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.point._target = Xyzwpr(601.0, 0.0, 400.0, 180.0, 0.0, 0.0)
        with pytest.raises(DeviceFaultError, match=r"stands 1\.000 mm"):
            await task


async def test_a_cancelled_move_is_stopped() -> None:
    async with karel_bench() as b:
        await b.ready()
        task = await b.begun_move()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert not b.point.moving
        assert b.arm.lifecycle is Lifecycle.INACTIVE


# -- the robot's own faults -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("carrier", CARRIERS)
async def test_an_e_stop_in_mid_move_is_named_and_nothing_is_continued(carrier: str) -> None:
    async with karel_bench(carrier) as b:
        await b.ready()
        task = await b.begun_move()
        b.point.stop()
        b.point.fault, b.point.servo_on = "SRVO-001 Operator panel E-stop", False
        with pytest.raises(DeviceFaultError, match="SRVO-001") as error:
            await task
        assert error.value.alarm is Alarm.ROBOT_FAULT
        stood = b.point.pose
        assert (await b.arm.status()).fault == "SRVO-001"
        b.point.servo_on = True
        await b.arm.reset_fault()
        assert (await b.arm.status()).fault is None
        with pytest.raises(NotReadyError):
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        await b.arm.activate()
        await b.clock.sleep(5.0)
        assert b.point.pose == stood
        assert await b.arm.move_linear(TARGET, SPEED_MM_S) == TARGET
        assert b.controller.motions_started == 2


async def test_a_collision_has_its_own_name() -> None:
    async with karel_bench() as b:
        b.point.collide_after_mm = 30.0
        await b.ready()
        with pytest.raises(DeviceFaultError) as error:
            await b.arm.move_linear(TARGET, SPEED_MM_S)
        assert error.value.alarm is Alarm.COLLISION


async def test_hold_on_the_pendant_ends_the_move_for_good() -> None:
    async with karel_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.hold()
        with pytest.raises(MotionStoppedError, match="at the robot"):
            await task
        stood = b.point.pose
        await b.arm.activate()
        await b.clock.sleep(5.0)
        assert b.point.pose == stood


async def test_a_fault_that_stays_is_said() -> None:
    async with karel_bench() as b:
        await b.arm.connect()
        b.point.fault, b.point.reset_fault = "SRVO-006 Hand broken", lambda: None  # type: ignore[method-assign]
        await b.clock.sleep(0.1)
        with pytest.raises(DeviceFaultError, match="code 13"):
            await b.arm.reset_fault()


# -- signals ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("carrier", CARRIERS)
async def test_inputs_and_outputs(carrier: str) -> None:
    async with karel_bench(carrier) as b:
        await b.arm.connect()
        b.point.inputs[3] = True
        assert (await b.arm.read_input(3), await b.arm.read_input(4)) == (True, False)
        await b.arm.write_output(12, on=True)
        assert b.point.outputs == {12: True}
        assert await b.arm.read_output(12)
        with pytest.raises(CommandRejectedError, match="code 14"):
            await b.arm.write_output(4096, on=True)
        with pytest.raises(CommandRejectedError):
            await b.arm.read_input(4096)


async def test_an_output_that_reads_otherwise_is_unknown() -> None:
    async with karel_bench() as b:
        await b.arm.connect()
        b.point.set_output = lambda *_: None  # type: ignore[method-assign]
        with pytest.raises(OutcomeUnknownError, match="but reads False"):
            await b.arm.write_output(5, on=True)
