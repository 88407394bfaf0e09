"""The lines of the KAREL protocol: what is one, what is none, and that nothing else gets through."""

import contextlib
import re
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from drivers.fanuc.karel import lines, messages
from drivers.fanuc.karel.lines import LINE_LIMIT, LineBuffer, LineError, Reply, checksum, decode, encode, next_sequence
from drivers.fanuc.karel.messages import Cause, State, Status
from drivers.fanuc.registers import UopOutput
from srvs_cell.alarms import Alarm
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import CommandRejectedError, PortError, RobotMode
from tests.drivers.fanuc.karel_conversation import fletcher

DOCS = Path(__file__).parents[3] / "docs"
PAGE = DOCS / "reference" / "karel-protocol.md"
HOW_TO = DOCS / "how-to" / "connect-fanuc-karel.md"
VALUES = st.lists(st.integers(-999_999_999, 999_999_999), max_size=7)
GOOD = (0, 0, 0, 1, 3, 100, 1, 1, 0, 500_000, 0, 400_000, 180_000, 0, 0)


def _reply(body: bytes) -> bytes:
    return b"%b*%d" % (body, checksum(body))


def _status(**changes: int) -> Reply:
    names = ("state", "cause", "move", "mode", "uop", "override", "frame", "tool", "alarm", *"xyzwpr")
    values = {**dict(zip(names, GOOD, strict=True)), **changes}
    return Reply(1, accepted=True, values=tuple(values.values()))


@pytest.mark.parametrize(("text", "value"), [(b"abcde", 0xC8F0), (b"abcdef", 0x2057), (b"abcdefgh", 0x0627), (b"", 0)])
def test_the_checksum_is_fletcher_16_by_its_published_examples(text: bytes, value: int) -> None:
    assert checksum(text) == value


@given(st.binary(max_size=200))
def test_the_checksum_is_that_of_rfc_1146(text: bytes) -> None:
    assert checksum(text) == fletcher(text)


def test_the_lines_of_the_page_and_of_the_module_are_right() -> None:
    shown = set()
    for text in (PAGE.read_text(encoding="utf-8"), lines.__doc__ or ""):
        found = re.findall(r"^ *([<>]17,\S+)", text, re.MULTILINE)
        assert len(found) == 2
        shown |= set(found)
    assert shown == {
        encode(17, "MOVL", *messages.move_values(Xyzwpr(600.0, 0.0, 400.0, 180.0, 0.0, 0.0), 20.0)).decode().strip(),
        _reply(b"<17,OK").decode(),
    }


def test_the_lines_that_the_how_to_shows_are_right() -> None:
    shown = re.findall(r"`([<>]\d+,[^`]*\*\d+)`", HOW_TO.read_text(encoding="utf-8"))
    assert [line.split("*")[0] for line in shown] == [">1,HELO,4301", ">2,STAT", "<0,NO,1"]
    for line in shown:
        assert _reply(line.split("*")[0].encode()).decode() == line


def test_the_numbers_of_the_page_are_those_of_the_code() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert f"**{lines.PROTOCOL}**" in text
    assert f"1 to {lines.LAST_SEQUENCE}, then 1 again" in text
    assert f"{LINE_LIMIT} characters" in text
    named = {int(code) for row in re.findall(r"^\| ([\d, ]+) \|", text, re.MULTILINE) for code in row.split(",")}
    assert named == {int(code) for code in messages.Refusal}


@given(st.integers(1, 30_000), VALUES)
def test_a_command_has_the_form_of_the_page(sequence: int, values: list[int]) -> None:
    line = encode(sequence, "STAT", *values)
    body, _, digits = line.removesuffix(b"\r\n").rpartition(b"*")
    assert body.decode() == f">{sequence},{','.join(['STAT', *map(str, values)])}"
    assert int(digits) == fletcher(body)


def test_what_is_too_long_is_not_sent() -> None:
    with pytest.raises(ValueError, match="nine digits"):
        encode(1, "MOVL", 10**9)
    with pytest.raises(ValueError, match="characters"):
        encode(1, "MOVL", *[-999_999_999] * 10)


@given(st.integers(0, 30_000), st.booleans(), st.lists(st.integers(-999_999_999, 999_999_999), min_size=1, max_size=8))
def test_a_reply_is_read_as_it_was_written(sequence: int, accepted: bool, values: list[int]) -> None:
    body = b"<%d,%b,%b" % (sequence, b"OK" if accepted else b"NO", ",".join(map(str, values)).encode())
    assert decode(_reply(body)) == Reply(sequence, accepted, tuple(values))


@pytest.mark.parametrize(
    "body",
    [
        b"<1",
        b"<1,",
        b"<1,YES",
        b"<1,NO",
        b"<01,OK",
        b"<30001,OK",
        b"<123456,OK",
        b"<-1,OK",
        b">1,OK",
        b"<1,OK,",
        b"<1,OK,+1",
        b"<1,OK,01",
        b"<1,OK,-0",
        b"<1,OK,-",
        b"<1,OK,1.5",
        b"<1,OK, 1",
        b"<1,OK,1234567890",
        b"<1,OK,1\x00",
        b"<1,OK,\xb2",
        b" <1,OK",
        b"<1,OK" + b",123456789" * 12,
    ],
)
def test_what_is_no_reply_is_refused_though_its_checksum_is_right(body: bytes) -> None:
    with pytest.raises(LineError):
        decode(_reply(body))


@pytest.mark.parametrize("digits", [b"", b"043627", b"43626", b"43628", b"+43627", b"999999", b"43627 "])
def test_a_checksum_that_is_not_exactly_right_is_refused(digits: bytes) -> None:
    assert decode(b"<17,OK*43627").sequence == 17
    with pytest.raises(LineError):
        decode(b"<17,OK*" + digits)


@given(st.data())
def test_every_single_changed_lost_or_exchanged_character_is_noticed(data: st.DataObject) -> None:
    line = _reply(b"<1234,OK,1,0,1233,1,7,100,1,1,0,512345,-4321,400000,180000,0,-90000")
    at = data.draw(st.integers(0, len(line) - 2))
    how = data.draw(st.sampled_from(["change", "lose", "double", "exchange"]))
    other = bytes([data.draw(st.integers(0, 255))])
    changed = {
        "change": line[:at] + other + line[at + 1 :],
        "lose": line[:at] + line[at + 1 :],
        "double": line[:at] + line[at : at + 1] + line[at:],
        "exchange": line[:at] + line[at + 1 : at + 2] + line[at : at + 1] + line[at + 2 :],
    }[how]
    if changed != line:
        with pytest.raises(LineError):
            decode(changed)


@given(st.binary(max_size=600))
@example(b"<" * 500)
@example(b"<1,OK*" + b"9" * 400)
def test_garbage_is_no_reply_and_nothing_worse(garbage: bytes) -> None:
    for line in LineBuffer().feed(garbage + b"\r"):
        try:
            reply = decode(line)
        except LineError:
            continue
        assert _reply(line.rpartition(b"*")[0]) == line
        assert 0 <= reply.sequence <= 30_000


@given(st.lists(st.sampled_from([b"<1,OK*1", b"x", b"<2,NO,1*2"]), max_size=6), st.data())
def test_lines_are_found_wherever_the_pieces_are_cut(found: list[bytes], data: st.DataObject) -> None:
    stream = b"".join(line + data.draw(st.sampled_from([b"\r\n", b"\n", b"\r", b"\r\r\n\n"])) for line in found)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=5)))
    buffer = LineBuffer()
    pieces = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    assert [line for piece in pieces for line in buffer.feed(piece)] == found


def test_what_never_ends_is_not_collected() -> None:
    buffer = LineBuffer()
    handed_on = [line for _ in range(1000) for line in buffer.feed(b"<1,OK,1" * 10)]
    assert len(buffer._rest) <= LINE_LIMIT
    assert sum(map(len, handed_on)) > 60_000
    for line in handed_on:
        with pytest.raises(LineError):
            decode(line)


@pytest.mark.parametrize(("before", "after"), [(0, 1), (1, 2), (29_999, 30_000), (30_000, 1)])
def test_sequence_numbers_go_round_without_zero(before: int, after: int) -> None:
    assert next_sequence(before) == after


def test_a_status_is_read() -> None:
    reply = _status(state=4, cause=2, move=77, mode=2, uop=130, override=10, frame=3, tool=9, x=-1, y=2_500)
    assert messages.read_status(reply) == Status(
        State.STOPPED,
        Cause.WATCHDOG,
        77,
        RobotMode.T1,
        UopOutput.SYSRDY | UopOutput.TPENBL,
        10,
        3,
        9,
        None,
        Xyzwpr(-0.001, 2.5, 400.0, 180.0, 0.0, 0.0),
    )
    assert messages.read_status(_status(uop=32, alarm=11_050)).fault == "SRVO-050"
    assert messages.read_status(_status(uop=32)).fault == "an alarm that is not named"
    assert messages.read_status(_status(alarm=11_050)).fault is None
    assert messages.read_status(_status(mode=0)).mode is RobotMode.UNKNOWN


@pytest.mark.parametrize(
    "change",
    [{"state": 5}, {"state": -1}, {"cause": 4}, {"uop": 256}, {"override": 101}, {"override": -1}, {"alarm": -1}],
)
def test_a_status_that_cannot_be_is_refused(change: dict[str, int]) -> None:
    with pytest.raises(PortError) as error:
        messages.read_status(_status(**change))
    assert error.value.alarm is Alarm.PROTOCOL_ERROR
    assert next(iter(change)).casefold() in error.value.detail.casefold().replace("uo ", "uop ")


@given(st.lists(st.integers(-999_999_999, 999_999_999), max_size=17))
def test_no_numbers_make_a_reader_fail_otherwise(values: list[int]) -> None:
    reply = Reply(1, accepted=True, values=tuple(values))
    for read in (messages.read_status, lambda reply: messages.read_signal("RDIN", reply)):
        with contextlib.suppress(PortError):
            assert read(reply) is not None


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1e6, -1e6])
def test_a_target_that_no_robot_reaches_is_not_sent(bad: float) -> None:
    with pytest.raises(CommandRejectedError):
        messages.move_values(Xyzwpr(bad, 0.0, 0.0, 0.0, 0.0, 0.0), 10.0)


@given(st.integers(-999_999_999, 999_999_999), st.lists(st.integers(0, 99), max_size=3))
def test_every_refusal_has_an_alarm_and_names_its_code(code: int, more: list[int]) -> None:
    for number in (code, *messages.Refusal):
        error = messages.refused("MOVL", Reply(1, accepted=False, values=(number, *more)))
        assert isinstance(error, PortError)
        assert str(int(number)) in error.detail
