"""Where the search for a face begins: what rises, less the side faces."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from srvs_cell.vision.recognition.rising_faces import without_sides
from tests.vision.painted import TABLE_Z_MM, cuboid, cylinder, outline_mm, prism, rig

if TYPE_CHECKING:
    from srvs_cell.geometry import Array

CAMERAS = rig()


def middle_and_area(points_mm: Array) -> tuple[float, float, float]:
    moments = cv2.moments(cv2.convexHull(points_mm[:, :2].astype(np.float32)))
    return moments["m10"] / moments["m00"], moments["m01"] / moments["m00"], moments["m00"]


def with_sides(face_mm: Array, foot_z_mm: float) -> Array:
    """Return what a face and its side faces down to a height cover, laid on the height of the face, shape (N, 2)."""
    camera_mm = CAMERAS.base_T_camera.translation_mm
    drawn = (camera_mm[2] - face_mm[0, 2]) / (camera_mm[2] - foot_z_mm)
    foot = camera_mm[:2] + drawn * (face_mm[:, :2] - camera_mm[:2])
    return np.concatenate([face_mm[:, :2], foot])


@given(
    st.sampled_from(("cuboid", "cylinder", "prism")),
    st.floats(400.0, 600.0),
    st.floats(-120.0, 120.0),
    st.floats(15.0, 110.0),
    st.floats(25.0, 70.0),
)
@example("cuboid", 409.0, -100.0, 50.0, 62.0)
@example("prism", 471.0, 18.0, 19.0, 44.0)
@settings(max_examples=60, deadline=None)
def test_the_side_faces_are_taken_away(kind: str, x_mm: float, y_mm: float, height_mm: float, across_mm: float) -> None:
    part = {
        "cuboid": cuboid(x_mm, y_mm, height_mm, 20.0, (across_mm, 0.7 * across_mm), 150),
        "cylinder": cylinder(x_mm, y_mm, height_mm, across_mm, 150),
        "prism": prism(x_mm, y_mm, height_mm, 10.0, across_mm, 150),
    }[kind]
    face_mm, z_mm = outline_mm(part), TABLE_Z_MM + height_mm
    alone = without_sides(with_sides(face_mm, TABLE_Z_MM), CAMERAS, z_mm, TABLE_Z_MM)
    assert alone is not None
    assert middle_and_area(alone) == pytest.approx(middle_and_area(face_mm), rel=1e-3, abs=0.05)


def test_nothing_is_left_of_what_is_smaller_than_the_side_faces_it_should_have() -> None:
    face_mm = outline_mm(cylinder(600.0, 120.0, 110.0, 4.0, 150))
    assert without_sides(face_mm[:, :2], CAMERAS, TABLE_Z_MM + 110.0, TABLE_Z_MM) is None
