"""The demo's report page."""

from srvs_cell.service.grading import Goal, TruePart, grade
from srvs_cell.service.pictures import PlanArrow
from srvs_cell.service.report import Figure, Report, compare, part_rows, render_report

PART = TruePart(0, "cuboid", (400.0, 100.0, 20.0), 20.0, 10.0, 0.0)
WORKPIECE = {"id": 3, "kind": "cuboid", "covariance_mm2": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]}
GRADE = grade([PART], [PART], {3: (400.0, 101.0, 20.0)}, [Goal(3, (400.0, 101.0))], frozenset())


def report(reasons: tuple[str, ...] = ()) -> Report:
    return Report(
        grade=GRADE,
        reasons=reasons,
        seed=5,
        imperfections="real",
        command="srvs-cell demo --seed 5",
        comparison=compare(GRADE, 61.25, 7, [(10.2, 20.0), (30.0, 40.6)], 2, 2),
        figures=(Figure("planes.png", "Matched planes"),),
        before_after=(),
        part_rows=part_rows(GRADE, [WORKPIECE]),
        moves=[PlanArrow(3, (400.0, 100.0), (1.0, 2.0))],
        timings_ms={"edges": 12.34},
    )


def test_the_page_puts_paper_and_run_side_by_side() -> None:
    page = render_report(report())
    for text in ("8 min", "61.2 s", "8.9 mm", "1.00 mm", "2 of at least 2", 'src="planes.png"', "cuboid 3", "12.3"):
        assert text in page
    assert "2, at x, y px of the left image: (10, 20), (30, 41)" in page
    assert "https://" not in page
    assert "http://" not in page


def test_expected_error_is_the_covariances() -> None:
    assert part_rows(GRADE, [WORKPIECE])[0]["expected"] == "2.00"


def test_reasons_are_escaped() -> None:
    assert "&lt;b&gt;" in render_report(report(("<b> is not html",)))


def test_a_run_without_ambiguous_planes_says_so() -> None:
    (row,) = (row for row in compare(GRADE, None, 7, [], 0, None) if "ambiguous" in row.what)
    assert row.this_run == "none"
