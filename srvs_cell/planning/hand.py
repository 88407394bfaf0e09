"""Where the TCP goes to pick and to place: straight down to a point and up again. Pure geometry.

The TCP lies between the finger tips; W = 180, P = 0 points the tool down; the jaws close along the TCP's x or y axis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

from srvs_cell.geometry import Xyzwpr, wrap_angle_deg

if TYPE_CHECKING:
    from srvs_cell.planning.carrying import Carry
    from srvs_cell.planning.legs import LegTops
    from srvs_cell.scene import Grasp

_TOOL_DOWN_W_DEG = 180.0
_QUARTER_DEG = 90.0
_HALF_TURN_DEG = 180.0


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


@dataclass(frozen=True, kw_only=True)
class HandMotion:
    """How the cell moves the hand.

    Attributes:
        table_z_mm: height of the table, base frame.
        clearance_mm: between the highest thing under a way and whatever passes above it.
        approach_mm: height above a grasp or a place where the slow descent begins.
        release_gap_mm: height above the table at which a part is let go.
        jaw_axis: axis of the TCP frame along which the jaws close, x or y.
        observe: TCP pose from which the cell looks; jobs begin and end there.
        z_mm: least and greatest height of the TCP.
        travel_speed_mm_s, approach_speed_mm_s: of straight moves above parts, and down to a part and up from it.
        looks_between: whether the hand goes back to the observe pose after every move, to look, not only in the end.
    """

    table_z_mm: float
    clearance_mm: float
    approach_mm: float
    release_gap_mm: float
    jaw_axis: str
    observe: Xyzwpr
    z_mm: tuple[float, float]
    travel_speed_mm_s: float
    approach_speed_mm_s: float
    looks_between: bool = False

    def grasp_pose(self, grasp: Grasp, turn_deg: float = 0.0) -> Xyzwpr:
        """Return the TCP pose of a grasp whose workpiece is to be turned by ``turn_deg`` in the hand."""
        # Half of the turn to either side of where R is nearest to the observe pose's.
        half_deg = turn_deg / 2.0
        r_deg = tool_rotation_deg(grasp.yaw_deg + half_deg, self.jaw_axis, self.observe.r_deg) - half_deg
        return Xyzwpr(*grasp.position_mm, _TOOL_DOWN_W_DEG, 0.0, r_deg)

    def carried_pose(self, at: Xyzwpr, carry: Carry) -> Xyzwpr:
        """Return the TCP pose at which a workpiece, gripped at ``at``, has been carried."""
        x_mm, y_mm = carry.point((at.x_mm, at.y_mm))
        return replace(at, x_mm=x_mm, y_mm=y_mm, r_deg=at.r_deg + carry.turn_deg)

    def release_pose(self, at: Xyzwpr, carry: Carry) -> Xyzwpr:
        """Return the TCP pose that lets a workpiece go, gripped at ``at``, that is carried."""
        return replace(self.carried_pose(at, carry), z_mm=at.z_mm + self.release_gap_mm)

    def hang_mm(self, at: Xyzwpr) -> float:
        """Return how far a workpiece that is gripped at ``at`` on the table reaches below the TCP."""
        return max(0.0, at.z_mm - self.table_z_mm)

    def travel_z_mm(self, top_mm: float, hang_mm: float = 0.0) -> float:
        """Return the TCP height at which open fingers, or a held part that hangs below, pass above a height.

        Args:
            top_mm: height above the table of the highest thing under the way.
            hang_mm: how far the held part reaches below the TCP.
        """
        return self.table_z_mm + top_mm + hang_mm + self.clearance_mm

    def pick_way(self, at: Xyzwpr, tops: LegTops) -> tuple[Approach, Xyzwpr]:
        """Return the way down to a grasp and up again, and where the hand with the workpiece rises to after that."""
        way = Approach.of(at, self.travel_z_mm(tops.to_pick_mm), self.approach_mm)
        lifted_z_mm = max(way.near.z_mm, self.travel_z_mm(tops.carried_mm, self.hang_mm(at)))
        return way, replace(way.above, z_mm=lifted_z_mm)

    def place_way(self, release: Xyzwpr, hang_mm: float, tops: LegTops) -> tuple[Approach, Approach]:
        """Return the way down to a place with a workpiece that hangs below the TCP, and the way up without it."""
        return (
            Approach.of(release, self.travel_z_mm(tops.carried_mm, hang_mm), self.approach_mm),
            Approach.of(release, self.travel_z_mm(tops.away_mm), self.approach_mm),
        )


def tool_rotation_deg(grasp_yaw_deg: float, jaw_axis: str, observe_r_deg: float) -> float:
    """Return the R that closes the jaws along a yaw, of the two possible ones the nearer to the observe pose's R.

    Nearer to the *present* R would wind up the wrist over many picks until a joint limit stops the arm.

    With the tool down, the TCP's x axis has the yaw R and its y axis the yaw R - 90.
    """
    r_deg = grasp_yaw_deg if jaw_axis == "x" else grasp_yaw_deg + _QUARTER_DEG
    return observe_r_deg + wrap_angle_deg(r_deg - observe_r_deg, _HALF_TURN_DEG)
