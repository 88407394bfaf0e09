"""Kinds of objects as a library says them: which top faces an object has, and how these lie to each other.

What the recognition knows of an object is its top faces: the outline of each (rectangle, circle or regular hexagon),
its sizes, its height over the table, its inclination, and where the faces lie to each other. A kind says ranges of
these, no more. Objects whose faces are no such figures are unknown, whatever a library says.
"""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import AfterValidator, ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass

from srvs_cell.scene import UNKNOWN_KIND
from srvs_cell.vision.faces.face import HEXAGON_RATIO, Figure

_CONFIG = ConfigDict(extra="forbid")
MAX_FACES = 4
_MAX_MM = 2000.0
_UPRIGHT_DEG = 90.0
_HALF_TURN_DEG = 180.0
_DIAGONAL_DEG = 45.0


def _ordered(limits: tuple[float, float]) -> tuple[float, float]:
    least, greatest = limits
    if least > greatest:
        raise ValueError(f"the least value {least:g} is greater than the greatest {greatest:g}")
    return limits


_Length = Annotated[float, Field(ge=0.0, le=_MAX_MM)]
Lengths = Annotated[tuple[_Length, _Length], AfterValidator(_ordered)]
"""Least and greatest length, millimetres."""
_Step = Annotated[float, Field(ge=-_MAX_MM, le=_MAX_MM)]
_Inclination = Annotated[float, Field(ge=0.0, le=_UPRIGHT_DEG)]
_Angle = Annotated[float, Field(ge=0.0, le=_HALF_TURN_DEG)]
_Turn = Annotated[float, Field(ge=0.0, le=_DIAGONAL_DEG)]
_Ratio = Annotated[float, Field(ge=1.0, le=1000.0)]
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]


def _shown(limits: tuple[float, float]) -> str:
    return f"[{limits[0]:g}, {limits[1]:g}]"


def _disjoint(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return one[1] < other[0] or other[1] < one[0]


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class FacePattern:
    """What one top face of a kind may be. Both ends of a range belong to it."""

    outline: Annotated[Figure, Field(description="outline of the face seen at right angles to the table")]
    inclination_deg: Annotated[
        tuple[_Inclination, _Inclination],
        AfterValidator(_ordered),
        Field(description="angle between the face and the table; a level face has exactly 0"),
    ] = (0.0, 0.0)
    length_mm: Annotated[
        Lengths, Field(description="long side seen from above; a circle's diameter, a hexagon's size across corners")
    ] = (0.0, _MAX_MM)
    width_mm: Annotated[
        Lengths, Field(description="short side seen from above; a circle's diameter, a hexagon's size across flats")
    ] = (0.0, _MAX_MM)
    aspect: Annotated[
        tuple[_Ratio, _Ratio], AfterValidator(_ordered), Field(description="length divided by width; a square has 1")
    ] = (1.0, 1000.0)
    height_mm: Annotated[Lengths, Field(description="highest point of the face above the table")] = (0.0, _MAX_MM)

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.outline is not Figure.RECTANGLE and self.inclination_deg[0] > 0.0:
            raise ValueError(f"inclination_deg: a {self.outline.value} is only seen level; let the range begin at 0")
        ratio = {Figure.CIRCLE: (1.0, 1.0), Figure.HEXAGON: (1.0 / HEXAGON_RATIO,) * 2}.get(self.outline, self.aspect)
        low, high = (max(self.aspect[0], ratio[0]), min(self.aspect[1], ratio[1]))
        if low > high:
            raise ValueError(f"aspect = {_shown(self.aspect)}: a {self.outline.value} has {ratio[0]:.4g}; leave it out")
        least, greatest = self.width_mm[0] * low, self.width_mm[1] * high
        if self.length_mm[1] < least or self.length_mm[0] > greatest:
            raise ValueError(
                f"length_mm = {_shown(self.length_mm)} and width_mm = {_shown(self.width_mm)}: no {self.outline.value} "
                f"has both, its length is {low:.4g} to {high:.4g} times its width; widen one of the ranges"
            )
        return self


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class FaceRelation:
    """How two top faces of a kind lie to each other."""

    between: Annotated[tuple[Name, Name], Field(description="names of the first and the second face")]
    max_gap_mm: Annotated[
        float, Field(ge=0.0, le=50.0, description="greatest distance of the outlines seen from above: adjacent faces")
    ] = 4.0
    angle_deg: Annotated[
        tuple[_Angle, _Angle], AfterValidator(_ordered), Field(description="angle between the faces' normals")
    ] = (0.0, _HALF_TURN_DEG)
    step_mm: Annotated[
        tuple[_Step, _Step],
        AfterValidator(_ordered),
        Field(description="height of the first face's highest point above the second's; negative where it is lower"),
    ] = (-_MAX_MM, _MAX_MM)
    turn_deg: Annotated[
        tuple[_Turn, _Turn],
        AfterValidator(_ordered),
        Field(description="angle between the sides of two rectangles seen from above, modulo 90"),
    ] = (0.0, _DIAGONAL_DEG)


def _contradiction(relation: FaceRelation, first: FacePattern, second: FacePattern) -> str:
    """Return which range of a relation the two faces' own ranges exclude, and why; empty where they exclude none."""
    (low, high), (other_low, other_high) = first.height_mm, second.height_mm
    steps_mm = (low - other_high, high - other_low)
    (low, high), (other_low, other_high) = first.inclination_deg, second.inclination_deg
    angles_deg = (max(0.0, low - other_high, other_low - high), high + other_high)
    turns_deg = (0.0, _DIAGONAL_DEG if first.outline is second.outline is Figure.RECTANGLE else 0.0)
    for key, own, possible, cause in (
        ("step_mm", relation.step_mm, steps_mm, "by their height_mm"),
        ("angle_deg", relation.angle_deg, angles_deg, "by their inclination_deg"),
        ("turn_deg", relation.turn_deg, turns_deg, "unless both are rectangles"),
    ):
        if _disjoint(own, possible):
            return f"{key} = {_shown(own)}: these faces have {_shown(possible)} {cause}; let the ranges overlap"
    return ""


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class ObjectKind:
    """A kind of object: its top faces by name, and relations that join them all."""

    name: Annotated[Name, Field(description="how the kind is reported; letters, digits and underscores")]
    description: Annotated[str, Field(max_length=200, description="for people")] = ""
    faces: Annotated[
        dict[Name, FacePattern],
        Field(min_length=1, max_length=MAX_FACES, description="its top faces, by names of one's own"),
    ]
    relations: Annotated[
        tuple[FaceRelation, ...], Field(max_length=6, description="needed where there are several faces")
    ] = ()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.name == UNKNOWN_KIND:
            raise ValueError(f"name: {UNKNOWN_KIND!r} is what objects of no kind are reported as")
        joined = {next(iter(self.faces))}
        for number, relation in enumerate(self.relations):
            first, second = relation.between
            for name in (first, second):
                if name not in self.faces:
                    raise ValueError(f"relations.{number}.between: no face {name!r} (faces: {', '.join(self.faces)})")
            if first == second:
                raise ValueError(f"relations.{number}.between: {first!r} has no relation to itself")
            if reason := _contradiction(relation, self.faces[first], self.faces[second]):
                raise ValueError(f"relations.{number}.{reason}")
        for _ in self.faces:
            joined |= {name for relation in self.relations for name in relation.between if joined & {*relation.between}}
        if apart := [name for name in self.faces if name not in joined]:
            raise ValueError(f"relations: none joins the face {apart[0]!r} to the others")
        return self


BUILT_IN_KINDS = (
    ObjectKind(
        name="cuboid",
        description="upright block",
        faces={"top": FacePattern(outline=Figure.RECTANGLE)},
    ),
    ObjectKind(
        name="wedge",
        description="block whose top is inclined along one side",
        faces={"top": FacePattern(outline=Figure.RECTANGLE, inclination_deg=(0.0, _UPRIGHT_DEG))},
    ),
    ObjectKind(
        name="cylinder",
        description="upright cylinder",
        faces={"top": FacePattern(outline=Figure.CIRCLE)},
    ),
    ObjectKind(
        name="prism",
        description="upright hexagonal prism",
        faces={"top": FacePattern(outline=Figure.HEXAGON)},
    ),
)
"""What is recognised without a library of one's own; as the file ``configs/object_kinds.yaml`` says it."""
