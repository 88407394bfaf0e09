"""Faces that one border in space and the outline of what rises enclose."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from srvs_cell.vision.recognition.bordered_faces import bordered_faces
from srvs_cell.vision.recognition.ledges import Ledges
from tests.vision.painted import TABLE_Z_MM, cuboid, rig

UP = np.array([0.0, 0.0, 1.0])
FACE = cuboid(520.0, 70.0, 60.0, 25.0, (60.0, 40.0), 180).face


def doubled_outline() -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return what encloses the face and its picture in the right image, laid over the left one by the table."""
    x, y, disparity = rig().project_px(FACE.corners_mm())
    a, b, c = rig().plane_disparity(UP, TABLE_Z_MM)
    laid = x - (disparity - (a * x + b * y + c))
    points = np.concatenate([np.column_stack([x, y]), np.column_stack([laid, y])]).astype(np.float32)
    return cv2.convexHull(points).reshape(-1, 2).astype(np.float64)


def ledge(first: int, second: int, share: float = 1.0) -> Ledges:
    """Return a piece of the face's side from one corner to another, begun at the first."""
    corners = FACE.corners_mm()
    ends = np.array([corners[first], corners[first] + share * (corners[second] - corners[first])])
    x, y, _ = rig().project_px(ends.mean(axis=0)[None])
    return Ledges(ends[None], np.column_stack([x, y]))


@pytest.mark.parametrize(("first", "second"), [(0, 1), (1, 2), (2, 3), (3, 0), (1, 0)])
def test_each_side_tells_the_face(first: int, second: int) -> None:
    found = bordered_faces(ledge(first, second), [doubled_outline()], rig(), TABLE_Z_MM)
    nearest = min(found, key=lambda face: abs(face.length_mm * face.width_mm - FACE.length_mm * FACE.width_mm))
    assert (nearest.x_mm, nearest.y_mm, nearest.z_mm) == pytest.approx((FACE.x_mm, FACE.y_mm, FACE.z_mm), abs=1.5)
    assert sorted((nearest.length_mm, nearest.width_mm)) == pytest.approx([40.0, 60.0], abs=3.0)


def test_a_piece_of_a_side_tells_it_too() -> None:
    found = bordered_faces(ledge(0, 1, 0.5), [doubled_outline()], rig(), TABLE_Z_MM)
    sizes = [sorted((face.length_mm, face.width_mm)) for face in found]
    assert sizes[0] == pytest.approx([30.0, 40.0], abs=3.0)
    assert sizes[1] == pytest.approx([40.0, 60.0], abs=3.0)


def test_a_border_elsewhere_or_a_sloping_one_tells_nothing() -> None:
    far = np.add(doubled_outline(), (200.0, 0.0))
    assert bordered_faces(ledge(0, 1), [far], rig(), TABLE_Z_MM) == []
    level = ledge(0, 1)
    sloping = Ledges(level.ends_mm + np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 9.0]]]), level.middle_px)
    assert bordered_faces(sloping, [doubled_outline()], rig(), TABLE_Z_MM) == []
