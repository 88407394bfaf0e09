"""What the interpreter does not know it refuses, with file, line and reason, before anything runs."""

import pytest

from drivers.sim.tp import TpError, load, parse
from tests.drivers.sim.tp.programs import program


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("OVERRIDE=30%", "'OVERRIDE'"),
        ("C PR[1] 100mm/sec FINE", "'C'"),
        ("FOR R[1]=1 TO 10", "'FOR'"),
        ("PAYLOAD[1]", "'PAYLOAD'"),
        ("IF (R[1]=1) THEN", "IF .. THEN"),
        ("IF R[1]=1 AND R[2]=2,JMP LBL[1]", "in parentheses"),
        ("IF R[1],JMP LBL[1]", "comparison"),
        ("IF (R[1]=1),RUN OTHER", "'RUN'"),
        ("IF (R[1]=1),PR[1]=LPOS", "cannot take a position"),
        ("R[1]=R[2]+R[3]+R[4]", r"'\+'"),
        ("R[1]=-5", "'-'"),
        ("R[R[1]]=5", r"\[R\[1\]\]=5"),
        ("DI[1]=ON", "nothing that can be assigned"),
        ("DO[1]=PULSE,0.5sec", "'PULSE'"),
        ("PR[1,7]=5", "no element"),
        ("PR[1]=JPOS", "'LPOS'"),
        ("WAIT 1.0", "'\\('"),
        ("WAIT DI[1]=ON+", "'\\+'"),
        ("JMP LBL[7]", "no LBL\\[7\\]"),
        ("CALL NOBODY", "no program NOBODY"),
        ("RUN NOBODY", "no program NOBODY"),
        ("CALL TOO_LONG_A_NAME", "longer than 8"),
        ("L P[1] 100mm/sec FINE", "'PR'"),
        ("L PR[1] 100mm/sec CNT50", "'FINE'"),
        ("L PR[1] 100% FINE", "'mm'"),
        ("J PR[1] 100mm/sec FINE", "'%'"),
        ("L PR[1] 100mm/sec FINE Offset,PR[3]", "'Offset'"),
        ("R[1:a comment that is too long]=5", "longer than 16"),
        ("!" + "x" * 33, "longer than 32"),
        ("MESSAGE[" + "x" * 25 + "]", "1 to 24"),
        ("SELECT R[1]=1", "','"),
        ("R[1]=5 @", "'@'"),
        ("UALM[1] UALM[2]", "'UALM'"),
    ],
)
def test_a_line_that_is_not_known(line: str, reason: str) -> None:
    with pytest.raises(TpError, match=reason) as error:
        load({"MAIN.LS": program("MAIN", "R[1]=1", line)})
    assert str(error.value).startswith("MAIN.LS, line 11: ")
    assert (error.value.file, error.value.line) == ("MAIN.LS", 11)


GOOD = program("MAIN", "LBL[1]", "R[1]=1", "JMP LBL[1]")


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("/PROG  MAIN", "/PROG  OTHER", "not /PROG  MAIN"),
        ("LINE_COUNT\t= 3", "LINE_COUNT\t= 4", "LINE_COUNT is 4, there are 3"),
        ("   2:", "   3:", "numbered 3, not 2"),
        ("R[1]=1 ;", "R[1]=1", "NUMBER:TEXT ;"),
        ("R[1]=1", "LBL[1]", "there twice"),
        ("   2:  R[1]=1", "   2:L PR[1] 9mm/sec FINE", None),
        ("   2:  R[1]=1", "   2:  L PR[1] 9mm/sec FINE", "directly after the colon"),
        ("/POS\n", "", "no section /POS"),
        ("/POS\n", "/POS\nP[1]{\n", "taught positions"),
        ('"test"', '"a title that is long"', "COMMENT is longer"),
        ("DEFAULT_GROUP", "DEFAULT", "no attribute DEFAULT_GROUP"),
    ],
)
def test_a_file_that_is_not_right(old: str, new: str, reason: str | None) -> None:
    assert old in GOOD
    text = GOOD.replace(old, new, 1)
    if reason is None:
        parse("MAIN.LS", text)
    else:
        with pytest.raises(TpError, match=reason):
            parse("MAIN.LS", text)


@pytest.mark.parametrize("line", ["L PR[1] 9mm/sec FINE", "PR[1]=LPOS", "PR[1,2]=5"])
def test_a_program_without_the_motion_group_cannot_move(line: str) -> None:
    with pytest.raises(TpError, match="does not own motion group 1"):
        parse("MAIN.LS", program("MAIN", line, group="*"))
