"""Packing, and the map's page against both sides that were written from it."""

import re
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.fanuc import registers
from drivers.fanuc.registers import Command, FaultCode, Snapshot, State, UopOutput
from drivers.sim.tp import shipped_sources
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import PortError, RobotMode

PAGE = (Path(__file__).parents[3] / "docs" / "reference" / "modbus-map.md").read_text(encoding="utf-8")
INT32 = st.integers(-(1 << 31), (1 << 31) - 1)


@given(INT32)
def test_a_32_bit_value_travels_as_two_words_low_word_first(value: int) -> None:
    words = registers.to_words(value)
    assert struct.pack("<2H", *words) == struct.pack("<i", value)
    assert registers.from_words(*words) == value


@given(st.integers(1, registers.COUNTER_LIMIT))
def test_sequence_numbers_stay_in_their_word(sequence: int) -> None:
    following = registers.next_sequence(sequence)
    assert 1 <= following <= 30_000
    assert following != sequence


def test_sequence_numbers_begin_at_1() -> None:
    assert (registers.next_sequence(0), registers.next_sequence(30_000)) == (1, 1)


MICRO = st.lists(st.integers(-3_000_000, 3_000_000), min_size=7, max_size=7)


@given(st.integers(1, 30_000), st.sampled_from(Command), MICRO)
def test_the_checksum_of_what_the_robot_accepts_fits_its_registers(seq: int, command: int, micro: list[int]) -> None:
    terms = [w * v for w, v in enumerate([seq, command, *micro], start=1)]
    assert max(abs(term) for term in terms) < 1 << 31
    assert abs(registers.checksum(seq, command, micro)) < 1 << 31


@given(st.integers(1, 30_000), MICRO, st.integers(0, 6), st.integers(0, 6))
def test_the_checksum_sees_exchanged_values(seq: int, micro: list[int], i: int, j: int) -> None:
    exchanged = micro.copy()
    exchanged[i], exchanged[j] = micro[j], micro[i]
    same = registers.checksum(seq, 1, micro) == registers.checksum(seq, 1, exchanged)
    assert same == (exchanged == micro)


def test_a_command_is_packed_as_the_page_says() -> None:
    words = registers.encode(7, Command.MOVE_JOINT, Xyzwpr(600.125, -50.0, 0.001, 180.0, -0.5, 90.0), 12.5)
    values = struct.unpack("<H8i", struct.pack("<17H", *words))
    assert values[:8] == (2, 600_125, -50_000, 1, 180_000, -500, 90_000, 12_500)
    x, y, z, w, p, r, speed = values[1:8]
    assert values[8] == 4201 + 7 + 2 * 2 + 3 * x + 4 * y + 5 * z + 6 * w + 7 * p + 8 * r + 9 * speed


def _words(**changes: int) -> list[int]:
    words = [4201, 7, 2, 0, 55, 1, 0b111, 0, 0, *[0] * 40]
    words[30] = 7
    for name, value in changes.items():
        words[int(name.removeprefix("w"))] = value
    return words


def test_a_reading_is_taken_apart_as_the_page_says() -> None:
    pose = struct.unpack("<12H", struct.pack("<6i", 500_250, -1, 400_000, 180_000, -90_000, 33_333))
    words = _words()
    words[9:21] = pose
    words[21], words[23], words[25] = 40, 2, 3
    assert registers.decode(words) == Snapshot(
        protocol=4201,
        acknowledged=7,
        state=State.DONE,
        fault_code=FaultCode.NONE,
        robot_heartbeat=55,
        mode=RobotMode.AUTO,
        uop=UopOutput.CMDENBL | UopOutput.SYSRDY | UopOutput.PROGRUN,
        alarm=None,
        pose=Xyzwpr(500.25, -0.001, 400.0, 180.0, -90.0, 33.333),
        override_percent=40,
        user_frame=2,
        user_tool=3,
        sequence=7,
    )


def test_what_the_wire_does_not_know_is_unknown() -> None:
    snapshot = registers.decode(_words(w5=9, w6=0xFF00, w7=99, w8=4))
    assert (snapshot.mode, snapshot.uop, snapshot.alarm) == (RobotMode.UNKNOWN, UopOutput(0), "facility 99-004")


@pytest.mark.parametrize(
    ("changes", "busy"), [({}, False), ({"w2": 1}, True), ({"w1": 6}, True), ({"w2": 3}, False), ({"w2": 0}, False)]
)
def test_busy_is_state_busy_or_a_command_that_is_not_acknowledged(changes: dict[str, int], busy: bool) -> None:
    assert registers.decode(_words(**changes)).busy == busy


def test_words_of_another_program_are_refused() -> None:
    with pytest.raises(PortError, match="PROTOCOL_VERSION"):
        registers.decode(_words(w0=4301))


def _page_rows(heading: str) -> dict[int, str]:
    section = PAGE.split(f"## {heading}")[1].split("\n## ")[0]
    return {int(row[1]): row[2].strip() for row in re.finditer(r"^\| (\d+) \| ([^|]*) \|", section, re.MULTILINE)}


def test_the_page_and_the_driver_agree_on_the_words() -> None:
    robot, pc = _page_rows("Words, robot to PC"), _page_rows("Words, PC to robot")
    assert min(robot) == registers.FIRST_WORD
    assert max(pc) + 2 == registers.FIRST_WORD + registers.WORD_COUNT
    assert robot[registers.ROBOT_HEARTBEAT_WORD] == "R[114]"
    assert pc[registers.SEQUENCE_WORD] == "R[101]"
    assert pc[registers.PC_HEARTBEAT_WORD] == "R[115]"
    assert pc[registers.COMMAND_WORD] == "R[102]"


def test_the_page_and_the_driver_agree_on_the_fault_codes() -> None:
    assert set(_page_rows("Fault codes, R[113]")) == {int(code) for code in FaultCode}


def test_the_assignment_table_covers_every_word_once() -> None:
    rows = re.findall(r"^\| (\d+) \| (12\d+) \| (\d+) \| `", PAGE, re.MULTILINE)
    covered = [word for _, address, size in rows for word in range(int(address), int(address) + int(size))]
    unassigned = [12028, 12029, 12030]
    assert sorted(covered + unassigned) == list(range(12001, 12050))


def test_the_page_and_the_command_file_assign_the_same_words() -> None:
    rows = re.findall(r"^\| (\d+) \| (12\d+) \| (\d+) \| `([^`]+)`[^|]*\| (\d+) \|", PAGE, re.MULTILINE)
    fields = ("$ADDRESS", "$SIZE", "$VAR_NAME", "$MULTIPLY")
    page = {(row[0], name): value for row in rows for name, value in zip(fields, row[1:], strict=True)}
    lines = re.findall(r'^SETVAR \$SNPX_ASG\[(\d+)\]\.(\S+) "?([^"\n]+)"?$', shipped_sources()["SRVS.CF"], re.MULTILINE)
    assert {(number, name): value for number, name, value in lines} == page


def test_the_page_the_driver_and_the_robots_program_name_the_same_version() -> None:
    assert registers.PROTOCOL == 4201
    assert "R[100:SRVS PROTO]=4201 ;" in shipped_sources()["SRVS.LS"]
    assert "Protocol version **4201**" in PAGE
