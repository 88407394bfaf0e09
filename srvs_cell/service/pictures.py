"""The plan as a picture: the table from above, the parts, and numbered arrows for the moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_WIDTH_PX, _MARGIN_PX = 900, 60
_PAD_MM = 70.0
_GRID_MM = 50
_PAPER, _GRID, _INK, _PART, _ARROW, _EMPTY = (
    (255, 255, 255),
    (232, 232, 232),
    (60, 60, 60),
    (205, 170, 120),
    (40, 60, 210),
    (140, 160, 140),
)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_ARROW_HEAD_PX = 10.0
_LABEL_GAP_PX = 11
_SHIFT = 4
"""Fractional bits of a curve's points: whole pixels make it waver."""


@dataclass(frozen=True)
class PlanPart:
    """A workpiece as the plan picture shows it; base frame."""

    id: int
    xy_mm: tuple[float, float]
    height_mm: float
    footprint_mm: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class PlanArrow:
    """One move of the plan; base frame."""

    workpiece_id: int
    from_xy_mm: tuple[float, float]
    to_xy_mm: tuple[float, float]


class _Sheet:
    """A drawing surface in millimetres: seen from above: base x upwards, base y to the left."""

    def __init__(self, points_mm: NDArray[np.float64]) -> None:
        self._low = points_mm.min(axis=0) - _PAD_MM
        high = points_mm.max(axis=0) + _PAD_MM
        span = high - self._low
        self._scale = (_WIDTH_PX - 2 * _MARGIN_PX) / span[1]
        self.image = np.full((int(span[0] * self._scale) + 2 * _MARGIN_PX, _WIDTH_PX, 3), 255, np.uint8)
        self._high = high

    def at(self, xy_mm: Sequence[float] | NDArray[np.float64]) -> tuple[int, int]:
        """Return the pixel of a point of the table."""
        column = _MARGIN_PX + (self._high[1] - xy_mm[1]) * self._scale
        row = _MARGIN_PX + (self._high[0] - xy_mm[0]) * self._scale
        return round(column), round(row)

    def text(self, words: str, at_px: tuple[int, int], colour: tuple[int, int, int], size: float = 0.5) -> None:
        """Write words centred at a pixel."""
        (width, height), _ = cv2.getTextSize(words, _FONT, size, 1)
        origin = (at_px[0] - width // 2, at_px[1] + height // 2)
        cv2.putText(self.image, words, origin, _FONT, size, _PAPER, 4, cv2.LINE_AA)
        cv2.putText(self.image, words, origin, _FONT, size, colour, 1, cv2.LINE_AA)

    def grid(self) -> None:
        """Draw the grid and its figures."""
        for axis in (0, 1):
            first = int(np.ceil(self._low[axis] / _GRID_MM)) * _GRID_MM
            for value in range(first, int(self._high[axis]) + 1, _GRID_MM):
                ends = [
                    (value, self._low[1]) if axis == 0 else (self._low[0], value),
                    (value, self._high[1]) if axis == 0 else (self._high[0], value),
                ]
                start, stop = self.at(ends[0]), self.at(ends[1])
                cv2.line(self.image, start, stop, _GRID, 1, cv2.LINE_AA)
                label_at = (stop[0] - 28, start[1]) if axis == 0 else (start[0], start[1] + 16)
                self.text(str(value), label_at, _INK, 0.38)


def draw_plan(parts: Sequence[PlanPart], arrows: Sequence[PlanArrow]) -> NDArray[np.uint8]:
    """Return a BGR picture of the table from above with the moves numbered in order.

    Base x runs upwards and base y to the left, millimetres on the grid. Free places that a move uses are rings.
    """
    points = [part.xy_mm for part in parts] + [end for arrow in arrows for end in (arrow.from_xy_mm, arrow.to_xy_mm)]
    sheet = _Sheet(np.array(points or [(0.0, 0.0)], dtype=np.float64))
    sheet.grid()
    for part in parts:
        corners = np.array([sheet.at(corner) for corner in part.footprint_mm], dtype=np.int32)
        cv2.fillPoly(sheet.image, [corners], _PART, cv2.LINE_AA)
        cv2.polylines(sheet.image, [corners], isClosed=True, color=_INK, thickness=1, lineType=cv2.LINE_AA)
    standing = np.array([part.xy_mm for part in parts], dtype=np.float64).reshape(-1, 2)
    for arrow in arrows:
        if not len(standing) or np.linalg.norm(standing - arrow.to_xy_mm, axis=1).min() > _PAD_MM / 4:
            cv2.circle(sheet.image, sheet.at(arrow.to_xy_mm), 16, _EMPTY, 1, cv2.LINE_AA)
    for number, arrow in enumerate(arrows, start=1):
        start, stop = np.array(sheet.at(arrow.from_xy_mm)), np.array(sheet.at(arrow.to_xy_mm))
        # Bowed to the right of the motion, so that a move there and a move back are two lines.
        middle = (start + stop) / 2 + np.array([-(stop - start)[1], (stop - start)[0]]) * 0.12
        share = np.linspace(0, 1, 24)[:, None]
        curve = (1 - share) ** 2 * start + 2 * share * (1 - share) * middle + share**2 * stop
        fine = np.rint(curve * (1 << _SHIFT)).astype(np.int32)
        cv2.polylines(
            sheet.image, [fine], isClosed=False, color=_ARROW, thickness=2, lineType=cv2.LINE_AA, shift=_SHIFT
        )
        cv2.arrowedLine(
            sheet.image,
            (int(curve[-2, 0]), int(curve[-2, 1])),
            (int(curve[-1, 0]), int(curve[-1, 1])),
            _ARROW,
            2,
            cv2.LINE_AA,
            tipLength=float(
                np.clip(_ARROW_HEAD_PX / max(float(np.linalg.norm(curve[-1] - curve[-2])), 1.0), 0.05, 1.0)
            ),
        )
        label = curve[len(curve) // 2].astype(int)
        cv2.circle(sheet.image, (int(label[0]), int(label[1])), 11, _ARROW, -1, cv2.LINE_AA)
        cv2.putText(
            sheet.image,
            str(number),
            (int(label[0]) - 5 * len(str(number)), int(label[1]) + 5),
            _FONT,
            0.45,
            _PAPER,
            1,
            cv2.LINE_AA,
        )
    for part in parts:
        column = sheet.at(part.xy_mm)[0]
        below = (
            max(sheet.at(corner)[1] for corner in part.footprint_mm) + _LABEL_GAP_PX
        )  # the arrows meet in the middle
        sheet.text(f"{part.id}: {part.height_mm:.0f} mm", (column, below), _INK, 0.45)
    sheet.text("base y / mm, to the left", (_WIDTH_PX // 2, sheet.image.shape[0] - 16), _INK)
    sheet.text("base x / mm, upwards", (100, 20), _INK)
    return sheet.image
