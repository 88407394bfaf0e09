"""Taking the motion session: every way in which it fails has its own name, nothing moves, and it is given back."""

import asyncio
import contextlib
import errno
import socket
from collections.abc import AsyncIterator

import pytest

from drivers.fanuc.rmi import FanucRmiConfig
from drivers.sim.rmi_server import RmiFault
from srvs_cell.alarms import Alarm
from srvs_cell.ports import (
    Lifecycle,
    MotionStoppedError,
    NotConnectedError,
    NotReadyError,
    OutcomeUnknownError,
    PortError,
)
from tests.drivers.fanuc.bench import HOME, IMPATIENT_S, TARGET
from tests.drivers.fanuc.rmi_bench import make_arm, rmi_bench
from tests.drivers.stepped import SteppedClock, SteppedTime


def _clock() -> SteppedClock:
    return SteppedClock(SteppedTime())


@contextlib.asynccontextmanager
async def welcome(answer: bytes) -> AsyncIterator[int]:
    """Serve a first port that gives every line the same answer, then closes."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readline()
        writer.write(answer)
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        await server.wait_closed()


async def test_connecting_takes_the_session_and_moves_nothing() -> None:
    async with rmi_bench() as b:
        await b.arm.connect()
        assert b.arm.lifecycle is Lifecycle.INACTIVE
        assert "RMI 9.0" in b.arm.description
        status = await b.arm.status()
        assert (status.pose, status.session_owner) == (HOME, "this cell")
        assert (status.user_frame, status.user_tool) == (0, 1)
        with pytest.raises(NotReadyError):
            await b.arm.move_linear(TARGET, 100.0)
        await b.clock.sleep(5.0)
        assert b.controller.motions_started == 0
        assert "FRC_Initialize" not in b.controller.server.received


async def test_letting_go_aborts_and_says_goodbye() -> None:
    async with rmi_bench() as b:
        await b.ready()
        await b.arm.disconnect()
        assert b.controller.server.received[-2:] == ["FRC_Abort", "FRC_Disconnect"]
        assert b.arm.lifecycle is Lifecycle.DISCONNECTED
        await b.ready()


async def test_a_controller_that_does_not_answer_is_let_go_of_in_a_bounded_time() -> None:
    async with rmi_bench(timeout_s=IMPATIENT_S, leave_timeout_s=4.0) as b:
        await b.ready()
        b.controller.abort_takes_s = 100.0
        begun_s = b.clock.now_s()
        await b.arm.disconnect()
        assert 4.0 <= b.clock.now_s() - begun_s < 4.2
        await b.heard()
        assert b.controller.server.received[-2:] == ["FRC_Abort", "FRC_Disconnect"]


async def test_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(NotConnectedError) as error:
        await make_arm(_clock(), port=port).connect()
    assert error.value.alarm is Alarm.CONNECTION_REFUSED
    assert f":{port}" in error.value.detail
    assert "R912" in error.value.detail


@pytest.mark.parametrize(
    ("failure", "words"),
    [
        (socket.gaierror(socket.EAI_NONAME, "Name or service not known"), "'robot-1' cannot be resolved"),
        (OSError(errno.EHOSTUNREACH, "No route to host"), "no route"),
        (OSError(errno.EMFILE, "Too many open files"), "the connection failed (Too many open files)"),
    ],
)
async def test_what_the_network_says_is_passed_on(
    monkeypatch: pytest.MonkeyPatch, failure: OSError, words: str
) -> None:
    async def fails(*_: object, **__: object) -> None:
        raise failure

    monkeypatch.setattr(asyncio.get_running_loop(), "create_connection", fails)
    with pytest.raises(NotConnectedError) as error:
        await make_arm(_clock(), host="robot-1").connect()
    assert error.value.alarm is Alarm.DEVICE_UNAVAILABLE
    assert words in error.value.detail


async def test_silence_on_the_first_port() -> None:
    async with rmi_bench(timeout_s=0.05) as b:
        b.controller.server.fault = RmiFault.DEAF
        with pytest.raises(NotConnectedError) as error:
            await b.arm.connect()
        assert error.value.alarm in {Alarm.CONNECTION_LOST, Alarm.CONNECTION_TIMEOUT}


async def test_a_port_that_takes_connections_and_says_nothing() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        arm = make_arm(_clock(), port=listener.getsockname()[1], timeout_s=0.05)
        with pytest.raises(NotConnectedError) as error:
            await arm.connect()
    assert error.value.alarm is Alarm.CONNECTION_TIMEOUT
    assert "no reply to FRC_Connect" in error.value.detail


@pytest.mark.parametrize(
    ("answer", "alarm", "words"),
    [
        (b'{"Communication":"FRC_Connect","ErrorID":0}\r\n', Alarm.PROTOCOL_ERROR, "names no PortNumber"),
        (
            b'{"Communication":"FRC_Connect","ErrorID":0,"PortNumber":99999,"MajorVersion":9,"MinorVersion":0}\r\n',
            Alarm.PROTOCOL_ERROR,
            "PortNumber reads 99999",
        ),
        (
            b'{"Communication":"FRC_Connect","ErrorID":0,"PortNumber":16002}\r\n',
            Alarm.PROTOCOL_VERSION,
            "MajorVersion reads None",
        ),
        (b'{"Communication":"FRC_Connect","ErrorID":2556944}\r\n', Alarm.ROBOT_NOT_READY, "RMIT-016"),
        (b'{"Communication":"FRC_Connect"}\r\n', Alarm.PROTOCOL_ERROR, "does not answer FRC_Connect"),
        (b'{"ErrorID":0}\r\n', Alarm.PROTOCOL_ERROR, "does not begin with"),
        (b"220 FTP server ready.\r\n", Alarm.PROTOCOL_ERROR, "220 FTP"),
        (b"x" * 9000, Alarm.PROTOCOL_ERROR, "without a line end"),
        (b"", Alarm.CONNECTION_LOST, "the connection was cut"),
    ],
)
async def test_what_answers_must_be_the_interface(answer: bytes, alarm: Alarm, words: str) -> None:
    async with welcome(answer) as port:
        arm = make_arm(_clock(), port=port)
        with pytest.raises(PortError) as error:
            await arm.connect()
    assert error.value.alarm is alarm
    assert words in error.value.detail
    assert arm.lifecycle is Lifecycle.DISCONNECTED


async def test_the_sessions_port_may_open_a_moment_late() -> None:
    async with rmi_bench() as b:
        session = b.arm._session
        connects: list[int] = []
        real = asyncio.get_running_loop().create_connection

        async def late(factory: object, host: str, port: int) -> object:
            connects.append(port)
            if 1 < len(connects) < 5:
                raise ConnectionRefusedError
            return await real(factory, host, port)  # type: ignore[call-overload]

        asyncio.get_running_loop().create_connection = late  # type: ignore[assignment,method-assign]
        begun_s = b.clock.now_s()
        await b.arm.connect()
        assert session.connected
        assert 0.7 < b.clock.now_s() - begun_s < 0.8
        assert len(connects) == 5


async def test_a_sessions_port_that_stays_closed_is_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    answer = f'{{"Communication":"FRC_Connect","ErrorID":0,"PortNumber":{port},"MajorVersion":7,"MinorVersion":0}}\r\n'
    async with welcome(answer.encode()) as first:
        with pytest.raises(NotConnectedError) as error:
            await make_arm(_clock(), port=first).connect()
    assert error.value.alarm is Alarm.CONNECTION_REFUSED


@pytest.mark.parametrize("refuses", [False, True])
async def test_somebody_else_holds_the_session(refuses: bool) -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.server.refuses_second = refuses
        second = make_arm(b.clock, port=b.port, timeout_s=IMPATIENT_S)
        with pytest.raises(NotConnectedError) as error:
            await second.connect()
        assert error.value.alarm is Alarm.SESSION_HELD
        assert second.lifecycle is Lifecycle.DISCONNECTED
        assert await task == TARGET  # and whoever has it is not disturbed
        await b.arm.disconnect()
        b.clock.busy = lambda: second._session.busy and not b.controller.working
        await second.connect()
        await second.disconnect()


async def test_what_an_earlier_client_left_running_is_aborted_before_anything_else() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.server.cut()
        with pytest.raises(OutcomeUnknownError):
            await task
        went_on = b.point.moving
        await b.arm.connect()
        assert (went_on, b.point.moving) == (True, False)
        assert b.point.pose != TARGET
        assert b.arm.lifecycle is Lifecycle.INACTIVE
        assert b.controller.motions_started == 1


async def test_a_session_that_idles_too_long_is_ended_by_the_controller_and_says_so() -> None:
    async with rmi_bench() as b:
        await b.arm.connect()
        b.controller.server.send({"Communication": "FRC_Terminate"})
        b.controller.server.cut()
        while b.arm._session.connected:  # noqa: ASYNC110 - the socket has no event for tests
            await asyncio.sleep(0)
        with pytest.raises(NotConnectedError, match=r"DISCNT_TIM"):
            await b.arm.status()


async def test_the_first_reply_of_the_session_may_not_come() -> None:
    async with rmi_bench(timeout_s=IMPATIENT_S) as b:
        b.controller.server.fault, b.controller.server.fault_at = RmiFault.SILENT, "FRC_GetStatus"
        with pytest.raises(NotConnectedError) as error:
            await b.arm.connect()
        assert error.value.alarm is Alarm.CONNECTION_TIMEOUT
        assert "FRC_GetStatus: no reply within 0.4 s" in error.value.detail
        assert b.arm.lifecycle is Lifecycle.DISCONNECTED


@pytest.mark.parametrize(
    ("attribute", "value", "alarm", "words"),
    [
        ("initialize_error", 2556944, Alarm.ROBOT_NOT_READY, "RMIT-016"),
        ("initialize_error", 7015, Alarm.ROBOT_NOT_READY, "delete RMI_MOVE"),
        ("initialize_error", 2556968, Alarm.CONFIG_INVALID, "group_mask"),
        ("single_step", True, Alarm.ROBOT_NOT_READY, "Single step"),
    ],
)
async def test_a_controller_that_cannot_be_initialised_says_why(
    attribute: str, value: int, alarm: Alarm, words: str
) -> None:
    async with rmi_bench() as b:
        await b.arm.connect()
        setattr(b.controller, attribute, value)
        with pytest.raises(NotReadyError) as error:
            await b.arm.activate()
        assert error.value.alarm is alarm
        assert words in error.value.detail
        assert b.arm.lifecycle is Lifecycle.INACTIVE
        setattr(b.controller, attribute, type(value)(0))
        await b.arm.activate()


async def test_an_old_version_resets_only_while_rmi_runs_and_says_so() -> None:
    async with rmi_bench() as b:
        b.controller.major_version = 3
        await b.arm.connect()
        with pytest.raises(NotReadyError, match="press RESET on the pendant"):
            await b.arm.reset_fault()


async def test_inputs_are_read_though_nothing_may_move() -> None:
    async with rmi_bench() as b:
        await b.arm.connect()
        b.point.inputs[7] = True
        assert await b.arm.read_input(7)
        assert not await b.arm.read_input(8)
        assert b.arm.lifecycle is Lifecycle.INACTIVE
        assert b.controller.server.received.count("FRC_Initialize") == 1
        await b.arm.activate()
        assert b.controller.server.received.count("FRC_Initialize") == 1
        assert await b.arm.move_linear(TARGET, 100.0) == TARGET


async def test_an_input_that_would_need_rmi_is_refused_with_the_reason_while_the_pendant_is_on() -> None:
    async with rmi_bench() as b:
        await b.arm.connect()
        b.point.pendant_enabled = True
        with pytest.raises(NotReadyError) as refused:
            await b.arm.read_input(7)
        assert refused.value.alarm is Alarm.MODE_NOT_AUTO


async def test_a_stop_while_the_arm_is_made_active_is_not_lost() -> None:
    async with rmi_bench() as b:
        await b.arm.connect()
        task = asyncio.create_task(b.arm.activate())
        while "FRC_SetUFrameUTool" not in b.controller.server.received:  # noqa: ASYNC110 - the double runs in a thread
            await asyncio.sleep(0)
        await b.arm.request_stop()
        with pytest.raises(NotReadyError, match="stop was requested"):
            await task
        assert b.arm.lifecycle is Lifecycle.INACTIVE


async def test_a_session_lost_in_mid_stop_is_reported() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.server.cut()
        with pytest.raises(OutcomeUnknownError):
            await task
        with pytest.raises(NotConnectedError):
            await b.arm.request_stop()


async def test_two_stops_are_one_abort() -> None:
    async with rmi_bench() as b:
        await b.ready()
        task = await b.begun_move()
        b.controller.abort_takes_s = 45.0
        await asyncio.gather(b.arm.request_stop(), b.arm.request_stop())
        with pytest.raises(MotionStoppedError):
            await task
        assert b.controller.server.received.count("FRC_Abort") == 1


@pytest.mark.parametrize(
    ("settings", "named"),
    [({"hots": "10.0.0.2"}, "hots"), ({"port": 0}, "port"), ({"user_tool": 0}, "user_tool")],
)
def test_a_wrong_config_names_what_is_wrong(settings: dict[str, object], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        FanucRmiConfig.model_validate(settings)
