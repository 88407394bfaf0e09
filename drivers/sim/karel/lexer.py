"""Tokens of KAREL source, with included files in their places."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final

from drivers.sim.karel.errors import KarelError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_LINE_CHARS: Final = 252
_NAME_CHARS: Final = 12
_TOKEN: Final = re.compile(
    r"""(?P<string>'(?:[^']|'')*')
  | (?P<real>\d+\.\d+)
  | (?P<integer>\d+)
  | (?P<word>\$?[A-Za-z_][A-Za-z0-9_]*)
  | (?P<symbol><>|<=|>=|::|[-+*/=<>()\[\],;:.])""",
    re.VERBOSE,
)
_DIRECTIVES: Final = frozenset(
    {"COMMENT", "STACKSIZE", "NOLOCKGROUP", "NOBUSYLAMP", "NOPAUSE", "NOABORT", "ALPHABETIZE", "ENVIRONMENT"}
)


@dataclass(frozen=True)
class Token:
    """A piece of a program.

    Attributes:
        kind: ``word`` (upper case: KAREL does not tell cases apart), ``integer``, ``real``, ``string``, ``symbol``,
            ``newline`` or ``end``.
        text: the piece; a string without its quotes.
        file, line: where it stands.
    """

    kind: str
    text: str
    file: str
    line: int


def tokens(sources: Mapping[str, str], file: str) -> list[Token]:
    """Split a program and what it includes.

    Args:
        sources: files by name.
        file: the one to begin with.

    Raises:
        KarelError: a character, a directive, a name or a line that the translator would not take.
    """
    return list(_split(tuple(sources.items()), file))


@lru_cache(maxsize=8)
def _split(sources: tuple[tuple[str, str], ...], file: str) -> tuple[Token, ...]:
    """Split as above; remembered, because every double reads the same files."""
    texts = dict(sources)
    return (*_tokens(texts, file), Token("end", "the end of the file", file, texts[file].count("\n")))


def _tokens(sources: Mapping[str, str], file: str) -> Iterator[Token]:
    joined = False
    for number, full in enumerate(sources[file].splitlines(), start=1):
        if len(full) > _LINE_CHARS:
            raise KarelError(file, number, f"the line is longer than {_LINE_CHARS} characters")
        line = _without_comment(full)
        if line.startswith("%"):
            yield from _directive(sources, file, number, line)
            continue
        joined = line.endswith("&")
        yield from _pieces(line.removesuffix("&"), file, number)
        if not joined:
            yield Token("newline", "the end of the line", file, number)
    if joined:
        raise KarelError(file, number, "the last line is to be continued")


def _without_comment(line: str) -> str:
    """Cut a line at -- outside of a string."""
    parts = re.split(r"('(?:[^']|'')*'|--.*)", line)
    return "".join(part for part in parts if not part.startswith("--")).strip()


def _directive(sources: Mapping[str, str], file: str, number: int, line: str) -> Iterator[Token]:
    name, _, rest = line.removeprefix("%").partition(" ")
    if name.upper() == "INCLUDE":
        included = f"{rest.strip().lower()}.kl"
        if included not in sources:
            raise KarelError(file, number, f"there is no file {included}")
        yield from _tokens(sources, included)
    elif name.upper() not in _DIRECTIVES:
        raise KarelError(file, number, f"the directive %{name} is not known to the interpreter")


def _pieces(line: str, file: str, number: int) -> Iterator[Token]:
    at = 0
    while at < len(line):
        if line[at].isspace():
            at += 1
            continue
        match = _TOKEN.match(line, at)
        if match is None:
            raise KarelError(file, number, f"{line[at:]!r} is not understood")
        at = match.end()
        kind, text = str(match.lastgroup), match[0]
        if kind == "string":
            text = text[1:-1].replace("''", "'")
        elif kind == "word":
            text = text.upper()
            if len(text) > _NAME_CHARS and not text.startswith("$"):
                raise KarelError(file, number, f"the name {text} is longer than {_NAME_CHARS} characters")
        yield Token(kind, text, file, number)
