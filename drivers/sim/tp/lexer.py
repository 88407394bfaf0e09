"""Tokens of one TP statement. Comments in brackets (``R[5:speed]``) are checked for their length and left out."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

_COMMENT_CHARS: Final = 16
_TOKEN: Final = re.compile(
    r"""\s*(?:
    \[\s*(?P<index>\d+)(?:,(?P<element>\d+))?(?::(?P<comment>[^\]]*))?\]
  | (?P<number>\d+\.\d*|\.\d+|\d+)
  | (?P<word>\$?[A-Za-z_][A-Za-z0-9_]*(?:\.\$[A-Za-z0-9_]+)*)
  | (?P<symbol><>|<=|>=|[-=<>()+*/!,%])
    )""",
    re.VERBOSE,
)


@dataclass(frozen=True)
class Token:
    """A piece of a statement.

    Attributes:
        kind: ``index`` (also with an element), ``number``, ``word``, ``symbol`` or ``end``.
        text: as written, without comment.
        numbers: index and element.
    """

    kind: str
    text: str
    numbers: tuple[int, ...] = ()


def tokens(statement: str) -> list[Token]:
    """Split a statement; the last token is of the kind ``end``.

    Raises:
        ValueError: a character or a comment that the controller would not take.
    """
    found: list[Token] = []
    at = 0
    statement = statement.rstrip()
    while at < len(statement):
        match = _TOKEN.match(statement, at)
        if match is None:
            raise ValueError(f"{statement[at:].strip()!r} is not understood")
        at = match.end()
        if match["index"] is not None:
            if len(match["comment"] or "") > _COMMENT_CHARS:
                raise ValueError(f"the comment {match['comment']!r} is longer than {_COMMENT_CHARS} characters")
            numbers = tuple(int(text) for text in (match["index"], match["element"]) if text is not None)
            found.append(Token("index", f"[{','.join(map(str, numbers))}]", numbers))
        else:
            kind = str(match.lastgroup)
            found.append(Token(kind, match[kind]))
    return [*found, Token("end", "the end of the line")]
