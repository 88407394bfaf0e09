"""Step 11e, beyond the paper: how high something rises of which nothing else is known.

Where it rises, the two pictures do not agree on the table. The height on which the most of these pixels agree is that
of its borders; shadow and table around it, which agree on the table and outweigh a part in a correlation, are not
asked.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.vision.recognition.evidence import Evidence
    from srvs_cell.vision.recognition.recovery import Region
    from srvs_cell.vision.relief import Relief

_STEP_PX = 0.25
_AROUND_PX = 3
"""The border of what rises may lie so far outside its region."""
_MOST_PIXELS = 2000
_FEWEST_PIXELS = 30
_MOST_GREY = 10.0
"""A pixel that differs by more is another border's, or hidden in one picture: it counts no more than this."""
_TOLD = 0.8
"""The best height must differ by less than this share of what they usually differ by."""
_UP = np.array([0.0, 0.0, 1.0])


def rising_disparity(region: Region, relief: Relief, evidence: Evidence) -> float | None:
    """Return the disparity that the middle of a region has at the height that suits what rises in it.

    Args:
        region: of the left image; what it shows is taken as level.
        relief: what rises over the table.
        evidence: the images; its limits say how high a part may be.

    Returns:
        The disparity in pixels; None where no height suits clearly better than the others.
    """
    rows, columns = _rising_pixels(region, relief)
    if rows.size < _FEWEST_PIXELS:
        return None
    rig, limits = evidence.rig, evidence.limits
    heights_mm = (evidence.table_z_mm + limits.min_height_mm, evidence.table_z_mm + limits.max_height_mm)
    low, high = (np.array(rig.plane_disparity(_UP, z_mm)) for z_mm in heights_mm)
    middle = np.array([*region.centre_px, 1.0])
    steps = max(2, int(np.ceil(float((high - low) @ middle) / _STEP_PX)) + 1)
    # the disparity plane of a level is linear in the inverse distance, and so is the disparity of the middle
    share = np.linspace(0.0, 1.0, steps, dtype=np.float32)[:, None]
    pixels = np.stack([columns, rows, np.ones_like(rows)]).astype(np.float64)
    at_low, at_high = ((plane @ pixels).astype(np.float32) for plane in (low, high))
    moved = columns.astype(np.float32) - (at_low + share * (at_high - at_low))
    left, right = evidence.fields[0].smooth, evidence.fields[1].smooth
    same_rows = np.broadcast_to(rows.astype(np.float32), moved.shape)
    seen = cv2.remap(right, moved, np.ascontiguousarray(same_rows), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    differs = np.minimum(np.abs(seen - left[rows, columns]), _MOST_GREY).mean(axis=1)
    best = int(differs.argmin())
    if differs[best] > _TOLD * float(np.median(differs)):
        return None
    return float((low + share[best] * (high - low)) @ middle)


def _rising_pixels(region: Region, relief: Relief) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns of what rises in a region and next to it, thinned."""
    size = 2 * _AROUND_PX + 1
    inside = np.pad(region.mask, _AROUND_PX).astype(np.uint8)
    grown = cv2.dilate(inside, np.ones((size, size), np.uint8))
    left, top = region.corner_px[0] - _AROUND_PX, region.corner_px[1] - _AROUND_PX
    height, width = relief.rises.shape
    own = grown[max(0, -top) : height - top, max(0, -left) : width - left]
    rising = relief.rises[max(0, top) :, max(0, left) :][: own.shape[0], : own.shape[1]]
    rows, columns = np.nonzero(own & rising.view(np.uint8))
    step = max(1, rows.size // _MOST_PIXELS)
    return rows[::step] + max(0, top), columns[::step] + max(0, left)
