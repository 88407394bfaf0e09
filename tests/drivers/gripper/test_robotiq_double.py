"""The gripper double on its own wire: the manual's example conversation, byte by byte (section 4.7)."""

import os
import select
from collections.abc import Iterator

import pytest
import serial

from drivers.sim.robotiq_double import RobotiqDouble
from drivers.sim.robotiq_fingers import ScriptedFingers
from drivers.sim.rtu_line import checksum

READ_ONE, READ_THREE = "09 04 07 D0 00 01 30 0F", "09 04 07 D0 00 03 B1 CE"
CLEAR, ACTIVATE = "09 10 03 E8 00 03 06 00 00 00 00 00 00 73 30", "09 10 03 E8 00 03 06 01 00 00 00 00 00 72 E1"
CLOSE, OPEN = "09 10 03 E8 00 03 06 09 00 00 FF FF FF 42 29", "09 10 03 E8 00 03 06 09 00 00 00 FF FF 72 19"
TAKEN = "09 10 03 E8 00 03 01 30"


class Bench:
    def __init__(self) -> None:
        self.now_s = 0.0
        self.fingers = ScriptedFingers(lambda: self.now_s)
        self.double = RobotiqDouble(self.fingers, lambda: self.now_s)
        self.port = serial.Serial(self.double.start(), 115200, timeout=5.0)

    def ask(self, request: str) -> str:
        self.port.write(bytes.fromhex(request))
        head = self.port.read(3)
        rest = 2 + head[2] if head[1] in {3, 4, 23} else 2 if head[1] & 0x80 else 5
        return (head + self.port.read(rest)).hex(" ").upper()

    def close(self) -> None:
        self.port.close()
        self.double.close()


@pytest.fixture
def b() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.close()


def test_the_manuals_example(b: Bench) -> None:
    assert b.ask(CLEAR) == TAKEN
    assert b.ask(ACTIVATE) == TAKEN
    assert b.ask(READ_ONE) == "09 04 02 11 00 54 A1"
    b.now_s += 0.9
    assert b.ask(READ_ONE) == "09 04 02 11 00 54 A1"
    b.now_s += 0.9
    assert b.ask(READ_ONE) == "09 04 02 11 00 54 A1"
    b.now_s += 0.9
    assert b.ask(READ_ONE) == "09 04 02 31 00 4D 61"
    b.fingers.part_at = 0xBD
    assert b.ask(CLOSE) == TAKEN
    b.now_s += 0.02
    assert b.ask(READ_THREE).startswith("09 04 06 39 00 00 FF ")
    b.now_s += 0.9
    assert b.ask(READ_THREE).startswith("09 04 06 B9 00 00 FF BD ")
    assert b.ask(OPEN) == TAKEN
    b.now_s += 0.1
    assert b.ask(READ_THREE).startswith("09 04 06 39 00 00 00 ")
    b.now_s += 0.8
    assert b.ask(READ_THREE).startswith("09 04 06 F9 00 00 00 03 ")


def test_the_same_with_function_3_and_with_writing_and_reading_at_once(b: Bench) -> None:
    b.double.make_ready()
    assert b.ask("09 03 07 D0 00 01 85 CF").startswith("09 03 02 F9 00")
    both = bytes.fromhex("09 17 07 D0 00 03 03 E8 00 03 06 09 00 00 FF FF FF")
    answer = b.ask((both + checksum(both)).hex())
    assert answer.startswith("09 17 06 39 00 00 FF 03 ")


def test_what_it_does_not_know_is_answered_with_an_exception_and_what_is_not_for_it_not_at_all(b: Bench) -> None:
    for request, answer in (
        ("09 06 03 E8 01 00", "09 86 01"),
        ("09 04 07 D0 00 04", "09 84 02"),
        ("09 10 03 E7 00 01 02 01 00", "09 90 02"),
        ("09 10 03 E8 00 03 02 01 00", "09 90 03"),
        ("09 03 07 D0 00 00", "09 83 03"),
        ("09 0F 03 E8 00 08 01 FF", "09 8F 01"),
        ("09 11", "09 91 01"),
        ("09 16 03 E8 00 F2 00 25", "09 96 01"),
    ):
        frame = bytes.fromhex(request)
        assert b.ask((frame + checksum(frame)).hex()).startswith(answer)
    for unheard in ("0A 04 07 D0 00 03 B1 FD", "09 04 07 D0 00 03 B1 CF"):
        b.port.write(bytes.fromhex(unheard))
    assert b.ask(READ_ONE)[:5] == "09 04"
    assert b.double.commands == []


def test_a_silence_ends_a_frame_that_is_not_whole(b: Bench) -> None:
    b.port.write(bytes.fromhex("09 10 03 E8"))
    ready, _, _ = select.select([b.port.fileno()], [], [], 0.2)
    assert not ready
    assert b.ask(READ_ONE).startswith("09 04 02")


def test_one_word_may_be_written_and_the_outputs_read_back(b: Bench) -> None:
    for request in ("09 10 03 E8 00 01 02 01 00", "09 10 03 E9 00 02 04 00 80 FF 20"):
        frame = bytes.fromhex(request)
        assert b.ask((frame + checksum(frame)).hex()).startswith(request[:17])
    frame = bytes.fromhex("09 03 03 E8 00 03")
    assert b.ask((frame + checksum(frame)).hex()).startswith("09 03 06 01 00 00 80 FF 20")
    assert b.double.commands == [(1, 0, 0, 0), (1, 0x80, 0xFF, 0x20)]


def test_automatic_release_asks_for_a_new_activation(b: Bench) -> None:
    b.double.make_ready()
    release = bytes.fromhex("09 10 03 E8 00 03 06 39 00 00 00 00 00")
    assert b.ask((release + checksum(release)).hex()) == TAKEN
    assert b.ask(READ_THREE).startswith("09 04 06 09 00 0B")
    b.now_s += 0.9
    b.ask(READ_THREE)
    b.now_s += 2.5
    assert b.ask(READ_THREE).startswith("09 04 06 09 00 0F")


def test_it_says_once_that_it_was_not_talked_to(b: Bench) -> None:
    b.double.make_ready()
    b.now_s += 1.5
    assert b.ask(READ_THREE).startswith("09 04 06 F9 00 09")
    assert b.ask(READ_THREE).startswith("09 04 06 F9 00 00")


def test_the_end_of_the_terminal_is_a_serial_port(b: Bench) -> None:
    assert os.isatty(b.port.fileno())
