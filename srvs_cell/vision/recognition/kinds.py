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
from srvs_cell.vision.faces.face import Figure

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
