"""Before the steps: whether there is a picture at all, and whether both pictures are of one scene from these poses.

What cannot be seen must not be guessed: a lens cap, a lamp that blinds, two images that were exchanged or belong to
different moves, and poses that are not those of the images have their own alarms instead of a table without parts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.alarms import Alarm, AlarmError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.vision.rectification import RectifiedPair

    Image = NDArray[np.uint8]

_CELL_PX = 8
"""Noise is averaged over squares of this side; anything that is seen covers one."""
_FLAT_GREY = 1.5
_NOISE_GREY = 15.0
"""Standard deviation of white noise that hides every scene."""
_WHITE = 0.8
"""Neighbouring pixels of white noise differ twice by its variance: from this share on a picture is nothing else."""
_PAIR_STRIDE = 4

_UP = np.array([0.0, 0.0, 1.0])
_SCALE = 2
_HALF_BLOCK = 7
"""Half the side of a block, in pixels of the halved image."""
_ROWS = 6
"""How far above and below its row a block is sought, halved pixels."""
_BEYOND = 24
"""How far outside the disparities that the poses allow a block is sought, halved pixels."""
_MARGIN = 2.0
"""What errors of calibration and poses may move a block, halved pixels."""
_ON_ROW = 1.0
_ON_TABLE = 1.5
"""Likewise for what lies on the table; a halved pixel is 20 to 30 mm of height."""
_LEAST_ON_TABLE = 0.1
"""Share of the blocks that is table, its texture, shadows or parts' feet, wherever there are many."""
_ALIKE = 0.8
_STRUCTURE_GREY = 4.0
_STRUCTURE_FACTOR = 4.0
"""Standard deviation of a block, in grey values and in the noise's, from which on it has structure."""
_STRONGEST = 60
"""So many blocks with the most structure are sought at first."""
_FEWEST_BLOCKS = 12
_FOUND = 0.4
"""Share of the blocks that must be found where the poses allow: parts hide some of them, and noise others."""
_TURNED = 2.5
"""Rows by which the left and the right third of the picture differ where one camera is turned about its axis."""
_THIRD = 1.0 / 3.0
_SHARP = 0.02
"""What two rows off its place a block must correlate less: one on a straight edge is found anywhere along the edge."""


def check_picture(grey: Image, name: str) -> None:
    """Refuse a picture that shows nothing.

    Args:
        grey: uint8, shape (H, W).
        name: of the picture, for the message.

    Raises:
        AlarmError: IMAGE_UNUSABLE: of one grey, overexposed, or nothing but noise.
    """
    height, width = grey.shape
    cells = cv2.resize(grey.astype(np.float32), (width // _CELL_PX, height // _CELL_PX), interpolation=cv2.INTER_AREA)
    darkest, brightest, *_ = cv2.minMaxLoc(cells)
    if brightest - darkest <= _FLAT_GREY:
        raise AlarmError(
            Alarm.IMAGE_UNUSABLE, f"The {name} image is of one grey: {darkest:.0f} to {brightest:.0f} of 255."
        )
    rows = grey[::_PAIR_STRIDE].astype(np.float32)
    variance = float(cv2.meanStdDev(rows)[1][0, 0]) ** 2
    steps = cv2.subtract(rows[:, 1:], rows[:, :-1])
    of_noise = cv2.norm(steps, cv2.NORM_L2SQR) / steps.size / 2.0
    if of_noise > _NOISE_GREY**2 and of_noise > _WHITE * variance:
        raise AlarmError(
            Alarm.IMAGE_UNUSABLE, f"The {name} image is noise: {np.sqrt(of_noise):.0f} grey values from pixel to pixel."
        )


def check_different(left: Image, right: Image) -> None:
    """Refuse two copies of one picture: no camera takes the same picture twice, moved or not.

    Raises:
        AlarmError: PAIR_INCONSISTENT.
    """
    if np.array_equal(left, right):
        raise AlarmError(Alarm.PAIR_INCONSISTENT, "The left and the right image are the same picture.")


def check_pair(pair: RectifiedPair, table_z_mm: float, max_height_mm: float) -> None:
    """Refuse rectified pictures that do not show one scene on the table from their poses.

    Blocks with structure are sought in the right picture: they should be on their own rows, between the table's
    disparity and that of the highest part, and some of them, if need be of the fainter ones, on the table. Too few
    blocks tell nothing and pass.

    Args:
        pair: the rectified pictures.
        table_z_mm: height of the table, base frame.
        max_height_mm: greatest height of a part above it.

    Raises:
        AlarmError: PAIR_INCONSISTENT, saying where the blocks were found instead.
    """
    left, right = (
        np.asarray(cv2.pyrDown(image.astype(np.float32)), dtype=np.float32) for image in (pair.left, pair.right)
    )
    least, greatest = (
        np.array(pair.rig.plane_disparity(_UP, z_mm)) for z_mm in (table_z_mm, table_z_mm + max_height_mm)
    )

    def sought(places: list[tuple[int, int]]) -> list[_Sought]:
        found = []
        for x, y in places:
            place = np.array([_SCALE * x, _SCALE * y, 1.0])
            one = _sought(left, right, (x, y), (float(least @ place) / _SCALE, float(greatest @ place) / _SCALE))
            if one is not None:
                found.append(one)
        return found

    places = _structured(left, pair)
    found = sought(places[:_STRONGEST])
    if len(found) < _FEWEST_BLOCKS:
        return
    seen = [one for one in found if one.alike >= _ALIKE]
    agreeing = [one for one in seen if one.agrees]
    enough = len(agreeing) >= _FOUND * len(found) and abs(_turn(seen, left.shape[1])) < _TURNED
    if enough and not _shows_table(agreeing):
        # on a crowded table the strongest structure is the parts' alone
        fainter = sought(places[_STRONGEST:])
        found += fainter
        seen += [one for one in fainter if one.alike >= _ALIKE]
        agreeing = [one for one in seen if one.agrees]
    if enough and _shows_table(agreeing):
        return
    on_table = sum(one.on_table for one in agreeing)
    detail = f"Of {len(found)} places with structure {len(agreeing)} are found where the poses allow"
    if len(seen) < _FOUND * len(found):
        detail += ", and most are found nowhere: exchanged images, or images of different scenes."
    else:
        rows = float(np.median([one.row for one in seen])) * _SCALE
        above = float(np.median([one.above for one in seen])) * _SCALE
        detail += (
            f", {on_table} on the table; the disparities are {above:+.0f} px off the table's, the rows {rows:+.0f} px, "
            f"{_SCALE * _turn(seen, left.shape[1]):+.0f} px from left to right: exchanged images, or poses or a table "
            "height that are not theirs."
        )
    raise AlarmError(Alarm.PAIR_INCONSISTENT, detail)


@dataclass(frozen=True)
class _Sought:
    """The best place of a block in the right picture; lengths in halved pixels.

    Attributes:
        alike: correlation there.
        row: rows below its own.
        sharp: whether the row is sure.
        x: column of the block.
        above: disparity less that of the table.
        highest: what that may be at most.
    """

    alike: float
    row: float
    sharp: bool
    x: float
    above: float
    highest: float

    @property
    def agrees(self) -> bool:
        """Whether it is where the poses allow."""
        return abs(self.row) <= _ON_ROW and -_MARGIN <= self.above <= self.highest + _MARGIN

    @property
    def on_table(self) -> bool:
        """Whether it is where the table is."""
        return abs(self.above) <= _ON_TABLE


def _shows_table(agreeing: list[_Sought]) -> bool:
    """Whether enough of the blocks that are where the poses allow are table; a few need not."""
    on_table = sum(one.on_table for one in agreeing)
    return len(agreeing) < _FEWEST_BLOCKS or on_table >= _LEAST_ON_TABLE * len(agreeing)


def _turn(seen: list[_Sought], width: int) -> float:
    """Return by how many rows blocks lie lower in the right third of the picture than in the left one, 0 if unknown."""
    left = [one.row for one in seen if one.sharp and one.x < _THIRD * width]
    right = [one.row for one in seen if one.sharp and one.x > (1.0 - _THIRD) * width]
    return float(np.median(right) - np.median(left)) if left and right else 0.0


def _structured(left: NDArray[np.float32], pair: RectifiedPair) -> list[tuple[int, int]]:
    """Return the centres (x, y) of the blocks with structure in the halved left picture, those with the most first."""
    side = 2 * _HALF_BLOCK + 1
    mean = cv2.blur(left, (side, side))
    deviation = np.sqrt(np.maximum(cv2.blur(left * left, (side, side)) - mean * mean, 0.0))
    fine = left - cv2.GaussianBlur(left, (3, 3), 0.0)
    noise = float(np.median(np.abs(fine)))
    centres = np.s_[_HALF_BLOCK + _ROWS :: side]
    seen = cv2.erode(pair.left_valid.astype(np.uint8), np.ones((2 * side, 2 * side), np.uint8), borderValue=0)
    grid = deviation[centres, centres] * (seen[::_SCALE, ::_SCALE][centres, centres] > 0)
    enough = max(_STRUCTURE_GREY, _STRUCTURE_FACTOR * noise)
    rows, columns = np.nonzero(grid >= enough)
    best = np.argsort(-grid[rows, columns], kind="stable")
    start = _HALF_BLOCK + _ROWS
    return [(start + side * int(columns[k]), start + side * int(rows[k])) for k in best]


def _sought(
    left: NDArray[np.float32], right: NDArray[np.float32], centre: tuple[int, int], disparities: tuple[float, float]
) -> _Sought | None:
    """Return where a block is found; None where the right picture does not show where it should be."""
    x, y = centre
    height, width = right.shape
    least, greatest = disparities
    low = int(np.floor(x - greatest)) - _BEYOND - _HALF_BLOCK
    high = int(np.ceil(x - least)) + _BEYOND + _HALF_BLOCK + 1
    top, bottom = y - _HALF_BLOCK - _ROWS, y + _HALF_BLOCK + _ROWS + 1
    if x - greatest < _HALF_BLOCK or x - least >= width - _HALF_BLOCK or top < 0 or bottom > height:
        return None
    low, high = max(low, 0), min(high, width)
    block = left[y - _HALF_BLOCK : y + _HALF_BLOCK + 1, x - _HALF_BLOCK : x + _HALF_BLOCK + 1]
    scores = np.asarray(cv2.matchTemplate(right[top:bottom, low:high], block, cv2.TM_CCOEFF_NORMED))
    row, column = (int(index) for index in np.unravel_index(int(scores.argmax()), scores.shape))
    by_row = scores.max(axis=1)
    alike, off = float(by_row[row]), np.abs(np.arange(by_row.size) - row) > 1
    # what is likest in the last row may be liker beyond it
    sharp = bool(alike - by_row[off].max() > _SHARP) and 0 < row < by_row.size - 1
    disparity = x - (low + column + _HALF_BLOCK)
    return _Sought(alike, float(row - _ROWS), sharp, float(x), disparity - least, greatest - least)
