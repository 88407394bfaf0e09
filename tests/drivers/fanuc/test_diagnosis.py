"""What a diagnosis says of a controller: each reason by its own name, read only, over both wires."""

import asyncio
import errno
import socket
import struct
from collections.abc import Callable, Sequence
from typing import Any

import pytest

from drivers.fanuc import registers
from drivers.fanuc.diagnosis import Conditions, judge
from drivers.fanuc.modbus import DRIVER as MODBUS
from drivers.fanuc.modbus_diagnosis import mapping_fault
from drivers.fanuc.rmi import DRIVER as RMI
from drivers.sim.modbus_server import WireFault
from drivers.sim.rmi_server import RmiFault
from srvs_cell.alarms import Alarm
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import (
    Diagnosable,
    DriverContext,
    Finding,
    FindingLevel,
    InputPeek,
    Lifecycle,
    NotReadyError,
    RobotMode,
    RobotStatus,
)
from tests.drivers.fanuc.bench import IMPATIENT_S, bench
from tests.drivers.fanuc.karel_bench import CARRIERS, karel_bench
from tests.drivers.fanuc.karel_bench import make_arm as make_karel_arm
from tests.drivers.fanuc.rmi_bench import rmi_bench
from tests.drivers.stepped import PointArm, SteppedClock, SteppedTime

FAILED, WARNING = FindingLevel.FAILED, FindingLevel.WARNING


def wrong(findings: Sequence[Finding]) -> dict[str, tuple[FindingLevel, Alarm | None]]:
    return {one.check: (one.level, one.alarm) for one in findings if one.level is not FindingLevel.OK}


def detail_of(findings: Sequence[Finding], check: str) -> str:
    return next(f"{one.detail} {one.remedy}" for one in findings if one.check == check)


# -- one judgement for every wire -------------------------------------------------------------------------------------


def _status(**changes: Any) -> RobotStatus:
    values: dict[str, Any] = {
        "pose": Xyzwpr(500.0, 0.0, 400.0, 180.0, 0.0, 0.0),
        "mode": RobotMode.AUTO,
        "pendant_enabled": False,
        "servo_on": True,
        "moving": False,
        "override_percent": 100,
        "fault": None,
        "user_frame": 1,
        "user_tool": 2,
        "session_owner": None,
        "read_at_s": 0.0,
    }
    return RobotStatus(**{**values, **changes})


ALL_KNOWN = Conditions(single_step=False, remote=True)


def test_a_robot_that_is_ready_has_no_findings_but_good_ones() -> None:
    findings = judge(_status(), ALL_KNOWN)
    assert wrong(findings) == {}
    assert {name: value for one in findings for name, value in one.facts.items()} == {
        "override_percent": 100,
        "user_frame": 1,
        "user_tool": 2,
    }


@pytest.mark.parametrize(
    ("changes", "conditions", "check", "alarm", "words"),
    [
        ({"fault": "SRVO-002"}, ALL_KNOWN, "controller alarm", Alarm.ROBOT_FAULT, "SRVO-002"),
        ({"pendant_enabled": True}, ALL_KNOWN, "teach pendant", Alarm.MODE_NOT_AUTO, "switch to OFF"),
        ({"mode": RobotMode.T1}, ALL_KNOWN, "mode switch", Alarm.MODE_NOT_AUTO, "at T1"),
        ({"mode": RobotMode.T2}, ALL_KNOWN, "mode switch", Alarm.MODE_NOT_AUTO, "at T2"),
        ({"servo_on": False}, ALL_KNOWN, "servo power", Alarm.ROBOT_NOT_READY, "E-stop"),
        ({}, Conditions(single_step=True), "single step", Alarm.ROBOT_NOT_READY, "Press STEP"),
        ({}, Conditions(remote=False), "remote conditions", Alarm.ROBOT_NOT_READY, "Remote/Local"),
    ],
)
def test_each_reason_has_its_own_name_and_remedy(
    changes: dict[str, Any], conditions: Conditions, check: str, alarm: Alarm, words: str
) -> None:
    findings = judge(_status(**changes), conditions)
    assert wrong(findings) == {check: (FAILED, alarm)}
    assert words in detail_of(findings, check)


@pytest.mark.parametrize(("percent", "level"), [(1, WARNING), (10, WARNING), (11, None), (100, None)])
def test_the_override_after_a_cold_start_is_a_warning(percent: int, level: FindingLevel | None) -> None:
    found = wrong(judge(_status(override_percent=percent), ALL_KNOWN))
    assert found == ({} if level is None else {"speed override": (level, Alarm.ROBOT_NOT_READY)})


def test_cmdenbl_is_not_blamed_for_what_has_its_own_name() -> None:
    remote = Conditions(remote=False)
    for changes in ({"fault": "SRVO-001"}, {"pendant_enabled": True}, {"servo_on": False}, {"mode": RobotMode.T1}):
        assert "remote conditions" not in wrong(judge(_status(**changes), remote))


def test_frames_that_the_driver_selects_count_instead_of_those_that_are_active() -> None:
    pose = judge(_status(), Conditions(selects=(3, 4)))[-1]
    assert pose.facts == {"user_frame": 3, "user_tool": 4}
    assert "the driver will select 3 and 4" in pose.detail


# -- how a controller cannot be reached -------------------------------------------------------------------------------


def _arm(driver: Any, **settings: Any) -> Any:
    config = driver.config_model.model_validate({"timeout_s": IMPATIENT_S, **settings})
    return driver.factory(config, DriverContext(SteppedClock(SteppedTime())))


BOTH = pytest.mark.parametrize("driver", [MODBUS, RMI], ids=["modbus", "rmi"])


@BOTH
async def test_refused(driver: Any) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    findings = await _arm(driver, port=port).diagnose()
    assert wrong(findings) == {"connection": (FAILED, Alarm.CONNECTION_REFUSED)}
    assert "refused" in detail_of(findings, "connection")


@BOTH
@pytest.mark.parametrize(
    ("reason", "alarm", "words"),
    [
        (OSError(errno.EHOSTUNREACH, "No route to host"), Alarm.DEVICE_UNAVAILABLE, "no route"),
        (OSError(errno.ENETUNREACH, "Network is unreachable"), Alarm.DEVICE_UNAVAILABLE, "no route"),
        (socket.gaierror(socket.EAI_NONAME, "Name unknown"), Alarm.DEVICE_UNAVAILABLE, "cannot be resolved"),
        (TimeoutError(), Alarm.CONNECTION_TIMEOUT, "Ping the controller"),
    ],
)
async def test_not_reached(
    driver: Any, reason: OSError, alarm: Alarm, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fail(*_: object, **__: object) -> None:
        raise reason

    monkeypatch.setattr(asyncio.get_running_loop(), "create_connection", fail)
    findings = await _arm(driver).diagnose()
    assert wrong(findings) == {"connection": (FAILED, alarm)}
    assert words in detail_of(findings, "connection")


@BOTH
def test_both_wires_offer_a_diagnosis_and_a_look_at_the_inputs(driver: Any) -> None:
    arm = _arm(driver)
    assert isinstance(arm, Diagnosable)
    assert isinstance(arm, InputPeek)


# -- what a robot says over both wires --------------------------------------------------------------------------------


def _in_t1(point: PointArm) -> None:
    point.mode = RobotMode.T1


def _pendant_on(point: PointArm) -> None:
    point.pendant_enabled = True


def _servo_off(point: PointArm) -> None:
    point.servo_on = False


def _slow(point: PointArm) -> None:
    point.override_percent = 10


ROBOTS: list[tuple[Callable[[PointArm], None], str, FindingLevel]] = [
    (_pendant_on, "teach pendant", FAILED),
    (_servo_off, "servo power", FAILED),
    (_slow, "speed override", WARNING),
]


@pytest.mark.parametrize(("change", "check", "level"), [*ROBOTS, (_in_t1, "mode switch", FAILED)])
async def test_over_modbus(change: Callable[[PointArm], None], check: str, level: FindingLevel) -> None:
    async with bench() as b:
        assert wrong(await b.arm.diagnose()) == {}
        change(b.point)
        await b.clock.sleep(0.5)
        assert wrong(await b.arm.diagnose())[check][0] is level


@pytest.mark.parametrize(("change", "check", "level"), ROBOTS)
async def test_over_rmi(change: Callable[[PointArm], None], check: str, level: FindingLevel) -> None:
    async with rmi_bench() as b:
        assert wrong(await b.arm.diagnose()) == {}
        change(b.point)
        await b.clock.sleep(0.5)
        assert wrong(await b.arm.diagnose())[check][0] is level


async def test_an_alarm_is_named_over_both_wires() -> None:
    async with bench() as b, rmi_bench() as r:
        for point, arm, clock in ((b.point, b.arm, b.clock), (r.point, r.arm, r.clock)):
            point.fault = "SRVO-050 Collision Detect alarm"
            await clock.sleep(0.5)
            findings = await arm.diagnose()
            assert wrong(findings)["controller alarm"] == (FAILED, Alarm.ROBOT_FAULT)
            assert "SRVO-050" in detail_of(findings, "controller alarm")


async def test_a_diagnosis_over_modbus_writes_nothing_and_leaves_the_connection_free(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with bench() as b:
        writes: list[object] = []
        for name in ("write_words", "write_coils"):
            monkeypatch.setattr(b.controller, name, lambda *arguments: writes.append(arguments))
        assert wrong(await b.arm.diagnose()) == {}
        assert writes == []
        assert b.controller.motions_started == 0
        assert b.arm.lifecycle is Lifecycle.DISCONNECTED
        monkeypatch.undo()
        await b.arm.connect()


async def test_a_diagnosis_over_rmi_starts_and_aborts_no_program_and_gives_the_session_back() -> None:
    async with rmi_bench() as b:
        assert wrong(await b.arm.diagnose()) == {}
        assert {"FRC_Initialize", "FRC_Abort", "FRC_Reset", "FRC_WriteDOUT"}.isdisjoint(b.controller.server.received)
        assert b.controller.server.received[-1] == "FRC_Disconnect"
        assert b.arm.lifecycle is Lifecycle.DISCONNECTED
        await b.arm.connect()


# -- Modbus alone -----------------------------------------------------------------------------------------------------


async def test_a_wrong_unit_id_and_another_client_are_suspected() -> None:
    async with bench() as b:
        findings = await _arm(MODBUS, port=b.port, unit_id=7).diagnose()
        assert wrong(findings) == {"first reading": (FAILED, Alarm.CONNECTION_TIMEOUT)}
        assert "$MODBUS_ADR" in detail_of(findings, "first reading")
        await b.arm.connect()
        findings = await _arm(MODBUS, port=b.port).diagnose()
        assert wrong(findings)["first reading"][0] is FAILED
        assert "one client" in detail_of(findings, "first reading")


async def test_a_heartbeat_that_stands() -> None:
    async with bench() as b:
        b.controller.heartbeat_frozen = True
        assert wrong(await b.arm.diagnose()) == {"robot's heartbeat": (FAILED, Alarm.HEARTBEAT_LOST)}


async def test_a_command_that_is_not_finished() -> None:
    async with bench() as b:
        b.controller.write_words(registers.SEQUENCE_WORD - 1, [17])  # written by a PC that is gone
        b.controller.heartbeat_frozen = True  # and by a robot that does not take it
        found = wrong(await b.arm.diagnose())
        assert found["last command"] == (FAILED, Alarm.ROBOT_BUSY)


@pytest.mark.parametrize("fault", [WireFault.HALF_PACKET, WireFault.NONSENSE, WireFault.EXCEPTION, WireFault.CUT])
async def test_a_modbus_server_that_talks_nonsense(fault: WireFault) -> None:
    async with bench(IMPATIENT_S) as b:
        b.controller.server.fault = fault
        assert wrong(await b.arm.diagnose())["first reading"][0] is FAILED


def _words(protocol: int, override: tuple[int, int]) -> list[int]:
    words = [0] * 49
    words[0], words[1], words[21:23] = protocol, 7, list(override)
    return words


FLOAT = list(struct.unpack("<2H", struct.pack("<f", 4201.0)))


@pytest.mark.parametrize(
    ("words", "said", "remedy"),
    [
        ([0] * 49, "All words read 0", "$SNPX_ASG"),
        (_words(4202, (100, 0)), "reads 4202, not 4201", "of this release"),
        (_words(0x6910, (100, 0)), "bytes exchanged", "$CMD_ENDIAN"),
        ([*FLOAT, *[0] * 47], "float 4201.0", "$MULTIPLY"),
        ([*FLOAT[::-1], *[0] * 47], "float 4201.0", "$MULTIPLY"),
        (_words(4201, (0, 100)), "other order", "$CMD_ENDIAN"),
        (_words(4201, (0, 0x42C8)), "no whole number", "$MULTIPLY"),
    ],
)
def test_how_the_controller_maps_its_registers(words: list[int], said: str, remedy: str) -> None:
    finding = mapping_fault(words)
    assert finding is not None
    assert finding.alarm is Alarm.PROTOCOL_VERSION
    assert said in finding.detail
    assert remedy in finding.remedy


def test_the_right_map_is_not_doubted() -> None:
    assert all(mapping_fault(_words(4201, (percent, 0))) is None for percent in (0, 1, 10, 100))


async def test_the_inputs_are_read_over_modbus_without_a_connection_of_the_cell() -> None:
    async with bench() as b:
        b.point.inputs[2] = True
        assert await b.arm.peek_inputs((1, 2, 3)) == (False, True, False)
        assert b.arm.lifecycle is Lifecycle.DISCONNECTED


# -- RMI alone --------------------------------------------------------------------------------------------------------


async def test_single_step_and_ascii_mode() -> None:
    async with rmi_bench() as b:
        b.controller.single_step = b.controller.ascii_mode = True
        findings = await b.arm.diagnose()
        assert wrong(findings) == {
            "single step": (FAILED, Alarm.ROBOT_NOT_READY),
            "packet format": (FAILED, Alarm.ROBOT_NOT_READY),
        }
        assert "$ASBN_ENB to FALSE" in detail_of(findings, "packet format")


async def test_a_controller_that_does_not_tell_its_packet_format() -> None:
    async with rmi_bench() as b:
        b.controller.has_variables = False
        assert wrong(await b.arm.diagnose()) == {"packet format": (WARNING, Alarm.ROBOT_NOT_READY)}


@pytest.mark.parametrize("major", [3, 10])
async def test_an_interface_that_is_older_or_newer_than_what_is_known(major: int) -> None:
    async with rmi_bench() as b:
        b.controller.major_version = major
        assert wrong(await b.arm.diagnose()) == {"version": (WARNING, Alarm.PROTOCOL_VERSION)}


async def test_a_session_that_somebody_else_holds() -> None:
    async with rmi_bench() as b:
        await b.arm.connect()
        findings = await _arm(RMI, port=b.port).diagnose()
        assert wrong(findings) == {"connection": (FAILED, Alarm.SESSION_HELD)}


async def test_a_program_that_an_earlier_client_left_is_not_aborted() -> None:
    async with rmi_bench() as b:
        await b.ready()
        b.controller.server.cut()
        while b.arm.lifecycle is not Lifecycle.DISCONNECTED:  # noqa: ASYNC110 - the wire's end comes by itself
            await asyncio.sleep(0)
        seen = len(b.controller.server.received)
        findings = await b.arm.diagnose()
        assert wrong(findings) == {"program RMI_MOVE": (WARNING, Alarm.ROBOT_BUSY)}
        assert "FRC_Abort" not in b.controller.server.received[seen:]


async def test_what_listens_there_is_no_rmi() -> None:
    async with bench() as b:
        found = wrong(await _arm(RMI, port=b.port).diagnose())
        assert found["connection"][0] is FAILED


@pytest.mark.parametrize("fault", [RmiFault.NONSENSE, RmiFault.CUT, RmiFault.HALF_PACKET, RmiFault.NO_ERROR_ID])
async def test_an_rmi_server_that_talks_nonsense(fault: RmiFault) -> None:
    async with rmi_bench(IMPATIENT_S) as b:
        b.controller.server.fault = fault
        assert wrong(await b.arm.diagnose())["reading"][0] is FAILED


async def test_inputs_that_need_a_running_program_are_not_read_over_rmi() -> None:
    async with rmi_bench() as b:
        with pytest.raises(NotReadyError, match="a diagnosis does not start"):
            await b.arm.peek_inputs((1, 2, 3))
        assert "FRC_Initialize" not in b.controller.server.received


# -- the KAREL line protocol alone ------------------------------------------------------------------------------------


@pytest.mark.parametrize("carrier", CARRIERS)
@pytest.mark.parametrize(("change", "check", "level"), [*ROBOTS, (_in_t1, "mode switch", FAILED)])
async def test_over_karel(carrier: str, change: Callable[[PointArm], None], check: str, level: FindingLevel) -> None:
    async with karel_bench(carrier) as b:
        assert isinstance(b.arm, Diagnosable)
        assert isinstance(b.arm, InputPeek)
        assert wrong(await b.arm.diagnose()) == {}
        change(b.point)
        await b.clock.sleep(0.5)
        assert wrong(await b.arm.diagnose())[check][0] is level
        assert b.arm.lifecycle is Lifecycle.DISCONNECTED


@pytest.mark.parametrize("carrier", CARRIERS)
async def test_the_inputs_are_read_over_karel_and_the_wire_is_free_afterwards(carrier: str) -> None:
    async with karel_bench(carrier) as b:
        b.point.inputs[2] = True
        assert await b.arm.peek_inputs((1, 2, 3)) == (False, True, False)
        await b.arm.connect()


async def test_a_karel_robot_that_is_not_there(tmp_path: Any) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    clock = SteppedClock(SteppedTime())
    refused = await make_karel_arm(clock, "tcp", str(port), timeout_s=IMPATIENT_S).diagnose()
    assert wrong(refused) == {"connection": (FAILED, Alarm.CONNECTION_REFUSED)}
    assert "srvstcp" in detail_of(refused, "connection")
    missing = await make_karel_arm(clock, "serial", str(tmp_path / "ttyS9"), timeout_s=IMPATIENT_S).diagnose()
    assert wrong(missing)["connection"][0] is FAILED
    assert "ttyS9" in detail_of(missing, "connection")


async def test_a_karel_robot_that_somebody_else_talks_to() -> None:
    async with karel_bench() as b:
        await b.arm.connect()
        other = make_karel_arm(b.clock, "tcp", b.address, timeout_s=IMPATIENT_S)
        assert wrong(await other.diagnose())["connection"] == (FAILED, Alarm.SESSION_HELD)
