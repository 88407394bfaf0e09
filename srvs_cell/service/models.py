"""What the API asks of the cell, and the bodies that go over the wire."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, Protocol

from pydantic import BaseModel, ConfigDict

if TYPE_CHECKING:
    from collections.abc import Awaitable, Sequence

    from srvs_cell.alarms import Alarm
    from srvs_cell.cell import Command, CommandAnswer, Mode


class ServedUnit(Protocol):
    """The part of `srvs_cell.cell.Unit` that the API uses."""

    async def command(self, command: Command, source: str) -> CommandAnswer:
        """Act on a PackML command, or answer why not."""
        ...

    async def set_mode(self, mode: Mode, source: str) -> CommandAnswer:
        """Change the unit mode, or answer why not."""
        ...

    async def resolve_gripper(self, holds: str, source: str) -> CommandAnswer:
        """Take the operator's word for what the gripper holds."""
        ...

    async def forget_job(self, source: str) -> CommandAnswer:
        """Give up the places of an unfinished job, or answer why not."""
        ...

    def snapshot(self) -> dict[str, Any]:
        """Return the state as plain data; it has a ``version`` that grows with each change."""
        ...

    async def wait_change(self, version: int) -> int:
        """Return the present version as soon as it differs from ``version``."""
        ...


class ServedJournal(Protocol):
    """The part of `srvs_cell.cell.Journal` that the API uses."""

    def history(self, limit: int) -> Awaitable[Sequence[dict[str, Any]]]:
        """Return the newest records, newest first."""
        ...

    def alarms(self, limit: int) -> Awaitable[Sequence[dict[str, Any]]]:
        """Return the newest alarms, newest first."""
        ...


class ModeRequest(BaseModel):
    """Body of ``POST /api/v1/mode``."""

    model_config = ConfigDict(extra="forbid")

    mode: str


class ResolveRequest(BaseModel):
    """Body of ``POST /api/v1/resolve``."""

    model_config = ConfigDict(extra="forbid")

    gripper: Literal["empty", "holding"]


def alarm_body(alarm: Alarm, detail: str) -> dict[str, Any]:
    """Return an alarm as the API shows it: code, name, severity, detail, cause, remedy."""
    row = alarm.value
    return {
        "code": row.code,
        "name": alarm.name,
        "severity": row.severity.value,
        "detail": detail,
        "cause": row.cause,
        "remedy": row.remedy,
    }


def answer_body(answer: CommandAnswer) -> dict[str, Any]:
    """Return a command's answer as the API shows it: accepted, state, reason, alarm, leads_there."""
    return {
        "accepted": answer.accepted,
        "state": answer.state.title,
        "reason": answer.reason,
        "alarm": None if answer.alarm is None else alarm_body(answer.alarm, answer.reason),
        "leads_there": [command.title for command in answer.leads_there],
    }
