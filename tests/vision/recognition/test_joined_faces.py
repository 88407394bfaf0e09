"""Which rectangles may be halves of one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from srvs_cell.vision.faces.face import Face, Figure
from srvs_cell.vision.recognition.joined_faces import joined_faces

WHOLE = Face(Figure.RECTANGLE, 600.0, 40.0, 50.0, 0.7, 60.0, 40.0, 0.2)


def halves(share: float = 0.6) -> tuple[Face, Face]:
    """Cut `WHOLE` across its length; the second part is told by other axes than the first."""
    first, second = (
        replace(WHOLE, x_mm=x_mm, y_mm=y_mm, z_mm=z_mm, length_mm=60.0 * part)
        for part, (x_mm, y_mm, z_mm) in zip(
            (share, 1.0 - share), WHOLE.place(np.array([[share - 1.0, 0.0], [share, 0.0]])).tolist(), strict=True
        )
    )
    return first, second.quarter_turned()


def test_two_unlike_halves_are_one_face() -> None:
    ((one, other, face),) = joined_faces(halves())
    assert (one, other) == (0, 1)
    assert face.corners_mm() == pytest.approx(WHOLE.corners_mm())


def test_their_order_does_not_matter() -> None:
    ((_, _, face),) = joined_faces(halves()[::-1])
    ordered = [
        corners[np.lexsort(np.round(corners[:, :2].T, 3))] for corners in (face.corners_mm(), WHOLE.corners_mm())
    ]
    assert ordered[0] == pytest.approx(ordered[1])


def test_parts_of_one_size_in_a_row_stay_two() -> None:
    assert joined_faces(halves(0.5)) == []


@pytest.mark.parametrize(
    "change",
    [
        {"z_mm": 60.0},
        {"width_mm": 32.0},
        {"length_mm": 46.0},
        {"angle_rad": 0.85 + np.pi / 2.0},
        {"x_mm": 608.0},
        {"figure": Figure.CIRCLE},
    ],
)
def test_what_is_not_flush_or_of_one_plane_stays_two(change: dict[str, object]) -> None:
    first, second = halves()
    assert joined_faces([first, replace(second, **change)]) == []  # type: ignore[arg-type]
