"""A unit that follows the PackML table at once, and a journal in memory."""

from __future__ import annotations

import asyncio
from typing import Any

from srvs_cell.alarms import Alarm
from srvs_cell.cell import Command, CommandAnswer, Mode, State
from srvs_cell.cell.packml import STATE_COMPLETE, allowed_commands, refuse, target_state


class FakeUnit:
    def __init__(self) -> None:
        self.state = State.ABORTED
        self.mode = Mode.PRODUCTION
        self.version = 1
        self.sources: list[str] = []
        self.gripper: str | None = None
        self._changed = asyncio.Condition()

    async def command(self, command: Command, source: str) -> CommandAnswer:
        self.sources.append(source)
        target = target_state(self.state, command, self.mode)
        if target is None:
            refusal = refuse(self.state, command, self.mode)
            return CommandAnswer(False, self.state, refusal.reason, Alarm.COMMAND_REFUSED, refusal.leads_there)
        while target in STATE_COMPLETE:
            target = STATE_COMPLETE[target]
        self.state = target
        await self.change()
        return CommandAnswer(True, self.state)

    async def set_mode(self, mode: Mode, source: str) -> CommandAnswer:
        self.sources.append(source)
        if self.state is State.EXECUTE:
            return CommandAnswer(False, self.state, "The mode stays in Execute.", Alarm.MODE_REFUSED)
        self.mode = mode
        await self.change()
        return CommandAnswer(True, self.state)

    async def resolve_gripper(self, holds: str, source: str) -> CommandAnswer:
        self.sources.append(source)
        self.gripper = holds
        return CommandAnswer(True, self.state)

    async def forget_job(self, source: str) -> CommandAnswer:
        self.sources.append(source)
        return CommandAnswer(False, self.state, "There is no unfinished job.", Alarm.COMMAND_REFUSED)

    async def change(self) -> None:
        async with self._changed:
            self.version += 1
            self._changed.notify_all()

    async def wait_change(self, version: int) -> int:
        async with self._changed:
            await self._changed.wait_for(lambda: self.version != version)
        return self.version

    def snapshot(self) -> dict[str, Any]:
        """The keys and types of the real unit's snapshot (checked against it in test_daemon.py)."""
        part = {
            "id": 3,
            "kind": "cuboid <b>",
            "position_mm": [400.0, -20.5, 60.0],
            "height_mm": 60.0,
            "yaw_deg": None,
            "size_mm": [50.0, 40.0],
            "brightness": 187.0,
            "grasp_refusal": "",
        }
        alarm = {
            "code": 2101,
            "name": "GRIP_EMPTY",
            "severity": "error",
            "detail": "at place 3",
            "cause": "The gripper closed and holds nothing.",
            "remedy": "Check the part and the gripper's sensor; unhold to look again.",
            "since": "2026-01-01T00:00:00.000+00:00",
        }
        folder = "/var/lib/srvs-cell/runs/000007"
        return {
            "version": self.version,
            "state": self.state.title,
            "state_number": int(self.state),
            "mode": self.mode.title,
            "mode_number": int(self.mode),
            "simulation": True,
            "job": 7,
            "step": "pick",
            "next_step": None,
            "workpieces": [part],
            "plan": [[3, 1, 2], [4, 5, 6]],
            "plan_detail": {
                "status": "solved",
                "plan": [[3, 1, 2], [4, 5, 6]],
                "travel_mm": 812.3,
                "moves_proven": True,
                "travel_proven": True,
                "bound_moves": 2,
                "bound_travel_mm": 812.3,
                "reasons": [],
                "moves": [
                    {"workpiece": number, "from_mm": [1.0, 2.0], "to_mm": [3.0, 4.0], "turn_deg": -35.0}
                    for number in (3, 4)
                ],
            },
            "moves_done": 1,
            "moves_total": 2,
            "alarms": [alarm],
            "gripper": {"knowledge": "holding", "workpiece": 3, "kind": "cuboid"},
            "arm": None,
            "devices": {"arm": {"lifecycle": "active", "description": "a fake", "counters": {"frames": 7}}},
            "allowed_commands": [command.title for command in allowed_commands(self.state, self.mode)],
            "mode_change_allowed": True,
            "timings_ms": {},
            "job_time_s": None,
            "runs_done": 6,
            "unfinished_job": 5,
            "run_directory": folder,
            "artefacts": {
                "left_1": f"{folder}/left_1.png",
                "left_2": f"{folder}/left_2.png",
                "overlay_2": f"{folder}/overlay_2.png",
                "perception_2": f"{folder}/perception_2.json",
            },
            "clock_s": 12.5,
        }


class FakeJournal:
    async def history(self, limit: int = 100) -> list[dict[str, Any]]:
        return [
            {
                "id": number,
                "at": "2026-01-01T00:00:00",
                "kind": "command",
                "name": "clear",
                "source": "test",
                "detail": {},
            }
            for number in range(limit)
        ]

    async def alarms(self, limit: int = 100) -> list[dict[str, Any]]:
        row = {"id": 1, "at": "2026-01-01T00:00:00", "run": None, "cleared_at": None}
        known = {**row, "code": 2101, "name": "GRIP_EMPTY", "detail": "at place 3"}
        forgotten = {**row, "code": 2999, "name": "OF_AN_OLD_RELEASE", "detail": "gone"}
        return [known, forgotten][:limit]
