"""Validation errors in an integrator's words: file, key path, value and bound."""

from __future__ import annotations

import difflib
import json
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from srvs_cell.alarms import Alarm, AlarmError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pydantic_core import ErrorDetails

T = TypeVar("T")

_UNKNOWN_KEY = frozenset({"extra_forbidden", "unexpected_keyword_argument"})
_MISSING = frozenset({"missing", "missing_argument", "missing_keyword_only_argument"})
_SHOWN_VALUE_LENGTH = 60


def validate(model: type[T], data: object, source: str, prefix: tuple[str, ...] = ()) -> T:
    """Return ``data`` as ``model``.

    Types are strict, as JSON has them: a number in quotes is not a number and a truth value is not one either.

    Args:
        model: a pydantic model or dataclass.
        data: what the YAML says.
        source: the file's name, for messages.
        prefix: keys that lead to this part of the file.

    Raises:
        AlarmError: CONFIG_INVALID naming every wrong key with its value and its bound.
    """
    adapter = TypeAdapter(model)
    try:
        return adapter.validate_json(json.dumps(data, default=str), strict=True)
    except ValidationError as error:
        schema = adapter.json_schema()
        lines = [_line(detail, schema, prefix) for detail in error.errors(include_url=False)]
    raise AlarmError(Alarm.CONFIG_INVALID, f"{source}: {'; '.join(lines)}.")


def _line(error: ErrorDetails, schema: Mapping[str, Any], prefix: tuple[str, ...]) -> str:
    location = error["loc"]
    key = ".".join(str(part) for part in (*prefix, *location)) or "(whole file)"
    if error["type"] in _UNKNOWN_KEY:
        return f"{key}: unknown key{_suggestion(str(location[-1]), _keys_at(schema, location[:-1]))}"
    if error["type"] in _MISSING:
        return f"{key}: missing"
    message = error["msg"].removeprefix("Value error, ").removeprefix("Input ")
    if error["type"] == "value_error":
        return f"{key}: {message}"
    return f"{key} = {_shown(error['input'])}: {message}"


def _shown(value: object) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= _SHOWN_VALUE_LENGTH else text[: _SHOWN_VALUE_LENGTH - 3] + "..."


def _suggestion(key: str, known: Sequence[str]) -> str:
    """Return the known key that was probably meant, or all of them."""
    with_unit = [name for name in known if name.startswith(f"{key}_")]
    close = with_unit or difflib.get_close_matches(key, known, n=1)
    if close:
        return f", did you mean {close[0]!r}?"
    return f" (known: {', '.join(known)})" if known else ""


def _keys_at(schema: Mapping[str, Any], location: Sequence[int | str]) -> list[str]:
    """Return the keys that the schema has at a location."""
    node: Mapping[str, Any] = _resolve(schema, schema)
    for part in location:
        if isinstance(part, int):
            node = _resolve(schema, node.get("items", {}))
        else:
            # keys of one's own choice have one schema for all their values
            own: Mapping[str, Any] = next(iter(node.get("patternProperties", {}).values()), {})
            node = _resolve(schema, node.get("properties", {}).get(part, own))
    return list(node.get("properties", {}))


def _resolve(schema: Mapping[str, Any], node: Mapping[str, Any]) -> Mapping[str, Any]:
    """Follow a ``$ref`` into ``$defs``, also where it is wrapped because the key has a default or may be null."""
    for wrapper in ("allOf", "anyOf"):
        for option in node.get(wrapper, ()):
            if "$ref" in option:
                node = option
    if "$ref" in node:
        return _resolve(schema, schema["$defs"][node["$ref"].rsplit("/", 1)[-1]])
    return node
