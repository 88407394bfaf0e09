"""Pictures for people: matched planes in both images (the paper's Fig. 6), three-dimensional locations (Fig. 7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array
    from srvs_cell.scene import Perception, PlaneImage, Point3, Workpiece

    Picture = NDArray[np.uint8]
    Colour = tuple[int, int, int]

_FONT = cv2.FONT_HERSHEY_SIMPLEX
_PAPER: Colour = (255, 255, 255)
_INK: Colour = (40, 40, 40)
_FAINT: Colour = (225, 225, 225)
_SOFT: Colour = (140, 140, 140)
_TRUTH: Colour = (60, 60, 220)
_GOLDEN_TURN = 0.618034
_HUES = 180
_SATURATION, _VALUE = 190, 235
_TINT = 0.35
_LABEL_OFFSET_PX = (17.0, -15.0)
_SHIFT = 4
_BAR_PX = 34
_GAP_PX = 8
_MIN_WIDTH_PX = 480
_TOP_VIEW_PX = (620, 560)
_SIDE_VIEW_PX = (620, 260)
_LIST_WIDTH_PX = 500
_MARGIN_PX = 52
_ROW_PX = 26
_GRID_STEPS_MM = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
_GRID_MIN_PX = 55.0
_PADDING_MM = 20.0
_LIST_COLUMNS = ((12, "no"), (52, "kind"), (145, "x"), (215, "y"), (285, "z"), (345, "height"), (420, "yaw"))


def draw_matches(perception: Perception) -> Picture:
    """Draw both images side by side; a matched plane has one number and one colour in both.

    Args:
        perception: what one stereo pair told.

    Returns:
        BGR, uint8: both images, each at least 480 px wide, under a line of text.
    """
    pairs = {(match.left, match.right): number for number, match in enumerate(perception.matches, start=1)}
    left = {plane: number for (plane, _), number in pairs.items()}
    right = {plane: number for (_, plane), number in pairs.items()}
    halves = [
        _numbered(perception.left, left, f"left: {len(left)} of {len(perception.left.planes)} planes matched"),
        _numbered(perception.right, right, f"right: {len(right)} of {len(perception.right.planes)} planes matched"),
    ]
    gap = np.full((halves[0].shape[0], _GAP_PX, 3), 255, np.uint8)
    return np.hstack([halves[0], gap, halves[1]])


def draw_locations(workpieces: Sequence[Workpiece], truth_positions_mm: Sequence[Point3] | None = None) -> Picture:
    """Draw where the workpieces are: the two views of `draw_views`, one above the other, and a list, millimetres.

    Args:
        workpieces: what was recognised; each is labelled with its id.
        truth_positions_mm: true positions in the base frame, drawn as crosses where they are known.

    Returns:
        BGR, uint8.
    """
    views = np.vstack(draw_views(workpieces, truth_positions_mm))
    return np.hstack([views, _list(workpieces, truth=bool(truth_positions_mm), height=views.shape[0])])


def draw_views(
    workpieces: Sequence[Workpiece], truth_positions_mm: Sequence[Point3] | None = None
) -> tuple[Picture, Picture]:
    """Draw where the workpieces are: from above (x, y) and from the side (x, z), millimetres; as `draw_locations`."""
    truth = np.array(truth_positions_mm or [], dtype=np.float64).reshape(-1, 3)
    table_mm = _table_mm(workpieces)
    points = np.concatenate([_extent(workpieces, table_mm), truth]) if workpieces or len(truth) else np.zeros((1, 3))
    low, high = points.min(axis=0) - _PADDING_MM, points.max(axis=0) + _PADDING_MM
    above = _View.fitted((low[0], low[1]), (high[0], high[1]), _TOP_VIEW_PX, ("x", "y"), "from above, mm")
    beside = _View.fitted((low[0], low[2]), (high[0], high[2]), _SIDE_VIEW_PX, ("x", "z"), "from the side, mm")
    picture_above, picture_beside = above.paper(), beside.paper()
    for workpiece in sorted(workpieces, key=lambda one: one.height_mm):
        colour = _colour(workpiece.id + 1)
        outline = above.pixels(workpiece.footprint_mm)
        _fill(picture_above, outline, colour)
        _draw_yaw(picture_above, above, workpiece)
        box = beside.pixels(_side_box(workpiece, table_mm))
        _fill(picture_beside, box, colour)
        position = np.array(workpiece.position_mm)
        for view, picture, axes in ((above, picture_above, (0, 1)), (beside, picture_beside, (0, 2))):
            centre = view.pixels(position[None, axes])[0]
            _dot(picture, centre)
            _label(picture, str(workpiece.id), centre + np.array(_LABEL_OFFSET_PX), colour)
    for position in truth:
        for view, picture, axes in ((above, picture_above, (0, 1)), (beside, picture_beside, (0, 2))):
            x, y = np.rint(view.pixels(position[None, axes])[0]).astype(int)
            cv2.drawMarker(picture, (int(x), int(y)), _TRUTH, cv2.MARKER_CROSS, 13, 1, cv2.LINE_AA)
    return picture_above, picture_beside


@dataclass(frozen=True)
class _View:
    """An orthographic view: which millimetre lies at which pixel."""

    low_mm: tuple[float, float]
    high_mm: tuple[float, float]
    size_px: tuple[int, int]
    axes: tuple[str, str]
    title: str
    scale: float

    @classmethod
    def fitted(
        cls,
        low_mm: tuple[float, float],
        high_mm: tuple[float, float],
        size_px: tuple[int, int],
        axes: tuple[str, str],
        title: str,
    ) -> _View:
        room = (size_px[0] - 2 * _MARGIN_PX, size_px[1] - 2 * _MARGIN_PX)
        scale = min(room[0] / (high_mm[0] - low_mm[0]), room[1] / (high_mm[1] - low_mm[1]))
        return cls(low_mm, high_mm, size_px, axes, title, scale)

    def pixels(self, points_mm: Array) -> Array:
        """Return pixel positions of points, shape (N, 2); the second axis points up."""
        middle = (np.array(self.low_mm) + np.array(self.high_mm)) / 2.0
        offset = (np.asarray(points_mm) - middle) * self.scale
        return np.column_stack([self.size_px[0] / 2.0 + offset[:, 0], self.size_px[1] / 2.0 - offset[:, 1]])

    def paper(self) -> Picture:
        """Return the empty view with grid, numbers and title."""
        width, height = self.size_px
        picture = np.full((height, width, 3), _PAPER, np.uint8)
        step = next((one for one in _GRID_STEPS_MM if one * self.scale >= _GRID_MIN_PX), _GRID_STEPS_MM[-1])
        for axis in (0, 1):
            ticks = np.arange(np.ceil(self.low_mm[axis] / step), np.floor(self.high_mm[axis] / step) + 1) * step
            for tick in ticks:
                self._grid_line(picture, axis, float(tick))
        _text(picture, self.title, (_MARGIN_PX, 26), _INK, 0.55)
        _text(picture, self.axes[0], (width - 24, height - 20), _INK, 0.55)
        _text(picture, self.axes[1], (16, 30), _INK, 0.55)
        cv2.rectangle(picture, (0, 0), (width - 1, height - 1), _FAINT, 1)
        return picture

    def _grid_line(self, picture: Picture, axis: int, tick_mm: float) -> None:
        width, height = self.size_px
        at = self.pixels(np.array([[tick_mm, tick_mm]]))[0]
        place = round(float(at[axis]))
        number = f"{tick_mm + 0.0:g}"
        half = 4 * len(number)
        if axis == 0:
            cv2.line(picture, (place, _MARGIN_PX - 10), (place, height - _MARGIN_PX + 10), _FAINT, 1)
            _text(picture, number, (place - half, height - _MARGIN_PX + 28), _SOFT, 0.42)
        else:
            cv2.line(picture, (_MARGIN_PX - 10, place), (width - _MARGIN_PX + 10, place), _FAINT, 1)
            _text(picture, number, (_MARGIN_PX - 16 - 2 * half, place + 5), _SOFT, 0.42)


def _numbered(image: PlaneImage, numbers: dict[int, int], title: str) -> Picture:
    """Return one image with its matched planes tinted, outlined and numbered, under its title."""
    scale = max(1, -(-_MIN_WIDTH_PX // image.grey.shape[1]))
    labels = np.repeat(np.repeat(image.labels, scale, axis=0), scale, axis=1)
    grey = cv2.resize(image.grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    picture = np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    for plane, number in numbers.items():
        colour = _colour(number)
        mask = labels == plane
        picture[mask] = np.rint((1.0 - _TINT) * picture[mask] + _TINT * np.array(colour)).astype(np.uint8)
        contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, contours, -1, colour, 1, cv2.LINE_AA)
    centres = {plane.id: plane.centre_px for plane in image.planes}
    for plane, number in numbers.items():
        place = _inside(labels == plane, np.array(centres[plane]) * scale)
        _label(picture, str(number), place, _colour(number))
    bar = np.full((_BAR_PX, picture.shape[1], 3), _PAPER, np.uint8)
    _text(bar, title, (8, 23), _INK, 0.55)
    return np.vstack([bar, picture])


def _inside(mask: NDArray[np.bool_], centre: Array) -> Array:
    """Return the centre, or where it lies outside the region (a ring, an L) the region's pixel nearest to it."""
    x, y = np.rint(centre).astype(int)
    if 0 <= y < mask.shape[0] and 0 <= x < mask.shape[1] and mask[y, x]:
        return centre
    rows, columns = np.nonzero(mask)
    if rows.size == 0:
        return centre
    nearest = np.hypot(rows - centre[1], columns - centre[0]).argmin()
    return np.array([columns[nearest], rows[nearest]], dtype=np.float64)


def _extent(workpieces: Sequence[Workpiece], table_mm: float) -> Array:
    """Return points that span all workpieces, shape (N, 3)."""
    spans = [np.zeros((0, 3))]
    for workpiece in workpieces:
        outline = workpiece.footprint_mm
        levels = (table_mm, table_mm + workpiece.height_mm)
        spans += [np.column_stack([outline, np.full(len(outline), z_mm)]) for z_mm in levels]
    return np.concatenate(spans)


def _table_mm(workpieces: Sequence[Workpiece]) -> float:
    """Return the height of the table: what is left below the top of a level workpiece (a wedge's position is lower)."""
    feet = [workpiece.position_mm[2] - workpiece.height_mm for workpiece in workpieces]
    return max(feet, default=0.0)


def _side_box(workpiece: Workpiece, table_mm: float) -> Array:
    x_low, x_high = workpiece.footprint_mm[:, 0].min(), workpiece.footprint_mm[:, 0].max()
    top_mm = table_mm + workpiece.height_mm
    return np.array([[x_low, table_mm], [x_high, table_mm], [x_high, top_mm], [x_low, top_mm]])


def _draw_yaw(picture: Picture, view: _View, workpiece: Workpiece) -> None:
    if workpiece.yaw_deg is None:
        return
    yaw = np.deg2rad(workpiece.yaw_deg)
    half = 0.5 * workpiece.size_mm[0] * np.array([np.cos(yaw), np.sin(yaw)])
    centre = np.array(workpiece.position_mm[:2])
    ends = np.rint(view.pixels(np.array([centre - half, centre + half])) * 2**_SHIFT).astype(int)
    cv2.line(picture, ends[0].tolist(), ends[1].tolist(), _INK, 1, cv2.LINE_AA, _SHIFT)


def _list(workpieces: Sequence[Workpiece], *, truth: bool, height: int) -> Picture:
    picture = np.full((height, _LIST_WIDTH_PX, 3), _PAPER, np.uint8)
    _text(picture, f"{len(workpieces)} workpieces; mm and deg, base frame", (12, 26), _INK, 0.5)
    for x, name in _LIST_COLUMNS:
        _text(picture, name, (x, 56), _SOFT, 0.45)
    for row, workpiece in enumerate(workpieces):
        y = 56 + _ROW_PX * (row + 1)
        if y > height - 2 * _ROW_PX:
            _text(picture, f"and {len(workpieces) - row} more", (12, y), _SOFT, 0.45)
            break
        x_mm, y_mm, z_mm = workpiece.position_mm
        yaw = "-" if workpiece.yaw_deg is None else f"{workpiece.yaw_deg:.1f}"
        values = (workpiece.kind, f"{x_mm:.1f}", f"{y_mm:.1f}", f"{z_mm:.1f}", f"{workpiece.height_mm:.1f}", yaw)
        _label(picture, str(workpiece.id), np.array([24.0, y - 5.0]), _colour(workpiece.id + 1))
        for (x, _), value in zip(_LIST_COLUMNS[1:], values, strict=True):
            _text(picture, value, (x, y), _INK, 0.45)
    if truth:
        cv2.drawMarker(picture, (20, height - 24), _TRUTH, cv2.MARKER_CROSS, 13, 1, cv2.LINE_AA)
        _text(picture, "true position", (34, height - 19), _INK, 0.45)
    return picture


def _colour(number: int) -> Colour:
    """Return a colour that differs much from that of the neighbouring numbers."""
    hue = round((number * _GOLDEN_TURN % 1.0) * _HUES) % _HUES
    pixel = cv2.cvtColor(np.array([[[hue, _SATURATION, _VALUE]]], np.uint8), cv2.COLOR_HSV2BGR)[0, 0]
    return int(pixel[0]), int(pixel[1]), int(pixel[2])


def _fill(picture: Picture, outline_px: Array, colour: Colour) -> None:
    corners = np.rint(outline_px * 2**_SHIFT).astype(np.int32)
    tinted = picture.copy()
    cv2.fillPoly(tinted, [corners], colour, cv2.LINE_AA, _SHIFT)
    cv2.addWeighted(tinted, 0.6, picture, 0.4, 0.0, dst=picture)
    cv2.polylines(picture, [corners], True, tuple(int(0.6 * part) for part in colour), 1, cv2.LINE_AA, _SHIFT)


def _dot(picture: Picture, centre: Array) -> None:
    cv2.circle(picture, (round(float(centre[0])), round(float(centre[1]))), 3, _INK, cv2.FILLED, cv2.LINE_AA)


def _label(picture: Picture, text: str, centre: Array, colour: Colour) -> None:
    (width, height), _ = cv2.getTextSize(text, _FONT, 0.45, 1)
    x, y = round(float(centre[0]) - width / 2.0), round(float(centre[1]) + height / 2.0)
    cv2.rectangle(picture, (x - 4, y - height - 4), (x + width + 3, y + 4), _INK, cv2.FILLED)
    cv2.rectangle(picture, (x - 4, y - height - 4), (x + width + 3, y + 4), colour, 1)
    _text(picture, text, (x, y), _PAPER, 0.45)


def _text(picture: Picture, text: str, place: tuple[int, int], colour: Colour, size: float) -> None:
    cv2.putText(picture, text, place, _FONT, size, colour, 1, cv2.LINE_AA)
