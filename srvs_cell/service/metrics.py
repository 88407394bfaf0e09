"""The cell's state for Prometheus, read from the unit's snapshot when it is asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from prometheus_client import CollectorRegistry, Counter, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily
from prometheus_client.registry import Collector

from srvs_cell import __version__
from srvs_cell.cell import State

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from prometheus_client.core import Metric


class Metrics:
    """One registry a daemon: the process, the commands that were given, and the unit's snapshot.

    Attributes:
        registry: what ``/metrics`` shows.
        commands: ``srvs_cell_commands_total`` by command and answer.
    """

    def __init__(self, snapshot: Callable[[], dict[str, Any]]) -> None:
        self.registry = CollectorRegistry()
        self.commands = Counter(
            "srvs_cell_commands", "Operator commands by answer.", ["command", "answer"], registry=self.registry
        )
        ProcessCollector(registry=self.registry)
        self.registry.register(_SnapshotCollector(snapshot))

    def count_command(self, command: str, *, accepted: bool) -> None:
        """Count one operator command."""
        self.commands.labels(command, "accepted" if accepted else "refused").inc()


class _SnapshotCollector(Collector):
    def __init__(self, snapshot: Callable[[], dict[str, Any]]) -> None:
        self._snapshot = snapshot

    def collect(self) -> Iterator[Metric]:
        snapshot = self._snapshot()
        yield InfoMetricFamily("srvs_cell", "Software version.", {"version": __version__})
        state = GaugeMetricFamily("srvs_cell_state", "1 for the PackML state that the cell is in.", labels=["state"])
        for candidate in State:
            state.add_metric([candidate.title], float(candidate.title == snapshot["state"]))
        yield state
        yield GaugeMetricFamily("srvs_cell_simulation", "1 where the cell is simulated.", float(snapshot["simulation"]))
        yield GaugeMetricFamily("srvs_cell_workpieces", "Workpieces in view.", len(snapshot["workpieces"]))
        yield GaugeMetricFamily("srvs_cell_active_alarms", "Alarms that are active.", len(snapshot["alarms"]))
        events = CounterMetricFamily(
            "srvs_cell_device_events", "What a device has counted since the start.", labels=["device", "event"]
        )
        for name, device in snapshot["devices"].items():
            for event, count in device["counters"].items():
                events.add_metric([name, event], count)
        yield events
        yield CounterMetricFamily("srvs_cell_moves_done", "Picks and places of this job.", snapshot["moves_done"])
