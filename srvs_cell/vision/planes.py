"""Step 7: the six parameters of each plane: centre, area, perimeter, short cut, long cut, brightness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.scene import Plane
from srvs_cell.vision.runs import RowRuns

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.vision.parameters import PlaneParameters

_DIAGONAL = float(np.sqrt(2.0))
_LENGTHS = np.array(
    [[0.0, _DIAGONAL / 2, 1.0, _DIAGONAL / 2, 0.0], [0.0, _DIAGONAL / 2, _DIAGONAL, _DIAGONAL / 2, 0.0]]
)
_SHARES = _LENGTHS / np.maximum(np.arange(5), 1)
"""A pixel's share of its region's boundary in a 2x2 window: by whether the opposite pixel is of the region too, and by
how many of the four are."""


def measure_planes(
    grey: NDArray[np.uint8],
    labels: NDArray[np.int32],
    parameters: PlaneParameters,
    valid: NDArray[np.bool_] | None = None,
) -> tuple[NDArray[np.int32], tuple[Plane, ...]]:
    """Find the six parameters of every region and reject the degenerate ones.

    Args:
        grey: uint8, shape (H, W).
        labels: int32, shape (H, W), 0 where there is no region; numbers may be missing.
        parameters: the limits of a plane.
        valid: pixels that belong to the image; all where None.

    Returns:
        Labels 1 to N of the N planes, and the planes.
    """
    runs = RowRuns.of(labels)
    count = int(runs.label.max()) + 1
    length = runs.length
    area = np.bincount(runs.label, weights=length)
    safe_area = np.maximum(area, 1.0)
    centre_x = np.bincount(runs.label, weights=length * 0.5 * (runs.first + runs.last)) / safe_area
    centre_y = np.bincount(runs.label, weights=length * runs.row) / safe_area
    brightness = np.bincount(runs.label, weights=runs.sums(grey)) / safe_area
    windows = BorderWindows.of(labels)
    perimeter = windows.perimeters(count)
    owner, rows, columns = windows.pixels()
    radius2 = np.square(columns - centre_x[owner]) + np.square(rows - centre_y[owner])
    least2, greatest2 = np.full(count, np.inf), np.zeros(count)
    np.minimum.at(least2, owner, radius2)
    np.maximum.at(greatest2, owner, radius2)
    short_cut, long_cut = np.sqrt(least2), np.sqrt(greatest2)
    boxes = _boxes(runs, count)
    cut_off = np.zeros(count, dtype=np.bool_)
    cut_off[labels.ravel()[_frame(labels.shape, valid)]] = True
    good = (
        (area >= parameters.min_area_px)
        & (4.0 * area >= parameters.min_thickness_px * perimeter)
        & (area <= parameters.max_area_share * labels.size)
    )
    good[0] = False
    kept = np.flatnonzero(good)
    number = np.zeros(count, dtype=np.int32)
    number[kept] = np.arange(1, kept.size + 1)
    planes = tuple(
        Plane(
            id=int(number[k]),
            centre_px=(float(centre_x[k]), float(centre_y[k])),
            area_px=float(area[k]),
            perimeter_px=float(perimeter[k]),
            short_cut_px=float(short_cut[k]),
            long_cut_px=float(long_cut[k]),
            brightness=float(brightness[k]),
            box_px=boxes[k],
            touches_border=bool(cut_off[k]),
        )
        for k in kept.tolist()
    )
    return runs.painted(number, labels.shape), planes


@dataclass(frozen=True, eq=False)
class BorderWindows:
    """The windows of 2x2 pixels that hold several labels; beyond the image there is the label -1.

    Attributes:
        row, column: of each window's last pixel, shape (N,).
        corners: the labels, clockwise from the first pixel, so that the third is opposite the first, shape (N,) each.
    """

    row: NDArray[np.intp]
    column: NDArray[np.intp]
    corners: list[NDArray[np.int32]]

    @classmethod
    def of(cls, labels: NDArray[np.int32]) -> BorderWindows:
        """Find the windows of a label image, int32, shape (H, W)."""
        framed = np.asarray(cv2.copyMakeBorder(labels, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=(-1,)), dtype=np.int32)
        flat, width = framed.ravel(), framed.shape[1]
        # a window is mixed where its upper or lower two pixels differ, or its left ones
        across = flat[1:] != flat[:-1]
        mixed = flat[width:] != flat[:-width]
        mixed[:-1] |= across[:-width]
        mixed[:-1] |= across[width:]
        # none begins in the last column
        mixed[width - 1 :: width] = False
        first = np.flatnonzero(mixed)
        row = first // width
        return cls(row, first - row * width, [flat[first + step] for step in (0, 1, width + 1, width)])

    def perimeters(self, count: int) -> NDArray[np.float64]:
        """Return the length of each region's boundary, pixels, shape (count,).

        Every window adds, for each region in it, the length of the boundary that passes through it: 1 where it passes
        straight, half a diagonal where it cuts one corner, a diagonal where it cuts two.
        """
        corners = self.corners
        same = [corners[number] == corners[number - 1] for number in range(len(corners))]
        crossed = [corners[number] == corners[number - 2] for number in (0, 1)]
        total = np.zeros(count + 1)
        for number, corner in enumerate(corners):
            opposite = crossed[number % 2].view(np.uint8)
            members = 1 + same[number].view(np.uint8) + same[number - 3].view(np.uint8) + opposite
            # what lies beyond the image is counted apart
            shares = _SHARES.ravel().take(_SHARES.shape[1] * opposite + members)
            total += np.bincount(corner + 1, weights=shares, minlength=count + 1)
        return total[1:]

    def pixels(self) -> tuple[NDArray[np.int32], NDArray[np.intp], NDArray[np.intp]]:
        """Return label, row and column of the pixels that have a 4-neighbour of another label, or none.

        A pixel is returned once for each such neighbour.
        """
        first, right, _, below = self.corners
        found = []
        # each side between two pixels is the upper or the left one of one window
        for other, down, along in ((right, 0, 1), (below, 1, 0)):
            apart = np.flatnonzero(first != other)
            row, column = self.row[apart] - 1, self.column[apart] - 1
            found += [(first[apart], row, column), (other[apart], row + down, column + along)]
        owner, rows, columns = (np.concatenate(each) for each in zip(*found, strict=True))
        seen = owner >= 0
        return owner[seen], rows[seen], columns[seen]


def _boxes(runs: RowRuns, count: int) -> list[tuple[int, int, int, int]]:
    """Return each label's bounding box (x, y, width, height)."""
    edges = []
    for first, last in ((runs.first, runs.last), (runs.row, runs.row)):
        low = np.full(count, np.iinfo(np.intp).max)
        high = np.full(count, -1)
        np.minimum.at(low, runs.label, first)
        np.maximum.at(high, runs.label, last)
        edges.append((low, high))
    (x0, x1), (y0, y1) = edges
    return list(zip(x0.tolist(), y0.tolist(), (x1 - x0 + 1).tolist(), (y1 - y0 + 1).tolist(), strict=True))


def _frame(shape: tuple[int, ...], valid: NDArray[np.bool_] | None) -> NDArray[np.intp]:
    """Return the numbers of the pixels at the border of the image or of its valid part."""
    usable = np.ones(shape, dtype=np.uint8) if valid is None else valid.view(np.uint8)
    inner = cv2.erode(usable, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.flatnonzero(np.asarray(cv2.subtract(usable, inner), dtype=np.uint8).view(np.bool_))
