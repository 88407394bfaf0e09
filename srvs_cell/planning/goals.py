"""Goal rules: what has to hold at the end, and how many moves it takes at least.

Both rules are brought into one form, a set of allowed places per object plus an exact final test. Objects whose
allowed places overlap form a class. The lower bound is the closed form of references/planning.md section 2:
wrongly standing objects, plus one for each component of classes that is full.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from srvs_cell.planning.problem import AssignGoal, RankGoal
from srvs_cell.scene import PlaceKind

if TYPE_CHECKING:
    from srvs_cell.planning.clearance import ConflictTable
    from srvs_cell.planning.problem import Problem

HEIGHT_ROUNDING_MM = 1e-9
OUTSIDE = -1
_MOST_LOOKS = 20_000


@dataclass(frozen=True)
class GoalRule:
    """A goal as the search uses it.

    Attributes:
        allowed: per object, mask of the places where it may end (necessary, not always sufficient).
        class_of_object: per object, its class.
        class_of_place: per place, the class that wants it, or `OUTSIDE`.
        class_places: per class, mask of its places.
        must_fill: mask of the places that must not stay empty.
        ranks: place id -> rank for a rank goal, else empty.
        heights_mm: per object.
        tolerance_mm: of a rank goal.
        single: mask over places that hold one object only.
    """

    allowed: tuple[int, ...]
    class_of_object: tuple[int, ...]
    class_of_place: tuple[int, ...]
    class_places: tuple[int, ...]
    must_fill: int
    ranks: dict[int, int]
    heights_mm: tuple[float, ...]
    tolerance_mm: float
    single: int

    def is_reached(self, arrangement: tuple[int, ...]) -> bool:
        """Tell whether an arrangement (place per object) is a goal."""
        filled = 0
        for item, place in enumerate(arrangement):
            if not self.allowed[item] >> place & 1:
                return False
            filled |= 1 << place
        if self.must_fill & ~filled:
            return False
        if not self.ranks:
            return True
        lowest_mm = float("inf")
        for item in sorted(range(len(arrangement)), key=lambda i: self.ranks[arrangement[i]]):
            height_mm = self.heights_mm[item]
            if height_mm > lowest_mm + self.tolerance_mm + HEIGHT_ROUNDING_MM:
                return False
            lowest_mm = min(lowest_mm, height_mm)
        return True

    def misplaced(self, arrangement: tuple[int, ...]) -> list[int]:
        """Return the objects that do not stand on an allowed place."""
        return [item for item, place in enumerate(arrangement) if not self.allowed[item] >> place & 1]

    @property
    def labelled(self) -> tuple[int, ...] | None:
        """The place of each object where the goal leaves no choice, else None."""
        if any(mask.bit_count() != 1 for mask in self.allowed):
            return None
        return tuple(mask.bit_length() - 1 for mask in self.allowed)

    def lower_bound(self, arrangement: tuple[int, ...]) -> int:
        """Return a proven lower bound on the moves from an arrangement to the goal.

        Each misplaced object moves at least once. Where all places of a component of classes are full, the first
        object to leave it lands outside, which is one move more. With a free place, nothing in the way and no chain of
        ties this is the least number of moves itself (references/planning.md section 2).
        """
        wrong = self.misplaced(arrangement)
        filled = 0
        for place in arrangement:
            filled |= 1 << place
        if not wrong:
            unfilled = (self.must_fill & ~filled).bit_count()
            return unfilled if unfilled or self.is_reached(arrangement) else 1
        parent = list(range(len(self.class_places)))
        has_room = [bool(places & ~(filled & self.single)) for places in self.class_places]
        for item in wrong:
            target = _root(parent, self.class_of_object[item])
            origin = self.class_of_place[arrangement[item]]
            if origin == OUTSIDE:
                has_room[target] = True
                continue
            origin = _root(parent, origin)
            parent[origin] = target
            has_room[target] |= has_room[origin]
        components = {_root(parent, self.class_of_object[item]) for item in wrong}
        moves = len(wrong) + sum(not has_room[component] for component in components)
        return max(moves, (self.must_fill & ~filled).bit_count())


def _root(parent: list[int], vertex: int) -> int:
    while parent[vertex] != vertex:
        parent[vertex] = parent[parent[vertex]]
        vertex = parent[vertex]
    return vertex


def goal_is_possible(start: tuple[int, ...], table: ConflictTable, rule: GoalRule) -> bool:
    """Tell whether any arrangement at all is a goal: every object on an allowed place, none too near to another.

    Objects that are too near to each other where they were found may stay there. Where looking for one takes too
    long the answer is yes: the search will find out.
    """
    order = sorted(range(len(start)), key=lambda item: rule.allowed[item].bit_count())
    arrangement = list(start)
    as_found = table.standing(start)
    looks = 0

    def complete(depth: int, standing: int, filled: int) -> bool:
        nonlocal looks
        looks += 1
        if depth == len(order) or looks > _MOST_LOOKS:
            return looks > _MOST_LOOKS or rule.is_reached(tuple(arrangement))
        item = order[depth]
        for place in range(table.place_count):
            stays = place == start[item]
            if not rule.allowed[item] >> place & 1 or filled >> place & 1:
                continue
            in_the_way = table.blocked_by[item][place] & (standing & ~as_found if stays else standing)
            if (not stays and not table.standable[item][place]) or in_the_way:
                continue
            arrangement[item] = place
            taken = filled | 1 << place & table.single
            if complete(depth + 1, standing | table.bit(item, place), taken):
                return True
        return False

    return complete(0, 0, 0)


def goal_rule(problem: Problem) -> GoalRule:
    """Bring a problem's goal into the form that the search uses."""
    goal = problem.goal
    heights_mm = tuple(item.height_mm for item in problem.objects)
    ranks: dict[int, int] = {}
    tolerance_mm = 0.0
    must_fill = 0
    if isinstance(goal, RankGoal):
        allowed = tuple(
            sum(1 << place for place in goal.slots[first : last + 1])
            for first, last in rank_windows(heights_mm, goal.tolerance_mm)
        )
        ranks = {place: rank for rank, place in enumerate(goal.slots)}
        tolerance_mm = goal.tolerance_mm
    else:
        allowed = _assign_masks(goal)
        must_fill = sum(1 << place for place in goal.must_fill)
    class_of_object, class_places = _classes(allowed)
    class_of_place = [OUTSIDE] * len(problem.places)
    for index, places in enumerate(class_places):
        for place in range(len(problem.places)):
            if places >> place & 1:
                class_of_place[place] = index
    return GoalRule(
        allowed=allowed,
        class_of_object=class_of_object,
        class_of_place=tuple(class_of_place),
        class_places=class_places,
        must_fill=must_fill,
        ranks=ranks,
        heights_mm=heights_mm,
        tolerance_mm=tolerance_mm,
        single=sum(1 << place.id for place in problem.places if place.kind is not PlaceKind.BIN),
    )


def _assign_masks(goal: AssignGoal) -> tuple[int, ...]:
    return tuple(sum(1 << place for place in places) for places in goal.allowed)


def rank_windows(heights_mm: tuple[float, ...], tolerance_mm: float) -> list[tuple[int, int]]:
    """Return per object the first and last rank that it can have in any pairwise-good order.

    Everything taller by more than the tolerance comes before, everything lower by more than it after. Windows are
    necessary, not sufficient (references/planning.md section 1).
    """
    reach_mm = tolerance_mm + HEIGHT_ROUNDING_MM
    return [
        (
            sum(other > height + reach_mm for other in heights_mm),
            len(heights_mm) - 1 - sum(other < height - reach_mm for other in heights_mm),
        )
        for height in heights_mm
    ]


def _classes(allowed: tuple[int, ...]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Group objects whose allowed places overlap, directly or through others; return (class per object, masks)."""
    groups: list[int] = []
    for mask in allowed:
        apart = [group for group in groups if not group & mask]
        merged = mask
        for group in groups:
            if group & mask:
                merged |= group
        groups = [*apart, merged]
    return tuple(next(i for i, group in enumerate(groups) if group & mask) for mask in allowed), tuple(groups)
