"""The alarms that are active, first out first."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from srvs_cell.alarms import Alarm, Severity

if TYPE_CHECKING:
    from collections.abc import Callable
    from datetime import datetime


@dataclass(frozen=True)
class ActiveAlarm:
    """An alarm that somebody has yet to deal with."""

    alarm: Alarm
    detail: str
    since: datetime

    def as_json(self) -> dict[str, Any]:
        """Return it for the snapshot."""
        row = self.alarm.value
        return {
            "code": row.code,
            "name": self.alarm.name,
            "severity": row.severity.value,
            "detail": self.detail,
            "cause": row.cause,
            "remedy": row.remedy,
            "since": self.since.isoformat(timespec="milliseconds"),
        }


class AlarmList:
    """Active alarms, one of each kind: an error's first detail is its cause and stays, a warning's newest is shown."""

    def __init__(self, now: Callable[[], datetime]) -> None:
        self._now = now
        self._active: dict[Alarm, ActiveAlarm] = {}

    def add(self, alarm: Alarm, detail: str) -> bool:
        """Add an alarm; tell whether it is new."""
        if alarm in self._active:
            if alarm.value.severity is Severity.WARNING:
                self._active[alarm] = replace(self._active[alarm], detail=detail)
            return False
        self._active[alarm] = ActiveAlarm(alarm, detail, self._now())
        return True

    def clear(self, *kept: Alarm) -> list[int]:
        """Remove all alarms but ``kept``; return the codes of those removed."""
        removed = [alarm for alarm in self._active if alarm not in kept]
        for alarm in removed:
            del self._active[alarm]
        return [alarm.code for alarm in removed]

    def remove(self, alarm: Alarm) -> list[int]:
        """Remove one kind; return its code where it was active."""
        return [] if self._active.pop(alarm, None) is None else [alarm.code]

    def as_json(self) -> list[dict[str, Any]]:
        """Return them for the snapshot."""
        return [active.as_json() for active in self._active.values()]
