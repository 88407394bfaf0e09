"""Step 11e, beyond the paper: where the top faces may come from that explain what rises, the cheapest source first.

Two straight borders in space span a face to a millimetre, one tells all but how far it reaches; a plane that matching
left without a partner may be one; a search for every figure at every height finds what has neither; and where only one
side rises a wedge may be high there. What a source proposes suits edges and grey values; which of the proposals stand
is for `verification` to say.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.faces.profile_fit import REACH, SCOUT
from srvs_cell.vision.faces.witnesses import CONVINCING_PX2
from srvs_cell.vision.recognition.bordered_faces import bordered_faces
from srvs_cell.vision.recognition.high_sides import high_sided_wedges
from srvs_cell.vision.recognition.recovery import find_places
from srvs_cell.vision.recognition.rising_faces import different, fit_rising, fitted
from srvs_cell.vision.recognition.spanned_faces import spanned_faces
from srvs_cell.vision.recognition.top_faces import fit_tops, is_top
from srvs_cell.vision.recognition.tops import rising_test, trusted

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces.edge_fit import FaceFit
    from srvs_cell.vision.faces.face import Face
    from srvs_cell.vision.faces.profile_fit import Effort
    from srvs_cell.vision.faces.witnesses import Bench, Witnesses
    from srvs_cell.vision.recognition.evidence import Evidence
    from srvs_cell.vision.recognition.recovery import Region
    from srvs_cell.vision.recognition.tops import Top
    from srvs_cell.vision.relief import Relief

    Source = Callable[[list[Array], list[Top]], list[Witnesses]]

_LENIENCY = 11.0 / 14.0
"""What rises is a witness already: of `min_support` so much is enough for a face that explains it (0.55 of 0.7)."""
_WEDGES = 8
"""So many wedges of which one side rises are fitted thoroughly."""
_DOUBTED = 2
"""So many faces that the edges do not confirm are asked what else they may be: one may lie beside a true one."""


@dataclass(frozen=True, eq=False)
class Sources:
    """Where top faces may come from that explain what rises, the cheapest first.

    Each takes outlines of what rises in the left image and the tops known so far.

    Attributes:
        planes: of the left image, those without a partner.
        relief: what rises over the table.
        evidence: the images.
        bench: what faces are fitted to.
    """

    planes: Sequence[Region]
    relief: Relief
    evidence: Evidence
    bench: Bench
    _outlines: list[Array] = field(default_factory=list)
    _told: list[Face] = field(default_factory=list)
    _from_borders: list[Witnesses] = field(default_factory=list)

    def from_lines(self, outlines: list[Array], _: list[Top]) -> list[Witnesses]:
        """Return the faces that one or two borders in space tell, where they need no other witness."""
        return [both for both in self._from_ledges(outlines) if both.misfit_px2 < CONVINCING_PX2]

    def from_planes(self, _: list[Array], known: list[Top]) -> list[Witnesses]:
        """Return the planes without a partner that are top faces."""
        rises = rising_test(known, self.relief, self.evidence.rig, self.evidence.table_z_mm)
        placed = find_places([plane for plane in self.planes if rises(plane.outline_px)], self.evidence)
        there = [fit for fit in fit_tops(placed, self.evidence) if fit is not None]
        return self.bench.settled([both for both in self.bench.by_profiles(there) if both is not None])

    def from_search(self, outlines: list[Array], _: list[Top]) -> list[Witnesses]:
        """Return what a search for every figure at every height finds, and all that borders in space tell."""
        rising = fit_rising(outlines, self.relief, self.evidence, self._lenient)
        max_rms_px = self.evidence.limits.max_rms_px
        found = sorted(self._with_edges(rising), key=lambda both: both.price_px2)
        believed = [both for both in found if both.is_believed(max_rms_px)]
        doubted = [both for both in found if not both.is_believed(max_rms_px)]
        asked = [doubted[number] for number in different([both.by_profiles for both in doubted], _DOUBTED)]
        settled = self._lenient.settled(believed + asked)
        return self._from_ledges(outlines) + [both for both in settled if both.is_believed(max_rms_px)]

    def from_high_sides(self, known: list[Top]) -> list[Witnesses]:
        """Return wedges of which only the high side rises, where they need no other witness."""
        starts = high_sided_wedges(trusted(known), self.relief, self.evidence)
        scouted = self._best_wedges(starts, SCOUT)
        fits = self._best_wedges([fit.face for fit in scouted], REACH)
        settled = self.bench.settled(self._with_edges([fit for fit in fits if self.bench.possible(fit)]))
        return [both for both in settled if both.is_inclined and both.misfit_px2 < CONVINCING_PX2]

    def _best_wedges(self, starts: list[Face], effort: Effort) -> list[FaceFit]:
        """Return the few different fits that suit the grey values best."""
        fits = sorted(fitted(starts, self.bench, effort), key=lambda fit: fit.rms_px)
        return [fits[number] for number in different(fits, _WEDGES)]

    def _with_edges(self, fits: list[FaceFit]) -> list[Witnesses]:
        """Return faces that were fitted to the grey values as both witnesses see them, those that have edges."""
        edges = self.bench.by_edges([fit.face for fit in fits])
        return self.bench.together([(one, fit) for one, fit in zip(edges, fits, strict=True) if one is not None])

    def _from_ledges(self, outlines: list[Array]) -> list[Witnesses]:
        """Return the faces that borders tell over these outlines or earlier ones, those that suit the pictures."""
        fresh = [one for one in outlines if not any(np.array_equal(one, other) for other in self._outlines)]
        self._outlines.extend(fresh)
        rig, table_z_mm = self.bench.rig, self.bench.table_z_mm
        new = spanned_faces(self.evidence.ledges, fresh, rig, self._told)
        new += bordered_faces(self.evidence.ledges, fresh, rig, table_z_mm, [*self._told, *new])
        self._told.extend(new)
        found = self._lenient.from_lines(new, self.evidence.limits.max_rms_px)
        kept = different([both.by_profiles for both in found])
        self._from_borders.extend(self._lenient.settled([found[number] for number in kept]))
        return self._from_borders

    @cached_property
    def _lenient(self) -> Bench:
        """What faces are fitted to that may lack more of their outline."""
        limits, table_z_mm = self.evidence.limits, self.evidence.table_z_mm
        limits = replace(limits, min_support=_LENIENCY * limits.min_support)
        return replace(self.bench, possible=lambda fit: is_top(fit, table_z_mm, limits))
