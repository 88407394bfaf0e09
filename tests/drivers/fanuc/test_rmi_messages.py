"""Bytes and packets: any split gives the same lines, garbage is refused by name, and what is sent is as the manual."""

import json
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.fanuc.rmi import errors, messages
from drivers.fanuc.rmi.framing import LINE_LIMIT, LineBuffer
from drivers.fanuc.rmi.messages import Configuration, Kind, Packet, Path
from srvs_cell.alarms import Alarm
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import PortError

LINES = st.lists(st.binary(min_size=1, max_size=40).filter(lambda line: b"\n" not in line and line[-1:] != b"\r"))
STATUS: dict[str, Any] = {
    "ServoReady": 1,
    "TPMode": 0,
    "RMIMotionStatus": 1,
    "ProgramStatus": 0,
    "SingleStepMode": 0,
    "NumberUTool": 10,
    "NextSequenceID": 7,
    "Override": 30,
}
POSTURE = Configuration(1, 2, 1, 1, 0, 1, 0, -1, 1)


def alarm_of(call: Callable[[], object]) -> Alarm | None:
    try:
        call()
    except PortError as error:
        return error.alarm
    return None


def reply(name: str, **fields: Any) -> Packet:
    return Packet(Kind.COMMAND, name, None, 0, fields)


@given(LINES, st.data(), st.sampled_from([b"\r\n", b"\n"]))
def test_any_split_of_the_bytes_gives_the_same_lines(lines: list[bytes], data: st.DataObject, end: bytes) -> None:
    stream = b"".join(line + end for line in lines)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=10)))
    buffer, got = LineBuffer(), []
    for begin, stop in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        got += buffer.feed(stream[begin:stop])
    assert got == lines


@given(st.binary(max_size=60), st.integers(1, 5))
def test_what_has_no_end_is_kept_and_gives_no_line(data: bytes, size: int) -> None:
    unended = data.replace(b"\n", b"")
    buffer = LineBuffer()
    for at in range(0, len(unended), size):
        assert buffer.feed(unended[at : at + size]) == []
    assert buffer.feed(b"\r\n") == ([unended] if unended else [])


def test_a_line_that_never_ends_is_refused() -> None:
    buffer = LineBuffer()
    buffer.feed(b"x" * LINE_LIMIT)
    with pytest.raises(PortError) as error:
        buffer.feed(b"x")
    assert error.value.alarm is Alarm.PROTOCOL_ERROR


@given(st.binary(max_size=200))
def test_no_bytes_make_the_decoder_fail_otherwise_than_by_name(data: bytes) -> None:
    assert alarm_of(lambda: messages.decode(data)) in {None, Alarm.PROTOCOL_ERROR}


_TEXT = st.sampled_from(["", "X", "W", "Front", "Turn4", "No Error", "1"])
_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | _TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(_TEXT, inner, max_size=3),
    max_leaves=8,
)


@given(
    st.fixed_dictionaries(
        {"ErrorID": st.just(0)},
        optional=dict.fromkeys([*STATUS, "Position", "Configuration", "ErrorData"], _JSON),
    )
)
def test_no_fields_make_a_reader_fail_otherwise_than_by_name(content: dict[str, Any]) -> None:
    packet = messages.decode(json.dumps({"Command": "FRC_GetStatus", **content}).encode())
    for read in (messages.read_status, messages.read_place, messages.read_errors):
        assert alarm_of(partial(read, packet)) in {None, Alarm.PROTOCOL_ERROR}


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"[]",
        b"{}",
        b"null",
        b'{"ErrorID":0}',
        b'{"ErrorID":0,"Command":"FRC_GetStatus"}',
        b'{"Command":7,"ErrorID":0}',
        b'{"Command":"FRC_GetStatus","ErrorID":"0"}',
        b'{"Command":"FRC_GetStatus","ErrorID":true}',
        b'{"Instruction":"FRC_LinearMotion","SequenceID":1.5,"ErrorID":0}',
        b"[" * 5000,
        b"9" * 5000,
        b"\xff\xfe",
        b"HTTP/1.1 400 Bad Request",
    ],
)
def test_what_is_no_packet_is_refused_and_quoted(line: bytes) -> None:
    with pytest.raises(PortError) as error:
        messages.decode(line)
    assert error.value.alarm is Alarm.PROTOCOL_ERROR
    assert repr(line[:20])[:-1] in error.value.detail


def test_the_first_key_comes_first_and_the_line_ends_in_cr_lf() -> None:
    target = Xyzwpr(500.0, 0.0, 120.12345, 180.0, 0.0, -0.5)
    fields = messages.move_fields(target, POSTURE, Path.LINEAR, 150.9)
    assert messages.encode(Kind.INSTRUCTION, Path.LINEAR.value, {"SequenceID": 7, **fields}) == (
        b'{"Instruction": "FRC_LinearMotion", "SequenceID": 7, "Configuration": {"UToolNumber": 1, "UFrameNumber": 2, '
        b'"Front": 1, "Up": 1, "Left": 0, "Flip": 1, "Turn4": 0, "Turn5": -1, "Turn6": 1}, '
        b'"Position": {"X": 500.0, "Y": 0.0, "Z": 120.1235, "W": 180.0, "P": 0.0, "R": -0.5}, '
        b'"SpeedType": "mmSec", "Speed": 150, "TermType": "FINE", "TermValue": 0}\r\n'
    )


def test_a_joint_move_goes_by_per_cent() -> None:
    fields = messages.move_fields(Xyzwpr(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), POSTURE, Path.JOINT, 10.0)
    assert (fields["SpeedType"], fields["Speed"], fields["TermType"]) == ("Percent", 10, "FINE")


def test_what_is_no_number_is_never_sent() -> None:
    with pytest.raises(ValueError, match="JSON"):
        messages.encode(Kind.COMMAND, "FRC_SetOverRide", {"Value": math.nan})


def test_fields_beside_an_error_id_are_not_read() -> None:
    packet = messages.decode(b'{"Command" : "FRC_GetStatus", "ErrorID" : 2556937, "ProgramStatus": -4}')
    assert packet == Packet(Kind.COMMAND, "FRC_GetStatus", None, 2556937, {})


def test_a_status_is_read() -> None:
    status = messages.read_status(reply("FRC_GetStatus", **STATUS))
    assert (status.servo_ready, status.pendant_enabled, status.rmi_running) == (True, False, True)
    assert (status.paused, status.single_step, status.override_percent, status.next_sequence) == (False, False, 30, 7)
    without = {key: value for key, value in STATUS.items() if key != "NextSequenceID"}
    assert messages.read_status(reply("FRC_GetStatus", **without)).next_sequence is None


@pytest.mark.parametrize(("key", "value"), [("Override", 101), ("TPMode", "0"), ("NextSequenceID", -3)])
def test_a_status_that_makes_no_sense_names_the_key(key: str, value: object) -> None:
    with pytest.raises(PortError) as error:
        messages.read_status(reply("FRC_GetStatus", **{**STATUS, key: value}))
    assert key in error.value.detail
    assert repr(value) in error.value.detail


def test_a_pose_is_read_with_its_frames() -> None:
    configuration = {
        "UToolNumber": 1,
        "UFrameNumber": 2,
        "Front": 1,
        "Up": 1,
        "Left": 0,
        "Flip": 1,
        "Turn4": 0,
        "Turn5": -1,
        "Turn6": 1,
    }
    position: dict[str, Any] = {"X": 1, "Y": 2.5, "Z": -3.0, "W": 180.0, "P": 0.0, "R": 90.0, "Ext1": 0.0}
    place = messages.read_place(
        reply("FRC_ReadCartesianPosition", Configuration=configuration, Position=position, TimeTag=5)
    )
    assert place.pose == Xyzwpr(1.0, 2.5, -3.0, 180.0, 0.0, 90.0)
    assert place.configuration == POSTURE
    for bad in (math.nan, math.inf, "1", True, None):
        with pytest.raises(PortError, match=r"Position: X reads"):
            messages.read_place(
                reply("FRC_ReadCartesianPosition", Configuration=configuration, Position={**position, "X": bad})
            )


@pytest.mark.parametrize(
    ("text", "alarm"), [("SRVO-002", "SRVO-002"), ("No Error", None), ("  ", None), ("MOTN-018 x\r\n", "MOTN-018 x")]
)
def test_the_newest_alarm_is_read(text: str, alarm: str | None) -> None:
    assert messages.read_errors(reply("FRC_ReadError", Count=1, ErrorData=text)) == alarm


@pytest.mark.parametrize(
    ("error_id", "alarm", "words"),
    [
        (2556936, Alarm.MODE_NOT_AUTO, "RMIT-008: The teach pendant is enabled."),
        (2556944, Alarm.ROBOT_NOT_READY, "RMIT-016: The controller must be restarted"),
        (2556954, Alarm.SESSION_HELD, "RMIT-026: Another client is connected."),
        (2556977, Alarm.ROBOT_NOT_READY, "$RMI_CFG.$ASBN_ENB"),
        (2556971, Alarm.ROBOT_NOT_READY, "RMIT-043: Single step mode is on."),
        (7015, Alarm.ROBOT_NOT_READY, "delete RMI_MOVE on the pendant"),
        (17035, Alarm.ROBOT_FAULT, "ErrorID 17035: an id that the manual does not list"),
    ],
)
def test_an_error_id_says_cause_and_remedy(error_id: int, alarm: Alarm, words: str) -> None:
    assert errors.meaning(error_id).alarm is alarm
    assert words in errors.describe(error_id)


def test_every_id_of_the_manual_is_listed_with_a_remedy() -> None:
    for number in range(1, 58):
        row = errors.meaning(errors.rmit(number))
        assert row is not errors.meaning(-1)
        assert row.cause.endswith(".")
        assert row.remedy.endswith((".", ")"))
