"""A plan as a picture: the table from above, as SVG text. Base frame, x to the right, y up, millimetres."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape

from srvs_cell.planning.problem import Disc, Rectangle
from srvs_cell.scene import PlaceKind

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.planning.problem import Footprint, Problem
    from srvs_cell.scene import Move, Point2

_STYLE = (
    "text{font-family:sans-serif;text-anchor:middle;dominant-baseline:central;"
    "paint-order:stroke;stroke:#fff;stroke-width:2}"
    ".start{fill:#cfe3f5;stroke:#1f5c99}.end{fill:none;stroke:#1f5c99;stroke-dasharray:4 3}"
    ".obstacle{fill:#999;stroke:#444}.place{fill:none;stroke:#888;stroke-width:.6}"
    ".far{stroke:#b00;stroke-dasharray:2 2}.move{fill:none;stroke:#c4511b;stroke-width:1.5}"
    ".number{fill:#c4511b;font-weight:bold}.home{fill:#c4511b}"
)
_WIDTH_PX = 900
_MARGIN = 0.08
_LEAST_SPAN_MM = 100.0
_TEXT = 0.022
"""Size of letters, as a part of the picture's longer side."""


def plan_svg(problem: Problem, moves: Sequence[Move], title: str) -> str:
    """Draw a problem and its plan.

    Objects are filled where they start and dashed where they end; moves are numbered arrows; obstacles are grey,
    places that are out of reach red, bins squares.

    Args:
        problem: the problem.
        moves: the plan's moves in order; may be empty.
        title: what the picture is called.

    Returns:
        the text of an SVG file.
    """
    low, high = _bounds(problem)
    width, height = high[0] - low[0], high[1] - low[1]
    letter = _TEXT * max(width, height)
    ends = {item.id: item.start for item in problem.objects} | {move.object: move.to_place for move in moves}
    parts = [_shape(o.footprint, (o.x_mm, o.y_mm), "obstacle") for o in problem.obstacles]
    parts += [_place_mark(problem, place, letter) for place in range(len(problem.places))]
    for item in problem.objects:
        parts.append(_shape(item.footprint, _point(problem, item.start), "start"))
        if ends[item.id] != item.start:
            parts.append(_shape(item.at(ends[item.id]).footprint, _point(problem, ends[item.id]), "end"))
    # Names and arrows come last: nothing hides them.
    for number, move in enumerate(moves, start=1):
        parts += _arrow(_point(problem, move.from_place), _point(problem, move.to_place), number, letter)
    parts += [_text(_point(problem, item.start), str(item.id), letter, "name", item.name) for item in problem.objects]
    home = problem.home_mm
    parts.append(f'<circle class="home" cx="{home[0]:.1f}" cy="{-home[1]:.1f}" r="{letter / 2:.1f}"/>')
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{low[0]:.1f} {-high[1]:.1f} {width:.1f} {height:.1f}" '
        f'width="{_WIDTH_PX}" height="{_WIDTH_PX * height / width:.0f}">'
        f'<title>{escape(title)}</title><style>{_STYLE}</style><defs><marker id="tip" viewBox="0 0 8 8" '
        'refX="7" refY="4" markerWidth="6" markerHeight="6" orient="auto"><path d="M0 0L8 4L0 8z" fill="#c4511b"/>'
        "</marker></defs>"
    )
    return "\n".join([head, *parts, "</svg>", ""])


def _point(problem: Problem, place: int) -> Point2:
    return problem.places[place].x_mm, problem.places[place].y_mm


def _bounds(problem: Problem) -> tuple[Point2, Point2]:
    """Return the picture's lower and upper corner: all points, and the widest shape around each."""
    shapes = [item.footprint for item in problem.objects] + [obstacle.footprint for obstacle in problem.obstacles]
    reach = max((max(map(abs, corner)) for shape in shapes for corner in _corners(shape)), default=0.0)
    points = [(place.x_mm, place.y_mm) for place in problem.places] + [problem.home_mm]
    points += [(obstacle.x_mm, obstacle.y_mm) for obstacle in problem.obstacles]
    lows = [min(point[axis] for point in points) - reach for axis in (0, 1)]
    highs = [max(point[axis] for point in points) + reach for axis in (0, 1)]
    margin = _MARGIN * max(highs[0] - lows[0], highs[1] - lows[1], _LEAST_SPAN_MM)
    return (lows[0] - margin, lows[1] - margin), (highs[0] + margin, highs[1] + margin)


def _corners(shape: Footprint) -> Sequence[Point2]:
    if isinstance(shape, Disc):
        return ((shape.radius_mm, shape.radius_mm),)
    if isinstance(shape, Rectangle):
        x, y = shape.half_x_mm, shape.half_y_mm
        return ((-x, -y), (x, -y), (x, y), (-x, y))
    return shape.vertices_mm


def _shape(shape: Footprint, at: Point2, kind: str) -> str:
    if isinstance(shape, Disc):
        return f'<circle class="{kind}" cx="{at[0]:.1f}" cy="{-at[1]:.1f}" r="{shape.radius_mm:.1f}"/>'
    corners = " ".join(f"{at[0] + x:.1f},{-at[1] - y:.1f}" for x, y in _corners(shape))
    return f'<polygon class="{kind}" points="{corners}"/>'


def _place_mark(problem: Problem, place: int, letter: float) -> str:
    spot = problem.places[place]
    kind = "place" if spot.reachable else "place far"
    if spot.kind is PlaceKind.BIN:
        mark = (
            f'<rect class="{kind}" x="{spot.x_mm - letter:.1f}" y="{-spot.y_mm - letter:.1f}" width="{2 * letter:.1f}" '
            f'height="{2 * letter:.1f}">'
        )
        end = "</rect>"
    else:
        mark = f'<circle class="{kind}" cx="{spot.x_mm:.1f}" cy="{-spot.y_mm:.1f}" r="{letter / 2:.1f}">'
        end = "</circle>"
    reach = "" if spot.reachable else ", out of reach"
    return f"{mark}<title>place {place}: {spot.kind.value}{reach}</title>{end}"


def _text(at: Point2, text: str, size: float, kind: str, title: str) -> str:
    return (
        f'<text class="{kind}" x="{at[0]:.1f}" y="{-at[1]:.1f}" font-size="{size:.1f}">{escape(text)}'
        f"<title>{escape(title)}</title></text>"
    )


def _arrow(begin: Point2, end: Point2, number: int, letter: float) -> list[str]:
    """Return a bent arrow, so that a way there and a way back do not lie on each other, and its number."""
    middle = (
        (begin[0] + end[0]) / 2 + 0.12 * (end[1] - begin[1]),
        (begin[1] + end[1]) / 2 - 0.12 * (end[0] - begin[0]),
    )
    # The number stands on the bend: half way between the chord and the point that the curve is drawn to.
    on_curve = ((begin[0] + end[0]) / 4 + middle[0] / 2, (begin[1] + end[1]) / 4 + middle[1] / 2)
    # Both ends leave room for a name.
    begin, end = (_towards(point, middle, letter) for point in (begin, end))
    path = (
        f'<path class="move" marker-end="url(#tip)" d="M{begin[0]:.1f} {-begin[1]:.1f}Q{middle[0]:.1f} '
        f'{-middle[1]:.1f} {end[0]:.1f} {-end[1]:.1f}"/>'
    )
    return [path, _text(on_curve, str(number), letter, "number", f"move {number}")]


def _towards(point: Point2, other: Point2, by_mm: float) -> Point2:
    """Return a point moved towards another one, half-way at most."""
    part = min(by_mm / max(math.dist(point, other), by_mm), 0.5)
    return point[0] + part * (other[0] - point[0]), point[1] + part * (other[1] - point[1])
