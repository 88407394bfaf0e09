"""The robot's own programs: they do what the map's page says, and no line of them can be lost unnoticed."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

from drivers.sim.tp import load, shipped_sources
from drivers.sim.tp.syntax import Label, Remark
from srvs_cell.alarms import Alarm
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import CommandRejectedError, DeviceFaultError, NotReadyError, OutcomeUnknownError, PortError
from tests.drivers.fanuc.bench import bench
from tests.drivers.fanuc.program_judge import JUDGES, judge_grip

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

SHIPPED = shipped_sources()
GRIPPER_FILES = {"SRVS_GRP.LS", "SRVS_TST.LS"}


@pytest.mark.parametrize("judge", [*JUDGES, judge_grip], ids=lambda judge: judge.__name__)
def test_the_shipped_programs_do_what_the_page_says(judge: Callable[[Mapping[str, str]], None]) -> None:
    judge(SHIPPED)


def _noticed(file: str, sources: Mapping[str, str]) -> bool:
    """Return whether a judge is not content with a changed file, or the program is refused."""
    try:
        for judge in [judge_grip] if file in GRIPPER_FILES else JUDGES:
            judge(sources)
    except Exception:  # noqa: BLE001 - however the mistake shows, it shows
        return True
    return False


def _changed(file: str, old: str, new: str, occurrence: int = 1) -> dict[str, str]:
    parts = SHIPPED[file].split(old)
    assert len(parts) > occurrence, f"{file} has no {old!r}"
    text = old.join(parts[:occurrence]) + new + old.join(parts[occurrence:])
    return {**SHIPPED, file: text}


def _lines() -> list[tuple[str, int]]:
    """Every line of the programs that does something."""
    return [
        (program.file, line)
        for program in load(SHIPPED).values()
        for line, statement in program.statements
        if not isinstance(statement, Remark | Label)
    ]


@pytest.mark.parametrize(("file", "line"), _lines())
def test_a_line_that_is_switched_off_is_noticed(file: str, line: int) -> None:
    text = SHIPPED[file].splitlines()
    text[line - 1] = re.sub(r"^(\s*\d+:)\s*(.*)$", r"\1  //\2", text[line - 1])
    assert _noticed(file, {**SHIPPED, file: "\n".join(text)})


ACK = "R[111:SRVS ACK]=R[120:SRVS SEQ COPY]"
MISTAKES = {
    "acknowledged before the checks": ("SRVS.LS", "CALL SRVS_CHK", ACK, 1),
    "acknowledged before the state": ("SRVS.LS", "R[113:SRVS FAULT]=0", ACK, 2),
    "a new sequence number instead of the copied one": ("SRVS.LS", ACK, "R[111:SRVS ACK]=R[101:SRVS SEQ]", 1),
    "done before the move": ("SRVS.LS", "R[112:SRVS STATE]=1", "R[112:SRVS STATE]=2", 2),
    "X for Y": ("SRVS_MOV.LS", "R[123:SRVS Y]/1000", "R[122:SRVS X]/1000", 1),
    "W for R": ("SRVS_MOV.LS", "R[127:SRVS R]/1000", "R[125:SRVS W]/1000", 1),
    "elements exchanged": ("SRVS_MOV.LS", "PR[90,4:", "PR[90,5:", 1),
    "micrometres taken for tenths": ("SRVS_MOV.LS", "R[124:SRVS Z]/1000", "R[124:SRVS Z]/100", 1),
    "speed not scaled": ("SRVS_MOV.LS", "R[128:SRVS SPEED]/1000", "R[128:SRVS SPEED]/100", 1),
    "linear and joint exchanged": ("SRVS_MOV.LS", "R[121:SRVS CMD]=2", "R[121:SRVS CMD]=1", 1),
    "another output holds": ("SRVS_MOV.LS", "DO[3:SRVS HOLD]=ON", "DO[5:SRVS HOLD]=ON", 1),
    "hold is inverted": ("SRVS_MOV.LS", "DO[3:SRVS HOLD]=ON", "DO[3:SRVS HOLD]=OFF", 1),
    "skip leads past the report": ("SRVS_MOV.LS", "JMP LBL[3]", "JMP LBL[10]", 1),
    "no skip on the linear move": ("SRVS_MOV.LS", "FINE Skip,LBL[10]", "FINE", 1),
    "no skip on the joint move": ("SRVS_MOV.LS", "FINE Skip,LBL[10]", "FINE", 2),
    "a wrong weight in the checksum": ("SRVS_CHK.LS", "5*R[124]", "6*R[124]", 1),
    "a register left out of the checksum": ("SRVS_CHK.LS", "+9*R[128]", "+9*R[127]", 1),
    "another protocol's seed": ("SRVS_CHK.LS", "(4201+", "(4202+", 1),
    "an open lower bound": ("SRVS_CHK.LS", "R[124:SRVS Z]<(-3000000)", "R[124:SRVS Z]<(-3000001)", 1),
    "an open upper bound": ("SRVS_CHK.LS", "R[127:SRVS R]>360000", "R[127:SRVS R]>360001", 1),
    "command copied from its neighbour": ("SRVS_CHK.LS", "R[102:SRVS PC CMD]", "R[103:SRVS PC CMD]", 1),
    "the watchdog too patient": ("SRVS_HB.LS", ">=20),DO[3", ">=40),DO[3", 1),
    "the watchdog switches off": ("SRVS_HB.LS", "DO[3:SRVS HOLD]=(ON)", "DO[3:SRVS HOLD]=(OFF)", 1),
    "the beat too slow": ("SRVS_HB.LS", "WAIT    .10(sec)", "WAIT    .20(sec)", 1),
    "the heartbeat pauses with the rest": ("SRVS_HB.LS", "PAUSE_REQUEST\t= 7", "PAUSE_REQUEST\t= 0", 1),
    "the heartbeat is aborted with the rest": ("SRVS_HB.LS", "ABORT_REQUEST\t= 7", "ABORT_REQUEST\t= 0", 1),
    "a beat that the PC does not know": ("SRVS_HB.LS", "30000", "30001", 1),
    "both coils of the valve": ("SRVS_GRP.LS", "DO[2:GRIPPER OPEN]=OFF", "DO[2:GRIPPER OPEN]=ON", 1),
    "a register mapped to its neighbour": ("SRVS.CF", '"R[111]@1.1"', '"R[112]@1.1"', 1),
    "parameters mapped one word off": ("SRVS.CF", "$ADDRESS 12034", "$ADDRESS 12035", 1),
    "metres for millimetres": ("SRVS.CF", "$MULTIPLY 1000", "$MULTIPLY 1", 1),
}


DIVERTED = Xyzwpr(600.0, -50.5, 300.125, 180.0, 0.25, -30.5)
SEEN_BY_THE_DRIVER: dict[str, tuple[tuple[str, str, str, int], type[PortError], Alarm]] = {
    "X for Y": (MISTAKES["X for Y"], DeviceFaultError, Alarm.MOTION_OUTCOME_UNKNOWN),
    "acknowledged first": (
        MISTAKES["acknowledged before the checks"],
        OutcomeUnknownError,
        Alarm.MOTION_OUTCOME_UNKNOWN,
    ),
    "a wrong weight": (MISTAKES["a wrong weight in the checksum"], CommandRejectedError, Alarm.TARGET_REJECTED),
    "never acknowledged": (
        ("SRVS.LS", ACK, "R[119:SRVS ACK]=R[120:SRVS SEQ COPY]", 1),
        OutcomeUnknownError,
        Alarm.MOTION_OUTCOME_UNKNOWN,
    ),
    "another protocol": (("SRVS.LS", "=4201", "=4301", 1), PortError, Alarm.PROTOCOL_VERSION),
    "no heartbeat": (("SRVS.LS", "RUN SRVS_HB", "", 1), NotReadyError, Alarm.MODE_NOT_AUTO),
    "parameters one word off": (MISTAKES["parameters mapped one word off"], NotReadyError, Alarm.PROTOCOL_ERROR),
}


@pytest.mark.parametrize("case", SEEN_BY_THE_DRIVER.values(), ids=SEEN_BY_THE_DRIVER.keys())
async def test_the_real_driver_on_its_wire_names_a_mistake(
    case: tuple[tuple[str, str, str, int], type[PortError], Alarm],
) -> None:
    mistake, error, alarm = case
    async with bench(sources=_changed(*mistake)) as b:
        with pytest.raises(error) as raised:  # noqa: PT012 - some show when connecting, some when moving
            await b.ready()
            await b.arm.move_linear(DIVERTED, 100.0)
        assert raised.value.alarm is alarm


async def test_a_hold_output_that_the_programs_do_not_heed_is_unknown() -> None:
    async with bench(sources=_changed(*MISTAKES["another output holds"])) as b:
        await b.ready()
        task = await b.begun_move()
        await b.arm.request_stop()
        b.point._speed_mm_s = 0.01
        with pytest.raises(OutcomeUnknownError):
            await task


@pytest.mark.parametrize("mistake", MISTAKES.values(), ids=MISTAKES.keys())
def test_a_mistake_is_noticed(mistake: tuple[str, str, str, int]) -> None:
    sources = _changed(*mistake)
    load(sources)  # it is no mistake of spelling
    assert _noticed(mistake[0], sources)
