"""The file format planning-problem/1 (references/planning.md section 5): field types and bounds of the JSON.

Keys that are no part of the question (``optimal``, ``family``, ``seed``) are ignored. Ids are list positions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from srvs_cell.alarms import Alarm, AlarmError

if TYPE_CHECKING:
    from collections.abc import Mapping

SCHEMA = "planning-problem/1"

_LONGEST_INPUT_SHOWN = 60

_FARTHEST_MM = 1e6
"""One kilometre: no cell is larger, and sums of squares stay exact enough."""

Length = Annotated[float, Field(allow_inf_nan=False, ge=0.0, le=_FARTHEST_MM)]
Coordinate = Annotated[float, Field(allow_inf_nan=False, ge=-_FARTHEST_MM, le=_FARTHEST_MM)]
Half = Annotated[float, Field(allow_inf_nan=False, gt=0.0, le=_FARTHEST_MM)]
Index = Annotated[int, Field(ge=0)]


class _Wire(BaseModel):
    model_config = ConfigDict(strict=True, extra="ignore", frozen=True)


class WirePlace(_Wire):
    """A place."""

    id: Index
    x_mm: Coordinate
    y_mm: Coordinate
    kind: Literal["slot", "loose", "stock", "buffer", "bin"]
    reachable: bool


class WireDisc(_Wire):
    """An upright cylinder's footprint."""

    id: Index
    height_mm: Half
    start: Index
    shape: Literal["disc"]
    r_mm: Half


class WireRect(_Wire):
    """An axis-aligned oblong footprint, half sizes."""

    id: Index
    height_mm: Half
    start: Index
    shape: Literal["rect"]
    hx_mm: Half
    hy_mm: Half


class WireObstacleDisc(_Wire):
    """A round static obstacle."""

    shape: Literal["disc"]
    x_mm: Coordinate
    y_mm: Coordinate
    r_mm: Half


class WireObstacleRect(_Wire):
    """An oblong static obstacle."""

    shape: Literal["rect"]
    x_mm: Coordinate
    y_mm: Coordinate
    hx_mm: Half
    hy_mm: Half


class WireGripper(_Wire):
    """Two fingers beyond the object's bounding box along one of the axes."""

    axes: Annotated[list[Literal["x", "y"]], Field(min_length=1)]
    gap_mm: Length
    thick_mm: Length
    width_mm: Length


class WireRankGoal(_Wire):
    """Slots in the order of height, the first for the tallest."""

    type: Literal["rank"]
    slots: list[Index]
    tol_mm: Length
    semantics: Literal["pairwise"]


class WireAssignGoal(_Wire):
    """Allowed final places per object, and places that must not stay empty."""

    type: Literal["assign"]
    allowed: list[list[Index]]
    must_fill: list[Index]


class WireProblem(_Wire):
    """One planning problem."""

    id: Annotated[str, Field(min_length=1)]
    home_mm: Annotated[list[Coordinate], Field(min_length=2, max_length=2)]
    clearance_mm: Length
    places: list[WirePlace]
    objects: list[Annotated[WireDisc | WireRect, Field(discriminator="shape")]]
    gripper: WireGripper | None
    obstacles: list[Annotated[WireObstacleDisc | WireObstacleRect, Field(discriminator="shape")]]
    goal: Annotated[WireRankGoal | WireAssignGoal, Field(discriminator="type")]
    n: Index | None = None
    k: Index | None = None


def problem_invalid(source: str, field: str, what: str) -> AlarmError:
    """Return the error for a malformed problem; ``field`` is a path such as ``objects[2].start``."""
    return AlarmError(Alarm.PROBLEM_INVALID, f"{source}: {field}: {what}.")


def read_wire(data: Mapping[str, Any], source: str) -> WireProblem:
    """Check types, bounds and cross references of one problem.

    Args:
        data: the decoded JSON object.
        source: what errors call it, usually the file's name.

    Raises:
        AlarmError: PROBLEM_INVALID, naming the field and what it should be.
    """
    check_schema(data, source)
    try:
        wire = WireProblem.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        shown = repr(first["input"])
        shown = shown if len(shown) <= _LONGEST_INPUT_SHOWN else f"{shown[:_LONGEST_INPUT_SHOWN]}..."
        raise problem_invalid(source, _field_path(first["loc"]), f"{first['msg']}, got {shown}") from error
    _check_references(wire, source)
    return wire


def check_schema(data: Mapping[str, Any], source: str) -> None:
    """Refuse another format's file; a problem without ``schema`` is taken as this one's."""
    schema = data.get("schema")
    if schema is not None and not str(schema).startswith(SCHEMA):
        raise problem_invalid(source, "schema", f"should be {SCHEMA}, got {schema!r}")


def _field_path(location: tuple[int | str, ...]) -> str:
    """Turn pydantic's location into ``objects[2].r_mm``; the tags of unions are left out."""
    path = ""
    for part in location:
        if isinstance(part, int):
            path += f"[{part}]"
        elif part not in {"disc", "rect", "rank", "assign"}:
            path += f".{part}" if path else part
    return path or "problem"


def _check_references(wire: WireProblem, source: str) -> None:
    for name, items in (("places", wire.places), ("objects", wire.objects)):
        for position, item in enumerate(items):
            if item.id != position:
                raise problem_invalid(source, f"{name}[{position}].id", f"should be its position, got {item.id}")
    if wire.n is not None and wire.n != len(wire.objects):
        raise problem_invalid(source, "n", f"should be the number of objects {len(wire.objects)}, got {wire.n}")
    buffers = sum(place.kind == "buffer" for place in wire.places)
    if wire.k is not None and wire.k != buffers:
        raise problem_invalid(source, "k", f"should be the number of buffer places {buffers}, got {wire.k}")
    stands_on: dict[int, int] = {}
    for item in wire.objects:
        _check_place(wire, source, f"objects[{item.id}].start", item.start)
        other = stands_on.setdefault(item.start, item.id)
        if other != item.id and wire.places[item.start].kind != "bin":
            raise problem_invalid(
                source, f"objects[{item.id}].start", f"object {other} already stands on place {item.start}"
            )
    if isinstance(wire.goal, WireRankGoal):
        _check_rank_goal(wire, wire.goal, source)
    else:
        _check_assign_goal(wire, wire.goal, source)


def _check_place(wire: WireProblem, source: str, field: str, place: int) -> None:
    if place >= len(wire.places):
        raise problem_invalid(source, field, f"should be a place id below {len(wire.places)}, got {place}")


def _check_rank_goal(wire: WireProblem, goal: WireRankGoal, source: str) -> None:
    if len(goal.slots) != len(wire.objects):
        what = f"should name one slot per object ({len(wire.objects)}), got {len(goal.slots)}"
        raise problem_invalid(source, "goal.slots", what)
    if len(set(goal.slots)) != len(goal.slots):
        raise problem_invalid(source, "goal.slots", f"should not name a slot twice, got {goal.slots}")
    for rank, place in enumerate(goal.slots):
        _check_place(wire, source, f"goal.slots[{rank}]", place)
        if wire.places[place].kind == "bin":
            raise problem_invalid(source, f"goal.slots[{rank}]", f"place {place} is a bin and holds no rank")


def _check_assign_goal(wire: WireProblem, goal: WireAssignGoal, source: str) -> None:
    if len(goal.allowed) != len(wire.objects):
        what = f"should have one list per object ({len(wire.objects)}), got {len(goal.allowed)}"
        raise problem_invalid(source, "goal.allowed", what)
    for item, places in enumerate(goal.allowed):
        if not places:
            raise problem_invalid(source, f"goal.allowed[{item}]", "should name at least one place")
        for position, place in enumerate(places):
            _check_place(wire, source, f"goal.allowed[{item}][{position}]", place)
    for position, place in enumerate(goal.must_fill):
        _check_place(wire, source, f"goal.must_fill[{position}]", place)
