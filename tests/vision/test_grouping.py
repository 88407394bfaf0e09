"""Which regions become one surface, on a face over a bare background."""

from __future__ import annotations

import cv2
import numpy as np

from srvs_cell.scene import PlaneImage, PlaneMatch
from srvs_cell.vision import VisionParameters
from srvs_cell.vision.grouping import group_surfaces
from srvs_cell.vision.planes import measure_planes
from srvs_cell.vision.refinement import GreyPair

HEIGHT, WIDTH, DISPARITY_PX = 120, 160, 10
TOP, LEFT, SIDE_PX = 40, 70, 40
FLOOR = 100


def test_a_bare_background_does_not_belong_to_the_face_whose_edge_bounds_it() -> None:
    texture = cv2.GaussianBlur(np.random.default_rng(0).normal(150.0, 60.0, (SIDE_PX, SIDE_PX)), (0, 0), 1.5)
    images, faces = [], []
    for left in (LEFT, LEFT - DISPARITY_PX):
        image, labels = np.full((HEIGHT, WIDTH), 30.0), np.ones((HEIGHT, WIDTH), np.int32)
        image[TOP : TOP + SIDE_PX, left : left + SIDE_PX] = texture
        # a darker floor below: the background does not end at the face alone
        image[FLOOR:], labels[FLOOR:] = 15.0, 4
        labels[TOP : TOP + SIDE_PX, left : left + SIDE_PX // 2] = 2
        labels[TOP : TOP + SIDE_PX, left + SIDE_PX // 2 : left + SIDE_PX] = 3
        images.append(np.asarray(np.rint(cv2.GaussianBlur(image, (0, 0), 0.7)), dtype=np.uint8))
        faces.append(labels)
    parameters = VisionParameters()
    one, other = (
        PlaneImage(image, *measure_planes(image, labels, parameters.planes))
        for image, labels in zip(images, faces, strict=True)
    )
    plane = (0.0, 0.0, float(DISPARITY_PX))
    halves = [PlaneMatch(half, half, 0.9, plane[2], plane, 0.05) for half in (2, 3)]
    grouping = group_surfaces(one, other, halves, GreyPair.of(*images), parameters)
    (match,) = grouping.matches
    assert grouping.left.planes[match.left - 1].area_px == SIDE_PX**2
    assert abs(match.disparity_px - DISPARITY_PX) < 0.1
