"""The robot's KAREL source: it does what the page says, it agrees with the driver, and mistakes in it are noticed."""

from __future__ import annotations

import functools
import re
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.fanuc.karel import lines, messages
from drivers.fanuc.registers import UopOutput
from drivers.sim.karel import KarelError
from drivers.sim.karel_controller import controller_sources
from tests.drivers.fanuc.karel_conversation import HOME, JUDGES, Conversation, content

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

SHIPPED = controller_sources()
CORE = "srvscell.kl"
TEXT = SHIPPED[CORE]
CONSTANTS = {name: int(value) for name, value in re.findall(r"^  ([A-Z_0-9]+) *= (\d+)", TEXT, re.MULTILINE)}


@pytest.mark.parametrize("judge", JUDGES, ids=lambda judge: judge.__name__)
def test_the_shipped_source_does_what_the_page_says(judge: Callable[[Mapping[str, str]], None]) -> None:
    judge(SHIPPED)


def test_source_and_driver_have_the_same_numbers() -> None:
    assert CONSTANTS["PROTOCOL"] == lines.PROTOCOL
    assert CONSTANTS["SEQ_MAX"] == lines.LAST_SEQUENCE
    assert CONSTANTS["LINE_MAX"] == lines.LINE_LIMIT
    for prefix, names in (("NO_", messages.Refusal), ("ST_", messages.State)):
        assert {name.removeprefix(prefix): value for name, value in CONSTANTS.items() if name.startswith(prefix)} == {
            member.name: member.value for member in names
        }
    causes = {"BY_NOBODY": "NOBODY", "BY_PC": "PC", "BY_WATCHDOG": "WATCHDOG", "AT_ROBOT": "ROBOT"}
    assert {causes[name]: CONSTANTS[name] for name in causes} == {c.name: c.value for c in messages.Cause}
    assert (CONSTANTS["CHAR_FIRST"], CONSTANTS["CHAR_LAST"]) == (32, 126)
    assert (CONSTANTS["SILENT_MAX"], CONSTANTS["PATH_LINEAR"], CONSTANTS["PATH_JOINT"]) == (2000, 1, 2)
    assert 1 << CONSTANTS["UO_FAULT"] - 1 == UopOutput.FAULT
    assert 1 << CONSTANTS["UO_CMDENBL"] - 1 == UopOutput.CMDENBL


NOT_ASKED = {"JNTS"}
"""For whoever sets the robot up: the driver asks for no joints."""


def test_source_and_driver_have_the_same_commands() -> None:
    in_source = set(re.findall(r"verb = '(\w{4})'", TEXT))
    page = lines.__file__.replace("lines.py", "")
    asked: set[str] = set()
    for file in ("arm.py", "session.py"):
        with open(page + file, encoding="utf-8") as source:  # noqa: PTH123 - beside the module that was imported
            asked |= set(re.findall(r'"([A-Z]{4})"', source.read()))
    assert in_source - asked == NOT_ASKED
    assert asked <= in_source


def test_source_and_driver_have_the_same_fields_in_the_same_order() -> None:
    (body,) = re.findall(r"ROUTINE do_stat\n(.*?)END do_stat", TEXT, re.DOTALL)
    words = ("state", "cause", "move_seq", "mode", "uo_word", "OVERRIDE", "FRAMENUM", "TOOLNUM", "alarm", *"xyzwpr")
    added = re.findall(r"^  add\((.*)\)$", body, re.MULTILINE)
    assert [word in text for word, text in zip(words, added, strict=True)] == [True] * 15


def test_the_mover_uses_the_registers_of_the_source() -> None:
    mover = SHIPPED["SRVS_KMV.LS"]
    assert {int(n) for n in re.findall(r"\bR\[(\d+)", mover)} == {CONSTANTS[n] for n in CONSTANTS if n.startswith("R_")}
    assert {int(n) for n in re.findall(r"\bPR\[(\d+)", mover)} == {CONSTANTS["PR_TARGET"]}
    assert f"R[140:SRVS PATH]={CONSTANTS['PATH_JOINT']}," in mover


@functools.cache
def _talk() -> Conversation:
    """A conversation that all examples go on with: to translate the source takes longer than an example."""
    return Conversation(SHIPPED)


@given(st.binary(max_size=60), st.integers(0, 30_000))
@settings(max_examples=40)
def test_the_robot_computes_the_same_checksum(text: bytes, sequence: int) -> None:
    c = _talk()
    body = b">%d,%b" % (sequence, re.sub(rb"[^A-Z0-9,]", b"", text))
    (answer,) = c.send(b"%b*%d\r\n" % (body, lines.checksum(body)))
    reply = lines.decode(answer.removesuffix(b"\r\n"))
    assert not reply.accepted
    assert reply.sequence in {0, sequence}


@given(st.lists(st.binary(max_size=80), max_size=4))
@settings(max_examples=60)
def test_no_garbage_moves_the_robot_or_ends_its_program(pieces: list[bytes]) -> None:
    c = _talk()
    c.sequence = 10  # the same lines in every example
    c.ready()
    for piece in pieces:
        c.send(piece)
    c.send(b"\r\n")
    c.pass_s(0.5)
    assert c.agreed("STAT")[9:] == list(HOME)
    assert c.controller.motions_started == 0


@given(st.data())
@settings(max_examples=60)
def test_no_damaged_move_moves_the_robot(data: st.DataObject) -> None:
    c = _talk()
    c.sequence = 10  # the same lines in every example
    c.ready()
    line = c.line("MOVL", 600_000, 0, 400_000, 180_000, 0, 0, 20_000)
    at = data.draw(st.integers(0, len(line) - 4))
    changed = line[:at] + bytes([data.draw(st.integers(0, 255))]) + line[at + data.draw(st.integers(0, 2)) :]
    # an empty line before a whole one damages nothing
    if changed.strip(b"\r\n") != line.strip(b"\r\n"):
        c.send(changed)
        c.send(b"\r\n")
        c.pass_s(0.5)
        assert c.controller.motions_started == 0


MUTANTS = [
    ("USER_TOOL    = 1", "USER_TOOL    = 2"),
    ("POS_LIMIT    = 3000000", "POS_LIMIT    = 3000001"),
    ("ANGLE_LIMIT  = 360000", "ANGLE_LIMIT  = 360001"),
    ("LINEAR_MAX   = 2000000", "LINEAR_MAX   = 2000001"),
    ("SPEED_MIN    = 1000", "SPEED_MIN    = 1001"),
    ("AHEAD_MAX    = 15000", "AHEAD_MAX    = 15001"),
    ("IO_SI        = 11", "IO_SI        = 12"),
    ("MOD 255", "MOD 256"),
    ("high * 256", "high * 255"),
    ("IF sum <> seen_sum THEN", "IF 1 = 2 THEN"),
    ("(ahead > AHEAD_MAX)", "(ahead < 0)"),
    ("IF NOT enabled THEN", "IF 1 = 2 THEN"),
    ("    silent_ms = 0\n    carry_out", "    carry_out"),
    ("  greeted = TRUE\n  done = stop_move(BY_PC)", "  greeted = TRUE"),
    ("target.p = args[5]", "target.p = args[6]"),
    ("ABORT_TASK(MOVER, FALSE, TRUE, status)\n  IF status", "status = 0\n  IF status"),
]
"""Mistakes in the source: what is replaced by what."""


@pytest.mark.parametrize(("old", "new"), MUTANTS, ids=[new for _, new in MUTANTS])
def test_a_mistake_in_the_source_is_noticed(old: str, new: str) -> None:
    assert old in TEXT
    assert not content({**SHIPPED, CORE: TEXT.replace(old, new, 1)})


@pytest.mark.parametrize("line", [3, 4, 7, 9])
def test_a_line_of_the_mover_that_is_switched_off_is_noticed(line: int) -> None:
    text, count = re.subn(rf"^(   {line}:)(.*)$", r"\1  //\2", SHIPPED["SRVS_KMV.LS"], flags=re.MULTILINE)
    assert count == 1
    assert not content({**SHIPPED, "SRVS_KMV.LS": text})


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("  greeted      : BOOLEAN\n", "", "GREETED"),
        ("ENDIF", "ENDIFF", "IF"),
        ("RETURN(high * 256 + low)", "RETURN(high * 256 + lowest)", "LOWEST"),
        ("RETURN(high * 256 + low)", "RETURN('0')", "INTEGER is to be returned"),
        ("  state        : INTEGER", "  stop         : INTEGER", "cannot be a name"),
        ("  seen_code    :", "  sequence_code :", "longer than 12"),
        ("low = 0", "low = 0.5", "REAL cannot be written to INTEGER"),
        ("(seq >= 1) AND (seq <= SEQ_MAX)", "seq >= 1 AND seq <= SEQ_MAX", "AND does not go with"),
        ("RESET(reset_ok)", "RESET(reset_ok, 1)", "takes 1 arguments"),
        ("MOD 255", "MOD 255 ?", "not understood"),
        ("%COMMENT", "%COMENT", "not known"),
        ("%INCLUDE srvscell", "%INCLUDE srvsbell", "there is no file"),
        ("low = 0", "low = = 0", "neither declared nor known"),
        ("  add(value)", "  adding(value)", "neither declared nor known"),
    ],
)
def test_what_the_translator_would_not_take_is_refused_with_file_and_line(old: str, new: str, reason: str) -> None:
    changed = {name: text.replace(old, new, 1) for name, text in SHIPPED.items() if name.endswith(".kl")}
    assert any(SHIPPED[name] != text for name, text in changed.items())
    with pytest.raises(KarelError, match=rf"srvs\w+\.kl, line \d+: .*{re.escape(reason)}"):
        Conversation({**SHIPPED, **changed})
