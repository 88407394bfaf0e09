"""The gripper's registers: the manual's own examples, and whatever else may come over a wire."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.gripper.robotiq_faults import describe, fault_of
from drivers.gripper.robotiq_registers import (
    MODELS,
    Action,
    Activation,
    Contact,
    Stroke,
    decode,
    encode,
    to_count,
)
from srvs_cell.alarms import Alarm
from srvs_cell.ports import PortError

WORDS = st.integers(0, 0xFFFF)


def test_the_manuals_commands() -> None:
    assert encode(Action(0)) == [0x0000, 0x0000, 0x0000]
    assert encode(Action.ACTIVATE) == [0x0100, 0x0000, 0x0000]
    assert encode(Action.ACTIVATE | Action.GO, 255, 255, 255) == [0x0900, 0x00FF, 0xFFFF]
    assert encode(Action.ACTIVATE | Action.GO, 0, 255, 255) == [0x0900, 0x0000, 0xFFFF]


@pytest.mark.parametrize(
    ("words", "activation", "contact", "echo", "position", "current_ma"),
    [
        ([0x1100, 0x0000, 0x0000], Activation.ACTIVATING, Contact.MOVING, 0, 0, 0),
        ([0x3900, 0x00FF, 0x0E0A], Activation.ACTIVE, Contact.MOVING, 255, 14, 100),
        ([0xB900, 0x00FF, 0xBD00], Activation.ACTIVE, Contact.WHILE_CLOSING, 255, 189, 0),
        ([0x3900, 0x0000, 0xBB10], Activation.ACTIVE, Contact.MOVING, 0, 187, 160),
        ([0xF900, 0x0000, 0x0D00], Activation.ACTIVE, Contact.ARRIVED, 0, 13, 0),
    ],
)
def test_the_manuals_answers(
    words: list[int], activation: Activation, contact: Contact, echo: int, position: int, current_ma: int
) -> None:
    status = decode(words)
    assert (status.activation, status.contact) == (activation, contact)
    assert (status.request, status.position, status.current_ma) == (echo, position, current_ma)
    assert status.activated
    assert status.fault == 0


@given(st.lists(WORDS, max_size=6))
def test_any_words_are_a_status_or_a_protocol_error(words: list[int]) -> None:
    if len(words) != 3 or words[0] >> 12 & 3 == 2:
        with pytest.raises(PortError) as error:
            decode(words)
        assert error.value.alarm is Alarm.PROTOCOL_ERROR
        return
    status = decode(words)
    state = status.contact << 6 | status.activation << 4 | status.going << 3 | status.activated
    assert state == words[0] >> 8 & 0xF9
    assert [status.controller_fault << 4 | status.fault, status.request] == list(words[1].to_bytes(2, "big"))
    assert [status.position, status.current_ma // 10] == list(words[2].to_bytes(2, "big"))


@pytest.mark.parametrize("words", [[0, 0, 0x10000], [-1, 0, 0], [0x2000, 0, 0], [], [0, 0]])
def test_what_is_no_status_is_refused(words: list[int]) -> None:
    with pytest.raises(PortError, match="gripper's status"):
        decode(words)


@pytest.mark.parametrize("wrong", [{"request": 256}, {"speed": -1}, {"force": 1000}])
def test_a_count_that_does_not_fit_is_not_sent(wrong: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="outside 0 to 255"):
        encode(Action.GO, **wrong)


def test_speed_and_force_of_both_models() -> None:
    small, large = MODELS["2f85"], MODELS["2f140"]
    assert [to_count(value, small.speed_mm_s) for value in (20.0, 85.0, 150.0)] == [0, 128, 255]
    assert [to_count(value, small.force_n) for value in (20.0, 235.0)] == [0, 255]
    assert [to_count(value, large.force_n) for value in (10.0, 125.0)] == [0, 255]


def test_a_measured_stroke_is_followed_between_its_points() -> None:
    stroke = Stroke(((3, 84.0), (100, 50.0), (228, 0.0)))
    assert [stroke.opening_mm(position) for position in (0, 3, 100, 228, 255)] == [84.0, 84.0, 50.0, 0.0, 0.0]
    assert stroke.opening_mm(164) == pytest.approx(25.0)
    assert [stroke.request(opening_mm) for opening_mm in (84.0, 100.0, 50.0, 25.0, 0.0)] == [0, 0, 100, 164, 255]


@st.composite
def strokes(draw: st.DrawFn) -> Stroke:
    counts = sorted(draw(st.sets(st.integers(0, 255), min_size=2, max_size=8)))
    openings = sorted(draw(st.sets(st.integers(0, 1400), min_size=len(counts), max_size=len(counts))), reverse=True)
    return Stroke(tuple((count, opening / 10.0) for count, opening in zip(counts, openings, strict=True)))


@given(strokes(), st.integers(0, 255), st.integers(0, 255))
def test_a_stroke_never_opens_while_it_closes(stroke: Stroke, one: int, other: int) -> None:
    low, high = sorted((one, other))
    assert stroke.opening_mm(low) >= stroke.opening_mm(high)
    inside = stroke.points[0][0] < one < stroke.points[-1][0]
    if inside:  # asked for the opening of a position, the fingers go to that position
        assert stroke.request(stroke.opening_mm(one)) == one


@pytest.mark.parametrize("points", [((3, 85.0),), ((3, 0.0), (230, 85.0)), ((3, 85.0), (3, 0.0)), ()])
def test_a_stroke_that_does_not_close_is_refused(points: tuple[tuple[int, float], ...]) -> None:
    with pytest.raises(ValueError, match="falling openings"):
        Stroke(points)


def test_every_fault_of_the_manual_has_cause_and_remedy() -> None:
    assert fault_of(0) is None
    listed = [0x05, 0x07, 0x08, 0x09, 0x0A, 0x0B, 0x0C, 0x0D, 0x0E, 0x0F]
    texts = {describe(code) for code in listed}
    assert len(texts) == len(listed)
    assert all(describe(code).startswith(f"fault 0x{code:02X}: ") for code in listed)
    ends = [code for code in range(1, 16) if (row := fault_of(code)) is not None and row.ends_activation]
    assert set(range(0x0A, 0x10)) <= set(ends)  # the manual's major faults, which need a rising edge of rACT
    assert not {0x05, 0x07, 0x08, 0x09} & set(ends)
    assert "does not list" in describe(0x03)
    assert [code for code, row in enumerate(map(fault_of, range(16))) if row is not None and row.passes] == [0x09]
