"""What a diagnosis says of a gripper: read only, each reason by its own name."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from drivers.gripper.robot_io import RobotIoGripper
from drivers.sim.rtu_line import LineFault
from srvs_cell.alarms import Alarm
from srvs_cell.ports import Diagnosable, Finding, FindingLevel, Lifecycle, NotConnectedError, NotReadyError
from tests.drivers.gripper.robotiq_bench import IMPATIENT_S, PART_AT, robotiq_bench
from tests.drivers.gripper.valve import CONFIG, Valve
from tests.drivers.stepped import SteppedClock, SteppedTime

FAILED, WARNING = FindingLevel.FAILED, FindingLevel.WARNING


def wrong(findings: Sequence[Finding]) -> dict[str, tuple[FindingLevel, Alarm | None]]:
    return {one.check: (one.level, one.alarm) for one in findings if one.level is not FindingLevel.OK}


# -- Robotiq ----------------------------------------------------------------------------------------------------------


async def test_a_robotiq_that_is_ready() -> None:
    async with robotiq_bench() as b:
        assert isinstance(b.gripper, Diagnosable)
        findings = await b.gripper.diagnose()
        assert wrong(findings) == {}
        assert findings[-1].facts == {"opening_mm": 85.0}
        assert b.gripper.lifecycle is Lifecycle.DISCONNECTED
        assert {frame[1] for frame in b.double.line.received} == {4}
        await b.gripper.connect()


async def test_a_robotiq_that_the_next_reset_will_activate() -> None:
    async with robotiq_bench(activated=False) as b:
        findings = await b.gripper.diagnose()
        assert wrong(findings) == {"activation": (WARNING, Alarm.GRIPPER_FAULT)}
        assert "open and close fully" in findings[2].remedy
        assert b.double.commands == []


@pytest.mark.parametrize(("code", "words"), [(0x08, "cool"), (0x0A, "24 V"), (0x0D, "free them"), (0x0E, "jam")])
async def test_a_robotiq_in_a_fault(code: int, words: str) -> None:
    async with robotiq_bench() as b:
        b.double.fault_code = code
        findings = await b.gripper.diagnose()
        assert wrong(findings) == {"fault": (FAILED, Alarm.GRIPPER_FAULT)}
        assert words in findings[1].remedy


async def test_that_it_was_not_talked_to_is_no_finding() -> None:
    async with robotiq_bench() as b:
        await b.clock.sleep(30.0)
        assert wrong(await b.gripper.diagnose()) == {}


async def test_a_robotiq_that_holds_something() -> None:
    async with robotiq_bench() as b:
        await b.ready()
        b.fingers.part_at = PART_AT
        await b.gripper.close()
        await b.gripper.disconnect()
        findings = await b.gripper.diagnose()
        assert "holding, 41.2 mm" in findings[-1].detail


async def test_a_robotiq_that_is_silent_or_not_there(tmp_path: Path) -> None:
    async with robotiq_bench(IMPATIENT_S) as b:
        b.double.line.fault = LineFault.DEAF
        findings = await b.gripper.diagnose()
        assert wrong(findings) == {"connection": (FAILED, Alarm.CONNECTION_TIMEOUT)}
        assert "A and B exchanged" in findings[0].detail
    async with robotiq_bench(port=str(tmp_path / "ttyUSB9")) as b:
        findings = await b.gripper.diagnose()
        assert wrong(findings) == {"connection": (FAILED, Alarm.DEVICE_UNAVAILABLE)}
        assert "no such device" in findings[0].detail


# -- through the robot's I/O ------------------------------------------------------------------------------------------


class PeekingValve(Valve):
    """A valve behind an arm that is disconnected: its inputs can only be peeked at."""

    refusal: Exception | None = None

    async def peek_inputs(self, numbers: Sequence[int]) -> tuple[bool, ...]:
        if self.refusal is not None:
            raise self.refusal
        return tuple([await Valve.read_input(self, number) for number in numbers])

    async def read_input(self, number: int) -> bool:
        raise NotConnectedError(Alarm.CONNECTION_LOST, f"DI[{number}]: not connected.")


def _gripper() -> tuple[RobotIoGripper, PeekingValve]:
    clock = SteppedClock(SteppedTime())
    valve = PeekingValve(clock)
    return RobotIoGripper(CONFIG, clock, valve), valve


async def test_sensors_that_agree() -> None:
    gripper, valve = _gripper()
    findings = await gripper.diagnose()
    assert wrong(findings) == {}
    assert "DI[22] open on" in findings[0].detail
    assert valve.writes == []
    assert gripper.lifecycle is Lifecycle.DISCONNECTED


async def test_sensors_that_contradict_each_other() -> None:
    gripper, valve = _gripper()
    valve.forced[21] = True
    assert wrong(await gripper.diagnose()) == {"sensors": (FAILED, Alarm.GRIPPER_STATE_UNKNOWN)}


async def test_sensors_that_say_nothing() -> None:
    gripper, valve = _gripper()
    valve.stuck = True
    assert wrong(await gripper.diagnose()) == {"sensors": (WARNING, Alarm.GRIPPER_STATE_UNKNOWN)}


@pytest.mark.parametrize(
    ("refusal", "level"),
    [
        (NotReadyError(Alarm.ROBOT_NOT_READY, "only while it runs."), WARNING),
        (NotConnectedError(Alarm.CONNECTION_REFUSED, "refused."), FAILED),
    ],
)
async def test_sensors_that_cannot_be_read(refusal: NotReadyError, level: FindingLevel) -> None:
    gripper, valve = _gripper()
    valve.refusal = refusal
    assert wrong(await gripper.diagnose()) == {"sensors": (level, refusal.alarm)}


async def test_an_arm_that_reads_no_inputs_for_a_diagnosis() -> None:
    clock = SteppedClock(SteppedTime())
    gripper = RobotIoGripper(CONFIG, clock, Valve(clock))
    assert wrong(await gripper.diagnose())["sensors"][0] is WARNING
