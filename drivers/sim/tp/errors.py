"""What can be wrong with a program: it is refused before it runs, or it stops with an alarm while it runs."""

from __future__ import annotations


class TpError(ValueError):
    """A program is refused: the text says file, line and reason.

    Attributes:
        file: name of the .LS file.
        line: line of the file, counted from 1.
    """

    def __init__(self, file: str, line: int, reason: str) -> None:
        super().__init__(f"{file}, line {line}: {reason}")
        self.file, self.line = file, line


class TpAlarm(Exception):  # noqa: N818 - the controller's word for it
    """A line cannot be executed: the controller raises an alarm and pauses the program there."""
