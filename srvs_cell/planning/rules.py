"""Goal rules: what a scene should become, as places that each workpiece may end on. The solver knows nothing of them.

A rule is any object with a name and ``choose``. Other packages add theirs as entry points of the group
``srvs_cell.goal_rules``: a class, made with the rule's settings as keyword arguments.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Annotated, Any, Protocol, runtime_checkable

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, ValidationError
from pydantic.dataclasses import dataclass as settings
from scipy.optimize import linear_sum_assignment

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.planning.carrying import turn_to_deg
from srvs_cell.planning.problem import AssignGoal, RankGoal
from srvs_cell.scene import PlaceKind, Point2

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pydantic_core import ErrorDetails

    from srvs_cell.scene import Workpiece

ENTRY_POINT_GROUP = "srvs_cell.goal_rules"
_STRICT = ConfigDict(extra="forbid")
_FAR_MM = 1e9

_MAX_GREY = 255.0


def _ordered(limits: tuple[float, float]) -> tuple[float, float]:
    least, greatest = limits
    if least > greatest:
        raise ValueError(f"the least value {least:g} is greater than the greatest {greatest:g}")
    return limits


Length = Annotated[float, Field(ge=0.0, le=5000.0)]
Lengths = Annotated[tuple[Length, Length], AfterValidator(_ordered)]
Grey = Annotated[float, Field(ge=0.0, le=_MAX_GREY)]
Greys = Annotated[tuple[Grey, Grey], AfterValidator(_ordered)]
Coordinate = Annotated[float, Field(ge=-5000.0, le=5000.0)]
Yaw = Annotated[float, Field(ge=-360.0, le=360.0)]


@dataclass(frozen=True)
class Standing:
    """A workpiece that can be taken, and the point of its footprint that stands on a place.

    Attributes:
        workpiece: the workpiece.
        point_mm: where its footprint's centroid stands.
        on_place: whether that is a place of the job; in mid-job it may wait elsewhere, or have been moved by somebody.
    """

    workpiece: Workpiece
    point_mm: Point2
    on_place: bool = True


@dataclass(frozen=True)
class Choice:
    """What a rule wants.

    Attributes:
        goal: in place ids: place i is where workpiece i stands, further places follow.
        further: point and kind of the places that a rule adds.
        notes: what the rule has to say, one line each.
        yaws_deg: places on which parts are put down at a yaw, and that; on all others they keep theirs.
    """

    goal: RankGoal | AssignGoal
    further: tuple[tuple[Point2, PlaceKind], ...] = ()
    notes: tuple[str, ...] = ()
    yaws_deg: Mapping[int, float] = field(default_factory=dict)


@runtime_checkable
class Rule(Protocol):
    """Turns a scene into places that its workpieces may end on."""

    @property
    def name(self) -> str:
        """What config and reasons call the rule."""

    def choose(self, standing: Sequence[Standing], vacant_mm: Sequence[Point2] = ()) -> Choice:
        """Return what should become of the workpieces.

        Args:
            standing: the workpieces that can be taken.
            vacant_mm: places of the job on which nothing stands any more; none before its first move.

        Raises:
            AlarmError: PLAN_INFEASIBLE where that is impossible.
        """


@dataclass(frozen=True)
class TaughtPlace:
    """A place that a rule's settings name.

    Attributes:
        key: in the settings.
        point_mm: x and y, base frame.
        seen: whether what stands there has to be seen; what lies in a bin is not looked for.
    """

    key: str
    point_mm: Point2
    seen: bool = True


@runtime_checkable
class HasTaughtPlaces(Protocol):
    """A rule whose settings name places, which are then checked with the config."""

    @property
    def taught_places(self) -> tuple[TaughtPlace, ...]:
        """The places."""


@settings(frozen=True, kw_only=True, config=_STRICT)
class HeightOrder:
    """The paper's rule: the highest workpiece goes to the occupied place that is farthest along a direction.

    Places whose ways along the direction differ by less than the tolerance are equal: the one farther to the left of
    the direction comes first, which for the paper's direction, y, is the smaller x.

    Attributes:
        direction_deg: from base x towards base y; 90 is y.
        ascending: the lowest workpiece instead of the highest.
        height_tolerance_mm: heights nearer than this may stand in either order, pair by pair.
        place_tolerance_mm: places nearer than this along the direction are equal.
        left_first: whether of equal places the one to the left of the direction comes first, or the one to the right.
        yaw_deg: yaw at which every workpiece is to stand; None: each keeps its own.
        tolerance_deg: turn away from that yaw at which a workpiece may stay as it stands.
    """

    direction_deg: Annotated[float, Field(ge=-360.0, le=360.0)] = 90.0
    ascending: bool = False
    height_tolerance_mm: Length = 2.0
    place_tolerance_mm: Length = 3.0
    left_first: bool = True
    yaw_deg: Yaw | None = None
    tolerance_deg: Annotated[float, Field(ge=0.0, le=90.0)] = 5.0

    @property
    def name(self) -> str:
        """The rule's name."""
        return "height_order"

    def choose(self, standing: Sequence[Standing], vacant_mm: Sequence[Point2] = ()) -> Choice:
        """Return the order of height on the job's places, as many as there are workpieces.

        Where parts were taken away the vacant places that come last in the order are given up; where parts were added
        their own places, the first in the order, become places of the job. Where a workpiece that is turned too far
        stands, the place in the order is a second one at the same point: there it stands at the right yaw.
        """
        elsewhere = [number for number, each in enumerate(standing) if not each.on_place]
        vacant = [vacant_mm[i] for i in self.order(vacant_mm)][: len(elsewhere)]
        added = [elsewhere[i] for i in self.order([standing[number].point_mm for number in elsewhere])]
        added = added[: len(elsewhere) - len(vacant)]
        taken = sorted({*(number for number, each in enumerate(standing) if each.on_place), *added})
        places = [*taken, *range(len(standing), len(standing) + len(vacant))]
        points = [*(standing[number].point_mm for number in taken), *vacant]
        further = list(vacant)
        yaws_deg: dict[int, float] = {}
        if self.yaw_deg is not None:
            for rank, number in enumerate(taken):
                if abs(turn_to_deg(standing[number].workpiece, self.yaw_deg)) > self.tolerance_deg:
                    places[rank] = len(standing) + len(further)
                    further.append(standing[number].point_mm)
            yaws_deg = dict.fromkeys(places, self.yaw_deg)
        order = tuple(places[i] for i in self.order(points))
        # Ranks go from tallest to lowest: ascending along the direction is descending against it.
        slots = order[::-1] if self.ascending else order
        goal = RankGoal(slots, self.height_tolerance_mm)
        return Choice(goal, tuple((point, PlaceKind.SLOT) for point in further), yaws_deg=yaws_deg)

    def order(self, points_mm: Sequence[Point2]) -> tuple[int, ...]:
        """Return the numbers of points, the farthest along the direction first.

        Groups of equal points are anchored at their farthest, so that a long chain of small steps is not one group.
        """
        angle = math.radians(self.direction_deg)
        cos, sin = round(math.cos(angle), 12), round(math.sin(angle), 12)
        along = [x * cos + y * sin for x, y in points_mm]
        # For the direction y this is x.
        across = [(x * sin - y * cos) * (1.0 if self.left_first else -1.0) for x, y in points_mm]
        remaining = sorted(range(len(points_mm)), key=lambda i: -along[i])
        order: list[int] = []
        while remaining:
            anchor_mm = along[remaining[0]]
            group = [i for i in remaining if anchor_mm - along[i] <= self.place_tolerance_mm]
            order += sorted(group, key=lambda i: (across[i], -along[i]))
            remaining = remaining[len(group) :]
        return tuple(order)


@settings(frozen=True, kw_only=True, config=_STRICT)
class NominalPlace:
    """A taught place: where a workpiece of a kind should stand, and at which yaw, where that matters."""

    kind: str
    x_mm: Coordinate
    y_mm: Coordinate
    yaw_deg: Yaw | None = None


@settings(frozen=True, kw_only=True, config=_STRICT)
class PositionCorrection:
    """Every workpiece goes to a taught place of its kind; those within the tolerance stay.

    Workpieces and places are matched for the least sum of distances.

    Attributes:
        places: the taught places.
        tolerance_mm: distance from its place at which a workpiece stays.
        tolerance_deg: turn away from the place's yaw at which it stays.
    """

    places: Annotated[tuple[NominalPlace, ...], Field(min_length=1, max_length=200)]
    tolerance_mm: Length = 2.0
    tolerance_deg: Annotated[float, Field(ge=0.0, le=90.0)] = 5.0

    @property
    def name(self) -> str:
        """The rule's name."""
        return "position_correction"

    @property
    def taught_places(self) -> tuple[TaughtPlace, ...]:
        """The taught places."""
        return tuple(TaughtPlace(f"places.{i}", (place.x_mm, place.y_mm)) for i, place in enumerate(self.places))

    def choose(
        self,
        standing: Sequence[Standing],
        vacant_mm: Sequence[Point2] = (),  # noqa: ARG002 - the taught places are the job's, whoever stands where
    ) -> Choice:
        """Return for each workpiece its own place, or the taught one."""
        count = len(standing)
        distance_mm = np.array(
            [
                [
                    math.dist(each.point_mm, (place.x_mm, place.y_mm)) if place.kind == each.workpiece.kind else _FAR_MM
                    for place in self.places
                ]
                for each in standing
            ]
        ).reshape(count, len(self.places))
        matched = dict(zip(*(side.tolist() for side in linear_sum_assignment(distance_mm)), strict=True))
        refused: list[str] = []
        allowed: list[frozenset[int]] = []
        further: list[tuple[Point2, PlaceKind]] = []
        yaws_deg: dict[int, float] = {}
        for number, each in enumerate(standing):
            column = matched.get(number)
            if column is None or distance_mm[number, column] >= _FAR_MM:
                refused.append(f"workpiece {each.workpiece.id}: no taught place of kind {each.workpiece.kind} is left")
                continue
            place = self.places[column]
            turn_deg = 0.0 if place.yaw_deg is None else turn_to_deg(each.workpiece, place.yaw_deg)
            if distance_mm[number, column] <= self.tolerance_mm and abs(turn_deg) <= self.tolerance_deg:
                allowed.append(frozenset({number}))
                continue
            allowed.append(frozenset({count + len(further)}))
            if place.yaw_deg is not None:
                yaws_deg[count + len(further)] = place.yaw_deg
            further.append(((place.x_mm, place.y_mm), PlaceKind.SLOT))
        if refused:
            raise AlarmError(Alarm.PLAN_INFEASIBLE, f"{'; '.join(refused)}.")
        return Choice(AssignGoal(tuple(allowed), frozenset()), tuple(further), yaws_deg=yaws_deg)


@settings(frozen=True, kw_only=True, config=_STRICT)
class ElementChange:
    """Workpieces that a rule rejects go to the bin, and one of the right kind from the stock takes their place.

    Attributes:
        reject_kinds: kinds that are rejected.
        height_mm: least and greatest height of what is not rejected.
        size_mm: least and greatest length of what is not rejected.
        brightness: least and greatest grey value of the top face of what is not rejected; one that was not measured
            rejects nothing, and that is said.
        bin_mm: where the bin is; what stands there was rejected before.
        stock_mm: where the stock stands; what stands there is no part of the scene that is judged.
        stock_radius_mm: distance from a stock place, or from the bin, at which a workpiece counts as standing there.
        substitute_kind: kind of the workpieces that may take a rejected one's place.
        place_yaw_deg: yaw at which they are put down there; None: they keep the one that they have in the stock.
        bin_yaw_deg: yaw at which a rejected one is let go over the bin; None: it keeps its own.
    """

    reject_kinds: frozenset[str] = frozenset()
    height_mm: Lengths = (0.0, 5000.0)
    size_mm: Lengths = (0.0, 5000.0)
    brightness: Greys = (0.0, _MAX_GREY)
    bin_mm: tuple[Coordinate, Coordinate]
    stock_mm: Annotated[tuple[tuple[Coordinate, Coordinate], ...], Field(max_length=100)] = ()
    stock_radius_mm: Length = 20.0
    substitute_kind: str
    place_yaw_deg: Yaw | None = None
    bin_yaw_deg: Yaw | None = None

    @property
    def name(self) -> str:
        """The rule's name."""
        return "element_change"

    @property
    def taught_places(self) -> tuple[TaughtPlace, ...]:
        """Bin and stock."""
        stock = (TaughtPlace(f"stock_mm.{i}", point_mm) for i, point_mm in enumerate(self.stock_mm))
        return (TaughtPlace("bin_mm", self.bin_mm, seen=False), *stock)

    def choose(self, standing: Sequence[Standing], vacant_mm: Sequence[Point2] = ()) -> Choice:
        """Return the bin for the rejected; their places, and the job's vacant ones, must be filled.

        They are filled from the stock, and by right parts that stand neither on a place nor in the stock.
        """
        count = len(standing)
        in_stock = [self._is_in_stock(each.point_mm) for each in standing]
        in_bin = [math.dist(each.point_mm, self.bin_mm) <= self.stock_radius_mm for each in standing]
        why = [
            "" if stocked or binned else self._why_rejected(each.workpiece)
            for each, stocked, binned in zip(standing, in_stock, in_bin, strict=True)
        ]
        vacant = [
            point
            for point in vacant_mm
            if not self._is_in_stock(point) and math.dist(point, self.bin_mm) > self.stock_radius_mm
        ]
        rejected = [number for number, reason in enumerate(why) if reason]
        freed = frozenset(number for number in rejected if standing[number].on_place)
        to_fill = freed | frozenset(range(count + 1, count + 1 + len(vacant)))
        astray = [
            number
            for number, each in enumerate(standing)
            if not (each.on_place or in_stock[number] or in_bin[number] or why[number])
        ]
        right = [
            number
            for number, stocked in enumerate(in_stock)
            if stocked and standing[number].workpiece.kind == self.substitute_kind
        ]
        if len(right) + len(astray) < len(to_fill):
            raise AlarmError(
                Alarm.PLAN_INFEASIBLE,
                f"{len(rejected)} workpieces are rejected and {len(vacant)} places are vacant, but {len(right)} of "
                f"kind {self.substitute_kind} are in stock.",
            )
        allowed = [frozenset({number}) for number in range(count)]
        for number in rejected:
            allowed[number] = frozenset({count})
        for number in right:
            allowed[number] |= to_fill
        for number in astray[: len(to_fill)]:
            allowed[number] = to_fill
        notes = tuple(
            f"workpiece {each.workpiece.id} is rejected: {reason}"
            for each, reason in zip(standing, why, strict=True)
            if reason
        )
        if self.brightness != (0.0, _MAX_GREY):
            notes += tuple(
                f"workpiece {each.workpiece.id} is not judged by its brightness: that was not measured"
                for each, reason, stocked, binned in zip(standing, why, in_stock, in_bin, strict=True)
                if each.workpiece.brightness is None and not (reason or stocked or binned)
            )
        further = ((self.bin_mm, PlaceKind.BIN), *((point, PlaceKind.SLOT) for point in vacant))
        yaws_deg = {} if self.place_yaw_deg is None else dict.fromkeys(to_fill, self.place_yaw_deg)
        if self.bin_yaw_deg is not None:
            yaws_deg[count] = self.bin_yaw_deg
        return Choice(AssignGoal(tuple(allowed), to_fill), further, notes, yaws_deg)

    def _is_in_stock(self, point_mm: Point2) -> bool:
        return any(math.dist(point_mm, place) <= self.stock_radius_mm for place in self.stock_mm)

    def _why_rejected(self, workpiece: Workpiece) -> str:
        if workpiece.kind in self.reject_kinds:
            return f"its kind is {workpiece.kind}"
        for what, value, (least, most), unit in (
            ("height", workpiece.height_mm, self.height_mm, " mm"),
            ("length", workpiece.size_mm[0], self.size_mm, " mm"),
            ("brightness", workpiece.brightness, self.brightness, ""),
        ):
            if value is not None and not least <= value <= most:
                return f"its {what} {value:.1f}{unit} is outside {least:g} to {most:g}{unit}"
        return ""


def taught_places(name: str, rule_settings: Mapping[str, Any]) -> tuple[TaughtPlace, ...]:
    """Return the places that a rule's settings name; raises as `make_rule`."""
    rule = make_rule(name, rule_settings)
    return rule.taught_places if isinstance(rule, HasTaughtPlaces) else ()


def make_rule(name: str, rule_settings: Mapping[str, Any]) -> Rule:
    """Make an installed rule.

    Args:
        name: the rule's name, ``planning.rule`` of the config.
        rule_settings: its settings, ``planning.rule_settings``.

    Raises:
        AlarmError: CONFIG_INVALID naming the key, and its value, for an unknown name or settings that the rule refuses.
    """
    installed = entry_points(group=ENTRY_POINT_GROUP)
    found = next(iter(installed.select(name=name)), None)
    if found is None:
        known = ", ".join(sorted(installed.names))
        raise AlarmError(
            Alarm.CONFIG_INVALID, f"planning.rule = {name!r}: no such goal rule is installed; there are: {known}."
        )
    try:
        made: Any = found.load()
        rule = made(**rule_settings)
    except ValidationError as error:
        lines = (_refused(detail) for detail in error.errors(include_url=False))
        raise AlarmError(Alarm.CONFIG_INVALID, f"{'; '.join(lines)} (goal rule {name}).") from error
    except TypeError as error:
        raise AlarmError(Alarm.CONFIG_INVALID, f"planning.rule_settings: {error} (goal rule {name}).") from error
    except (ImportError, AttributeError) as error:
        raise AlarmError(Alarm.CONFIG_INVALID, f"planning.rule = {name!r}: cannot be loaded: {error}.") from error
    if not isinstance(rule, Rule):
        raise AlarmError(Alarm.CONFIG_INVALID, f"planning.rule = {name!r}: is no goal rule but {rule!r}.")
    return rule


def _refused(error: ErrorDetails) -> str:
    key = ".".join(map(str, ("planning.rule_settings", *error["loc"])))
    if error["type"] in {"unexpected_keyword_argument", "missing", "missing_keyword_only_argument"}:
        return f"{key}: {error['msg'].lower()}"
    return f"{key} = {error['input']!r}: {error['msg'].removeprefix('Input ')}"
