"""Where the hand can take and leave a workpiece: workspace box, reach and joint limits, along the way down and up."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.geometry import Transform
from srvs_cell.planning.arm import ArmReach
from srvs_cell.planning.hand import Approach
from srvs_cell.planning.view import in_view
from srvs_cell.scene import PlaceKind

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array, Xyzwpr
    from srvs_cell.planning.arm import ArmParameters
    from srvs_cell.planning.buffers import Workspace
    from srvs_cell.planning.carrying import Carry
    from srvs_cell.planning.hand import HandMotion
    from srvs_cell.planning.problem import ProblemObject
    from srvs_cell.scene import Grasp, Place


class Access:
    """Tells whether the TCP may go down to a place and up again.

    Args:
        hand: how the cell moves the hand.
        arm: the arm; None: reach and joint limits are not checked.
        workspace: where the TCP may be.
    """

    def __init__(self, hand: HandMotion, arm: ArmParameters | None, workspace: Workspace) -> None:
        self._hand, self._workspace = hand, workspace
        self._reach = None if arm is None else ArmReach(arm, hand.observe)

    def why_not(self, grasp: Grasp, carries: Sequence[Carry], top_mm: float) -> list[str]:
        """Return, per place, why a workpiece cannot be put down there after it was carried, or an empty string.

        Args:
            grasp: of the workpiece where it was seen.
            carries: from there, one to each place.
            top_mm: its height at most: the hand comes down from above it.
        """
        poses = [self._hand.carried_pose(self._hand.grasp_pose(grasp, carry.turn_deg), carry) for carry in carries]
        reasons = [self._why_outside(pose) for pose in poses]
        if self._reach is not None:
            inside = [number for number, reason in enumerate(reasons) if not reason]
            of_arm = self._reach.why_not([self._column(poses[number], top_mm) for number in inside])
            for number, reason in zip(inside, of_arm, strict=True):
                reasons[number] = reason
        return reasons

    def _why_outside(self, at: Xyzwpr) -> str:
        low_mm, high_mm = self._hand.z_mm
        if not low_mm <= at.z_mm <= high_mm:
            return f"the grasp at z = {at.z_mm:.1f} mm is outside the workspace's {low_mm:g} to {high_mm:g} mm"
        beyond_mm = self._workspace.beyond_mm(at.x_mm, at.y_mm)
        return f"out of the workspace by {beyond_mm:.0f} mm" if beyond_mm > 0.0 else ""

    def why_unseen(self, item: ProblemObject, place: Place) -> str:
        """Return why an object cannot be checked on a place after it was put there, or an empty string.

        What waits in a buffer place has to be seen by a repeated look too; what lies in a bin is not looked for.
        """
        view = self._workspace.view
        if view is None or place.kind is PlaceKind.BIN:
            return ""
        point_mm = np.array([[place.x_mm, place.y_mm]])
        waits = place.kind is PlaceKind.BUFFER
        return "" if in_view(item.at(place.id), point_mm, view, from_aside=waits)[0] else "no look would see it there"

    def mask(self, grasp: Grasp, offsets_mm: Array, top_mm: float) -> NDArray[np.bool_]:
        """Return, per offset (N, 2), whether a workpiece can be gripped there, not turned.

        Both ends of the way down are looked at.
        """
        low = self._hand.grasp_pose(grasp)
        x_mm, y_mm = offsets_mm[:, 0] + low.x_mm, offsets_mm[:, 1] + low.y_mm
        free: NDArray[np.bool_] = self._workspace.holds(x_mm, y_mm)
        if self._reach is None:
            return free
        for end in self._column(low, top_mm):
            poses = np.tile(Transform.from_xyzwpr("base", "tcp", end).matrix, (len(offsets_mm), 1, 1))
            poses[:, :2, 3] += offsets_mm
            free &= self._reach.within(poses)
        return free

    def why_not_way(self, way: list[Xyzwpr]) -> str:
        """Return why the TCP cannot go straight from pose to pose, or an empty string."""
        low_mm, high_mm = self._hand.z_mm
        for pose in way:
            if not low_mm <= pose.z_mm <= high_mm:
                return f"z = {pose.z_mm:.1f} mm is outside the workspace's {low_mm:g} to {high_mm:g} mm"
        return "" if self._reach is None else self._reach.why_not([way])[0]

    def _column(self, at: Xyzwpr, top_mm: float) -> list[Xyzwpr]:
        way = Approach.of(at, self._hand.travel_z_mm(top_mm, self._hand.hang_mm(at)), self._hand.approach_mm)
        return [way.at, way.above]
