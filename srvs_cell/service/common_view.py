"""What the camera sees in both pictures of every look: from the observe pose and from aside.

A part that stands elsewhere cannot be checked by the look after a move, and would be taken for missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import cv2
import numpy as np

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.calibration import moved_aside, plan_right_pose
from srvs_cell.geometry import Transform
from srvs_cell.planning import taught_places
from srvs_cell.vision.rectification import rectification_maps

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.calibration import Calibration
    from srvs_cell.config import CellConfig, CellParameters
    from srvs_cell.geometry import Array
    from srvs_cell.scene import Workpiece
    from srvs_cell.vision.rectification import RectifiedRig

_MARGIN_PX = 4
"""A face that touches the border is not measured; poses and calibration are not exact either."""


@dataclass(frozen=True, eq=False)
class _Look:
    """One stereo pair: its cameras, and the pixels of the rectified images in which something is seen, shape (H, W)."""

    rig: RectifiedRig
    left: NDArray[np.bool_]
    right: NDArray[np.bool_]

    def sees(self, points_mm: Array) -> NDArray[np.bool_]:
        x_px, y_px, disparity_px = self.rig.project_px(points_mm)
        in_front: NDArray[np.bool_] = disparity_px > 0.0
        return in_front & _at(self.left, x_px, y_px) & _at(self.right, x_px - disparity_px, y_px)


@dataclass(frozen=True, eq=False)
class CommonView:
    """What all pictures of all looks have in view.

    Attributes:
        table_z_mm: height of the table in the base frame.
        looks: from the observe pose and from aside.
    """

    table_z_mm: float
    looks: tuple[_Look, ...]

    @classmethod
    def of(cls, cell: CellParameters, calibration: Calibration) -> Self:
        """Compute it from the planned poses; raises BASELINE_INVALID as `plan_right_pose`."""
        observe = Transform.from_xyzwpr("base", "tcp", cell.look.observe_pose.pose())
        looks = []
        for left in (observe, moved_aside(calibration, observe, *cell.look.aside_mm)):
            maps = rectification_maps(calibration, left, plan_right_pose(calibration, left, cell.look.baseline_mm))
            looks.append(_Look(maps.rig, _within(maps.left_valid), _within(maps.right_valid)))
        return cls(cell.table_z_mm, tuple(looks))

    def sees(self, points_mm: Array, *, from_aside: bool) -> NDArray[np.bool_]:
        """Tell of points (..., 3), x and y in the base frame and height above the table, whether all pictures do."""
        in_base = points_mm + np.array([0.0, 0.0, self.table_z_mm])
        looks = self.looks if from_aside else self.looks[:1]
        seen: NDArray[np.bool_] = np.all([look.sees(in_base) for look in looks], axis=0)
        return seen

    def shows(self, workpiece: Workpiece) -> bool:
        """Tell whether all pictures show the whole of a workpiece, foot and top."""
        foot_mm = workpiece.footprint_mm
        solid = [np.column_stack([foot_mm, np.full(len(foot_mm), z_mm)]) for z_mm in (0.0, workpiece.height_mm)]
        return bool(self.sees(np.concatenate(solid), from_aside=True).all())


def check_places(config: CellConfig, view: CommonView) -> None:
    """Raise CONFIG_INVALID where a configured place is not in view, however low the part that stands there.

    A buffer place has to be seen by a look from aside, too; what lies in a bin need not be seen.
    """
    planning = config.planning
    places = [(f"buffer_places_mm.{i}", point_mm, True) for i, point_mm in enumerate(planning.buffer_places_mm)]
    if planning.names_a_rule:
        taught = taught_places(planning.rule, planning.rule_settings)
        places += [(f"rule_settings.{place.key}", place.point_mm, False) for place in taught if place.seen]
    for key, (x_mm, y_mm), from_aside in places:
        if not view.sees(np.array([x_mm, y_mm, 0.0]), from_aside=from_aside):
            aside = ", and cell.look.aside_mm beside it," if from_aside else ""
            raise AlarmError(
                Alarm.CONFIG_INVALID,
                f"{config.source}: planning.{key} = [{x_mm:g}, {y_mm:g}]: the pictures that are taken from "
                f"cell.look.observe_pose{aside} do not all show that place.",
            )


def _within(valid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels that are farther from the border than the margin."""
    square = np.ones((2 * _MARGIN_PX + 1, 2 * _MARGIN_PX + 1), dtype=np.uint8)
    eroded = cv2.erode(valid.astype(np.uint8), square, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(eroded, dtype=bool)


def _at(mask: NDArray[np.bool_], x_px: Array, y_px: Array) -> NDArray[np.bool_]:
    """Return a mask's value at points; False outside it."""
    height, width = mask.shape
    # Far outside, or behind the camera, a projection may be any number, or none.
    column = np.rint(np.nan_to_num(np.clip(x_px, -1.0, width), nan=-1.0)).astype(int)
    row = np.rint(np.nan_to_num(np.clip(y_px, -1.0, height), nan=-1.0)).astype(int)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    seen: NDArray[np.bool_] = inside & mask[np.where(inside, row, 0), np.where(inside, column, 0)]
    return seen
