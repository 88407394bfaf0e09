"""The library of object kinds: what is right is taken, what is wrong names file, key, value and bound."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import pytest

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.config import built_in_library, load_config, load_library, parse_library
from srvs_cell.vision.recognition import RecognitionParameters
from srvs_cell.vision.recognition.kinds import BUILT_IN_KINDS, FacePattern, FaceRelation, ObjectKind

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "reference" / "object-kinds.md").read_text(encoding="utf-8")
EXAMPLE = next(block for block in re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL) if "kinds:" in block)
BAR = "schema_version: 1\nkinds:\n  - name: bar\n    faces: {top: {outline: rectangle, FACE}}\n"
KIND = "schema_version: 1\nkinds: [{name: bar, KIND}]\n"
TOP = "faces: {top: {outline: circle}}"
HEIGHTS = "faces: {a: {outline: circle, height_mm: [20, 30]}, b: {outline: circle, height_mm: [40, 50]}}"
TWO = "faces: {a: {outline: circle}, b: {outline: circle}}"


def refusal(text: str) -> str:
    with pytest.raises(AlarmError) as caught:
        parse_library(text, "objects.yaml")
    assert caught.value.alarm is Alarm.CONFIG_INVALID
    assert caught.value.detail.startswith("objects.yaml: ")
    return caught.value.detail


def test_the_shipped_library_is_what_the_vision_knows_without_one() -> None:
    assert built_in_library().kinds == BUILT_IN_KINDS


def test_the_pages_example_is_a_library_in_front_of_the_built_in_kinds() -> None:
    library = parse_library(EXAMPLE, "page")
    own = ["bar", "plate", "cube_32", "nut_m24", "gable", "step"]
    assert [kind.name for kind in library.kinds] == [*own, *(kind.name for kind in BUILT_IN_KINDS)]
    library.check(RecognitionParameters())


@pytest.mark.parametrize("table", [ObjectKind, FacePattern, FaceRelation])
def test_the_page_tells_every_key(table: type) -> None:
    for field in fields(table):
        assert f"\n| `{field.name}` |" in PAGE


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (BAR.replace("FACE", "length_mm: [160, 80]"), "kinds.0.faces.top.length_mm: the least value 160 is greater"),
        (BAR.replace("FACE", "length_mm: [-1, 80]"), "kinds.0.faces.top.length_mm.0 = -1: should be greater than or"),
        (BAR.replace("FACE", "length_mm: [1, 2001]"), "kinds.0.faces.top.length_mm.1 = 2001: should be less than or"),
        (BAR.replace("FACE", "length_mm: [1, .nan]"), "kinds.0.faces.top.length_mm.1 = NaN"),
        (BAR.replace("FACE", 'length_mm: ["1", 2]'), 'kinds.0.faces.top.length_mm.0 = "1": should be a valid number'),
        (BAR.replace("FACE", "length_mm: [80]"), "kinds.0.faces.top.length_mm.1: missing"),
        (BAR.replace("FACE", "aspect: [0.5, 2]"), "kinds.0.faces.top.aspect.0 = 0.5: should be greater than or equal"),
        (BAR.replace("FACE", "length: [1, 2]"), "kinds.0.faces.top.length: unknown key, did you mean 'length_mm'?"),
        (BAR.replace("rectangle, FACE", "square"), "faces.top.outline = \"square\": should be 'rectangle', 'circle'"),
        (BAR.replace("bar", "Bar"), 'kinds.0.name = "Bar": String should match pattern'),
        (BAR.replace("bar", "b" * 41), "at most 40 characters"),
        (BAR.replace("bar", "unknown").replace(", FACE", ""), "kinds.0: name: 'unknown' is what objects of no kind"),
        (BAR.replace("bar", "cuboid").replace(", FACE", ""), "kinds: the name 'cuboid' is given twice (a built-in"),
        (
            "schema_version: 1\nkinds: [{name: bar, " + TOP + "}, {name: rod, " + TOP + "}, {name: bar, " + TOP + "}]",
            "kinds: the name 'bar' is given twice by kinds.0 and kinds.2; give one of them another name",
        ),
        (
            BAR.replace("FACE", "length_mm: [10, 20], width_mm: [30, 40]"),
            "length_mm = [10, 20] and width_mm = [30, 40]",
        ),
        (BAR.replace("FACE", "length_mm: [90, 99], width_mm: [30, 40], aspect: [1, 2]"), "1 to 2 times its width"),
        (BAR.replace("rectangle, FACE", "circle, length_mm: [30, 40], width_mm: [50, 60]"), "no circle has both"),
        (BAR.replace("rectangle, FACE", "circle, aspect: [1.1, 2]"), "aspect = [1.1, 2]: a circle has 1; leave"),
        (BAR.replace("rectangle, FACE", "hexagon, aspect: [1, 1.1]"), "aspect = [1, 1.1]: a hexagon has 1.155"),
        (BAR.replace("rectangle, FACE", "hexagon, inclination_deg: [5, 9]"), "a hexagon is only seen level"),
        (
            KIND.replace("KIND", HEIGHTS + ", relations: [{between: [a, b], step_mm: [1, 50]}]"),
            "relations.0.step_mm = [1, 50]: these faces have [-30, -10] by their height_mm",
        ),
        (
            KIND.replace("KIND", TWO + ", relations: [{between: [a, b], angle_deg: [10, 20]}]"),
            "relations.0.angle_deg = [10, 20]: these faces have [0, 0] by their inclination_deg",
        ),
        (
            KIND.replace("KIND", TWO + ", relations: [{between: [a, b], turn_deg: [10, 20]}]"),
            "relations.0.turn_deg = [10, 20]: these faces have [0, 0] unless both are rectangles",
        ),
        (KIND.replace("KIND", "faces: {}"), "kinds.0.faces = {}: Dictionary should have at least 1 item"),
        (KIND.replace("KIND", TWO), "kinds.0: relations: none joins the face 'b' to the others"),
        (KIND.replace("KIND", TWO + ", relations: [{between: [a, c]}]"), "between: no face 'c' (faces: a, b)"),
        (KIND.replace("KIND", TWO + ", relations: [{between: [a, a]}]"), "'a' has no relation to itself"),
        (KIND.replace("KIND", TWO + ", relations: [{between: [a, b], max_gap_mm: 51}]"), "max_gap_mm = 51: should be"),
        (KIND.replace("KIND", TWO + ", relations: [{between: [a, b], step_mm: [3, 1]}]"), "step_mm: the least value 3"),
        ("schema_version: 2\nkinds: []", "schema_version = 2: should be 1"),
        ("schema_version: 1", "kinds: missing"),
        ("schema_version: 1\nkinds: []\nbuilt_in: false", "without built-in kinds nothing is recognised"),
        ("schema_version: 1\nkinds: []\nkinds: []", "the key 'kinds' is given twice"),
        ("schema_version: 1\nkinds: &all [*all]", "an alias is not allowed"),
        ("[" * 50, "nested deeper than 12"),
        ("kinds: [", "not YAML"),
        ("- 1", "a mapping of keys is expected"),
        ("#" * 70000, "longer than 65536 bytes"),
    ],
)
def test_what_is_wrong_is_named(text: str, named: str) -> None:
    assert named in refusal(text.replace(", FACE", ""))


def test_a_file_that_is_missing_or_no_text_is_named(tmp_path: Path) -> None:
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe")
    for name in ("none.yaml", "binary.yaml"):
        with pytest.raises(AlarmError, match=name) as caught:
            load_library(tmp_path / name)
        assert caught.value.alarm is Alarm.CONFIG_INVALID


@pytest.mark.parametrize(
    ("face", "named"),
    [
        ("length_mm: [200, 300]", "faces.top.length_mm = [200, 300]: vision.recognition.max_size_mm = 160 mm excludes"),
        ("width_mm: [2, 6]", "faces.top.width_mm = [2, 6]: vision.recognition.min_size_mm = 10 mm excludes"),
        ("height_mm: [1, 5]", "faces.top.height_mm = [1, 5]: vision.recognition.min_height_mm = 8 mm excludes"),
    ],
)
def test_a_kind_that_would_never_be_seen_is_refused(face: str, named: str) -> None:
    library = parse_library(BAR.replace("FACE", face), "objects.yaml")
    with pytest.raises(AlarmError) as caught:
        library.check(RecognitionParameters())
    assert named in caught.value.detail


def test_the_cells_configuration_names_its_library(tmp_path: Path) -> None:
    cell = tmp_path / "cell.yaml"
    text = (ROOT / "configs" / "cell.sim.yaml").read_text(encoding="utf-8")
    cell.write_text(text, encoding="utf-8")
    assert load_config(cell).load_library().kinds == BUILT_IN_KINDS
    cell.write_text(text + "\nobject_library: objects.yaml\n", encoding="utf-8")
    (tmp_path / "objects.yaml").write_text(EXAMPLE, encoding="utf-8")
    config = load_config(cell)
    assert config.object_library == tmp_path / "objects.yaml"
    assert config.load_library().kinds[0].name == "bar"


@pytest.mark.parametrize("inclination_deg", ["[1, 4]", "[60, 80]"])
def test_an_inclination_that_no_face_is_seen_with_is_refused(inclination_deg: str) -> None:
    library = parse_library(BAR.replace("FACE", f"inclination_deg: {inclination_deg}"), "objects.yaml")
    with pytest.raises(AlarmError, match="none is in this range") as caught:
        library.check(RecognitionParameters())
    assert caught.value.alarm is Alarm.CONFIG_INVALID
    parse_library(BAR.replace("FACE", "inclination_deg: [0, 4]"), "objects.yaml").check(RecognitionParameters())
