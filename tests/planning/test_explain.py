"""A plan in words and as a picture."""

import dataclasses
import math
import re
import xml.etree.ElementTree as ET

from srvs_cell.planning import AssignGoal, Disc, Obstacle, explain, plan, plan_svg, what_would_help
from srvs_cell.scene import Place, PlaceKind
from tests.planning.problems import line_problem

SVG = "{http://www.w3.org/2000/svg}"


def test_a_ring_is_explained_and_every_object_has_a_line() -> None:
    problem = line_problem([10.0, 20.0, 5.0])
    lines = explain(problem, plan(problem))
    assert lines[0].startswith("3 moves, proven least: 2 stand wrongly, 1 more where places are exchanged in a ring")
    assert len(lines) == 4
    assert sum("for the time being" in line and "in the way at its goal" in line for line in lines) == 1
    assert lines[3] == "object 2: stays, it stands where it may end"


def test_an_object_that_stands_right_says_that_it_makes_room() -> None:
    base = line_problem([10.0, 20.0], buffers=2, spacing_mm=24.0)
    # Object 0 goes past nobody, but its goal is beside object 1, which may end anywhere free.
    places = (*base.places[:2], Place(2, 44.0, 0.0, PlaceKind.SLOT), Place(3, 300.0, 0.0, PlaceKind.SLOT))
    goal = AssignGoal((frozenset({2}), frozenset({1, 3})), frozenset())
    problem = dataclasses.replace(base, places=places, goal=goal)
    lines = explain(problem, plan(problem))
    assert any(line.startswith("object 1: stands where it may end, but makes room") for line in lines)


def test_a_part_from_the_stock_fills_the_place_of_a_rejected_one() -> None:
    base = line_problem([10.0, 20.0], buffers=1)
    places = (*base.places[:2], dataclasses.replace(base.places[2], kind=PlaceKind.BIN))
    goal = AssignGoal((frozenset({2}), frozenset({0, 1})), frozenset({0}))
    problem = dataclasses.replace(base, places=places, goal=goal)
    lines = explain(problem, plan(problem))
    assert lines[0].endswith("1 stand wrongly, 1 more from a place where they might stay to one that must be filled")
    assert "object 1: stands where it may end, but goes where a place must be filled: move 2" in lines[2]


def test_an_arrow_leaves_room_for_the_name_at_both_ends() -> None:
    problem = line_problem([10.0, 20.0])
    root = ET.fromstring(plan_svg(problem, plan(problem).moves, ""))  # noqa: S314 - our own text
    names = [(float(t.attrib["x"]), float(t.attrib["y"])) for t in root.findall(f"{SVG}text[@class='name']")]
    assert len(names) == 2
    for path in root.findall(f"{SVG}path[@class='move']"):
        begin, _, end = (tuple(map(float, pair.split())) for pair in re.findall(r"-?[\d.]+ -?[\d.]+", path.attrib["d"]))
        assert min(math.dist(point, name) for point in (begin, end) for name in names) > 4.0


def test_one_more_buffer_place_would_help() -> None:
    problem = line_problem([10.0, 20.0], buffers=0)
    assert what_would_help(problem) == ("one more free buffer place",)
    assert explain(problem, plan(problem)) == ("it would help: one more free buffer place",)


def test_an_obstacle_taken_away_would_help() -> None:
    problem = dataclasses.replace(
        line_problem([10.0]), goal=AssignGoal((frozenset({1}),), frozenset()), obstacles=(Obstacle(Disc(5.0), 0, -110),)
    )
    assert what_would_help(problem) == ("the obstacle at (0.0, -110.0) taken away",)


def test_reach_would_help() -> None:
    problem = line_problem([10.0, 20.0])
    places = (dataclasses.replace(problem.places[0], reachable=False), *problem.places[1:])
    assert what_would_help(dataclasses.replace(problem, places=places)) == ("slot 0 (0.0, 0.0) within reach",)


def test_the_picture_holds_every_object_obstacle_and_move() -> None:
    problem = dataclasses.replace(line_problem([10.0, 20.0, 5.0]), obstacles=(Obstacle(Disc(5.0), 500.0, 0.0),))
    answer = plan(problem)
    root = ET.fromstring(plan_svg(problem, answer.moves, "a & b"))  # noqa: S314 - our own text
    kinds = [element.get("class") for element in root.iter()]
    assert kinds.count("start") == 3
    assert kinds.count("end") == 2
    assert kinds.count("obstacle") == 1
    assert kinds.count("move") == len(answer.moves)
    title = root.find(f"{SVG}title")
    assert title is not None
    assert title.text == "a & b"
    left, top, width, height = map(float, (root.get("viewBox") or "").split())
    for element in root.iter(f"{SVG}circle"):
        x, y = float(element.get("cx", "nan")), float(element.get("cy", "nan"))
        assert left < x < left + width
        assert top < y < top + height


def test_an_object_taken_away_or_a_place_within_reach_would_help() -> None:
    problem = line_problem([10.0, 20.0, 30.0], spacing_mm=60.0)
    fixed = dataclasses.replace(problem.objects[1], blocked=((1, "out of reach by 14 mm"),))
    stuck = dataclasses.replace(
        problem,
        objects=(problem.objects[0], fixed, problem.objects[2]),
        goal=AssignGoal((frozenset({2}), frozenset({0}), frozenset({1})), frozenset()),
    )
    lines = explain(stuck, plan(stuck))
    assert lines == (
        "it would help: slot 1 (60.0, 0.0) free of what blocks it (out of reach by 14 mm)",
        "it would help: object 1 taken off the table",
    )
    assert any("out of reach by 14 mm" in reason for reason in plan(stuck).reasons)
