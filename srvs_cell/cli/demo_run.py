"""One demo: start the simulated cell and the daemon, work through the operator's commands, judge, report."""

from __future__ import annotations

import json
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cli.simulated_cell import SimulationOptions, SimulatorControl, simulated_cell
from srvs_cell.scene import Workpiece
from srvs_cell.service.grading import Goal, Grade, TruePart, grade
from srvs_cell.service.pictures import PlanArrow, PlanPart, draw_plan
from srvs_cell.service.report import Figure, Report, compare, part_rows, render_report
from srvs_cell.vision.overlay import draw_locations

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from srvs_cell.cli.client import DaemonClient

_JOB_LIMIT_S, _STATE_LIMIT_S = 900.0, 60.0
_POLL_S = 0.05
_MOVE_STEPS = {"pick", "place"}
_WORKING = {"Starting", "Execute", "Unholding", "Completing", "Suspending", "Unsuspending"}


@dataclass(frozen=True)
class DemoOptions:
    """What the user chose."""

    simulation: SimulationOptions
    out: Path

    def command(self) -> str:
        """Return the command line that repeats this run."""
        chosen = self.simulation
        return (
            f"srvs-cell demo --objects {chosen.objects} --seed {chosen.seed} --imperfections {chosen.imperfections} "
            f"--wire {chosen.wire}"
        )


def true_parts(control: SimulatorControl) -> list[TruePart]:
    """Return every part as it really stands now."""
    return [TruePart.from_truth(part) for part in control.ask("truth")["parts"]]


def run_demo(options: DemoOptions, progress: Callable[[str], None]) -> dict[str, Any]:
    """Run one demo and write its report.

    Args:
        options: what the user chose.
        progress: called with a line of text at each step.

    Returns:
        The object that ``demo --json`` prints.

    Raises:
        AlarmError: the simulated cell or the daemon did not start, or did not answer.
    """
    out = options.out
    if out.exists():
        _clear(out)
    out.mkdir(parents=True, exist_ok=True)
    simulation = options.simulation
    progress(
        f"simulated cell: {simulation.objects} parts, seed {simulation.seed}, {simulation.imperfections} imperfections"
    )
    with simulated_cell(simulation, out) as cell:
        before = true_parts(cell.control)
        status = work_through(cell.client, progress)
        after = true_parts(cell.control)
    return _conclude(options, status, before, after, progress)


def _clear(out: Path) -> None:
    """Empty the folder of an earlier demo; refuse any other folder."""
    if any(out.iterdir()) and not (out / "demo.json").exists() and not (out / "cell.yaml").exists():
        raise AlarmError(Alarm.FILE_INVALID, f"{out} is not empty and holds no earlier demo; choose another --out.")
    for entry in out.iterdir():
        shutil.rmtree(entry) if entry.is_dir() else entry.unlink()


def work_through(client: DaemonClient, progress: Callable[[str], None]) -> dict[str, Any]:
    """Give the operator's commands and watch until the job ends; return the last status."""
    for command, state in (("clear", "Stopped"), ("reset", "Idle")):
        status = _command(client, command, state)
        if status["state"] != state:
            return status
        progress(f"{command}: {state}")
    _accepted(client, "start")
    started_s = time.monotonic()
    shown: tuple[Any, ...] = ()
    for status in client.changes():
        now = (status["state"], status["step"])
        if now != shown and status["step"] is not None:
            moving = status["step"] in _MOVE_STEPS
            move = f", move {status['moves_done'] + 1} of {status['moves_total']}" if moving else ""
            progress(f"[{status['clock_s']:8.1f} s] {status['state']}: {status['step'].replace('_', ' ')}{move}")
            shown = now
        if status["state"] not in _WORKING or time.monotonic() - started_s > _JOB_LIMIT_S:
            return status
    return client.read("status")


def _accepted(client: DaemonClient, command: str) -> None:
    answer = client.command(f"command/{command}")
    if not answer["accepted"]:
        raise AlarmError(Alarm.COMMAND_REFUSED, f"{command}: {answer['reason']}")


def _command(client: DaemonClient, command: str, wanted: str) -> dict[str, Any]:
    """Give a command and wait for the state that it ends in, or for a wait state that it did not want."""
    _accepted(client, command)
    deadline_s = time.monotonic() + _STATE_LIMIT_S
    status = client.read("status")
    while status["state"] not in {wanted, "Aborted", "Held"} and time.monotonic() < deadline_s:
        time.sleep(_POLL_S)
        status = client.read("status")
    return status


def _conclude(
    options: DemoOptions,
    status: Mapping[str, Any],
    before: Sequence[TruePart],
    after: Sequence[TruePart],
    progress: Callable[[str], None],
) -> dict[str, Any]:
    """Judge, write the pictures and the page, and return the JSON."""
    run = Path(status["run_directory"]) if status.get("run_directory") else None
    look = _first_planned_look(run)
    perception = _read(run, f"perception_{look}.json")
    plan = _read(run, f"plan_{look}.json")
    workpieces = perception.get("workpieces", [])
    moves = [PlanArrow(m["workpiece"], tuple(m["from_mm"]), tuple(m["to_mm"])) for m in plan.get("moves", [])]
    verdict = grade(
        before,
        after,
        {w["id"]: tuple(w["position_mm"]) for w in workpieces},
        [Goal(g["workpiece"], tuple(g["point_mm"])) for g in plan.get("goals", [])],
        frozenset(move.workpiece_id for move in moves),
    )
    ended = [] if status["state"] == "Complete" else [f"the cell ended in {status['state']}, not in Complete"]
    told = [a for a in status["alarms"] if ended or a["severity"] != "warning" or a["name"] == "PART_LEFT"]
    alarms = [f"alarm {a['code']} {a['name']}: {a['detail']}" for a in told]
    reasons = [*ended, *alarms, *verdict.reasons]
    success = verdict.success and not ended
    result = {
        "success": success,
        "state": status["state"],
        "mode": status["mode"],
        "simulation": status["simulation"],
        "objects": options.simulation.objects,
        "seed": options.simulation.seed,
        "imperfections": options.simulation.imperfections,
        "workpieces": workpieces,
        "plan": plan.get("plan", []),
        "moves_done": status["moves_done"],
        "moves_least": plan.get("bound_moves"),
        "moves_proven": plan.get("moves_proven"),
        "matched_planes": perception.get("matches"),
        "ambiguous_px": perception.get("ambiguous_px", []),
        "position_error_mm": verdict.error_summary("position_error_mm"),
        "grasp_offset_mm": verdict.error_summary("grasp_offset_mm"),
        "placement_error_mm": verdict.error_summary("placement_error_mm"),
        "job_time_s": status["job_time_s"],
        "timings_ms": perception.get("timings_ms", {}),
        "reasons": [*reasons, *(f"part {v.part.id}: {'; '.join(v.reasons)}" for v in verdict.parts if v.reasons)],
    }
    _write_report(options, result, verdict, run, [_plan_part(w) for w in workpieces], moves)
    (options.out / "demo.json").write_text(json.dumps(result, indent=1), encoding="utf-8")
    _say(result, options.out, progress)
    return result


def _first_planned_look(run: Path | None) -> int:
    """Return the number of the look that the first plan was made from; the first look where no plan was made."""
    plans = [] if run is None else [int(path.stem.split("_")[1]) for path in run.glob("plan_*.json")]
    return min(plans, default=0)


def _read(run: Path | None, name: str) -> dict[str, Any]:
    path = None if run is None else run / name
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path and path.exists() else {}
    return content


def _plan_part(workpiece: Mapping[str, Any]) -> PlanPart:
    x, y, _ = workpiece["position_mm"]
    footprint = tuple((corner[0], corner[1]) for corner in workpiece["footprint_mm"])
    return PlanPart(workpiece["id"], (x, y), workpiece["height_mm"], footprint)


def _workpiece(seen: Mapping[str, Any]) -> Workpiece:
    """Return a perceived workpiece of the run's JSON, as far as a picture needs it."""
    x, y, z = seen["position_mm"]
    return Workpiece(
        id=seen["id"],
        kind=seen["kind"],
        position_mm=(x, y, z),
        height_mm=seen["height_mm"],
        yaw_deg=seen["yaw_deg"],
        size_mm=tuple(seen["size_mm"]),
        covariance_mm2=np.array(seen["covariance_mm2"]),
        footprint_mm=np.array(seen["footprint_mm"]),
        surfaces=tuple(seen["surfaces"]),
        grasp=None,
    )


def _write_report(
    options: DemoOptions,
    result: Mapping[str, Any],
    verdict: Grade,
    run: Path | None,
    parts: Sequence[PlanPart],
    moves: Sequence[PlanArrow],
) -> None:
    out = options.out
    cv2.imwrite(str(out / "plan.png"), draw_plan(parts, moves))
    caption = "Left and right image with the matched planes numbered (as the paper's Fig. 6)"
    planes = _copied(run, f"planes_{_first_planned_look(run)}.png", out, "planes.png", caption)
    figures = [planes] if planes else []
    seen = [_workpiece(w) for w in result["workpieces"]]
    true_mm = [part.part.position_mm for part in verdict.parts]
    cv2.imwrite(str(out / "locations.png"), draw_locations(seen, true_mm))
    figures.append(Figure("locations.png", "Three-dimensional locations against the truth (as the paper's Fig. 7)"))
    figures.append(Figure("plan.png", "The plan, seen from above: parts with number and height, moves in order"))
    last = max((int(p.stem.split("_")[1]) for p in run.glob("left_*.png")), default=0) if run else 0
    before_after = [
        figure
        for source, name, caption in (
            ("left_0.png", "before.png", "before, left image"),
            (f"left_{last}.png", "after.png", "after, left image"),
        )
        if last and (figure := _copied(run, source, out, name, caption))
    ]
    report = Report(
        grade=verdict,
        reasons=tuple(result["reasons"]),
        seed=options.simulation.seed,
        imperfections=options.simulation.imperfections,
        command=options.command(),
        comparison=compare(
            verdict,
            result["job_time_s"],
            result["matched_planes"] or 0,
            result["ambiguous_px"],
            result["moves_done"],
            result["moves_least"],
        ),
        figures=tuple(figures),
        before_after=tuple(before_after),
        part_rows=part_rows(verdict, result["workpieces"]),
        moves=moves,
        timings_ms=result["timings_ms"],
    )
    (out / "report.html").write_text(render_report(report), encoding="utf-8")


def _copied(run: Path | None, source: str, out: Path, name: str, caption: str) -> Figure | None:
    """Copy a picture of the run beside the page; None where the run has none."""
    if run is None or not (run / source).exists():
        return None
    shutil.copyfile(run / source, out / name)
    return Figure(name, caption)


def _say(result: Mapping[str, Any], out: Path, progress: Callable[[str], None]) -> None:
    error, placed = result["position_error_mm"], result["placement_error_mm"]
    if error["mean"] is not None:
        progress(f"position error: mean {error['mean']:.2f} mm, max {error['max']:.2f} mm (paper: 8.9, 25.2)")
    if placed["mean"] is not None:
        progress(f"placement error: mean {placed['mean']:.2f} mm, max {placed['max']:.2f} mm")
    if result["job_time_s"] is not None:
        progress(f"first image to last release: {result['job_time_s']:.1f} s (paper: 480 s)")
    progress(f"moves: {result['moves_done']}, least possible {result['moves_least']}")
    progress("the simulator's truth agrees: the job is done" if result["success"] else "the job FAILED")
    progress(f"report: {out / 'report.html'}")
