"""What statements do, one by one."""

import re

import pytest

from tests.drivers.sim.tp.programs import Bench, program


@pytest.mark.parametrize(
    ("value", "result"),
    [
        ("7", 7),
        ("(-7)", -7),
        ("R[2]+1", 6),
        ("R[2]/2", 2.5),
        ("R[2] DIV 2", 2),
        ("R[2] MOD 2", 1),
        ("(1+2*R[2])", 11),
        ("((1+2)*R[2]-1)", 14),
        ("R[2]/10", pytest.approx(0.5)),
        ("$MNUFRAMENUM[1]", 4),
        ("R[99]", 0),
    ],
)
def test_arithmetic(value: str, result: float) -> None:
    b = Bench("R[2]=5", f"R[1]={value}")
    assert b.go() is None
    assert b.r(1) == result


def test_a_real_has_32_bits() -> None:
    b = Bench("R[1]=1/3")
    b.go()
    assert b.r(1) != 1 / 3
    assert b.r(1) == pytest.approx(1 / 3, abs=1e-7)


@pytest.mark.parametrize(
    ("line", "alarm"),
    [
        ("R[1]=2000000000*2", "INTP-323"),
        ("R[1]=1/0", "INTP-302"),
        ("R[1]=(DI[1])", "INTP-205"),
        ("DO[1]=5", "INTP-205"),
        ("R[1]=AR[1]", "INTP-288"),
        ("R[1]=$NOBODY", "INTP-311"),
        ("$MNUFRAMENUM[1]=5", "INTP-311"),
        ("PR[5,1]=5", "INTP-311"),
        ("L PR[5] 9mm/sec FINE", "INTP-311"),
        ("L PR[5] 9mm/sec FINE Skip,LBL[1]", "INTP-241"),
        ("CALL MAIN", "INTP-222"),
        ("RUN MAIN", "INTP-267"),
        ("UALM[3]", "INTP-213 UALM\\[3\\]"),
        ("IF (R[1]),JMP LBL[1]", "INTP-205"),
    ],
)
def test_an_alarm_pauses_the_program_on_its_line(line: str, alarm: str) -> None:
    b = Bench(line, "LBL[1]", "R[7]=1")
    said = b.go(1.0)
    assert said is not None
    assert re.match(alarm, said)
    assert said.endswith("(MAIN.LS, line 10)")
    assert b.machine.paused
    assert b.runs
    b.go()
    assert b.r(7) == 0


@pytest.mark.parametrize(
    ("condition", "holds"),
    [
        ("R[1]=3", True),
        ("R[1]<>3", False),
        ("(R[1]>=3 AND !DI[1])", True),
        ("(R[1]<3 OR DI[1])", False),
        ("(R[1]<3 OR R[1]>2 AND DI[1])", False),
        ("DI[1]=OFF", True),
        ("(F[1]=ON)", False),
        ("R[1]<=(-3)", False),
    ],
)
def test_conditions(condition: str, holds: bool) -> None:
    b = Bench("R[1]=3", f"IF {condition},R[2]=(1)")
    assert b.go() is None
    assert b.r(2) == holds


@pytest.mark.parametrize(("value", "result"), [(1, 10), (2, 20), (3, 30)])
def test_select_takes_the_first_match(value: int, result: int) -> None:
    lines = ["SELECT R[1]=1,JMP LBL[1]", "       =2,CALL TWO", "       =2,JMP LBL[1]", "       ELSE,JMP LBL[3]"]
    rest = ["END", "LBL[1]", "R[2]=10", "END", "LBL[3]", "R[2]=30"]
    b = Bench(f"R[1]={value}", *lines, *rest, others={"TWO.LS": program("TWO", "R[2]=20")})
    assert b.go() is None
    assert b.r(2) == result
    assert not b.runs


def test_arguments_and_nested_calls() -> None:
    others = {
        "A.LS": program("A", "CALL B(AR[2],AR[1])", "R[3]=1"),
        "B.LS": program("B", "R[1]=AR[1]", "R[2]=AR[2]", "END", "R[1]=0"),
    }
    b = Bench("R[9]=8", "CALL A(7,R[9])", others=others)
    assert b.go() is None
    assert (b.r(1), b.r(2), b.r(3)) == (8, 7, 1)


def test_waiting_for_time_and_for_a_condition() -> None:
    b = Bench("WAIT    .50(sec)", "R[1]=1", "WAIT DI[1]=ON", "R[1]=2")
    b.go(0.4)
    assert b.r(1) == 0
    b.go(0.2)
    assert b.r(1) == 1
    b.go(100.0)
    assert b.r(1) == 1
    b.devices.signals["DI", 1] = True
    b.go()
    assert b.r(1) == 2


@pytest.mark.parametrize(("comes_s", "result"), [(1.0, 1), (3.0, 2)])
def test_waiting_with_a_time_out(comes_s: float, result: int) -> None:
    b = Bench("$WAITTMOUT=200", "WAIT (DI[1]) TIMEOUT,LBL[1]", "R[1]=1", "END", "LBL[1]", "R[1]=2")
    b.go(comes_s)
    b.devices.signals["DI", 1] = True
    b.go()
    assert b.r(1) == result


def test_outputs_flags_frames_and_messages() -> None:
    b = Bench(
        "DO[1]=ON", "RO[2]=(!DI[1])", "F[3]=(ON)", "UFRAME_NUM=2", "UTOOL_NUM=3", "MESSAGE[Hello; world]", "//DO[1]=OFF"
    )
    assert b.go() is None
    assert b.devices.signals == {("DO", 1): True, ("RO", 2): True, ("F", 3): True}
    assert b.devices.frames == [("UFRAME_NUM", 2), ("UTOOL_NUM", 3)]
    assert b.machine.messages == ["Hello; world"]


def test_a_move_takes_a_position_and_goes_on_when_it_has_ended() -> None:
    b = Bench("PR[1]=LPOS", "PR[1,3]=R[5]/2", "R[6]=2.5", "L PR[1] R[6]mm/sec FINE", "J PR[1] 20% FINE", "R[1]=1")
    b.go(0.05)
    assert b.devices.moves == []
    b.go(0.2)
    assert b.devices.moves == [((1.0, 2.0, 0, 4.0, 5.0, 6.0), 2.5, False)]
    b.devices.moving = False
    b.go(0.2)
    assert b.devices.moves[1:] == [((1.0, 2.0, 0, 4.0, 5.0, 6.0), 20.0, True)]
    assert b.r(1) == 0
    b.devices.moving = False
    b.go()
    assert b.r(1) == 1


SKIPPING = (
    "PR[1]=LPOS",
    "SKIP CONDITION DO[3]=ON",
    "L PR[1] 9mm/sec FINE Skip,LBL[1]",
    "R[1]=1",
    "END",
    "LBL[1]",
    "R[1]=2",
)


@pytest.mark.parametrize(("skip_at_s", "moves", "result"), [(0.0, 0, 1), (0.05, 0, 1), (0.3, 1, 1), (None, 1, 2)])
def test_skip_goes_on_with_the_next_line_and_jumps_only_where_it_has_arrived(
    skip_at_s: float | None, moves: int, result: int
) -> None:
    b = Bench(*SKIPPING)
    if skip_at_s is not None:
        b.go(skip_at_s)
        b.devices.signals["DO", 3] = True
        b.go()
        assert not b.devices.moving
    else:
        b.go(0.3)
        assert b.r(1) == 0
        b.devices.moving = False
    b.go(0.3)
    assert (len(b.devices.moves), b.r(1)) == (moves, result)


def test_a_skip_condition_is_its_programs_own() -> None:
    others = {"SUB.LS": program("SUB", "L PR[1] 9mm/sec FINE Skip,LBL[1]", "LBL[1]")}
    said = Bench("PR[1]=LPOS", "SKIP CONDITION DO[3]=ON", "CALL SUB", others=others).go(1.0)
    assert said is not None
    assert "INTP-241" in said


def test_a_motion_that_is_refused_or_ends_short_is_an_alarm() -> None:
    b = Bench("PR[1]=LPOS", "L PR[1] 9mm/sec FINE")
    b.devices.refusal = "MOTN-018 Position not reachable"
    said = b.go(0.5)
    assert said is not None
    assert said.startswith("MOTN-018")
    b = Bench("PR[1]=LPOS", "L PR[1] 9mm/sec FINE")
    b.go(0.5)
    b.devices.moving, b.devices.stopped_short = False, True
    said = b.go(0.5)
    assert said is not None
    assert said.startswith("SYST-999")


def test_tasks_run_beside_each_other_and_only_those_that_ignore_it_go_on_in_a_pause() -> None:
    loop = ("LBL[1]", "R[{n}]=R[{n}]+1", "WAIT    .10(sec)", "JMP LBL[1]")
    others = {
        "HEEDS.LS": program("HEEDS", *(line.format(n=1) for line in loop)),
        "IGNORES.LS": program("IGNORES", *(line.format(n=2) for line in loop), ignore=7),
    }
    b = Bench("RUN HEEDS", "RUN IGNORES", "WAIT   1.00(sec)", "UALM[1]", others=others)
    b.go(0.95)
    assert 9 <= b.r(1) == b.r(2) <= 10
    assert b.go() is not None
    paused = b.r(1)
    b.go(1.0)
    assert b.r(1) == paused
    assert b.r(2) > paused + 8
    b.machine.abort()
    assert [b.machine.running(name) for name in ("MAIN", "HEEDS", "IGNORES")] == [False, False, True]
    b.machine.power_off()
    assert not b.machine.running("IGNORES")
    assert b.r(2) > 0
