"""Where the TCP goes: the way to a grasp and to a place. Pure geometry.

The TCP lies between the finger tips; W = 180, P = 0 points the tool down; the jaws close along the TCP's x or y axis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self

from srvs_cell.geometry import Xyzwpr, wrap_angle_deg

if TYPE_CHECKING:
    from srvs_cell.config import MotionParameters
    from srvs_cell.planning import CellMove
    from srvs_cell.scene import Grasp, Workpiece

_TOOL_DOWN_W_DEG = 180.0
_QUARTER_DEG = 90.0
_HALF_TURN_DEG = 180.0


def tool_rotation_deg(grasp_yaw_deg: float, jaw_axis: str, observe_r_deg: float) -> float:
    """Return the R that closes the jaws along a yaw, of the two possible ones the nearer to the observe pose's R.

    Nearer to the *present* R would wind up the wrist over many picks until a joint limit stops the arm.

    With the tool down, the TCP's x axis has the yaw R and its y axis the yaw R - 90.
    """
    r_deg = grasp_yaw_deg if jaw_axis == "x" else grasp_yaw_deg + _QUARTER_DEG
    return observe_r_deg + wrap_angle_deg(r_deg - observe_r_deg, _HALF_TURN_DEG)


@dataclass(frozen=True)
class Approach:
    """The way down to a point and up again.

    Attributes:
        above: at travel height.
        near: where the slow descent begins.
        at: where the gripper acts.
    """

    above: Xyzwpr
    near: Xyzwpr
    at: Xyzwpr

    @classmethod
    def of(cls, at: Xyzwpr, travel_z_mm: float, approach_mm: float) -> Self:
        """Return the way straight down to ``at``; it never begins below ``at`` and never above travel height."""
        above_z_mm = max(travel_z_mm, at.z_mm)
        near_z_mm = min(at.z_mm + approach_mm, above_z_mm)
        return cls(replace(at, z_mm=above_z_mm), replace(at, z_mm=near_z_mm), at)


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


def travel_height_mm(table_z_mm: float, tallest_mm: float, clearance_mm: float, hang_mm: float = 0.0) -> float:
    """Return the TCP height at which open fingers, or a held part that hangs below, pass above the tallest part."""
    return table_z_mm + tallest_mm + hang_mm + clearance_mm


def grasp_pose(grasp: Grasp, offset_mm: tuple[float, float], motion: MotionParameters, observe: Xyzwpr) -> Xyzwpr:
    """Return the TCP pose of a grasp whose workpiece has meanwhile been moved by ``offset_mm``."""
    x_mm, y_mm, z_mm = grasp.position_mm
    r_deg = tool_rotation_deg(grasp.yaw_deg, motion.jaw_axis, observe.r_deg)
    return Xyzwpr(x_mm + offset_mm[0], y_mm + offset_mm[1], z_mm, _TOOL_DOWN_W_DEG, 0.0, r_deg)


def held_part(
    workpiece: Workpiece, move: CellMove, at: Xyzwpr, table_z_mm: float, motion: MotionParameters
) -> HeldPart:
    """Return the part that a grip at ``at`` takes, with the pose that puts its reference point on the goal."""
    place = replace(
        at,
        x_mm=at.x_mm + move.to_mm[0] - move.from_mm[0],
        y_mm=at.y_mm + move.to_mm[1] - move.from_mm[1],
        z_mm=at.z_mm + motion.release_gap_mm,
    )
    return HeldPart(workpiece.id, workpiece.kind, place, max(0.0, at.z_mm - table_z_mm))
