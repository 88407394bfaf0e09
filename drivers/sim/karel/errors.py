"""What can be wrong with a program: it is refused before it runs, or it is aborted while it runs."""

from __future__ import annotations


class KarelError(ValueError):
    """A program is refused: the text says file, line and reason.

    Attributes:
        file: name of the .kl file.
        line: line of the file, counted from 1.
    """

    def __init__(self, file: str, line: int, reason: str) -> None:
        super().__init__(f"{file}, line {line}: {reason}")
        self.file, self.line = file, line


class KarelAbort(Exception):  # noqa: N818 - the controller's word for it
    """A statement cannot be executed: the controller aborts the program there.

    Attributes:
        line: where, once it is known.
    """

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason, self.line = reason, ""

    def __str__(self) -> str:
        return f"{self.reason} ({self.line})"
