"""The paper's matching rule, threshold by threshold, in both readings of the maxima."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from srvs_cell.scene import Plane
from srvs_cell.vision.matching import Matching, PlanePair, find_matches, match_planes
from srvs_cell.vision.parameters import MatchingParameters, Maxima
from tests.vision.straightforward_matching import straightforward

PAPER = MatchingParameters(max_row_distance_px=2.0, max_column_margin_px=0.0, ordered=False)
RANGE = (10.0, 40.0)


def plane(number: int, x: float = 100.0, y: float = 50.0, brightness: float = 100.0, area: float = 400.0) -> Plane:
    return Plane(
        id=number,
        centre_px=(x, y),
        area_px=area,
        perimeter_px=80.0,
        short_cut_px=10.0,
        long_cut_px=14.0,
        brightness=brightness,
        box_px=(0, 0, 20, 20),
        touches_border=False,
    )


def test_the_same_face_shifted_by_its_disparity_matches_with_the_ratio_of_brightness() -> None:
    assert match_planes([plane(1)], [plane(1, x=75.0, brightness=80.0)], RANGE, PAPER) == (PlanePair(1, 1, 0.8),)


def test_the_row_distance_and_the_disparity_range_are_gates() -> None:
    assert not match_planes([plane(1)], [plane(1, x=75.0, y=52.5)], RANGE, PAPER)
    assert not match_planes([plane(1)], [plane(1, x=95.0)], RANGE, PAPER)
    assert not match_planes([plane(1)], [plane(1, x=55.0)], RANGE, PAPER)
    wider = replace(PAPER, max_column_margin_px=10.0)
    assert match_planes([plane(1)], [plane(1, x=95.0)], RANGE, wider)


def test_each_difference_must_be_less_than_its_weight_times_the_smaller_value() -> None:
    right = plane(1, x=75.0)
    for name in ("area_px", "perimeter_px", "short_cut_px", "long_cut_px"):
        value = getattr(right, name)
        just_inside, just_outside = replace(right, **{name: value * 1.299}), replace(right, **{name: value * 1.301})
        assert match_planes([plane(1)], [just_inside], RANGE, PAPER), name
        assert not match_planes([plane(1)], [just_outside], RANGE, PAPER), name


def test_every_weight_has_its_own_threshold() -> None:
    right = replace(plane(1, x=75.0), area_px=480.0)
    assert match_planes([plane(1)], [right], RANGE, PAPER)
    assert not match_planes([plane(1)], [right], RANGE, replace(PAPER, weight_area=0.1))


def test_a_match_function_of_no_more_than_the_threshold_is_refused() -> None:
    assert not match_planes([plane(1)], [plane(1, x=75.0, brightness=70.0)], RANGE, PAPER)
    assert match_planes([plane(1)], [plane(1, x=75.0, brightness=70.5)], RANGE, PAPER)


def test_the_best_must_be_mutual() -> None:
    left = [plane(1, brightness=100.0), plane(2, x=110.0, brightness=95.0)]
    right = [plane(7, x=80.0, brightness=96.0)]
    assert [(pair.left, pair.right) for pair in match_planes(left, right, RANGE, PAPER)] == [(2, 7)]


def test_a_distant_plane_of_the_same_brightness_spoils_only_the_literal_reading() -> None:
    left = [plane(1, brightness=100.0)]
    right = [plane(1, x=75.0, brightness=98.0), plane(2, x=75.0, y=300.0, brightness=100.0)]
    assert not match_planes(left, right, RANGE, replace(PAPER, maxima=Maxima.ALL_PLANES))
    admissible = match_planes(left, right, RANGE, replace(PAPER, maxima=Maxima.ADMISSIBLE))
    assert [(pair.left, pair.right) for pair in admissible] == [(1, 1)]


def test_both_readings_agree_where_every_plane_has_its_own_brightness() -> None:
    left = [plane(1, brightness=60.0), plane(2, y=150.0, brightness=120.0)]
    right = [plane(1, x=80.0, brightness=61.0), plane(2, x=70.0, y=150.0, brightness=118.0)]
    readings = [match_planes(left, right, RANGE, replace(PAPER, maxima=maxima)) for maxima in Maxima]
    assert readings[0] == readings[1]
    assert [(pair.left, pair.right) for pair in readings[0]] == [(1, 1), (2, 2)]


def test_equal_match_functions_are_decided_by_the_differences_then_by_the_id() -> None:
    left = [plane(1)]
    right = [plane(1, x=75.0, area=440.0), plane(2, x=80.0, area=410.0), plane(3, x=85.0, area=410.0)]
    assert [(pair.left, pair.right) for pair in match_planes(left, right, RANGE, PAPER)] == [(1, 2)]


def test_black_planes_have_a_ratio_of_one_and_no_planes_no_match() -> None:
    (pair,) = match_planes([plane(1, brightness=0.0)], [plane(1, x=75.0, brightness=0.0)], RANGE, PAPER)
    assert pair.score == 1.0
    assert match_planes([], [plane(1)], RANGE, PAPER) == ()
    assert match_planes([plane(1)], [], RANGE, PAPER) == ()


def row_of_squares(count: int, shift: float, first: int = 1) -> list[Plane]:
    return [plane(first + k, x=60.0 + 30.0 * k - shift) for k in range(count)]


def test_a_lone_square_with_two_equal_partners_is_ambiguous() -> None:
    left, right = [plane(1)], [plane(1, x=85.0), plane(2, x=65.0)]
    ordered = replace(PAPER, maxima=Maxima.ADMISSIBLE, ordered=True)
    assert find_matches(left, right, RANGE, ordered) == Matching((), (1,))
    assert find_matches(left, right, RANGE, replace(ordered, ordered=False)).pairs


def test_neighbours_tell_which_of_equal_partners_is_right() -> None:
    known = [plane(2, x=160.0, brightness=200.0), plane(3, x=180.0, brightness=150.0)]
    seen = [plane(2, x=145.0, brightness=200.0), plane(3, x=165.0, brightness=150.0)]
    ordered = replace(PAPER, maxima=Maxima.ADMISSIBLE, ordered=True)
    found = find_matches([plane(1), *known], [plane(1, x=85.0), *seen, plane(4, x=61.0)], RANGE, ordered)
    assert (1, 1) in [(pair.left, pair.right) for pair in found.pairs]


def test_a_match_that_crosses_better_ones_is_given_up() -> None:
    left, right = row_of_squares(6, 0.0), row_of_squares(6, 15.0)
    left = [replace(each, brightness=60.0 + 30.0 * k) for k, each in enumerate(left)]
    right = [replace(each, brightness=60.0 + 30.0 * k) for k, each in enumerate(right)]
    # the partner of the last one is missing, and a plane far to the left has just its brightness
    stray = replace(right[-1], centre_px=(left[-1].centre_px[0] - 115.0, 50.0))
    ordered = replace(PAPER, maxima=Maxima.ADMISSIBLE, ordered=True)
    found = find_matches(left, [*right[:-1], stray], (10.0, 120.0), ordered)
    assert [pair.left for pair in found.pairs] == [1, 2, 3, 4, 5]
    assert found.ambiguous == (6,)


@st.composite
def lists_of_planes(draw: st.DrawFn) -> tuple[list[Plane], list[Plane]]:
    """Planes of a few places, sizes and greys, so that equals, ties and crossings are common."""
    numbers = st.integers(0, 4)
    images = []
    for _ in range(2):
        drawn = draw(st.lists(st.tuples(*[numbers] * 7), max_size=9))
        images.append(
            [
                replace(
                    plane(number, 20.0 * x + 3.0 * off, 40.0 + 1.1 * y, (0.0, 80.0, 81.0, 95.0, 200.0)[grey]),
                    area_px=400.0 + 25.0 * size,
                    short_cut_px=9.0 + 0.7 * cut,
                    box_px=(0, 30 + 4 * y, 20, 4 + 9 * height),
                )
                for number, (x, off, y, grey, size, cut, height) in enumerate(drawn, start=1)
            ]
        )
    return images[0], images[1]


@given(
    lists_of_planes(),
    st.sampled_from(Maxima),
    st.booleans(),
    st.sampled_from([0.3, 1.1, 2.2, 50.0]),
    st.sampled_from([(0.0, 40.0), (-30.0, 90.0)]),
)
@settings(max_examples=300)
def test_the_same_matches_and_doubts_as_by_looking_at_all_pairs(
    planes: tuple[list[Plane], list[Plane]],
    maxima: Maxima,
    ordered: bool,
    row_distance: float,
    disparity_range: tuple[float, float],
) -> None:
    limits = replace(PAPER, max_row_distance_px=row_distance, maxima=maxima, ordered=ordered)
    assert find_matches(*planes, disparity_range, limits) == straightforward(*planes, disparity_range, limits)


def crowd(seed: int) -> tuple[list[Plane], list[Plane]]:
    """A table full of parts of a few greys, most of them seen again, some out of their order."""
    random = np.random.default_rng(seed)
    count = 45
    x, y = random.uniform((0.0, 0.0), (400.0, 120.0), (count, 2)).T
    grey = random.choice([60.0, 90.0, 91.0, 130.0, 190.0], count)
    area = random.uniform(380.0, 450.0, count)
    shift = np.where(random.random(count) < 0.75, 20.0 + 0.04 * x, random.uniform(10.0, 90.0, count))
    boxes = [(0, int(top) - 12, 20, int(height)) for top, height in zip(y, random.integers(8, 40, count), strict=True)]
    left, right = (
        [
            replace(
                plane(number + 1, float(place[number]), float(y[number]), float(grey[number])), box_px=boxes[number]
            )
            for number in range(count)
        ]
        for place in (x, x - shift)
    )
    left = [replace(each, area_px=float(size)) for each, size in zip(left, area, strict=True)]
    return left, [right[number] for number in random.permutation(count)[: random.integers(25, count)]]


@given(st.integers(0, 10**6), st.sampled_from(Maxima))
@settings(max_examples=40)
def test_the_same_on_a_crowded_table(seed: int, maxima: Maxima) -> None:
    limits = replace(PAPER, ordered=True, maxima=maxima, max_column_margin_px=4.0)
    left, right = crowd(seed)
    assert find_matches(left, right, (10.0, 90.0), limits) == straightforward(left, right, (10.0, 90.0), limits)
