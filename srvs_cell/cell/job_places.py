"""The places that a job is about, journalled: whoever goes on after a hold, a stop or a crash goes on on these."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

from srvs_cell.planning import KeptPlaces

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.scene import Point2

Json = dict[str, Any]


@dataclass(frozen=True)
class JobPlaces:
    """Places of a job that is not finished.

    Attributes:
        begun_by: number of the job that first planned on them.
        run: number of the last job that has.
        points_mm: those that were occupied when it first planned, and of parts that were added since.
        waits_mm: buffer places of its plans, where a part may have been left.
        fewer: how many parts fewer than places there may be: taken away meanwhile, or put where nobody looks.
    """

    begun_by: int
    run: int
    points_mm: tuple[Point2, ...]
    waits_mm: tuple[Point2, ...] = ()
    fewer: int = 0

    def why_given_up(self, standing_mm: Sequence[Point2], tolerance_mm: float) -> str:
        """Return why another job cannot go on on these places, or an empty string.

        As many parts must be there, each where this job can have left it; one may stand elsewhere: the one that was in
        the gripper, which a person may have put anywhere.

        Args:
            standing_mm: where parts stand now.
            tolerance_mm: distance from a place at which a part counts as standing on it.
        """
        count = len(standing_mm)
        if not 0 <= len(self.points_mm) - count <= self.fewer:
            return f"{count} parts are seen, the job was about {len(self.points_mm)}"
        on_place, _ = KeptPlaces((*self.points_mm, *self.waits_mm), tolerance_mm).compare(standing_mm)
        if sum(on_place) < max(1, count - 1):
            return f"{count - sum(on_place)} of {count} parts stand where the job has left none"
        return ""

    def as_json(self) -> Json:
        """Return it for the journal."""
        return {
            "begun_by": self.begun_by,
            "run": self.run,
            "points_mm": [list(point) for point in self.points_mm],
            "waits_mm": [list(point) for point in self.waits_mm],
            "fewer": self.fewer,
        }

    @classmethod
    def from_json(cls, data: Json) -> Self:
        """Return what `as_json` wrote."""
        points_mm, waits_mm = (tuple((float(x), float(y)) for x, y in data[key]) for key in ("points_mm", "waits_mm"))
        return cls(int(data["begun_by"]), int(data["run"]), points_mm, waits_mm, int(data["fewer"]))
