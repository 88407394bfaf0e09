"""Step 11b, beyond the paper: at a glance, how much of a face's outline lies on edges of both images."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.faces.outlines import Outlines, batches

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces.edge_fit import EdgeField
    from srvs_cell.vision.faces.face import Face
    from srvs_cell.vision.rectification import RectifiedRig

_SAMPLES = 36
_BESIDE_PX = np.arange(-2.0, 2.5, 1.0, dtype=np.float32)
_CLEAR_GRADIENT = 2.0
"""Grey values per pixel: steeper edges count no more."""


def shares_on_edges(faces: Sequence[Face], fields: tuple[EdgeField, EdgeField], rig: RectifiedRig) -> Array:
    """Return how much of each face's outline lies within two pixels of edges of both images, 0 to 1, shape (N,).

    Each place counts by the fainter of its two edges; a face that is not in front of the cameras has no share.
    """
    shares = np.zeros(len(faces))
    for some in batches(len(faces), _SAMPLES):
        batch = faces[some]
        outlines = Outlines.of(batch, [False] * len(batch), _SAMPLES, equal_sides=True)
        borders = outlines.seen(rig)
        steepest = [
            np.abs(field.along_normals(points, normals, _BESIDE_PX)).max(axis=0)
            for field, points, normals in zip(fields, borders.points_px, borders.normals, strict=True)
        ]
        on_edges = np.minimum(np.minimum(*steepest) / _CLEAR_GRADIENT, 1.0).mean(axis=1)
        shares[some] = np.where(borders.in_front, on_edges, 0.0)
    return shares
