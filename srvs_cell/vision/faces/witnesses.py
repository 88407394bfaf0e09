"""Step 11d, beyond the paper: a face fitted to the edges and to the grey values, and what the two make of it.

Both see the same borders in different ways: edges are exact where they are clear, the grey values tell faint borders
and slivers of side faces. Together they judge which of several figures a face is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.vision.faces.edge_fit import SETTLE, fit_faces
from srvs_cell.vision.faces.face import share_place
from srvs_cell.vision.faces.glance import shares_on_edges
from srvs_cell.vision.faces.inner_texture import inner_displacements
from srvs_cell.vision.faces.other_sides import other_rectangles
from srvs_cell.vision.faces.profile_fit import fit_profiles

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from srvs_cell.geometry import Array
    from srvs_cell.vision.faces.edge_fit import EdgeField, FaceFit
    from srvs_cell.vision.faces.face import Face
    from srvs_cell.vision.faces.profiles import Pictures
    from srvs_cell.vision.rectification import RectifiedRig

CONVINCING_PX2 = 0.6
"""A face whose misfit is less needs no search, and what lies in it is print."""
_GOOD_RMS_PX = 0.65
"""A fit to the grey values that is as good as this counts, however good that to the edges is.

It reads more of the picture, so that its misfit is larger where the place is right.
"""
_BY_EDGES, _BY_PROFILES, _BY_INSIDE = 0.75, 1.25, 3.0
"""What counts how much in the misfit: the grey values read more of the picture than the edges, and what displaces all
of the inside is more than what displaces some of the border."""
_INSIDE_TELLS_PX2 = 0.1
"""Where the inside is displaced by so much less if the face is where one fit has it, that fit is right."""
_WITNESS_RMS_PX = 0.25
"""Edges that fit so well count half against the grey values."""
_UNDOUBTED_RMS_PX = 0.4
"""A fit to the grey values that is as good as this needs no edges: shadow and side faces beside a face may have its."""
_BELIEVED_PX2 = 1.5
"""A face whose misfit is less is believed even where its edges and its grey values each are a little too far off."""
_STRAY_RMS_PX = 0.5
"""Where the edges fit worse than this, and worse than the grey values, they may be another border's."""
_ALL_SEEN = 0.85
"""Grey values that see less of an outline, a side less, do not speak against a figure that fits well."""
SIDE_UNSEEN = 0.77
"""Where neither fit sees more of an outline, nobody knows where one side is."""
_LEAST_SHARE, _LEAST_OF_BEST = 0.6, 0.65
"""Share of a spanned face's outline on edges, and that over the best face's, below which no fit was ever believed."""
_LOST_RMS_PX = 2.0
"""Where the edges fit worse they are another border's, and the face is not there."""
_DOUBTFUL_PX2 = 0.2
"""A rectangle whose misfit is less is not asked what else it may be."""
_CLEAR_GAIN = 0.7
"""Another rectangle must have less than this share of the misfit."""
_INCLINED_GAIN = 0.93
"""An inclined rectangle must suit better than the level one by more than its one parameter more does."""
_LEVEL_SLOPE = 0.05
"""Edges that fit well and show less rise per millimetre speak for a level face."""
_SLACK_PX = 0.05
"""By this much more a fit may miss by chance."""
_TWIN_SLACK_PX = 0.12
"""The same for the grey values of a level and of an inclined figure: a slope takes more of them with it."""
_RIVALRY = 4
"""With this power of the ratio of their misfits a figure that suits worse counts."""
_HOPELESS_RATIO = 3.0
"""A face that suits worse than another at its place by more is not asked what else it may be."""
_ROUNDS = 2
"""What suits better is asked again what else it may be, so often at most."""


@dataclass(frozen=True, eq=False)
class Witnesses:
    """One face as both fits see it.

    Attributes:
        by_edges: fitted to the edges.
        by_profiles: fitted to the grey values across the outline.
        inner_px2: by how much the inside is displaced between the pictures, mean square, if the face is as by_profiles.
        edges_inner_px2: the same if it is as by_edges.
        twin: the inclined rectangle that a level one may be, or the other way round; None where that was not asked.
    """

    by_edges: FaceFit
    by_profiles: FaceFit
    inner_px2: float
    edges_inner_px2: float
    twin: Witnesses | None = None

    @property
    def is_inclined(self) -> bool:
        """Whether the figure's slope is free."""
        return self.by_profiles.face.slope_u != 0.0

    @property
    def misfit_px2(self) -> float:
        """How badly the figure suits border and inside, to compare figures at one place."""
        borders_px2 = _BY_EDGES * self.by_edges.rms_px**2 + _BY_PROFILES * self.by_profiles.rms_px**2
        return borders_px2 + _BY_INSIDE * self.inner_px2

    @property
    def price_px2(self) -> float:
        """The misfit, and for an inclined figure what the slope may have gained by chance."""
        if not self.is_inclined:
            return self.misfit_px2
        edges = self.by_edges
        level_edges = edges.rms_px < _WITNESS_RMS_PX and abs(edges.face.slope_u) < _LEVEL_SLOPE
        return self.misfit_px2 / (_CLEAR_GAIN if level_edges else _INCLINED_GAIN)

    def suits_better(self, other: Witnesses, gain: float) -> bool:
        """Whether the price is less than a share of another figure's, and neither witness speaks against it."""
        slack_px = _SLACK_PX if self.is_inclined == other.is_inclined else _TWIN_SLACK_PX
        most_px = other.by_profiles.rms_px + slack_px
        if other.by_profiles.support < _ALL_SEEN:
            most_px = max(most_px, _GOOD_RMS_PX)
        return (
            self.price_px2 < gain * other.price_px2
            and self.by_edges.rms_px <= other.by_edges.rms_px + _SLACK_PX
            and self.by_profiles.rms_px <= most_px
        )

    def is_believed(self, max_rms_px: float) -> bool:
        """Whether the edges confirm what the grey values say, or these leave nothing to confirm, or both little.

        Part of a face may explain the grey values along itself, but it has no edges of its own.
        """
        undoubted = self.by_edges.rms_px <= max_rms_px or self.by_profiles.rms_px <= _UNDOUBTED_RMS_PX
        return undoubted or self.misfit_px2 <= _BELIEVED_PX2

    def may_yield_to(self, by_edges: FaceFit) -> bool:
        """Whether a figure fitted to the edges may suit better or be the twin, whatever the grey values say."""
        as_inclined = (by_edges.face.slope_u != 0.0) == self.is_inclined
        most_px = self.by_edges.rms_px + _SLACK_PX if as_inclined else np.inf
        return by_edges.rms_px <= most_px and by_edges.rms_px**2 <= self.misfit_px2

    def agreed(self) -> FaceFit:
        """Return the better of both fits: the one the inside speaks for, else that to the grey values if it is good.

        Its ``rms_px`` is the less of both, with what the inside contradicts, its ``support`` the greater. Where they
        disagree, or neither sees all sides, neither is surer than that. Edges that do not fit well are a weaker witness
        against the grey values. A face that may as well be inclined, or level, is no surer than the height of the part.
        """
        edges, profiles = self.by_edges, self.by_profiles
        told_px2 = self.edges_inner_px2 - self.inner_px2
        inside_tells = abs(told_px2) > _INSIDE_TELLS_PX2
        grey_values = told_px2 > 0.0 if inside_tells else profiles.rms_px <= max(_GOOD_RMS_PX, edges.rms_px)
        weight = 1.0 / (1.0 + (edges.rms_px / _WITNESS_RMS_PX) ** 2) if grey_values else 1.0
        apart_mm = _centre(edges.face) - _centre(profiles.face)
        surer = min((edges, profiles), key=lambda fit: float(np.trace(fit.covariance_mm2)))
        agreed = profiles if grey_values else edges
        covariance_mm2 = surer.covariance_mm2 + weight * np.outer(apart_mm, apart_mm)
        if self.twin is not None:
            share = self._share(self.twin)
            higher_mm = self.twin.by_profiles.face.highest_mm - agreed.face.highest_mm
            covariance_mm2[2, 2] += share / (1.0 + share) * higher_mm**2
        support = max(edges.support, profiles.support)
        if support < SIDE_UNSEEN:
            reach_mm = (1.0 - support) * max(agreed.face.length_mm, agreed.face.width_mm) / 2.0
            covariance_mm2[(0, 1), (0, 1)] += reach_mm**2
        inner_px2 = self.inner_px2 if grey_values else self.edges_inner_px2
        rms_px = float(np.hypot(min(profiles.rms_px, edges.rms_px), np.sqrt(inner_px2)))
        return replace(agreed, rms_px=rms_px, covariance_mm2=covariance_mm2, support=support)

    def agreed_among(self, rivals: Sequence[Witnesses]) -> FaceFit:
        """Return the same, no surer than how far other figures for this place that suit about as well lie from it."""
        fit = self.agreed()
        shares = [self._share(rival) for rival in rivals]
        apart_mm = [_centre(rival.agreed().face) - _centre(fit.face) for rival in rivals]
        spread = sum(
            (share * np.outer(one, one) for share, one in zip(shares, apart_mm, strict=True)), np.zeros((3, 3))
        )
        return replace(fit, covariance_mm2=fit.covariance_mm2 + spread / (1.0 + sum(shares)))

    def _share(self, rival: Witnesses) -> float:
        return min(1.0, self.misfit_px2 / rival.misfit_px2) ** _RIVALRY


@dataclass(frozen=True, eq=False)
class Bench:
    """What a face is fitted to.

    Attributes:
        pictures: the rectified images.
        fields: their gradients.
        rig: the rectified cameras.
        table_z_mm: height of the table, base frame.
        min_gradient: least gradient of an edge, grey values per pixel.
        possible: whether a fit may be a part's top face.
    """

    pictures: Pictures
    fields: tuple[EdgeField, EdgeField]
    rig: RectifiedRig
    table_z_mm: float
    min_gradient: float
    possible: Callable[[FaceFit], bool]

    def by_profiles(self, fits: Sequence[FaceFit]) -> list[Witnesses | None]:
        """Fit faces that were fitted to the edges to the grey values; None where there is no possible fit."""
        faces = [fit.face for fit in fits]
        inclined = [_is_sloped(face) for face in faces]
        seen = fit_profiles(faces, inclined, self.pictures, self.rig, self.table_z_mm)
        there = {
            number: (edges, fit)
            for number, (edges, fit) in enumerate(zip(fits, seen, strict=True))
            if fit is not None and self.possible(fit)
        }
        witnesses = dict(zip(there, self.together(list(there.values())), strict=True))
        return [witnesses.get(number) for number in range(len(fits))]

    def together(self, fits: Sequence[tuple[FaceFit, FaceFit]]) -> list[Witnesses]:
        """Return faces, each fitted to the edges and to the grey values, with what their insides say."""
        fits = self._sought_again(fits)
        faces = [fit.face for both in zip(*fits, strict=True) for fit in both]
        inner = inner_displacements(faces, self.fields, self.rig, self.pictures.noise)
        by_edges, by_profiles = inner[: len(fits)], inner[len(fits) :]
        return [
            Witnesses(*both, *inside)
            for both, inside in zip(fits, zip(by_profiles, by_edges, strict=True), strict=True)
        ]

    def _sought_again(self, fits: Sequence[tuple[FaceFit, FaceFit]]) -> list[tuple[FaceFit, FaceFit]]:
        """Return the fits; edges that led astray are sought again from where the grey values have the face."""
        sought = list(fits)
        stray = [
            number
            for number, (edges, profiles) in enumerate(fits)
            if edges.rms_px > _STRAY_RMS_PX and profiles.rms_px <= min(edges.rms_px, _GOOD_RMS_PX)
        ]
        again = self.by_edges([fits[number][1].face for number in stray])
        for number, fit in zip(stray, again, strict=True):
            edges, profiles = fits[number]
            if fit is not None and fit.rms_px < edges.rms_px:
                sought[number] = (fit, profiles)
        return sought

    def by_edges(self, faces: Sequence[Face]) -> list[FaceFit | None]:
        """Fit faces to the edges; None where they have none."""
        inclined = [_is_sloped(face) for face in faces]
        return fit_faces(faces, inclined, self.fields, self.rig, SETTLE, self.min_gradient)

    def from_lines(self, faces: Sequence[Face], max_rms_px: float) -> list[Witnesses]:
        """Fit faces that lines span to the edges and to the grey values; those that suit both, the best first.

        Lines that belong to different things span faces that have too few edges to be worth a fit.
        """
        shares = shares_on_edges(faces, self.fields, self.rig)
        least = max(_LEAST_SHARE, _LEAST_OF_BEST * shares.max(initial=0.0))
        faces = [face for face, share in zip(faces, shares, strict=True) if share >= least]
        fitted = [
            (face, fit)
            for face, fit in zip(faces, self.by_edges(faces), strict=True)
            if fit is not None and fit.rms_px <= _LOST_RMS_PX
        ]
        # where the edges led need not be where the grey values lead: both begin at the lines
        starts = [face for face, _ in fitted]
        seen = fit_profiles(starts, [_is_sloped(face) for face in starts], self.pictures, self.rig, self.table_z_mm)
        there = [
            (edges, fit) for (_, edges), fit in zip(fitted, seen, strict=True) if fit is not None and self.possible(fit)
        ]
        believed = [both for both in self.together(there) if both.is_believed(max_rms_px)]
        return sorted(believed, key=lambda both: both.misfit_px2)

    def settled(self, found: Sequence[Witnesses]) -> list[Witnesses]:
        """Return faces as they are, or as another rectangle that suits the pictures clearly better.

        What suits much worse than another face at its place stays as it is.
        """
        best = list(found)
        changed = _contenders(best)
        for _ in range(_ROUNDS):
            changed = self._improve(best, changed)
        return best

    def _others(self, face: Face) -> list[Face]:
        return other_rectangles(face, self.fields[0], self.rig, self.table_z_mm, self.min_gradient)

    def _improve(self, best: list[Witnesses], numbers: set[int]) -> set[int]:
        """Replace some faces that another rectangle suits better; returns which it replaced."""
        others = [
            (number, face)
            for number in sorted(numbers)
            if best[number].misfit_px2 > _DOUBTFUL_PX2
            for face in self._others(best[number].agreed().face)
        ]
        fitted = self.by_edges([face for _, face in others])
        there = [
            (number, fit)
            for (number, _), fit in zip(others, fitted, strict=True)
            if fit is not None and best[number].may_yield_to(fit)
        ]
        improved: set[int] = set()
        rivals: dict[int, list[Witnesses]] = {number: [best[number]] for number, _ in there}
        for (number, _), other in zip(there, self.by_profiles([fit for _, fit in there]), strict=True):
            if other is None:
                continue
            rivals[number].append(other)
            alike = number not in improved and other.is_inclined == best[number].is_inclined
            if other.suits_better(best[number], _CLEAR_GAIN if alike else 1.0):
                best[number] = other
                improved.add(number)
        for number, all_of_it in rivals.items():
            twins = [one for one in all_of_it if one.is_inclined != best[number].is_inclined]
            twin = min(twins, key=lambda one: one.misfit_px2, default=None)
            best[number] = replace(best[number], twin=twin)
        return improved


def _contenders(found: Sequence[Witnesses]) -> set[int]:
    """Return the numbers of the faces that suit about as well as any other at their place."""
    faces = [one.agreed().face for one in found]
    leaders: list[int] = []
    contenders: set[int] = set()
    for number in sorted(range(len(found)), key=lambda one: found[one].price_px2):
        leader = next((one for one in leaders if share_place(faces[one], faces[number])), number)
        if leader == number:
            leaders.append(number)
        if found[number].price_px2 <= _HOPELESS_RATIO * found[leader].price_px2:
            contenders.add(number)
    return contenders


def _is_sloped(face: Face) -> bool:
    return face.slope_u != 0.0


def _centre(face: Face) -> Array:
    return np.array([face.x_mm, face.y_mm, face.z_mm])
