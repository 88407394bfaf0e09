"""Any .LS text is a program or is refused with file, line and reason; any program runs, or stops with an alarm."""

import re
from types import MappingProxyType

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drivers.sim.tp import TpError, TpMachine, load, parse, shipped_sources
from tests.drivers.sim.tp.programs import Devices, program

SOURCES = MappingProxyType({name: text for name, text in shipped_sources().items() if name.endswith(".LS")})
LINES = sorted({line for text in SOURCES.values() for line in text.splitlines()})
PIECES = st.sampled_from([
    "R[1]", "R[1:x]", "PR[1,2]", "DO[3]", "AR[1]", "=", "<>", "(", ")", ",", "+", "-", "*", "/", "DIV", "MOD", "AND",
    "OR", "!", "ON", "OFF", "JMP", "LBL[1]", "CALL", "MAIN", "RUN", "IF", "SELECT", "ELSE", "WAIT", "TIMEOUT", "SKIP",
    "CONDITION", "L", "J", "UALM[1]", "MESSAGE[", "]", "[", "%", "mm/sec", "FINE", "Skip", "END", "$WAITTMOUT", "$X.$Y",
    "1", "0", ".5", "9" * 30, "9" * 5000, "1e9", "THEN", ";", ":", "/POS", "\\", "\x00", "\u0663", "\u00e9",
    "UFRAME_NUM", "LPOS", "sec",
])  # fmt: skip
STATEMENTS = (
    st.lists(PIECES, max_size=12).map(" ".join) | st.lists(PIECES, max_size=6).map("".join) | st.text(max_size=40)
)


def judge(sources: dict[str, str]) -> None:
    try:
        programs = load(sources)
    except TpError as error:
        assert error.file in sources
        lines = sources[error.file].splitlines()
        assert 1 <= error.line <= max(1, len(lines))
        assert re.match(re.escape(f"{error.file}, line {error.line}: ") + ".", str(error), re.DOTALL)
        return
    machine = TpMachine(programs, Devices())
    machine.run(min(programs), 0.0)
    for step in range(4):
        alarm = machine.catch_up(0.05 * step)
        assert alarm is None or re.match(r"[A-Z]{4}-\d{3} ", alarm)


@given(st.lists(STATEMENTS, min_size=1, max_size=4))
@example(["IF (" + "(" * 2000 + "R[1]" + ")" * 2000 + "),JMP LBL[1]"])
@example(["IF (" + "(" * 120 + "DI[1]" + ")" * 120 + "),JMP LBL[1]", "LBL[1]"])
@example(["R[1]=(1" + "+1" * 115 + ")"])
@example(["R[1]=" + "9" * 240, "R[2]=R[1]/3"])
@example(["IF (" + "!" * 5000 + "DI[1]),JMP LBL[1]"])
@example(["R[1]=(1" + "+1" * 5000 + ")"])
@example(["R[" + "9" * 5000 + "]=1"])
@example(["R[1]=" + "9" * 5000])
@example(["R[1]=" + "9" * 400 + ".5"])
@example(["R[1]=" + "9" * 50 + ".5"])
@example(["R[1]=" + "9" * 39 + "/3"])
@example(["WAIT " + "9" * 400 + ".(sec)"])
@example(["R[1]=R[\u0663]"])
@example(["R[1]=1 MOD 0"])
@example(["R[1]=(1 DIV 0.5 MOD 0)"])
@example(["PR[1]=LPOS", "PR[1,1]=5", "L PR[1] 0mm/sec FINE"])
@example(["LBL[1]", "JMP LBL[1]"])
@example(["CALL MAIN"])
@example(["RUN MAIN"])
@settings(max_examples=80)
def test_any_statements(statements: list[str]) -> None:
    judge({"MAIN.LS": program("MAIN", *statements)})


@st.composite
def damaged(draw: st.DrawFn) -> dict[str, str]:
    """The robot's programs with some damage to one of them."""
    name = draw(st.sampled_from(sorted(SOURCES)))
    text = SOURCES[name]
    for _ in range(draw(st.integers(1, 3))):
        lines = text.split("\n")
        at = draw(st.integers(0, len(lines) - 1))
        line = lines[at]
        cut = draw(st.integers(0, len(line)))
        kind = draw(st.sampled_from(["drop", "twice", "cut", "insert", "other", "truncate"]))
        if kind == "truncate":
            lines = [*lines[:at], line[:cut]]
        elif kind == "drop":
            del lines[at]
        else:
            inserted = line[:cut] + draw(PIECES | st.characters()) + line[cut:]
            other = draw(st.sampled_from(LINES))
            lines[at] = {"twice": line + "\n" + line, "cut": line[:cut], "insert": inserted, "other": other}[kind]
        text = "\n".join(lines)
    return {**SOURCES, name: text}


@given(damaged())
@settings(max_examples=50)
def test_damaged_programs(sources: dict[str, str]) -> None:
    judge(sources)


@pytest.mark.parametrize("text", ["", "\n", "/", "/ \n", "/PROG", "/PROG  MAIN\n/ATTR\n/MN\n/POS\n/END\n"])
def test_what_is_no_program_at_all(text: str) -> None:
    with pytest.raises(TpError, match=r"^MAIN\.LS, line 1: "):
        parse("MAIN.LS", text)


@pytest.mark.parametrize("count", ["x", "", "1.5", "9" * 5000])
def test_a_line_count_that_is_no_number(count: str) -> None:
    with pytest.raises(TpError, match="LINE_COUNT"):
        parse("MAIN.LS", program("MAIN", "R[1]=1").replace("LINE_COUNT\t= 1", f"LINE_COUNT\t= {count}"))
