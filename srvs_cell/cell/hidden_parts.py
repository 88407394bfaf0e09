"""Parts that only the look from the other place shows: what this look cannot see has not gone away."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from srvs_cell.planning import footprint_centroid_mm

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from srvs_cell.scene import Workpiece


def with_hidden(
    seen: Sequence[Workpiece],
    other: Sequence[Workpiece],
    in_every_look: Callable[[Workpiece], bool],
    tolerance_mm: float,
) -> tuple[Workpiece, ...]:
    """Return what a look saw, and what only one from another place can have seen.

    Args:
        seen: by this look.
        other: by the last look from the other place; nothing was moved since.
        in_every_look: whether the pictures from both places show the whole of a part.
        tolerance_mm: distance within which two sightings are of one part.
    """
    places = [footprint_centroid_mm(part.footprint_mm) for part in seen]
    hidden = [
        part
        for part in other
        if not in_every_look(part)
        and all(math.dist(footprint_centroid_mm(part.footprint_mm), place) > tolerance_mm for place in places)
    ]
    first = max((part.id for part in seen), default=-1) + 1
    return (*seen, *(replace(part, id=number) for number, part in enumerate(hidden, start=first)))
