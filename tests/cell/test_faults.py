"""What goes wrong ends in a named alarm and a defined state, and the journal has it."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell import Command, Mode, State, Unit
from srvs_cell.config import RetryParameters
from srvs_cell.ports import (
    CommandRejectedError,
    DeviceFaultError,
    NotConnectedError,
    NotReadyError,
    OutcomeUnknownError,
    RobotMode,
)
from tests.cell.support import PARAMETERS, Cell, build, connected, in_step, running, seen

if TYPE_CHECKING:
    from asyncio import Future
    from pathlib import Path

    from srvs_cell.cell import CommandAnswer, StereoLook
    from srvs_cell.ports import PortError, RobotStatus
    from srvs_cell.scene import Perception

ENDS = ("Complete", "Held", "Stopped", "Aborted", "Suspended")


async def run_to_end(cell: Cell) -> str:
    await connected(cell)
    await cell.start()
    return await cell.reaches(*ENDS)


def replace_equipment(cell: Cell, **changes: object) -> None:
    cell.unit = Unit(replace(cell.unit.equipment, **changes), simulation=True)  # type: ignore[arg-type]


# -- camera ---------------------------------------------------------------------------------------------------------


async def test_a_frame_that_does_not_come_is_asked_for_again(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.to_idle()
        await cell.give(Command.START)
        await cell.reaches("Execute")
        cell.camera.silent = 1
        assert await cell.reaches(*ENDS) == "Complete"


async def test_a_camera_that_stops_holds_the_cell(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await cell.reaches("Execute")
        cell.camera.silent = 1000
        assert await cell.reaches(*ENDS) == "Held"
        assert cell.alarms == ["CAMERA_TIMEOUT"]
        cell.camera.silent = 0
        await cell.give(Command.UNHOLD)
        assert await cell.reaches(*ENDS) == "Complete"
        assert cell.alarms == []
        assert "CAMERA_TIMEOUT" in {alarm["name"] for alarm in await cell.journal.alarms()}


async def test_frames_from_before_the_standstill_hold_the_cell(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await cell.reaches("Execute")
        cell.camera.frozen = 0.0
        assert await cell.reaches(*ENDS) == "Held"
        assert cell.alarms == ["CAMERA_STALE"]


async def test_a_camera_of_another_size_is_found_before_anything_moves(tmp_path: Path) -> None:
    cell = build(tmp_path)
    cell.camera.size = (32, 24)
    async with running(cell):
        assert await run_to_end(cell) == "Held"
        assert cell.alarms == ["IMAGE_INVALID"]
        assert cell.arm.targets == []


# -- robot ----------------------------------------------------------------------------------------------------------


async def test_what_a_job_ended_with_is_told_even_if_a_command_comes_while_it_is_journalled(tmp_path: Path) -> None:
    cell = build(tmp_path)
    cell.arm.trouble[5] = DeviceFaultError(Alarm.COLLISION, "SRVO-050 collision")
    plain = cell.journal.end_run
    commands: list[asyncio.Task[CommandAnswer]] = []

    def end_run(run: int, outcome: str) -> Future[None]:
        written = plain(run, outcome)
        if commands:
            return written
        commands.append(asyncio.create_task(cell.unit.command(Command.ABORT, "test")))
        # the disk is so slow that the command is answered first
        told: Future[None] = asyncio.get_running_loop().create_future()
        commands[0].add_done_callback(lambda _: written.add_done_callback(lambda done: told.set_result(done.result())))
        return told

    cell.journal.end_run = end_run  # type: ignore[method-assign]
    async with running(cell):
        assert await run_to_end(cell) == "Aborted"
        assert (await commands[0]).accepted
        assert "COLLISION" in cell.alarms


@pytest.mark.parametrize(
    ("error", "state", "alarm"),
    [
        (DeviceFaultError(Alarm.ROBOT_FAULT, "SRVO-050"), "Aborted", "ROBOT_FAULT"),
        (DeviceFaultError(Alarm.COLLISION, "SRVO-050 collision"), "Aborted", "COLLISION"),
        (CommandRejectedError(Alarm.TARGET_UNREACHABLE, "MOTN-018"), "Held", "TARGET_UNREACHABLE"),
        (OutcomeUnknownError(Alarm.MOTION_OUTCOME_UNKNOWN, "silence"), "Aborted", "MOTION_OUTCOME_UNKNOWN"),
        (NotConnectedError(Alarm.CONNECTION_LOST, "cut"), "Aborted", "CONNECTION_LOST"),
    ],
)
@pytest.mark.parametrize("move", [1, 2, 5, 9])
async def test_a_robot_that_fails_in_a_move(
    tmp_path: Path, error: PortError, state: str, alarm: str, move: int
) -> None:
    cell = build(tmp_path)
    cell.arm.trouble[move] = error
    async with running(cell):
        assert await run_to_end(cell) == state
        assert alarm in cell.alarms
        assert len(cell.arm.targets) == move
        await cell.clock.sleep(10.0)
        assert len(cell.arm.targets) == move


async def test_a_collision_keeps_its_name_although_the_status_says_fault_before_the_move_ends(tmp_path: Path) -> None:
    cell = build(tmp_path, parameters=replace(PARAMETERS, status_interval_s=0.01))
    cell.arm.trouble[2] = DeviceFaultError(Alarm.COLLISION, "SRVO-050 collision")
    async with running(cell):
        await connected(cell)
        await cell.start()
        await in_step(cell, "move_laterally")
        cell.arm.present = replace(cell.arm.present, fault="SRVO-050 collision")
        assert await cell.reaches(*ENDS) == "Aborted"
        assert "COLLISION" in cell.alarms


async def test_after_a_fault_only_clear_reset_and_start_move_again(tmp_path: Path) -> None:
    cell = build(tmp_path)
    cell.arm.trouble[6] = DeviceFaultError(Alarm.ROBOT_FAULT, "SRVO-050")
    async with running(cell):
        assert await run_to_end(cell) == "Aborted"
        assert cell.arm.fault_resets == 0
        await cell.give(Command.CLEAR)
        await cell.reaches("Stopped")
        assert cell.arm.fault_resets == 1
        assert cell.alarms == []
        await cell.give(Command.RESET)
        await cell.reaches("Idle")
        assert len(cell.arm.targets) == 6
        await cell.give(Command.START)
        assert await cell.reaches(*ENDS) == "Complete"


async def test_a_fault_between_motions_is_noticed(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.to_idle()
        cell.arm.present = replace(cell.arm.present, fault="SYST-011")
        await cell.reaches("Aborted")
        assert cell.alarms == ["ROBOT_FAULT"]


@pytest.mark.parametrize(
    ("change", "alarm"),
    [({"mode": RobotMode.T1}, "MODE_NOT_AUTO"), ({"servo_on": False}, "ROBOT_NOT_READY")],
)
async def test_a_robot_that_is_taken_over_by_a_person_stops_the_cell(
    tmp_path: Path, change: dict[str, object], alarm: str
) -> None:
    async with running(build(tmp_path, [])) as cell:
        await connected(cell)
        await cell.start()
        await cell.reaches("Suspended")
        cell.arm.present = replace(cell.arm.present, **change)  # type: ignore[arg-type]
        await cell.reaches("Stopped")
        assert alarm in cell.alarms
        commanded = len(cell.arm.targets)
        cell.arm.present = replace(cell.arm.present, mode=RobotMode.AUTO, servo_on=True)
        await cell.clock.sleep(15.0)
        assert (cell.state, len(cell.arm.targets)) == ("Stopped", commanded)


async def test_another_tool_frame_than_the_calibrations_aborts(tmp_path: Path) -> None:
    cell = build(tmp_path)
    calibration = cell.unit.equipment.calibration
    replace_equipment(cell, calibration=replace(calibration, robot=replace(calibration.robot, user_tool=4)))
    async with running(cell):
        await connected(cell)
        await cell.give(Command.CLEAR)
        await cell.reaches("Stopped")
        await cell.give(Command.RESET)
        await cell.reaches("Aborted")
        assert cell.alarms == ["FRAME_CHANGED"]


async def test_a_cut_wire_aborts_and_clear_reconnects(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.to_idle()
        cell.arm.unreachable = True
        await cell.reaches("Aborted")
        assert cell.alarms == ["CONNECTION_LOST"]
        await cell.give(Command.CLEAR)
        await cell.reaches("Aborted")
        cell.arm.unreachable = False
        await cell.start()
        assert await cell.reaches(*ENDS) == "Complete"


async def test_a_camera_that_is_gone_is_named_by_clear(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        cell.camera.unreachable = True
        await cell.give(Command.CLEAR)
        await cell.reaches("Aborted")
        (alarm,) = cell.unit.snapshot()["alarms"]
        assert alarm["detail"] == "camera: The fake camera does not answer."
        cell.camera.unreachable = False
        await cell.start()
        assert await cell.reaches(*ENDS) == "Complete"


async def test_silence_in_mid_move_needs_a_person_to_look(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await in_step(cell, "pick")
        cell.arm.unreachable = True
        await cell.reaches("Aborted")
        cell.arm.unreachable = False
        refused = await cell.unit.command(Command.CLEAR, "test")
        assert not refused.accepted
        assert "resolve gripper" in refused.reason
        assert "clear" not in cell.unit.snapshot()["allowed_commands"]
        assert (await cell.unit.resolve_gripper("empty", "test")).accepted
        await cell.start()
        assert await cell.reaches(*ENDS) == "Complete"


async def test_a_gripper_that_only_a_robot_without_fault_can_read_is_reached_after_the_reset(tmp_path: Path) -> None:
    """As a gripper on the robot's inputs is over RMI, whose inputs cannot be read in a fault."""
    cell = build(tmp_path)
    reach = cell.gripper.connect

    async def through_the_robot() -> None:
        if cell.arm.present.fault is not None:
            raise NotReadyError(Alarm.ROBOT_FAULT, cell.arm.present.fault)
        await reach()

    cell.gripper.connect = through_the_robot  # type: ignore[method-assign]
    cell.arm.present = replace(cell.arm.present, fault="SRVO-001")
    async with running(cell):
        await cell.start()
        assert await cell.reaches(*ENDS) == "Complete"
        assert cell.arm.fault_resets == 1


async def test_a_fault_that_stays_is_named_although_the_gripper_fails_too(tmp_path: Path) -> None:
    cell = build(tmp_path)

    async def stays() -> None:
        cell.arm.fault_resets += 1

    cell.arm.reset_fault = stays  # type: ignore[method-assign]
    cell.arm.present = replace(cell.arm.present, fault="SRVO-001")
    async with running(cell):
        await connected(cell)
        cell.gripper.unreachable = True
        await cell.gripper.disconnect()
        await cell.give(Command.CLEAR)
        await cell.reaches("Aborted")
        (alarm,) = cell.unit.snapshot()["alarms"]
        assert alarm["name"] == "ROBOT_FAULT"
        assert "SRVO-001" in alarm["detail"]
        assert "gripper: The fake gripper does not answer" in alarm["detail"]


# -- gripper --------------------------------------------------------------------------------------------------------


async def test_an_empty_grip_is_looked_at_again_and_planned_anew(tmp_path: Path) -> None:
    cell = build(tmp_path)
    cell.gripper.misses = 1
    async with running(cell):
        assert await run_to_end(cell) == "Complete"
        steps = [event["name"] for event in await cell.journal.history(500) if event["kind"] == "step"]
        assert steps.count("plan") == 2 * 2
        heights = [block.height_mm for block in sorted(cell.world.blocks, key=lambda block: -block.y_mm)]
        assert heights == sorted(heights, reverse=True)


async def test_grips_that_stay_empty_hold_the_cell(tmp_path: Path) -> None:
    cell = build(tmp_path)
    cell.gripper.misses = 100
    async with running(cell):
        assert await run_to_end(cell) == "Held"
        assert cell.alarms == ["SCENE_CHANGED", "GRIP_EMPTY"]
        assert cell.arm.pose.z_mm >= 60.0


async def test_a_part_lost_on_the_way_holds_a_cell_that_may_not_look_for_it(tmp_path: Path) -> None:
    async with running(build(tmp_path, parameters=replace(PARAMETERS, retries=RetryParameters(grip=0)))) as cell:
        await connected(cell)
        await cell.start()
        await cell.until("step", "place")
        cell.world.lose()
        assert await cell.reaches(*ENDS) == "Held"
        assert cell.alarms == ["GRIP_LOST"]
        await cell.give(Command.UNHOLD)
        assert await cell.reaches(*ENDS) == "Complete"


async def test_a_sensor_that_does_not_confirm_asks_for_a_person(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await cell.until("step", "pick")
        cell.gripper.silent = True
        assert await cell.reaches(*ENDS) == "Held"
        assert cell.alarms == ["GRIP_TIMEOUT"]
        refused = await cell.unit.command(Command.UNHOLD, "test")
        assert (refused.accepted, refused.alarm) == (False, Alarm.GRIPPER_STATE_UNKNOWN)
        cell.gripper.silent = False
        said = "holding" if cell.world.held else "empty"
        wrong = await cell.unit.resolve_gripper("empty" if cell.world.held else "holding", "test")
        assert not wrong.accepted
        assert "sensors say" in wrong.reason
        assert (await cell.unit.resolve_gripper(said, "test")).accepted
        await cell.give(Command.UNHOLD)
        assert await cell.reaches(*ENDS) == "Complete"


async def test_a_part_in_the_gripper_that_nobody_picked_is_refused_at_reset(tmp_path: Path) -> None:
    cell = build(tmp_path)
    block = cell.world.blocks[0]
    cell.world.held = (block, (0.0, 0.0, -20.0, 0.0))
    async with running(cell):
        await connected(cell)
        await cell.give(Command.CLEAR)
        await cell.reaches("Stopped")
        await cell.give(Command.RESET)
        await cell.until("alarms", cell.unit.snapshot()["alarms"])
        await cell.reaches("Stopped")
        await cell.clock.sleep(1.0)
        assert cell.alarms == ["GRIPPER_OCCUPIED"]
        assert cell.arm.targets == []


# -- vision and planning --------------------------------------------------------------------------------------------


async def test_an_uncertain_position_is_looked_at_again_and_then_refused(tmp_path: Path) -> None:
    cell = build(tmp_path)
    replace_equipment(cell, perceive=lambda _: seen(cell.world, 100.0 * np.eye(3)))
    async with running(cell):
        assert await run_to_end(cell) == "Held"
        assert cell.alarms == ["UNCERTAIN_POSITION"]
        assert cell.unit.snapshot()["moves_done"] == 0
        assert len(cell.arm.targets) == 4


async def test_a_vision_that_fails_unexpectedly_is_a_named_alarm(tmp_path: Path) -> None:
    cell = build(tmp_path)

    def broken(_: StereoLook) -> Perception:
        raise ZeroDivisionError("no planes")

    replace_equipment(cell, perceive=broken)
    async with running(cell):
        assert await run_to_end(cell) == "Aborted"
        assert cell.alarms == ["INTERNAL_ERROR"]
        assert "ZeroDivisionError: no planes" in cell.unit.snapshot()["alarms"][0]["detail"]
        assert (await cell.journal.runs())[0]["outcome"] == "INTERNAL_ERROR"


async def test_no_plan_names_the_reasons(tmp_path: Path) -> None:
    cell = build(tmp_path)

    def refuse(*_: object) -> None:
        raise AlarmError(Alarm.NO_BUFFER_PLACE, "The table is full.")

    replace_equipment(cell, plan=refuse)
    async with running(cell):
        assert await run_to_end(cell) == "Held"
        assert cell.unit.snapshot()["alarms"][0]["detail"] == "The table is full."


# -- journal --------------------------------------------------------------------------------------------------------


async def test_without_a_journal_nothing_moves(tmp_path: Path) -> None:
    (tmp_path / "journal.sqlite").mkdir()
    cell = build(tmp_path)
    async with running(cell):
        await connected(cell)
        assert cell.alarms == ["JOURNAL_FAILED"]
        await cell.unit.command(Command.CLEAR, "test")
        await cell.reaches("Aborted")
        assert cell.alarms == ["JOURNAL_FAILED"]
        assert cell.arm.targets == []


async def test_a_journal_that_fails_in_mid_job_ends_the_motion(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.start()
        await cell.until("step", "pick")
        await cell.journal.close()
        await cell.reaches("Aborted")
        commanded = len(cell.arm.targets)
        assert "JOURNAL_FAILED" in cell.alarms
        await cell.clock.sleep(10.0)
        assert len(cell.arm.targets) == commanded


# -- commands at the wrong time, modes ------------------------------------------------------------------------------


async def test_commands_at_the_wrong_time_change_nothing_and_are_answered(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        for command in (Command.START, Command.RESET, Command.HOLD, Command.COMPLETE):
            answer = await cell.unit.command(command, "test")
            assert (answer.accepted, answer.state, answer.alarm) == (False, State.ABORTED, Alarm.COMMAND_REFUSED)
        assert (await cell.unit.command(Command.START, "test")).leads_there == (
            Command.CLEAR,
            Command.RESET,
            Command.START,
        )
        events = [event for event in await cell.journal.history() if event["kind"] == "command"]
        assert [event["name"] for event in events] == ["start", "complete", "hold", "reset", "start"]
        assert events[0]["source"] == "test"
        assert not events[0]["detail"]["accepted"]


async def test_the_mode_is_changed_only_at_rest(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        assert (await cell.unit.set_mode(Mode.DRY_RUN, "test")).accepted
        assert cell.unit.snapshot()["mode"] == "Dry run"
        await cell.start()
        await cell.reaches("Execute")
        refused = await cell.unit.set_mode(Mode.PRODUCTION, "test")
        assert (refused.accepted, refused.alarm) == (False, Alarm.MODE_REFUSED)


async def test_a_dry_run_moves_above_the_parts_and_grips_nothing(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.unit.set_mode(Mode.DRY_RUN, "test")
        before = [(block.x_mm, block.y_mm) for block in cell.world.blocks]
        assert await run_to_end(cell) == "Complete"
        assert [(block.x_mm, block.y_mm) for block in cell.world.blocks] == before
        assert min(target.z_mm for target in cell.arm.targets) >= 60.0 + 30.0
        assert {motion["kind"] for motion in await cell.journal.motions()} == {"move_linear", "move_joint"}
        assert cell.unit.snapshot()["moves_done"] == 3


async def test_manual_does_one_step_at_a_time(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.unit.set_mode(Mode.MANUAL, "test")
        await cell.start()
        seen_steps = []
        while await cell.reaches("Held", "Complete") == "Held":
            seen_steps.append(cell.unit.snapshot()["next_step"])
            await cell.clock.sleep(5.0)
            assert cell.state == "Held"
            await cell.give(Command.UNHOLD)
        looked = ["observe_left", "move_laterally", "observe_right", "perceive"]
        assert seen_steps[:7] == [*looked, "confirm", "plan", "pick"]
        assert seen_steps[-1] == "verify"
        assert cell.world.dropped == []


async def test_maintenance_looks_and_touches_nothing(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.unit.set_mode(Mode.MAINTENANCE, "test")
        await cell.to_idle()
        await cell.give(Command.START)
        await cell.reaches("Execute")
        await cell.reaches("Stopped", "Held", "Aborted")
        assert (cell.state, cell.alarms) == ("Stopped", [])
        assert len(cell.arm.targets) == 2
        assert len(cell.unit.snapshot()["workpieces"]) == 3


# -- the unit itself ------------------------------------------------------------------------------------------------


async def test_a_unit_turns_while_it_waits_and_not_while_a_driver_never_answers(tmp_path: Path) -> None:
    async with running(build(tmp_path)) as cell:
        await connected(cell)
        await cell.to_idle()
        before = cell.unit.turns
        await cell.clock.sleep(10.0)
        assert cell.unit.turns >= before + 10

        answers = asyncio.Event()

        async def silence() -> RobotStatus:
            await answers.wait()
            return cell.arm.present

        cell.arm.status = silence  # type: ignore[method-assign]
        await cell.clock.sleep(2.0)
        before = cell.unit.turns
        await cell.clock.sleep(60.0)
        assert cell.unit.turns == before
        answers.set()


async def test_a_clock_that_was_lost_is_watched_by_again_after_clear(tmp_path: Path) -> None:
    async with running(build(tmp_path, parameters=replace(PARAMETERS, status_interval_s=0.001))) as cell:
        await connected(cell)
        await cell.to_idle()
        there = cell.clock.sleep

        async def gone(seconds: float) -> None:
            raise NotConnectedError(Alarm.CONNECTION_LOST, f"no {seconds} s on a clock that is gone")

        cell.clock.sleep = gone  # type: ignore[method-assign]
        assert await cell.reaches("Aborted") == "Aborted"
        cell.clock.sleep = there  # type: ignore[method-assign]
        await cell.to_idle()
        cell.arm.present = replace(cell.arm.present, fault="SRVO-001")
        assert await cell.reaches("Aborted") == "Aborted", "nobody watches the arm any more"
        assert cell.alarms == ["ROBOT_FAULT"]
