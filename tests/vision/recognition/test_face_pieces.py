"""Pieces of a picture that may be the face which an outline of what rises is of."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from srvs_cell.scene import PlaneImage
from srvs_cell.vision.recognition.face_pieces import face_pieces, plane_hulls, round_pieces
from tests.vision.painted import SIZE, TABLE_Z_MM, cuboid, cylinder, outline_mm, paint, planes, rig

WHOLE = np.array([[200.0, 100.0], [460.0, 100.0], [460.0, 360.0], [200.0, 360.0]])
MAX_SIZE_MM = 160.0


def blank() -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    noisy = np.random.default_rng(5).normal(110.0, 1.5, (SIZE[1], SIZE[0]))
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("grey", [104, 150])
def test_a_round_border_is_found_whatever_is_printed_inside(grey: int) -> None:
    part = cylinder(500.0, 60.0, 50.0, 44.0, grey)
    label = cuboid(500.0, 60.0, 50.0, 20.0, (22.0, 16.0), 40)
    left, _ = paint([part, label], rig())
    x, y, _ = rig().project_px(outline_mm(part))
    middle, radius = np.array([x.mean(), y.mean()]), float(np.ptp(x)) / 2.0
    around = middle + 1.6 * radius * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    found = face_pieces(left.astype(np.float32), around, ())
    assert min(np.linalg.norm(one.mean(axis=0) - middle) for one in found) < 3.0
    assert min(abs(np.linalg.norm(one - one.mean(axis=0), axis=1).mean() - radius) for one in found) < 3.0


def test_where_nothing_is_round_nothing_is_found() -> None:
    assert round_pieces(blank().astype(np.float32), WHOLE) == []


def test_a_plane_reaches_beyond_the_part_of_it_that_rises_but_no_table_does() -> None:
    part = cuboid(500.0, 60.0, 30.0, 20.0, (60.0, 40.0), 170)
    cameras = rig()
    images = paint([part], cameras)
    left = images[0].astype(np.float32)
    image, _, _ = planes([part], cameras, images, disparity_noise_px=0.0)
    x, y, _ = cameras.project_px(outline_mm(part))
    face = np.column_stack([x, y])
    strip = face[[0, 1]]
    strip = np.concatenate([strip, strip[::-1] + 0.2 * (face[[2, 3]] - strip[::-1])])
    hulls = plane_hulls(image, cameras, TABLE_Z_MM, MAX_SIZE_MM)
    (hull,) = hulls
    assert cv2.contourArea(hull) == pytest.approx(cv2.contourArea(face.astype(np.float32)), rel=0.1)
    assert any(np.array_equal(piece, hull) for piece in face_pieces(left, strip, hulls))
    assert plane_hulls(image, cameras, TABLE_Z_MM, 20.0) == []
    away = strip + np.array([150.0, 100.0])
    assert not any(np.array_equal(piece, hull) for piece in face_pieces(left, away, hulls))


def test_planes_of_no_picture_make_no_pieces() -> None:
    nothing = PlaneImage(blank(), np.zeros((SIZE[1], SIZE[0]), np.int32), ())
    assert plane_hulls(nothing, rig(), TABLE_Z_MM, MAX_SIZE_MM) == []
