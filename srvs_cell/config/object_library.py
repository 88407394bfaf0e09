"""The library of object kinds: a YAML file of its own, as strict as the cell's; see docs/reference/object-kinds.md."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.config.embedded import embedded_config
from srvs_cell.config.validation import validate
from srvs_cell.config.yaml_text import read_yaml
from srvs_cell.vision.recognition import ObjectKind

if TYPE_CHECKING:
    from pathlib import Path

    from srvs_cell.vision.recognition import RecognitionParameters

BUILT_IN_LIBRARY = "objects/built-in.yaml"
_MAX_BYTES = 65536
_MAX_DEPTH = 12
_MAX_KINDS = 64


class _File(BaseModel):
    """The whole file."""

    model_config = ConfigDict(extra="forbid")

    schema_version: Literal[1]
    built_in: Annotated[bool, Field(description="whether the built-in kinds are tried where none of these fits")] = True
    kinds: Annotated[tuple[ObjectKind, ...], Field(max_length=_MAX_KINDS, description="the first that fits wins")]


@dataclass(frozen=True)
class ObjectLibrary:
    """The kinds of objects that a cell knows.

    Attributes:
        source: the file, for messages.
        kinds: in the order in which they are tried.
    """

    source: str
    kinds: tuple[ObjectKind, ...]

    def check(self, limits: RecognitionParameters) -> None:
        """Refuse a kind that is never seen because the recognition's limits exclude it.

        Raises:
            AlarmError: CONFIG_INVALID naming file, key, value and limit.
        """
        sizes = ("min_size_mm", limits.min_size_mm), ("max_size_mm", limits.max_size_mm)
        heights = ("min_height_mm", limits.min_height_mm), ("max_height_mm", limits.max_height_mm)
        for kind in self.kinds:
            for name, face in kind.faces.items():
                low_deg, high_deg = limits.min_inclination_deg, limits.max_inclination_deg
                least, greatest = face.inclination_deg
                if least > high_deg or 0.0 < least <= greatest < low_deg:
                    raise AlarmError(
                        Alarm.CONFIG_INVALID,
                        f"{self.source}: kind {kind.name}, faces.{name}.inclination_deg = [{least:g}, {greatest:g}]: "
                        f"a face is level (0) or inclined by {low_deg:g} to {high_deg:g} deg "
                        "(vision.recognition.min_inclination_deg, max_inclination_deg); none is in this range.",
                    )
                for key, bounds in (("length_mm", sizes), ("width_mm", sizes), ("height_mm", heights)):
                    (low_name, low), (high_name, high) = bounds
                    least, greatest = getattr(face, key)
                    if greatest < low or least > high:
                        limit = f"{low_name} = {low:g}" if greatest < low else f"{high_name} = {high:g}"
                        raise AlarmError(
                            Alarm.CONFIG_INVALID,
                            f"{self.source}: kind {kind.name}, faces.{name}.{key} = [{least:g}, {greatest:g}]: "
                            f"vision.recognition.{limit} mm excludes all of it.",
                        )


def built_in_library() -> ObjectLibrary:
    """Return the library that is shipped."""
    return parse_library(embedded_config(BUILT_IN_LIBRARY), BUILT_IN_LIBRARY)


def load_library(path: Path) -> ObjectLibrary:
    """Return the library of a file; raises `AlarmError` as `parse_library`, also where it cannot be read."""
    try:
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
        text = data.decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise AlarmError(Alarm.CONFIG_INVALID, f"{path}: {' '.join(str(error).split())}.") from error
    return parse_library(text, str(path))


def parse_library(text: str, source: str) -> ObjectLibrary:
    """Return the kinds that a YAML text says, and behind them the built-in ones unless it says ``built_in: false``.

    Args:
        text: the YAML.
        source: its name, for messages.

    Raises:
        AlarmError: CONFIG_INVALID naming file, key, value and bound.
    """
    if len(text) > _MAX_BYTES:
        raise AlarmError(Alarm.CONFIG_INVALID, f"{source}: longer than {_MAX_BYTES} bytes.")
    try:
        _check_structure(text)
        data = read_yaml(text)
    except yaml.YAMLError as error:
        raise AlarmError(Alarm.CONFIG_INVALID, f"{source}: not YAML: {' '.join(str(error).split())}.") from error
    if not isinstance(data, dict):
        raise AlarmError(Alarm.CONFIG_INVALID, f"{source}: a mapping of keys is expected, got {type(data).__name__}.")
    file = validate(_File, data, source)
    kinds = file.kinds + (built_in_library().kinds if file.built_in else ())
    if not kinds:
        raise AlarmError(Alarm.CONFIG_INVALID, f"{source}: kinds = []: without built-in kinds nothing is recognised.")
    places: dict[str, int] = {}
    for number, kind in enumerate(kinds):
        earlier = places.setdefault(kind.name, number)
        if earlier != number:
            told = (
                f"by kinds.{earlier} and kinds.{number}; give one of them another name"
                if number < len(file.kinds)
                else f"(a built-in kind has the name of kinds.{earlier}; choose another one, or built_in: false)"
            )
            raise AlarmError(Alarm.CONFIG_INVALID, f"{source}: kinds: the name {kind.name!r} is given twice {told}.")
    return ObjectLibrary(source, kinds)


def _check_structure(text: str) -> None:
    """Refuse what makes a small file a large one, before anything is built from it.

    Raises:
        yaml.YAMLError: the text is no YAML, has an alias, or is nested too deeply.
    """
    depth = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            raise yaml.YAMLError(f"an alias is not allowed{event.start_mark}")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _MAX_DEPTH:
            raise yaml.YAMLError(f"nested deeper than {_MAX_DEPTH}{event.start_mark}")
