"""A program: its declarations, its routines, and its main part as a task."""

from __future__ import annotations

from importlib.resources import files
from typing import TYPE_CHECKING, Final

from drivers.sim.karel.errors import KarelAbort, KarelError
from drivers.sim.karel.expressions import constant
from drivers.sim.karel.lexer import tokens
from drivers.sim.karel.scope import Expression, Reader, Routine, Scope, Statement
from drivers.sim.karel.statements import block
from drivers.sim.karel.values import INTEGER, NAMED, STRING_CHARS, Cell, Type

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Mapping

    from drivers.sim.karel.built_in import Host
    from drivers.sim.karel.scope import Frame, Signal

_SECTIONS: Final = ("CONST", "VAR", "ROUTINE", "BEGIN")
_FILE_CHARS: Final = 8
_MS: Final = 1000.0


def shipped_sources() -> dict[str, str]:
    """Return the robot's KAREL sources as they are shipped, by name."""
    folder = files("drivers").joinpath("fanuc", "controller", "karel")
    return {file.name: file.read_text(encoding="ascii") for file in folder.iterdir() if file.name.endswith(".kl")}


class KarelTask:
    """A program that runs.

    Args:
        sources: files by name.
        file: the one that has the PROGRAM.
        host: the controller.

    Raises:
        KarelError: the first thing that is wrong with it.

    Attributes:
        aborted: why it has come to an end, or None.
    """

    def __init__(self, sources: Mapping[str, str], file: str, host: Host) -> None:
        self.aborted: str | None = None
        self._scope = Scope(host)
        self._main = _Program(sources, file, self._scope).read()
        self._going: Generator[float, None, Signal] | None = None
        self._wake_s = self._timed_s = 0.0

    def start(self, now_s: float) -> None:
        """Begin at the first line; variables keep their values, as those of a controller do."""
        if self._main.wait is None:
            raise KarelAbort("the main program never waits: nothing else would run")
        self.aborted, self._wake_s, self._timed_s = None, now_s, now_s
        self._scope.timers.clear()
        self._going = self._main.wait([])

    def stop(self) -> None:
        """End it, as a power failure does."""
        self._going = None

    def resume(self, now_s: float, *, early: bool = False) -> None:
        """Let it run up to its next wait, if it does not wait any more, or ``early``: a real one looks often enough."""
        if self._going is None or (now_s < self._wake_s and not early):
            return
        for timer in self._scope.timers:
            timer.value += round((now_s - self._timed_s) * _MS)
        self._timed_s = now_s
        try:
            self._wake_s = now_s + next(self._going)
        except StopIteration:
            self._end("the program has ended")
        except KarelAbort as abort:
            self._end(str(abort))

    def _end(self, reason: str) -> None:
        self.aborted, self._going = reason, None


class _Program:
    """Reads one program."""

    def __init__(self, sources: Mapping[str, str], file: str, scope: Scope) -> None:
        self._file, self._scope = file, scope
        self._reader = Reader(tokens(sources, file))

    def read(self) -> Statement:
        """Return the main part."""
        reader, stem = self._reader, self._file.removesuffix(".kl")
        if len(stem) > _FILE_CHARS:
            raise KarelError(self._file, 1, f"old controllers take file names of {_FILE_CHARS} characters")
        reader.skip_ends()
        reader.expect("PROGRAM")
        if reader.name() != stem.upper():
            raise reader.error("program and file do not have the same name")
        reader.end_of_statement()
        while not reader.accepts("BEGIN"):
            if not reader.sees(*_SECTIONS):
                raise reader.error(f"a declaration cannot begin with {reader.now.text!r}")
            {"CONST": self._constants, "VAR": self._variables, "ROUTINE": self._routine}[reader.next().text]()
        main = block(reader, self._scope, "END")
        reader.expect("END")
        reader.expect(stem.upper())
        return main

    def _constants(self) -> None:
        reader = self._reader
        reader.skip_ends()
        while not reader.sees(*_SECTIONS):
            name = self._new_name()
            reader.expect("=")
            sign = -1 if reader.accepts("-") else 1
            token = reader.next()
            if token.kind == "integer":
                self._scope.constants[name] = Expression(INTEGER, _signed(sign, int(token.text)))
            elif token.kind in {"string", "real"} and sign == 1:
                self._scope.constants[name] = constant(token.kind, token.text)
            else:
                raise reader.error("a constant is a number or a string")
            reader.end_of_statement()

    def _variables(self) -> None:
        reader = self._reader
        reader.skip_ends()
        while not reader.sees(*_SECTIONS):
            for name, type_ in self._declaration():
                self._scope.variables[name] = Cell(type_)
            reader.end_of_statement()

    def _declaration(self) -> list[tuple[str, Type]]:
        """Read ``NAME, NAME : TYPE``."""
        names = [self._new_name()]
        while self._reader.accepts(","):
            names.append(self._new_name())
        self._reader.expect(":")
        type_ = self._type()
        return [(name, type_) for name in names]

    def _type(self, *, parameter: bool = False) -> Type:
        reader = self._reader
        token = reader.next()
        if token.text == "ARRAY":
            reader.expect("[")
            length = int(reader.of_kind("integer").text)
            reader.expect("]")
            reader.expect("OF")
            return Type("ARRAY", length, self._type())
        if token.kind != "word" or token.text not in NAMED:
            raise reader.error(f"the type {token.text!r} is not known to the interpreter")
        if token.text != "STRING" or parameter:
            return NAMED[token.text]
        reader.expect("[")
        length = int(reader.of_kind("integer").text)
        reader.expect("]")
        if not 1 <= length <= STRING_CHARS:
            raise reader.error(f"a string has 1 to {STRING_CHARS} characters")
        return Type("STRING", length)

    def _routine(self) -> None:
        """Read a routine; it is known from its heading on."""
        reader, scope = self._reader, self._scope
        name = self._new_name()
        parameters: list[tuple[str, Type]] = []
        scope.local_names = {}
        if reader.accepts("("):
            while not reader.accepts(")"):
                parameter = self._new_name()
                reader.expect(":")
                parameters.append((parameter, self._type(parameter=True)))
                reader.accepts(";")
        result = self._type(parameter=True) if reader.accepts(":") else None
        routine = Routine(name, [type_ for _, type_ in parameters], result, [type_ for _, type_ in parameters])
        scope.routines[name], scope.routine = routine, routine
        scope.local_names = {parameter: at for at, (parameter, _) in enumerate(parameters)}
        reader.end_of_statement()
        if reader.accepts("VAR"):
            reader.skip_ends()
            while not reader.sees("BEGIN"):
                for local, type_ in self._declaration():
                    scope.local_names[local] = len(routine.locals)
                    routine.locals.append(type_)
                reader.end_of_statement()
        reader.expect("BEGIN")
        routine.body = block(reader, scope, "END")
        reader.expect("END")
        reader.expect(name)
        reader.end_of_statement()
        scope.routine, scope.local_names = None, {}

    def _new_name(self) -> str:
        name, scope = self._reader.name(), self._scope
        local = scope.routine is not None and name in scope.local_names
        taken = scope.routine is None and (name in scope.variables or name in scope.constants or name in scope.routines)
        if local or taken:
            raise self._reader.error(f"{name} is declared twice")
        return name


def _signed(sign: int, value: int) -> Callable[[Frame], int]:
    return lambda _: sign * value
