"""Commands that answer at once: typer converts arguments with pydantic, whose import takes longer than all the rest."""

from functools import partial
from pathlib import Path
from typing import Any, get_args

from typer.core import TyperCommand, TyperGroup


class QuickCommand(TyperCommand):
    """A command that takes arguments of the right type as they are; typer converts, or refuses, all others."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse what was typed."""
        return super().parse_args(ctx, _quickened(self, ctx, args))


class QuickGroup(TyperGroup):
    """A group of commands that converts its own options as `QuickCommand` does."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse what was typed."""
        return super().parse_args(ctx, _quickened(self, ctx, args))


def _quickened(command: TyperCommand | TyperGroup, ctx: Any, args: list[str]) -> list[str]:
    """Let every parameter of a command take the short way where there is one; return ``args``."""
    for parameter in command.get_params(ctx):
        annotation = getattr(getattr(parameter, "type_descriptor", None), "annotation", None)
        process = partial(_process, annotation, parameter.required, parameter.process_value)
        parameter.process_value = process  # type: ignore[method-assign]
    return args


def _process(annotation: Any, required: bool, convert: Any, context: Any, value: Any) -> Any:
    """Return a parameter's value: as it was typed where that is enough, else as typer's ``convert`` has it."""
    if annotation is Path and isinstance(value, str):
        return Path(value)
    if annotation is not bool and isinstance(annotation, type) and isinstance(value, annotation):
        return value
    if (value is None and not required) or value in get_args(annotation):
        return value
    return convert(context, value)
