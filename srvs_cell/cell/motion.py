"""A part in the gripper and where it belongs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

from srvs_cell.geometry import Xyzwpr

if TYPE_CHECKING:
    from srvs_cell.planning import CellMove, HandMotion
    from srvs_cell.scene import Workpiece


@dataclass(frozen=True)
class HeldPart:
    """A part in the gripper and where it belongs. Journalled, so that it survives this process.

    Attributes:
        workpiece: its number in the perception that it was picked from.
        kind: for people.
        place: TCP pose at which it is let go.
        hang_mm: how far it reaches below the TCP.
    """

    workpiece: int
    kind: str
    place: Xyzwpr
    hang_mm: float

    def as_json(self) -> dict[str, Any]:
        """Return it for the journal."""
        return {
            "workpiece": self.workpiece,
            "kind": self.kind,
            "place": list(self.place.as_tuple()),
            "hang_mm": self.hang_mm,
        }

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Self:
        """Return what `as_json` wrote."""
        return cls(int(data["workpiece"]), str(data["kind"]), Xyzwpr(*data["place"]), float(data["hang_mm"]))


def held_part(workpiece: Workpiece, move: CellMove, at: Xyzwpr, hand: HandMotion) -> HeldPart:
    """Return the part that a grip at ``at`` takes, with the pose that puts its reference point on the goal."""
    return HeldPart(workpiece.id, workpiece.kind, hand.release_pose(at, move.carry), hand.hang_mm(at))
