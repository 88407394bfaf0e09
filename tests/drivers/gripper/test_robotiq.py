"""The Robotiq driver: what it sends, what it believes, and what becomes of a grip when wire or gripper fail."""

import asyncio
import os
import pty
from pathlib import Path

import pytest
import serial

from drivers.gripper.robotiq_config import RobotiqGripperConfig
from drivers.sim.rtu_line import LineFault
from srvs_cell.alarms import Alarm
from srvs_cell.ports import (
    DeviceFaultError,
    GripState,
    Lifecycle,
    NotConnectedError,
    NotReadyError,
    OutcomeUnknownError,
    PortError,
)
from tests.drivers.gripper.robotiq_bench import IMPATIENT_S, PART_AT, PART_MM, robotiq_bench

CLEAR, ACTIVATE = (0x00, 0, 0, 0), (0x01, 0, 0, 0)


# -- activation -------------------------------------------------------------------------------------------------------


async def test_connecting_moves_nothing_and_activating_makes_it_ready() -> None:
    async with robotiq_bench(activated=False) as b:
        await b.gripper.connect()
        assert b.double.commands == []
        assert await b.gripper.state() is GripState.UNKNOWN
        begun_s = b.clock.now_s()
        await b.gripper.activate()
        assert b.double.commands == [CLEAR, ACTIVATE]
        assert b.clock.now_s() - begun_s >= b.double.activation_takes_s
        await b.gripper.open()
        assert await b.gripper.state() is GripState.OPEN


async def test_what_is_active_is_not_activated_again() -> None:
    async with robotiq_bench() as b:
        await b.ready()
        await b.gripper.deactivate()
        await b.gripper.activate()
        assert b.double.commands == []


async def test_an_activation_that_something_obstructs_is_a_fault_with_its_remedy() -> None:
    async with robotiq_bench(activated=False) as b:
        b.double.activation_fails = True
        await b.gripper.connect()
        with pytest.raises(DeviceFaultError) as fault:
            await b.gripper.activate()
        assert fault.value.alarm is Alarm.GRIPPER_FAULT
        assert "0x0D" in fault.value.detail
        assert "Nothing may be between" in fault.value.detail
        assert b.gripper.lifecycle is Lifecycle.INACTIVE
        b.double.activation_fails = False
        await b.gripper.activate()
        assert b.double.commands == [CLEAR, ACTIVATE, CLEAR, ACTIVATE]


async def test_an_activation_without_end_is_given_up() -> None:
    async with robotiq_bench(activated=False, activation_timeout_s=3.0) as b:
        b.double.activation_takes_s = 1000.0
        await b.gripper.connect()
        with pytest.raises(OutcomeUnknownError, match=r"not activated after 3.0 s"):
            await b.gripper.activate()
        assert b.double.commands == [CLEAR, ACTIVATE]


async def test_power_lost_while_holding_is_said_before_the_activation_drops_the_part() -> None:
    async with robotiq_bench() as b:
        await b.holding()
        b.double.lose_power()
        for _ in range(2):
            with pytest.raises(DeviceFaultError) as lost:
                await b.gripper.state()
            assert lost.value.alarm is Alarm.GRIPPER_STATE_UNKNOWN
        await b.gripper.deactivate()
        sent = len(b.double.commands)
        with pytest.raises(NotReadyError, match="take the part out") as refused:
            await b.gripper.activate()
        assert refused.value.alarm is Alarm.GRIPPER_STATE_UNKNOWN
        assert len(b.double.commands) == sent
        await b.gripper.activate()
        assert b.double.commands[sent:] == [CLEAR, ACTIVATE]


# -- position, speed, force -------------------------------------------------------------------------------------------


async def test_position_speed_and_force_are_sent_in_the_models_counts() -> None:
    async with robotiq_bench(open_mm=42.5, speed_mm_s=150.0, force_n=20.0) as b:
        await b.ready()
        await b.gripper.close()
        await b.gripper.open()
        assert b.double.commands == [(0x09, 255, 255, 0), (0x09, 116, 255, 0)]
        assert b.fingers.position == 116
        assert await b.gripper.state() is GripState.OPEN


async def test_fingers_that_somebody_else_has_left_half_open_are_neither_open_nor_holding() -> None:
    async with robotiq_bench(open_mm=20.0) as narrow:
        await narrow.ready()
        await narrow.gripper.close()
        await narrow.gripper.open()
        request = narrow.double.commands[-1][1]
    async with robotiq_bench() as b:
        await b.ready()
        b.double._command([0x0900, request, 0xFFFF])
        await b.clock.sleep(2.0)
        assert await b.gripper.state() is GripState.UNKNOWN


async def test_slow_fingers_are_awaited() -> None:
    async with robotiq_bench(speed_mm_s=20.0) as b:
        await b.ready()
        begun_s = b.clock.now_s()
        assert await b.gripper.close() is GripState.CLOSED_EMPTY
        assert b.clock.now_s() - begun_s > 85.0 / 25.0


@pytest.mark.parametrize(
    "wrong",
    [
        {"force_n": 10.0},
        {"speed_mm_s": 200.0},
        {"model": "2f140", "force_n": 200.0},
        {"open_mm": 90.0},
        {"open_mm": 2.0},
        {"stroke": ((3, 0.0), (230, 85.0))},
        {"baud_rate": 4800},
        {"port": "ttyUSB0"},
        {"device_id": 0},
        {"grip": "outside"},
    ],
)
def test_an_impossible_config_is_an_error(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="validation error"):
        RobotiqGripperConfig.model_validate({"port": "/dev/ttyUSB0", **wrong})


# -- object detection -------------------------------------------------------------------------------------------------


async def test_a_lost_part_is_noticed() -> None:
    async with robotiq_bench() as b:
        await b.holding()
        assert await b.gripper.state() is GripState.HOLDING
        b.fingers.lose_part()
        await b.clock.sleep(0.05)
        assert await b.gripper.state() is GripState.MOVING
        await b.clock.sleep(2.0)
        assert await b.gripper.state() is GripState.CLOSED_EMPTY


async def test_a_part_that_has_tipped_in_the_fingers_is_said_once_and_then_the_sensors_count() -> None:
    async with robotiq_bench() as b:
        await b.holding()
        b.fingers.slip_to(PART_AT + 4)
        await b.clock.sleep(1.0)
        assert await b.gripper.state() is GripState.HOLDING  # 1.5 mm is the rubber of the tips
        b.fingers.slip_to(PART_AT + 40)
        await b.clock.sleep(1.0)
        with pytest.raises(DeviceFaultError, match=rf"gripped at {PART_MM:.1f} mm.*26\.2 mm") as slipped:
            await b.gripper.state()
        assert slipped.value.alarm is Alarm.GRIPPER_STATE_UNKNOWN
        assert await b.gripper.state() is GripState.HOLDING


async def test_finger_tips_that_meet_are_no_part() -> None:
    async with robotiq_bench() as b:
        await b.ready()
        b.fingers.part_at = 228
        assert await b.gripper.close() is GripState.CLOSED_EMPTY


async def test_fingers_that_are_stopped_while_opening_are_not_open() -> None:
    async with robotiq_bench() as b:
        await b.holding()
        b.fingers.part_at, b.fingers.jam_at = None, 60
        with pytest.raises(OutcomeUnknownError, match="the fingers are holding, not open") as jammed:
            await b.gripper.open()
        assert jammed.value.alarm is Alarm.GRIP_TIMEOUT


async def test_the_reading_from_before_the_command_is_not_believed() -> None:
    async with robotiq_bench(settle_s=0.0) as b:
        await b.ready()
        take = b.double._command

        def ignore(words: list[int]) -> None:
            del words

        b.double._command = ignore  # type: ignore[method-assign]  # confirmed on the wire, not carried out
        with pytest.raises(OutcomeUnknownError):
            await b.gripper.close()
        b.double._command = take  # type: ignore[method-assign]


# -- faults of the gripper --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("code", [0x0A, 0x0B, 0x0C, 0x0D, 0x0E, 0x0F, 0x03])
async def test_a_major_fault_while_carrying_is_named_and_asks_for_a_person(code: int) -> None:
    async with robotiq_bench() as b:
        await b.holding()
        b.double.fault_code = code
        with pytest.raises(DeviceFaultError, match=f"0x{code:02X}") as fault:
            await b.gripper.state()
        assert fault.value.alarm is Alarm.GRIPPER_FAULT
        with pytest.raises(NotReadyError, match=f"0x{code:02X}"):
            await b.gripper.open()
        with pytest.raises(NotReadyError, match="take the part out"):
            await b.gripper.activate()
        await b.gripper.activate()
        assert b.double.commands[-2:] == [CLEAR, ACTIVATE]


async def test_a_hot_gripper_is_read_but_does_not_act() -> None:
    async with robotiq_bench() as b:
        await b.holding()
        b.double.fault_code = 0x08
        assert await b.gripper.state() is GripState.HOLDING
        with pytest.raises(NotReadyError, match="hotter than 85"):
            await b.gripper.open()
        await b.gripper.deactivate()
        with pytest.raises(DeviceFaultError, match="hotter than 85"):
            await b.gripper.activate()


async def test_a_fault_in_mid_grip_ends_it() -> None:
    async with robotiq_bench(speed_mm_s=20.0) as b:
        await b.ready()
        grip = asyncio.create_task(b.gripper.close())
        await b.clock.sleep(1.0)
        b.double.fault_code = 0x0E
        with pytest.raises(DeviceFaultError, match="too much current") as fault:
            await grip
        assert fault.value.alarm is Alarm.GRIPPER_FAULT


async def test_power_lost_in_mid_grip_ends_it() -> None:
    async with robotiq_bench(speed_mm_s=20.0) as b:
        await b.ready()
        grip = asyncio.create_task(b.gripper.close())
        await b.clock.sleep(1.0)
        b.double.lose_power()
        with pytest.raises(DeviceFaultError, match="lost its power"):
            await grip
        with pytest.raises(NotReadyError, match="not activated"):
            await b.gripper.open()
        assert len(b.double.commands) == 1


async def test_that_nobody_talked_to_it_is_no_fault() -> None:
    async with robotiq_bench() as b:
        await b.ready()
        await b.clock.sleep(5.0)
        assert await b.gripper.state() is GripState.OPEN
        await b.clock.sleep(5.0)
        assert await b.gripper.close() is GripState.CLOSED_EMPTY


# -- faults of the wire -----------------------------------------------------------------------------------------------

USELESS = [fault for fault in LineFault if fault not in {LineFault.NONE, LineFault.PIECES, LineFault.EXCEPTION}]


@pytest.mark.parametrize("fault", USELESS, ids=lambda fault: fault.name)
async def test_after_a_silence_nothing_is_known_until_it_is_connected_anew(fault: LineFault) -> None:
    async with robotiq_bench() as b:
        await b.holding()
        b.lose_patience()
        b.double.line.fault = fault
        with pytest.raises(NotConnectedError) as silent:
            await b.gripper.state()
        assert silent.value.alarm is Alarm.CONNECTION_TIMEOUT
        assert b.gripper.lifecycle is Lifecycle.DISCONNECTED
        b.double.line.fault = LineFault.NONE
        for ask in (b.gripper.state, b.gripper.open, b.gripper.activate):
            with pytest.raises(NotConnectedError, match="given up"):
                await ask()
        await b.gripper.connect()
        assert await b.gripper.state() is GripState.HOLDING


@pytest.mark.parametrize("action", ["open", "close"])
@pytest.mark.parametrize("fault", USELESS, ids=lambda fault: fault.name)
async def test_a_command_without_an_answer_is_sent_once_and_its_outcome_is_unknown(
    fault: LineFault, action: str
) -> None:
    async with robotiq_bench() as b:
        await b.ready()
        asked = len(b.double.line.received)
        b.lose_patience()
        b.double.line.fault, b.double.line.fault_after = fault, 1  # the reading before the command is answered
        with pytest.raises(OutcomeUnknownError) as unknown:
            await (b.gripper.open() if action == "open" else b.gripper.close())
        assert unknown.value.alarm in {Alarm.CONNECTION_TIMEOUT, Alarm.PROTOCOL_ERROR}
        sent = b.double.line.received[asked:]
        assert [frame[1] for frame in sent] == [4, 16]
        assert b.gripper.lifecycle is Lifecycle.DISCONNECTED


async def test_an_answer_that_comes_late_is_not_taken_for_the_next_one() -> None:
    async with robotiq_bench() as b:
        await b.ready()
        b.lose_patience()
        b.double.line.fault = LineFault.LATE
        with pytest.raises(NotConnectedError):
            await b.gripper.state()
        b.fingers.part_at, b.double.line.fault = PART_AT, LineFault.NONE
        await b.gripper.connect()
        await b.gripper.activate()
        assert await b.gripper.close() is GripState.HOLDING


async def test_an_exception_is_named() -> None:
    async with robotiq_bench() as b:
        await b.ready()
        b.double.line.fault = LineFault.EXCEPTION
        with pytest.raises(PortError, match="Modbus exception 4"):
            await b.gripper.state()
        with pytest.raises(PortError, match="Modbus exception 4"):
            await b.gripper.close()
        assert b.double.commands == []


async def test_byte_by_byte_is_an_answer_too() -> None:
    async with robotiq_bench() as b:
        b.double.line.fault = LineFault.PIECES
        await b.ready()
        assert await b.gripper.close() is GripState.CLOSED_EMPTY


async def test_a_converter_that_is_unplugged_while_holding() -> None:
    async with robotiq_bench() as b:
        await b.holding()
        b.lose_patience()
        b.double.close()
        with pytest.raises(NotConnectedError):
            await b.gripper.state()
        assert b.gripper.lifecycle is Lifecycle.DISCONNECTED
        with pytest.raises(NotConnectedError) as gone:
            await b.gripper.connect()
        assert gone.value.alarm is Alarm.DEVICE_UNAVAILABLE
        await b.gripper.disconnect()


async def test_a_grip_that_is_cancelled_leaves_the_wire_in_order() -> None:
    async with robotiq_bench(speed_mm_s=20.0) as b:
        await b.ready()
        for _ in range(5):
            grip = asyncio.create_task(b.gripper.close())
            for _ in range(3):
                await asyncio.sleep(0)
            grip.cancel()
            with pytest.raises(asyncio.CancelledError):
                await grip
        assert await b.gripper.close() is GripState.CLOSED_EMPTY


# -- why a port cannot be opened --------------------------------------------------------------------------------------


async def _why_not(port: str) -> str:
    async with robotiq_bench(IMPATIENT_S, port=port) as b:
        with pytest.raises(NotConnectedError) as error:
            await b.gripper.connect()
        assert error.value.alarm is Alarm.DEVICE_UNAVAILABLE
        assert b.gripper.lifecycle is Lifecycle.DISCONNECTED
        return error.value.detail


async def test_a_port_that_is_not_there(tmp_path: Path) -> None:
    assert "no such device" in await _why_not(str(tmp_path / "ttyUSB7"))


async def test_a_file_is_no_serial_port(tmp_path: Path) -> None:
    file = tmp_path / "ttyUSB0"
    file.touch()
    assert "cannot be used as a serial port" in await _why_not(str(file))


async def test_a_port_that_another_program_has() -> None:
    async with robotiq_bench() as b:
        with serial.Serial(b.port, exclusive=True), pytest.raises(NotConnectedError, match="in use by another program"):
            await b.gripper.connect()


async def test_a_port_without_permission(monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.open

    def refuse(path: str, *arguments: int) -> int:
        if os.path.realpath(path).startswith("/dev/pts/"):
            raise PermissionError(13, "Permission denied", path)
        return real(path, *arguments)

    async with robotiq_bench() as b:
        monkeypatch.setattr(os, "open", refuse)
        with pytest.raises(NotConnectedError, match=r"no permission: .*dialout"):
            await b.gripper.connect()


async def test_a_silent_port_says_what_to_look_at() -> None:
    ours, theirs = pty.openpty()
    try:
        async with robotiq_bench(IMPATIENT_S, port=os.ttyname(theirs)) as b:
            with pytest.raises(NotConnectedError, match=r"24 V supply.*device id 9 and 115200 baud") as silent:
                await b.gripper.connect()
            assert silent.value.alarm is Alarm.CONNECTION_TIMEOUT
    finally:
        os.close(ours)
        os.close(theirs)
