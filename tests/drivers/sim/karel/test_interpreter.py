"""The KAREL interpreter by itself: what statements do, and what aborts a program."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import pytest

from drivers.sim.karel import KarelError, KarelTask

if TYPE_CHECKING:
    from drivers.sim.karel import FileVariable, Host


class Screen:
    """A controller with a screen."""

    def __init__(self) -> None:
        self.shown: list[str] = []
        self.visitors = 0

    def write(self, file: FileVariable | None, text: str) -> int:
        assert file is None
        self.shown.append(text)
        return 0

    def connected(self, _tag: str) -> bool:
        return self.visitors > 0


def _task(body: str, declarations: str = "", screen: Screen | None = None) -> tuple[KarelTask, Screen]:
    screen = Screen() if screen is None else screen
    source = f"PROGRAM t\n%NOLOCKGROUP\n{declarations}\nBEGIN\n{body}\n  DELAY 1\nEND t\n"
    task = KarelTask({"t.kl": source}, "t.kl", cast("Host", screen))
    task.start(0.0)
    return task, screen


def _shown(body: str, declarations: str = "") -> str:
    """Return what a program shows, or why it was aborted."""
    task, screen = _task(body, declarations)
    task.resume(0.0)
    return task.aborted or "".join(screen.shown)


VARIABLES = "VAR\n  i, k : INTEGER\n  x : REAL\n  b : BOOLEAN\n  s : STRING[5]\n  a : ARRAY[3] OF INTEGER"


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("1 + 2 * 3", "7"),
        ("(1 + 2) * 3", "9"),
        ("7 DIV 2", "3"),
        ("-7 DIV 2", "-3"),
        ("7 MOD 4", "3"),
        ("1 / 2", "0.5"),
        ("2 - -3", None),
        ("NOT TRUE OR TRUE", "True"),
        ("TRUE OR TRUE AND FALSE", "True"),
        ("(1 < 2) AND (2.5 >= 2)", "True"),
        ("'a' + 'b' = 'ab'", "True"),
        ("STR_LEN('it''s')", "4"),
        ("SUB_STR('abcd', 2, 2)", "bc"),
        ("INDEX('abcd', 'c')", "3"),
        ("ORD('A', 1)", "65"),
        ("CHR(66)", "B"),
        ("ROUND(2.6)", "3"),
        ("ABS(-4)", "4"),
    ],
)
def test_expressions(expression: str, value: str | None) -> None:
    if value is None:
        with pytest.raises(KarelError):
            _shown(f"WRITE({expression})")
    else:
        assert _shown(f"WRITE({expression})") == value


@pytest.mark.parametrize(
    ("body", "shown"),
    [
        ("FOR i = 2 TO 4 DO\n WRITE(i)\nENDFOR", "234"),
        ("FOR i = 2 TO 1 DO\n WRITE(i)\nENDFOR", ""),
        ("i = 3\nWHILE i > 0 DO\n WRITE(i)\n i = i - 1\nENDWHILE", "321"),
        ("IF 1 = 2 THEN\n WRITE('a')\nELSE\n WRITE('b')\nENDIF", "b"),
        ("IF TRUE THEN WRITE('a'); WRITE('b'); ENDIF", "ab"),
        ("s = 'abcdefg'\nWRITE(s)", "abcde"),
        ("x = 1\nWRITE(x + 1)", "2.0"),
        ("a[2] = 5\ni = 2\nWRITE(a[i], CR)", "5\n"),
        ("WRITE(UNINIT(i), UNINIT(x))\ni = 0\nWRITE(UNINIT(i))", "TrueTrueFalse"),
        ("CNV_INT_STR(-12, 1, 10, s)\nWRITE(s)\nCNV_INT_STR(12, 1, 10, s)\nWRITE(s)", "-12 12"),
        ("i = 1 + &\n 2\nWRITE(i) -- a remark", "3"),
    ],
)
def test_statements(body: str, shown: str) -> None:
    assert _shown(body, VARIABLES) == shown


def test_arguments_go_by_reference_unless_they_are_values() -> None:
    routines = (
        "ROUTINE bump(n : INTEGER)\nBEGIN\n n = n + 1\nEND bump\n"
        "ROUTINE twice(n : INTEGER) : INTEGER\nVAR\n m : INTEGER\nBEGIN\n m = n\n bump(n)\n RETURN(m + n)\nEND twice"
    )
    assert _shown(
        "i = 5\nbump(i)\nWRITE(i)\nbump((i))\nWRITE(i)\nWRITE(twice(i))\nWRITE(i)", f"{VARIABLES}\n{routines}"
    ) == ("66137")


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("WRITE(i)", "INTP-311 Uninitialized data is used: I"),
        ("i = 0\nk = 1 DIV i", "INTP-302"),
        ("i = 2147483647\ni = i + 1", "INTP-323"),
        ("WRITE(SUB_STR('abc', 2, 3))", "INTP-312"),
        ("WRITE(ORD('', 1))", "INTP-312"),
        ("WRITE(CHR(-1))", "INTP-312"),
        ("i = 4\na[i] = 1", "INTP-302"),
    ],
)
def test_what_cannot_be_carried_out_aborts_the_program_and_names_the_line(body: str, reason: str) -> None:
    aborted = _shown(body, VARIABLES)
    assert reason in aborted
    assert f"(t.kl, line {10 + body.count(chr(10))})" in aborted


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("j = 1", "J is neither declared nor known"),
        ("i = 'a'", "STRING cannot be written to INTEGER"),
        ("b = 1 AND 2", "AND does not go with INTEGER and INTEGER"),
        ("b = 1 = 2 = 3", "the end of the statement"),
        ("IF i THEN\nENDIF", "a condition is BOOLEAN"),
        ("i = STR_LEN(1)", "takes STRING, not INTEGER"),
        ("STR_LEN('a')", "is not used"),
        ("CNV_INT_STR(1, 1, 10, 'a')", "no variable of its type"),
        ("WAIT FOR b", "neither declared nor known"),
        ("i = 1 2", "the end of the statement is expected"),
        ("averylongname = 1", "longer than 12"),
        ("MOVE TO i", "MOVE is neither declared nor known"),
        ("FOR x = 1 TO 2 DO\nENDFOR", "FOR counts with INTEGER"),
        ("DELAY 0.5", "milliseconds"),
    ],
)
def test_what_is_wrong_is_refused_before_it_runs(body: str, reason: str) -> None:
    with pytest.raises(KarelError, match=rf"t\.kl, line \d+: .*{reason}"):
        _task(body, VARIABLES)


@pytest.mark.parametrize(
    ("declarations", "reason"),
    [
        ("VAR\n  i : INTEGER\n  I : REAL", "I is declared twice"),
        ("CONST\n  n = 1\nVAR\n  n : REAL", "N is declared twice"),
        ("VAR\n  s : STRING[300]", "1 to 254"),
        ("VAR\n  stop : INTEGER", "cannot be a name"),
        ("VAR\n  v : VECTOR", "is not known to the interpreter"),
        ("CONST\n  c = TRUE", "a constant is a number or a string"),
        ("TYPE", "a declaration cannot begin with"),
    ],
)
def test_what_is_declared_wrongly_is_refused(declarations: str, reason: str) -> None:
    with pytest.raises(KarelError, match=reason):
        _task("", declarations)


def test_a_program_waits_counts_and_comes_to_its_end() -> None:
    body = "CONNECT TIMER TO i\nWRITE('a')\nDELAY 100\nWRITE(i)\nDELAY 50\nWRITE(i)"
    task, screen = _task(body, VARIABLES)
    task.resume(0.0)
    task.resume(0.05)
    assert screen.shown == ["a"]
    task.resume(0.1)
    assert screen.shown == ["a", "100"]
    task.resume(0.12, early=True)
    assert screen.shown == ["a", "100", "120"]
    task.resume(1.0)
    assert task.aborted == "the program has ended"


def test_msg_connect_waits_for_a_client_also_inside_of_a_routine() -> None:
    routine = "ROUTINE come\nBEGIN\n MSG_CONNECT('S3:', i)\nEND come"
    task, screen = _task("come\nWRITE(i)", f"{VARIABLES}\n{routine}")
    for now_s in (0.0, 1.0, 2.0):
        task.resume(now_s)
    assert not screen.shown
    screen.visitors = 1
    task.resume(3.0)
    assert screen.shown == ["0"]
