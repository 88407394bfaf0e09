"""The judge of a demo run: it must not be fooled."""

from dataclasses import replace

import pytest

from srvs_cell.service.grading import Goal, Grade, TruePart, grade

LOW = TruePart(0, "cuboid", (400.0, 100.0, 20.0), 20.0, 10.0, 0.0)
HIGH = TruePart(1, "cuboid", (400.0, -100.0, 60.0), 60.0, 20.0, 0.0)
PERCEIVED = {7: (401.0, 100.0, 21.0), 8: (400.0, -102.0, 60.0)}
GOALS = [Goal(7, (400.0, -101.0)), Goal(8, (401.0, 100.0))]
BOTH = frozenset({7, 8})


def at(part: TruePart, x: float, y: float) -> TruePart:
    return replace(part, position_mm=(x, y, part.position_mm[2]))


def run(low: TruePart, high: TruePart, moved: frozenset[int] = BOTH) -> Grade:
    return grade([LOW, HIGH], [low, high], PERCEIVED, GOALS, moved)


def test_a_good_run_succeeds_and_errors_are_measured() -> None:
    result = run(at(LOW, 402.0, -100.0), at(HIGH, 400.0, 97.0))
    assert result.success
    assert result.error_summary("placement_error_mm") == {"mean": pytest.approx(2.5), "max": pytest.approx(3.0)}
    assert result.error_summary("position_error_mm")["max"] == pytest.approx(2.0)
    assert result.parts[0].grasp_offset_mm == pytest.approx(1.0)


def test_nothing_moved_is_no_success() -> None:
    result = run(LOW, HIGH)
    assert not result.success
    assert "part 0 (20.0 mm) stands before the higher part 1 (60.0 mm)" in result.reasons


@pytest.mark.parametrize(
    ("low", "reason"),
    [
        (at(LOW, 406.0, -100.0), "ended 6.0 mm from its goal"),
        (replace(at(LOW, 400.0, -100.0), tilt_deg=90.0), "does not stand upright"),
        (replace(at(LOW, 400.0, -100.0), yaw_deg=16.0), "turned by 6.0 deg"),
    ],
)
def test_each_fault_of_a_part_is_named(low: TruePart, reason: str) -> None:
    result = run(low, at(HIGH, 400.0, 100.0))
    assert not result.success
    assert any(reason in text for text in result.parts[0].reasons)


def test_half_a_turn_is_no_turn() -> None:
    assert run(replace(at(LOW, 400.0, -100.0), yaw_deg=189.0), at(HIGH, 400.0, 100.0)).success


def test_half_a_turn_of_a_wedge_is_the_wrong_way_round() -> None:
    wedge = replace(LOW, kind="wedge", rise_deg=359.0)
    there = at(wedge, 400.0, -100.0)
    for rise_deg, reasons in ((2.0, ()), (179.0, ("turned by 180.0 deg",))):
        after = [replace(there, rise_deg=rise_deg), at(HIGH, 400.0, 100.0)]
        result = grade([wedge, HIGH], after, PERCEIVED, GOALS, BOTH)
        assert result.parts[0].reasons == reasons


def test_the_truth_of_the_simulator_is_read() -> None:
    answer = {
        "id": 2,
        "kind": "wedge",
        "position_mm": [1.0, 2.0, 3.0],
        "height_mm": 40.0,
        "yaw_deg": 10.0,
        "tilt_deg": 0.5,
        "rise_deg": 190.0,
    }
    assert TruePart.from_truth(answer) == TruePart(2, "wedge", (1.0, 2.0, 3.0), 40.0, 10.0, 0.5, 190.0)


def test_a_part_without_a_planned_move_must_stay() -> None:
    parts = [LOW, HIGH, TruePart(2, "cylinder", (500.0, 0.0, 40.0), 40.0, None, 0.0)]
    after = [at(LOW, 400.0, -100.0), at(HIGH, 400.0, 100.0), at(parts[2], 503.0, 0.0)]
    perceived = {**PERCEIVED, 9: (500.0, 0.0, 40.0)}
    result = grade(parts, after, perceived, [*GOALS, Goal(9, (500.0, 0.0))], BOTH)
    assert any("disturbed by 3.0 mm" in text for text in result.parts[2].reasons)


def test_unseen_and_invented_parts_fail_the_run() -> None:
    result = grade([LOW, HIGH], [LOW, HIGH], {7: PERCEIVED[7], 3: (900.0, 900.0, 10.0)}, GOALS[:1], frozenset())
    assert result.parts[1].reasons[0] == "not seen"
    assert result.spurious == (3,)
    assert not result.success
