"""What the grey values inside a face say of its place."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from srvs_cell.vision.faces.edge_fit import EdgeField
from srvs_cell.vision.faces.face import Face, Figure
from srvs_cell.vision.faces.inner_texture import inner_displacements
from tests.vision.painted import SIZE, rig

FACE = Face(Figure.RECTANGLE, 500.0, 60.0, 40.0, 0.3, 60.0, 40.0)
DISC = Face(Figure.CIRCLE, 500.0, 60.0, 40.0, 0.0, 50.0, 50.0)
NOISE = 1.5


def pictures(face: Face, contrast: float, ramp: float = 0.0, tilt: float = 0.0) -> tuple[EdgeField, EdgeField]:
    """Paint a texture that lies on the face's plane, with noise and other exposures.

    The picture grows brighter by ``ramp`` grey values from left to right, the right one by ``tilt`` besides downwards.
    """
    cameras, random = rig(), np.random.default_rng(3)
    texture = cv2.GaussianBlur(random.normal(size=(SIZE[1], SIZE[0])), (0, 0), 2.5)
    left = 120.0 + contrast * texture / texture.std() + np.linspace(0.0, ramp, SIZE[0])
    normal = face.normal()
    a, b, c = cameras.plane_disparity(normal, float(normal @ (face.x_mm, face.y_mm, face.z_mm)))
    y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(np.float64)
    source = ((x + b * y + c) / (1.0 - a)).astype(np.float32)
    right = 0.95 * cv2.remap(left, source, y.astype(np.float32), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT) + 4.0
    right = right + np.linspace(0.0, tilt, SIZE[1])[:, None]
    seen = (np.rint(image + random.normal(scale=NOISE, size=image.shape)) for image in (left, right))
    first, second = (EdgeField.of(np.clip(image, 0.0, 255.0).astype(np.uint8)) for image in seen)
    return first, second


def parallax_px(face: Face, other: Face) -> float:
    """Return how much two faces' middles differ in disparity."""
    middles = np.array([[one.x_mm, one.y_mm, one.z_mm] for one in (face, other)])
    disparity = rig().project_px(middles)[2]
    return float(disparity[1] - disparity[0])


@pytest.mark.parametrize("face", [FACE, replace(FACE, slope_u=0.4), DISC])
def test_where_a_face_stands_its_inside_falls_on_itself(face: Face) -> None:
    (displaced,) = inner_displacements([face], pictures(face, 10.0), rig(), NOISE)
    assert displaced < 0.01


def test_a_lens_that_darkens_one_picture_more_does_not_displace_a_smooth_face() -> None:
    (displaced,) = inner_displacements([FACE], pictures(FACE, 0.5, ramp=90.0, tilt=20.0), rig(), NOISE)
    assert displaced < 0.02


@pytest.mark.parametrize("face", [FACE, DISC])
def test_another_height_displaces_it_by_the_parallax(face: Face) -> None:
    higher = replace(face, z_mm=face.z_mm + 4.0)
    there, displaced = inner_displacements([face, higher], pictures(face, 10.0), rig(), NOISE)
    assert there < 0.01
    assert displaced == pytest.approx(parallax_px(face, higher) ** 2, rel=0.2)


def test_a_slope_taken_for_level_is_displaced() -> None:
    sloped = replace(FACE, slope_u=0.3)
    (displaced,) = inner_displacements([FACE], pictures(sloped, 10.0), rig(), NOISE)
    end = replace(FACE, z_mm=FACE.z_mm + 0.3 * 0.85 * FACE.length_mm / 2.0)
    assert displaced == pytest.approx(parallax_px(FACE, end) ** 2 / 3.0, rel=0.3)


def test_without_texture_nothing_is_said() -> None:
    higher = replace(FACE, z_mm=FACE.z_mm + 2.0)
    bare, textured = (
        inner_displacements([higher], pictures(FACE, contrast), rig(), NOISE)[0] for contrast in (0.05, 10.0)
    )
    assert bare < 0.3 * textured
    assert inner_displacements([], pictures(FACE, 1.0), rig(), NOISE) == []


def test_what_a_picture_does_not_show_has_no_say() -> None:
    # the right end of the face lies beyond the left picture's border: what is read there is the border, repeated
    _, y, disparity = rig().project_px(FACE.place(np.zeros((1, 2))))
    inwards = rig().points_mm(np.array([SIZE[0] - 6.0]), y, disparity)[0]
    cut = replace(FACE, x_mm=float(inwards[0]), y_mm=float(inwards[1]))
    (displaced,) = inner_displacements([cut], pictures(cut, 10.0), rig(), NOISE)
    assert displaced < 0.02
