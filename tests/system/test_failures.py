"""What a real cell meets: the daemon killed, the wire cut, the camera gone. Real processes, real sockets."""

import itertools
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from srvs_cell.cli.client import DaemonClient
from srvs_cell.cli.simulated_cell import SimulatedCell, SimulationOptions, simulated_cell

LIMIT_S, POLL_S = 90.0, 0.04
"""The first is the longest that nothing may happen; how long a job takes depends on what else the machine does."""
NEAR_MM = 8.0
pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[SimulatedCell]:
    """A cell whose controller is given up after 2.5 seconds of silence instead of five."""
    options = SimulationOptions(objects=3, seed=1, imperfections="none")
    with simulated_cell(options, tmp_path, {"devices": {"arm": {"timeout_s": 2.5}}}) as running:
        yield running


def follow(cell: SimulatedCell, until: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Return the first status that satisfies the condition; fail with what the cell says where nothing happens."""
    deadline_s, seen = 0.0, None
    while not until(status := cell.client.read("status")):
        stage = status["state"], status["step"], status["moves_done"]
        if stage != seen:
            deadline_s, seen = time.monotonic() + LIMIT_S, stage
        assert time.monotonic() < deadline_s, f"{status['state']}, step {status['step']}: {status['alarms']}"
        time.sleep(POLL_S)  # other processes work meanwhile; there is nothing in this one to wait on
    return status


def bring_up(cell: SimulatedCell) -> None:
    for command, state in (("clear", "Stopped"), ("reset", "Idle")):
        assert cell.client.command(f"command/{command}")["accepted"]
        follow(cell, lambda status, state=state: status["state"] == state)  # type: ignore[misc]


def clear_until_stopped(cell: SimulatedCell) -> None:
    """Clear, again where the robot's program has not ended the cut move yet (ROBOT_BUSY)."""
    deadline_s = time.monotonic() + LIMIT_S
    while True:
        assert cell.client.command("command/clear")["accepted"]
        status = follow(cell, lambda status: status["state"] in {"Stopped", "Aborted"})
        if status["state"] == "Stopped":
            return
        assert time.monotonic() < deadline_s, status["alarms"]
        assert codes(status) <= {2011}


def start_until_holding(cell: SimulatedCell) -> dict[str, Any]:
    """Start the job and return the status when the gripper has taken the first part."""
    bring_up(cell)
    assert cell.client.command("command/start")["accepted"]
    return follow(cell, lambda status: status["gripper"]["knowledge"] == "holding")


def _standing(cell: SimulatedCell) -> list[tuple[float, float]]:
    """Return where the parts truly stand, sorted by y."""
    feet = (part["base_mm"] for part in cell.control.ask("truth")["parts"])
    return sorted(((float(x_mm), float(y_mm)) for x_mm, y_mm, _ in feet), key=lambda foot: foot[1])


def codes(status: dict[str, Any]) -> set[int]:
    return {alarm["code"] for alarm in status["alarms"]}


def test_nothing_moves_before_an_operator_commands_and_a_camera_that_stops_ends_in_held(cell: SimulatedCell) -> None:
    status = cell.client.read("status")
    assert status["state"] == "Aborted"
    refused = cell.client.command("command/start")
    assert not refused["accepted"]
    assert [step.lower() for step in refused["leads_there"]] == ["clear", "reset", "start"]
    bring_up(cell)
    assert cell.control.ask("truth")["motions_started"] == 0
    cell.control.ask("inject", fault="camera_stop")
    assert cell.client.command("command/start")["accepted"]
    status = follow(cell, lambda status: status["state"] in {"Held", "Aborted"})
    assert codes(status) & {3001, 3002, 3003}
    assert status["moves_done"] == 0


def test_killed_in_mid_plan_it_sends_no_move_again_and_plans_anew_after_a_person_has_looked(
    cell: SimulatedCell,
) -> None:
    places = _standing(cell)
    start_until_holding(cell)
    cell.daemon.kill()
    motions = cell.control.ask("truth")["motions_started"]
    cell.daemon.start()
    with DaemonClient(cell.daemon.socket_path) as client:
        restarted = replace(cell, client=client)
        status = follow(restarted, lambda status: bool(status["alarms"]))
        assert status["state"] == "Aborted"
        assert 5003 in codes(status)
        assert status["gripper"]["knowledge"] == "unknown"
        assert client.read("history")["history"], "the journal lost what it had"
        assert not client.command("command/start")["accepted"]
        assert not client.command("command/clear")["accepted"], "the operator has not said what the gripper holds"
        # before it is connected nobody can ask its sensor, and a person's word is all there is
        follow(restarted, lambda status: status["devices"]["gripper"]["lifecycle"] != "disconnected")
        assert not client.command("resolve", {"gripper": "empty"})["accepted"], (
            "the gripper's own sensor says otherwise"
        )
        assert client.command("resolve", {"gripper": "holding"})["accepted"]
        bring_up(restarted)
        moved = cell.control.ask("truth")["motions_started"]
        assert moved <= motions + 1, "only the move under way may have begun"
        assert client.command("command/start")["accepted"]
        status = follow(restarted, lambda status: status["state"] in {"Complete", "Held", "Aborted", "Stopped"})
        assert status["state"] == "Complete", status["alarms"]
        begun = [
            event["name"]
            for event in reversed(client.read("history?limit=1000")["history"])
            if event["kind"] == "step" and event["detail"]["phase"] == "begin" and event["run"] == status["job"]
        ]
        looked = ["observe_left", "move_laterally", "observe_right", "perceive"]
        assert begun[:6] == ["rise", "deliver", *looked], "something moved on that was not looked at anew"
        assert begun.index("plan") < begun.index("pick")
        assert status["unfinished_job"] is None
    # The part that was in the gripper went to a buffer place first; nobody has made a place of the job of that.
    for place, end in zip(places, _standing(cell), strict=True):
        assert math.dist(place, end) < NEAR_MM
    heights_mm = [
        part["height_mm"]
        for part in sorted(cell.control.ask("truth")["parts"], key=lambda part: -float(part["base_mm"][1]))
    ]
    assert all(later < earlier + 2.0 for earlier, later in itertools.pairwise(heights_mm))


def test_a_cut_wire_and_a_silent_controller_end_in_named_alarms_and_nothing_is_told_again(cell: SimulatedCell) -> None:
    start_until_holding(cell)
    cell.control.ask("inject", fault="wire_cut")
    status = follow(cell, lambda status: status["state"] == "Aborted")
    assert codes(status) & {1003, 2004}
    assert status["gripper"]["knowledge"] != "empty", "a part was held when the wire was cut"

    if status["gripper"]["knowledge"] == "unknown":
        assert cell.client.command("resolve", {"gripper": "holding"})["accepted"]
    clear_until_stopped(cell)
    assert cell.client.command("command/reset")["accepted"]
    follow(cell, lambda status: status["state"] == "Idle")
    assert cell.client.command("command/start")["accepted"]
    follow(cell, lambda status: status["step"] == "pick")
    motions = cell.control.ask("truth")["motions_started"]
    cell.control.ask("inject", fault="wire", kind="silent")
    status = follow(cell, lambda status: status["state"] == "Aborted")
    assert codes(status) & {1002, 1003, 1004, 2004}
    assert cell.control.ask("truth")["motions_started"] <= motions + 1
