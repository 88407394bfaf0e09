"""The picture of matched lines, like the paper's Fig. 6 of matched planes: one number and one colour in both images."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

# one look for both methods' pictures
from srvs_cell.vision.overlay import _colour, _label, _text

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.vision.line_support import LineImage
    from srvs_cell.vision.lines import LinePerception

    Picture = NDArray[np.uint8]

_PAPER = (255, 255, 255)
_INK = (40, 40, 40)
_UNMATCHED = (170, 170, 170)
_FADE = 0.6
"""The image is drawn pale, so that the lines stand out."""
_MIN_WIDTH_PX = 900
_BAR_PX = 34
_GAP_PX = 8
_SHIFT = 4
_NUMBERED = 40
"""As many matched lines as have room for a number: the longest."""


def draw_line_matches(perception: LinePerception) -> Picture:
    """Draw both images side by side; a matched line has one colour in both, the 40 longest have a number too.

    Args:
        perception: what the baseline told of one stereo pair.

    Returns:
        BGR, uint8: both images, each at least 900 px wide, under a line of text.
    """
    matches = perception.matches
    length = perception.left.length_px[matches.left]
    numbered = set(np.argsort(-length, kind="stable")[:_NUMBERED].tolist())
    halves = [
        _drawn(image, chosen, numbered, f"{name}: {len(matches)} of {len(image)} lines matched")
        for image, chosen, name in (
            (perception.left, matches.left, "left"),
            (perception.right, matches.right, "right"),
        )
    ]
    gap = np.full((halves[0].shape[0], _GAP_PX, 3), _PAPER, np.uint8)
    return np.hstack([halves[0], gap, halves[1]])


def _drawn(image: LineImage, chosen: NDArray[np.intp], numbered: set[int], title: str) -> Picture:
    """Return one image with its lines; ``chosen`` are the matched ones in the order of the matches."""
    scale = max(1, -(-_MIN_WIDTH_PX // image.grey.shape[1]))
    grey = cv2.resize(image.grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    pale = np.rint((1.0 - _FADE) * grey + _FADE * _PAPER[0]).astype(np.uint8)
    picture = np.asarray(cv2.cvtColor(pale, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    ends = np.stack([image.start_px, image.end_px], axis=1)
    # pixel centres lie on whole numbers, in the enlarged picture too
    ends = (ends + 0.5) * scale - 0.5
    for line in np.setdiff1d(np.arange(len(image)), chosen).tolist():
        _line(picture, ends[line], _UNMATCHED, 1)
    for number, line in enumerate(chosen.tolist()):
        _line(picture, ends[line], _colour(number + 1), 2)
    for number, line in enumerate(chosen.tolist()):
        if number in numbered:
            _label(picture, str(number + 1), ends[line].mean(axis=0), _colour(number + 1))
    bar = np.full((_BAR_PX, picture.shape[1], 3), _PAPER, np.uint8)
    _text(bar, title, (8, 23), _INK, 0.55)
    return np.vstack([bar, picture])


def _line(picture: Picture, ends: Array, colour: tuple[int, int, int], width_px: int) -> None:
    start, end = np.rint(ends * 2**_SHIFT).astype(int).tolist()
    cv2.line(picture, start, end, colour, width_px, cv2.LINE_AA, _SHIFT)
