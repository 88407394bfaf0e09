"""What a name means, and the tokens still to be read: what reading expressions and statements share."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from drivers.sim.karel.errors import KarelError
from drivers.sim.karel.values import Cell

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence

    from drivers.sim.karel.built_in import Host
    from drivers.sim.karel.lexer import Token
    from drivers.sim.karel.values import Type

Frame = list[Cell]
"""Parameters and variables of a routine under way."""

Signal = tuple[Any] | None
"""What a statement ends in: what RETURN returns, or None to go on."""

_RESERVED: Final = """
    ABORT ABOUT ABS AFTER ALONG AND ARRAY ARRAY_LEN AT ATTACH AWAY AXIS BEFORE BEGIN BOOLEAN BY BYNAME BYTE CANCEL
    CASE CLOSE CMOS COMMAND CONDITION CONFIG CONNECT CONST CONTINUE COORDINATED CR DELAY DISABLE DISCONNECT DIV DO
    DOWNTO DRAM ELSE ENABLE END ENDCONDITION ENDFOR ENDIF ENDMOVE ENDSELECT ENDSTRUCTURE ENDUSING ENDWHILE ERROR EVAL
    EVENT FILE FOR FROM GET_VAR GO GOTO GROUP HAND HOLD IF IN INDEPENDENT INTEGER JOINTPOS MOD MODEL MOVE NEAR NOABORT
    NODE NODEDATA NOMESSAGE NOPAUSE NOT NOWAIT OF OPEN OR PATH PATHHEADER PAUSE POSITION POWERUP PROGRAM PULSE PURGE
    READ REAL RELATIVE RELAX RELEASE REPEAT RESTORE RESUME RETURN ROUTINE SELECT SEMAPHORE SET_VAR SHORT SIGNAL STOP
    STRING STRUCTURE THEN TIME TIMER TO TPENABLE TYPE UNHOLD UNINIT UNPAUSE UNTIL USING VAR VECTOR VIA WAIT WHEN WHILE
    WITH WRITE XYZWPR XYZWPREXT TRUE FALSE
"""
RESERVED: Final = frozenset(_RESERVED.split())
"""Words that are no names."""


@dataclass(frozen=True)
class Expression:
    """A value that can be computed, and the variable that it stands in, if it does."""

    type: Type
    value: Callable[[Frame], Any]
    cell: Callable[[Frame], Cell] | None = None


@dataclass(frozen=True)
class Statement:
    """A statement.

    Attributes:
        line: where it stands, for people.
        run: carries it out; not to be used where it waits.
        wait: carries it out where it waits: yields seconds; None where it never does.
    """

    line: str
    run: Callable[[Frame], Signal]
    wait: Callable[[Frame], Generator[float, None, Signal]] | None = None


@dataclass
class Routine:
    """A routine; its body is known after its heading.

    Attributes:
        parameters: types.
        result: what a function returns, None of a procedure.
        locals: types of all variables, parameters first.
        body: its statements.
    """

    name: str
    parameters: Sequence[Type]
    result: Type | None
    locals: list[Type] = field(default_factory=list)
    body: Statement | None = None

    def frame(self, arguments: Sequence[Cell]) -> Frame:
        """Return variables for a call."""
        return [*arguments, *(Cell(type_) for type_ in self.locals[len(arguments) :])]


@dataclass
class Scope:
    """The names that are known.

    Attributes:
        host: the controller.
        timers: variables that count milliseconds.
    """

    host: Host
    constants: dict[str, Expression] = field(default_factory=dict)
    variables: dict[str, Cell] = field(default_factory=dict)
    routines: dict[str, Routine] = field(default_factory=dict)
    local_names: dict[str, int] = field(default_factory=dict)
    routine: Routine | None = None
    timers: list[Cell] = field(default_factory=list)


class Reader:
    """The tokens of a program, one after the other.

    Attributes:
        now: the token that comes.
    """

    def __init__(self, tokens: list[Token]) -> None:
        self.now = tokens[0]
        self._after = iter(tokens[1:])

    def next(self) -> Token:
        """Take the token that comes; the last one stays."""
        token = self.now
        self.now = next(self._after, token)
        return token

    def sees(self, *texts: str) -> bool:
        """Whether one of these words or symbols comes."""
        return self.now.text in texts and self.now.kind in {"word", "symbol"}

    def accepts(self, *texts: str) -> bool:
        """Take one of these words or symbols if it comes."""
        found = self.sees(*texts)
        if found:
            self.next()
        return found

    def expect(self, text: str) -> None:
        """Take this word or symbol; anything else is refused."""
        if not self.accepts(text):
            raise self.error(f"{text} is expected, not {self.now.text!r}")

    def name(self) -> str:
        """Take a name that a program may give."""
        token = self.next()
        if token.kind != "word" or token.text in RESERVED or token.text.startswith("$"):
            raise KarelError(token.file, token.line, f"{token.text!r} cannot be a name")
        return token.text

    def of_kind(self, kind: str) -> Token:
        """Take a token of a kind; another one is refused."""
        token = self.next()
        if token.kind != kind:
            raise KarelError(token.file, token.line, f"{kind} is expected, not {token.text!r}")
        return token

    def end_of_statement(self) -> None:
        """Take what separates statements; ENDIF and its like may follow at once."""
        if self.now.kind != "newline" and not self.sees(";"):
            raise self.error(f"the end of the statement is expected, not {self.now.text!r}")
        self.skip_ends()

    def skip_ends(self) -> None:
        """Take all separators that come."""
        while self.now.kind == "newline" or self.sees(";"):
            self.next()

    def error(self, reason: str) -> KarelError:
        """Return a refusal of what comes."""
        return KarelError(self.now.file, self.now.line, reason)
