"""What anybody can see of the cell, as plain JSON values: what the service, the page and the tests read."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from srvs_cell.cell.export import plan_json, plan_list, status_json, workpiece_json
from srvs_cell.cell.job import Progress
from srvs_cell.cell.packml import MODE_CHANGE_STATES
from srvs_cell.ports import Counting

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.cell.devices import Devices
    from srvs_cell.cell.manipulator import Hand
    from srvs_cell.cell.notices import Notices
    from srvs_cell.cell.packml import Command, Mode, State
    from srvs_cell.cell.runner import JobRunner
    from srvs_cell.ports import RobotStatus

Json = dict[str, Any]


def make_snapshot(
    *,
    state: State,
    mode: Mode,
    simulation: bool,
    allowed: Sequence[Command],
    runner: JobRunner,
    notices: Notices,
    hand: Hand,
    status: RobotStatus | None,
    devices: Devices,
) -> Json:
    """Return all that is known of the cell."""
    job = runner.job
    now_s = devices.clock.now_s()
    return {
        "version": notices.version,
        "state": state.title,
        "state_number": int(state),
        "mode": mode.title,
        "mode_number": int(mode),
        "simulation": simulation,
        "job": notices.run,
        "next_step": job.next_step() if job is not None and runner.paused else None,
        "run_directory": None if job is None else str(job.folder),
        "runs_done": runner.runs_done,
        "unfinished_job": None if runner.places is None else runner.places.begun_by,
        **_progress_json(Progress() if job is None else job.progress),
        "alarms": notices.alarms.as_json(),
        "gripper": {
            "knowledge": hand.knowledge.value,
            "workpiece": None if hand.held is None else hand.held.workpiece,
            "kind": None if hand.held is None else hand.held.kind,
        },
        "arm": None if status is None else status_json(status, now_s),
        "devices": {
            name: {
                "lifecycle": device.lifecycle.value,
                "description": device.description,
                "counters": device.counters if isinstance(device, Counting) else {},
            }
            for name, device in devices.named()
        },
        "allowed_commands": [command.title for command in allowed],
        "mode_change_allowed": state in MODE_CHANGE_STATES,
        "clock_s": round(now_s, 3),
    }


def _progress_json(progress: Progress) -> Json:
    plan = progress.plan
    return {
        "step": None if progress.step is None else progress.step.value,
        "workpieces": [workpiece_json(workpiece) for workpiece in progress.workpieces],
        "plan": [] if plan is None else plan_list(plan),
        "plan_detail": None if plan is None else plan_json(plan),
        "moves_done": progress.moves_done,
        "moves_total": progress.moves_done + progress.moves_left,
        "timings_ms": {name: round(elapsed_ms, 3) for name, elapsed_ms in progress.timings_ms.items()},
        "artefacts": dict(progress.artefacts),
        "job_time_s": progress.job_time_s,
    }
