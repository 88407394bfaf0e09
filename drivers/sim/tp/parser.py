"""Reads .LS files and refuses, with file, line and reason, what a controller or this interpreter would not take."""

from __future__ import annotations

import re
from functools import lru_cache
from importlib.resources import files
from typing import TYPE_CHECKING, Final

from drivers.sim.tp.errors import TpError
from drivers.sim.tp.statements import statement
from drivers.sim.tp.syntax import Assign, Call, Element, If, Jump, Label, Move, Program, Run, Select, TakePosition, Wait

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from drivers.sim.tp.syntax import Statement

_LINE: Final = re.compile(r"\s*(\d+):(.*);\s*$")
_CONTINUES: Final = re.compile(r"\s*(=|ELSE)")
_ATTRIBUTE: Final = re.compile(r"^\s*(?:TCD:)?\s*([A-Z_]+)\s*=\s*([^;,]*)")
_TITLE_CHARS: Final = 16
_LINE_CHARS: Final = 255
_SHOWN: Final = 20
_NEEDED: Final = ("COMMENT", "LINE_COUNT", "ABORT_REQUEST", "PAUSE_REQUEST", "DEFAULT_GROUP")


def shipped_sources() -> dict[str, str]:
    """Return the robot's files as they are shipped, by name."""
    folder = files("drivers").joinpath("fanuc", "controller")
    return {
        file.name: file.read_text(encoding="ascii") for file in folder.iterdir() if file.name.endswith((".LS", ".CF"))
    }


def load(sources: Mapping[str, str]) -> dict[str, Program]:
    """Return the programs of all .LS files, by name.

    Raises:
        TpError: the first thing that is wrong.
    """
    programs = {name.removesuffix(".LS"): parse(name, text) for name, text in sources.items() if name.endswith(".LS")}
    for program in programs.values():
        for line, found in program.statements:
            for called in _called(found):
                if called not in programs:
                    raise TpError(program.file, line, f"there is no program {called}")
    return programs


@lru_cache(maxsize=16)
def parse(file: str, text: str) -> Program:
    """Return the program of one file; remembered, because every double reads the same files.

    Raises:
        TpError: the first thing that is wrong.
    """
    head, main = _sections(file, text)
    name = file.removesuffix(".LS")
    if text.split("\n", 1)[0].split() != ["/PROG", name]:
        raise TpError(file, 1, f"the first line is not /PROG  {name}")
    attributes = _attributes(file, head)
    statements = tuple(_statements(file, main))
    count = attributes["LINE_COUNT"]
    if count != str(len(main)):
        raise TpError(file, 1, f"LINE_COUNT is {count[:_SHOWN]}, there are {len(main)} lines")
    owns_arm = attributes["DEFAULT_GROUP"] == "1"
    labels = _labels(file, statements)
    for line, found in statements:
        for label in _targets(found):
            if label not in labels:
                raise TpError(file, line, f"there is no LBL[{label}]")
        if _needs_arm(found) and not owns_arm:
            raise TpError(file, line, "the program does not own motion group 1 (DEFAULT_GROUP)")
    return Program(
        name,
        file,
        statements,
        labels,
        owns_arm,
        ignores_pause=attributes["PAUSE_REQUEST"] != "0",
        ignores_abort=attributes["ABORT_REQUEST"] != "0",
    )


def _sections(file: str, text: str) -> tuple[list[tuple[int, str]], list[tuple[int, str]]]:
    """Return the lines of /ATTR and of /MN, each with its number in the file."""
    sections: dict[str, list[tuple[int, str]]] = {}
    current: list[tuple[int, str]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if line.startswith("/"):
            current = sections.setdefault(line.split()[0], [])
        elif line.strip():
            current.append((number, line))
    for needed in ("/PROG", "/ATTR", "/MN", "/POS", "/END"):
        if needed not in sections:
            raise TpError(file, 1, f"there is no section {needed}")
    if sections["/POS"]:
        raise TpError(file, sections["/POS"][0][0], "taught positions are not known to the interpreter")
    return sections["/ATTR"], sections["/MN"]


def _attributes(file: str, head: list[tuple[int, str]]) -> dict[str, str]:
    found = {match[1]: match[2].strip() for _, line in head if (match := _ATTRIBUTE.match(line))}
    for needed in _NEEDED:
        if needed not in found:
            raise TpError(file, head[0][0] if head else 1, f"there is no attribute {needed}")
    if len(found["COMMENT"].strip('"')) > _TITLE_CHARS:
        raise TpError(file, head[0][0], f"COMMENT is longer than {_TITLE_CHARS} characters")
    return found


def _statements(file: str, main: list[tuple[int, str]]) -> Iterator[tuple[int, Statement]]:
    """Yield the statements; further lines of a SELECT are joined to its first."""
    begun: tuple[int, str] | None = None
    for expected, (number, line) in enumerate(main, start=1):
        match = _LINE.match(line)
        if match is None:
            raise TpError(file, number, "a line is NUMBER:TEXT ;")
        if len(line) > _LINE_CHARS:
            raise TpError(file, number, f"the line is longer than {_LINE_CHARS} characters")
        if match[1] != str(expected):
            raise TpError(file, number, f"the line is numbered {match[1][:_SHOWN]}, not {expected}")
        if _CONTINUES.match(match[2]) and begun is not None:
            begun = (begun[0], begun[1] + " " + match[2].strip())
            continue
        if begun is not None:
            yield _read(file, *begun)
        begun = (number, match[2])
    if begun is not None:
        yield _read(file, *begun)


def _read(file: str, number: int, text: str) -> tuple[int, Statement]:
    if (text[:2] in {"L ", "J "}) != (text.strip()[:2] in {"L ", "J "}):
        raise TpError(file, number, "the letter of a motion stands directly after the colon")
    try:
        return number, statement(text)
    except ValueError as error:
        raise TpError(file, number, str(error)) from error
    except RecursionError as error:
        raise TpError(file, number, "the expression is nested too deeply") from error


def _labels(file: str, statements: tuple[tuple[int, Statement], ...]) -> dict[int, int]:
    labels: dict[int, int] = {}
    for index, (line, found) in enumerate(statements):
        if isinstance(found, Label):
            if found.number in labels:
                raise TpError(file, line, f"LBL[{found.number}] is there twice")
            labels[found.number] = index
    return labels


def _branches(found: Statement) -> Sequence[Statement]:
    if isinstance(found, If):
        return [found.action]
    if isinstance(found, Select):
        return [action for _, action in found.cases] + ([found.otherwise] if found.otherwise else [])
    return [found]


def _targets(found: Statement) -> list[int]:
    if isinstance(found, Wait):
        return [] if found.timeout_label is None else [found.timeout_label]
    if isinstance(found, Move):
        return [] if found.skip_label is None else [found.skip_label]
    return [branch.label for branch in _branches(found) if isinstance(branch, Jump)]


def _called(found: Statement) -> list[str]:
    return [branch.program for branch in _branches(found) if isinstance(branch, Call | Run)]


def _needs_arm(found: Statement) -> bool:
    assigned = isinstance(found, Assign) and isinstance(found.target, Element)
    return assigned or isinstance(found, Move | TakePosition)
