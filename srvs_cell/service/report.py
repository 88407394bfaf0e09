"""The demo's report: an HTML page beside its pictures, readable without a network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import jinja2
import numpy as np

from srvs_cell import __version__

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from srvs_cell.service.grading import Grade
    from srvs_cell.service.pictures import PlanArrow

PAPER_TIME = "8 min"
PAPER_MEAN_ERROR = "8.9 mm"
PAPER_MAX_ERROR = "25.2 mm"
_DASH = "-"


@dataclass(frozen=True)
class Figure:
    """A picture of the report: its file beside the page, and what it shows."""

    file: str
    caption: str


@dataclass(frozen=True)
class Comparison:
    """A line of the table "paper / this run"."""

    what: str
    paper: str
    this_run: str


@dataclass(frozen=True)
class Report:
    """All that the page says."""

    grade: Grade
    reasons: tuple[str, ...]
    seed: int
    imperfections: str
    command: str
    comparison: tuple[Comparison, ...]
    figures: tuple[Figure, ...]
    before_after: tuple[Figure, ...]
    part_rows: tuple[Mapping[str, str], ...]
    moves: Sequence[PlanArrow]
    timings_ms: Mapping[str, float]
    version: str = __version__


def _mm(value: float | None) -> str:
    return _DASH if value is None else f"{value:.2f}"


def _mean_and_max(summary: Mapping[str, float | None]) -> str:
    return f"{_with_unit(summary['mean'])} / {_with_unit(summary['max'])}"


def _with_unit(value_mm: float | None) -> str:
    return _DASH if value_mm is None else f"{value_mm:.2f} mm"


def compare(
    grade: Grade,
    job_time_s: float | None,
    matched_planes: int,
    ambiguous_px: Sequence[Sequence[float]],
    moves_done: int,
    moves_least: int | None,
) -> tuple[Comparison, ...]:
    """Make the table "paper / this run"; ``ambiguous_px``: centres of the planes that were not matched for doubt."""
    error = grade.error_summary("position_error_mm")
    least = "no plan" if moves_least is None else f"{moves_done} of at least {moves_least}"
    return (
        Comparison(
            "time from first image to last release", PAPER_TIME, _DASH if job_time_s is None else f"{job_time_s:.1f} s"
        ),
        Comparison("mean position error", PAPER_MEAN_ERROR, _with_unit(error["mean"])),
        Comparison("maximum position error", PAPER_MAX_ERROR, _with_unit(error["max"])),
        Comparison("matched planes", "all", str(matched_planes)),
        Comparison("planes left unmatched because they are ambiguous", "none", _places(ambiguous_px)),
        Comparison("moves", "the minimum", least),
        Comparison(
            "grasp offset from the centre, mean / max",
            "not at the centre",
            _mean_and_max(grade.error_summary("grasp_offset_mm")),
        ),
        Comparison(
            "placement error, mean / max", "not given", _mean_and_max(grade.error_summary("placement_error_mm"))
        ),
    )


def _places(centres_px: Sequence[Sequence[float]]) -> str:
    """Return how many and where."""
    if not centres_px:
        return "none"
    places = ", ".join(f"({x:.0f}, {y:.0f})" for x, y in centres_px)
    return f"{len(centres_px)}, at x, y px of the left image: {places}"


def part_rows(grade: Grade, workpieces: Sequence[Mapping[str, Any]]) -> tuple[Mapping[str, str], ...]:
    """Make the table "part by part" from the verdicts and the first perception's workpieces (perceive's JSON)."""
    seen = {workpiece["id"]: workpiece for workpiece in workpieces}
    rows = []
    for verdict in grade.parts:
        workpiece = seen.get(verdict.workpiece_id)
        sigma_mm = None if workpiece is None else float(np.sqrt(np.trace(np.array(workpiece["covariance_mm2"]))))
        rows.append(
            {
                "part": str(verdict.part.id),
                "kind": verdict.part.kind,
                "seen_as": _DASH if workpiece is None else f"{workpiece['kind']} {workpiece['id']}",
                "height": f"{verdict.part.height_mm:.1f}",
                "position_error": _mm(verdict.position_error_mm),
                "expected": _mm(sigma_mm),
                "grasp_offset": _mm(verdict.grasp_offset_mm),
                "placement_error": _mm(verdict.placement_error_mm),
                "turn": f"{verdict.angle_error_deg:.1f}",
                "tilt": f"{verdict.tilt_deg:.1f}",
                "remark": "; ".join(verdict.reasons),
            }
        )
    return tuple(rows)


def render_report(report: Report) -> str:
    """Return the page as HTML."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("srvs_cell.service"), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template("report.html").render(report=report)
