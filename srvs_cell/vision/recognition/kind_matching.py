"""Step 11g: which object each top face belongs to, and of which kind that is, by the relations between faces.

"The first step in recognition is to search planes to know what planes are belong to an object and the next step is to
recognize the object from the relation between planes" (the paper). Kinds of more faces come first, so that half a
gable roof is no wedge; among equals the library's order decides. A face that no kind claims is an object of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision.faces.face import Figure

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from srvs_cell.vision.faces.face import Face
    from srvs_cell.vision.recognition.kinds import FacePattern, FaceRelation, ObjectKind

_QUARTER_DEG = 90.0


@dataclass(frozen=True)
class FaceGroup:
    """The top faces of one object: their numbers, in the order of the kind's faces; no kind where none fits."""

    kind: ObjectKind | None
    members: tuple[int, ...]


def group_faces(faces: Sequence[Face], table_z_mm: float, kinds: Sequence[ObjectKind]) -> list[FaceGroup]:
    """Return objects such that each face belongs to exactly one, by ascending first face.

    Args:
        faces: top faces with the long side as their length.
        table_z_mm: height of the table, base frame.
        kinds: the library, the first of those that fit wins.
    """
    free = set(range(len(faces)))
    groups = []
    for kind in sorted(kinds, key=lambda kind: -len(kind.faces)):
        found = [(_looseness(kind, members, faces), members) for members in _assignments(kind, faces, table_z_mm, free)]
        for _, members in sorted(found):
            if free.issuperset(members):
                free.difference_update(members)
                groups.append(FaceGroup(kind, members))
    groups += [FaceGroup(None, (number,)) for number in free]
    return sorted(groups, key=lambda group: min(group.members))


def _assignments(
    kind: ObjectKind, faces: Sequence[Face], table_z_mm: float, free: set[int]
) -> Iterator[tuple[int, ...]]:
    """Return every way to take free faces for the faces of a kind."""
    names = list(kind.faces)
    fitting = [
        [number for number in sorted(free) if _fits(kind.faces[name], faces[number], table_z_mm)] for name in names
    ]

    def extended(taken: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        if len(taken) == len(names):
            yield taken
            return
        for number in fitting[len(taken)]:
            chosen = (*taken, number)
            placed = {name: faces[member] for name, member in zip(names, chosen, strict=False)}
            if number not in taken and all(_holds(relation, placed) for relation in kind.relations):
                yield from extended(chosen)

    yield from extended(())


def _looseness(kind: ObjectKind, members: tuple[int, ...], faces: Sequence[Face]) -> float:
    """Return the sum of the gaps between related faces: of several ways the closest is right."""
    placed = {name: faces[member] for name, member in zip(kind.faces, members, strict=True)}
    return sum(gap_mm(placed[relation.between[0]], placed[relation.between[1]]) for relation in kind.relations)


def _fits(pattern: FacePattern, face: Face, table_z_mm: float) -> bool:
    measured = (
        (face.inclination_deg, pattern.inclination_deg),
        (face.length_mm, pattern.length_mm),
        (face.width_mm, pattern.width_mm),
        (face.length_mm / face.width_mm, pattern.aspect),
        (face.highest_mm - table_z_mm, pattern.height_mm),
    )
    return face.figure is pattern.outline and all(least <= value <= greatest for value, (least, greatest) in measured)


def _holds(relation: FaceRelation, placed: Mapping[str, Face]) -> bool:
    """Whether a relation holds, as far as both its faces are placed."""
    if not placed.keys() >= set(relation.between):
        return True
    first, second = (placed[name] for name in relation.between)
    measured = (
        (gap_mm(first, second), (0.0, relation.max_gap_mm)),
        (_angle_deg(first, second), relation.angle_deg),
        (first.highest_mm - second.highest_mm, relation.step_mm),
        (_turn_deg(first, second), relation.turn_deg),
    )
    return all(least <= value <= greatest for value, (least, greatest) in measured)


def gap_mm(face: Face, other: Face) -> float:
    """Return the distance of two outlines seen from above; 0 where they overlap."""
    outlines = [one.corners_mm()[:, :2].astype(np.float32) for one in (face, other)]
    shared_mm2, _ = cv2.intersectConvexConvex(outlines[0], outlines[1])
    if shared_mm2 > 0.0:
        return 0.0
    # of two convex outlines that are apart, a corner of one is the nearest point
    return min(
        -cv2.pointPolygonTest(polygon, (float(x), float(y)), measureDist=True)
        for polygon, corners in (outlines, outlines[::-1])
        for x, y in corners
    )


def _angle_deg(face: Face, other: Face) -> float:
    cosine = float(face.normal() @ other.normal())
    return float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _turn_deg(face: Face, other: Face) -> float:
    """Return the angle between the sides of two rectangles, 0 to 45; 0 where one is none."""
    if any(one.figure is not Figure.RECTANGLE for one in (face, other)):
        return 0.0
    turn = float(np.rad2deg(face.angle_rad - other.angle_rad)) % _QUARTER_DEG
    return min(turn, _QUARTER_DEG - turn)
