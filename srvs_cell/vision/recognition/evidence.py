"""Step 11: what recognition goes by: both images, where the cameras stood, and the table."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from srvs_cell.vision.faces.edge_fit import EdgeField
from srvs_cell.vision.recognition.ledges import find_ledges, find_lines

if TYPE_CHECKING:
    from srvs_cell.scene import PlaneImage
    from srvs_cell.vision.recognition.ledges import Ledges
    from srvs_cell.vision.recognition.planes_to_objects import RecognitionParameters
    from srvs_cell.vision.rectification import RectifiedRig


@dataclass(frozen=True, eq=False)
class Evidence:
    """What one look gives the recognition.

    Attributes:
        left: the rectified left image with its planes.
        right: the rectified right image with its planes.
        fields: the gradients of both.
        rig: the rectified cameras.
        table_z_mm: height of the table, base frame.
        limits: of the recognition.
    """

    left: PlaneImage
    right: PlaneImage
    fields: tuple[EdgeField, EdgeField]
    rig: RectifiedRig
    table_z_mm: float
    limits: RecognitionParameters

    @classmethod
    def of(
        cls, left: PlaneImage, right: PlaneImage, rig: RectifiedRig, table_z_mm: float, limits: RecognitionParameters
    ) -> Evidence:
        """Take the gradients of the images."""
        return cls(left, right, (EdgeField.of(left.grey), EdgeField.of(right.grey)), rig, table_z_mm, limits)

    @cached_property
    def ledges(self) -> Ledges:
        """Straight borders in space; sought when they are asked for."""
        lines = (find_lines(self.left.grey), find_lines(self.right.grey))
        return find_ledges(lines, self.rig, self.table_z_mm, self.limits.max_height_mm)
