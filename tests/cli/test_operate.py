from __future__ import annotations

import asyncio
import json
import tempfile
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell import Command, CommandAnswer, Mode, State
from srvs_cell.cli import operate
from srvs_cell.cli.client import DaemonClient
from srvs_cell.cli.main import run
from srvs_cell.service.api import create_app
from srvs_cell.service.listeners import serving, unix_listener
from tests.service.fakes import FakeJournal, FakeUnit

if TYPE_CHECKING:
    from collections.abc import Iterator


class Daemon:
    """The API with a fake unit in a thread of its own: the command line is synchronous."""

    def __init__(self, socket: Path) -> None:
        self.socket = socket
        self.unit = FakeUnit()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()))

    async def _serve(self) -> None:
        self._loop, self._stop, closing = asyncio.get_running_loop(), asyncio.Event(), asyncio.Event()
        app = create_app(self.unit, FakeJournal(), self.socket.parent, closing=closing, heartbeat_s=0.05)
        with unix_listener(self.socket) as unix:
            async with serving(app, unix, None):
                self._ready.set()
                await self._stop.wait()
                closing.set()

    def start(self) -> None:
        self._thread.start()
        assert self._ready.wait(30)

    def end(self) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(30)

    def run(self, *arguments: str) -> int:
        return run([*arguments, "--socket", str(self.socket)])


@pytest.fixture
def daemon() -> Iterator[Daemon]:
    with tempfile.TemporaryDirectory() as folder:
        served = Daemon(Path(folder) / "api.sock")
        served.start()
        yield served
        if served._thread.is_alive():
            served.end()


def test_status_for_people_says_state_simulation_alarm_and_remedy(
    daemon: Daemon, capsys: pytest.CaptureFixture[str]
) -> None:
    assert daemon.run("status") == 0
    out, err = capsys.readouterr()
    for shown in ("Aborted", "SIMULATION", "1 of 2", "cuboid", "2101 GRIP_EMPTY", "Remedy: Check the part", "clear"):
        assert shown in out, shown
    assert err == ""


def test_status_json_is_one_object_with_the_contracts_keys(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
    assert daemon.run("status", "--json") == 0
    status = json.loads(capsys.readouterr().out)
    assert {"state", "mode", "simulation", "workpieces", "plan", "moves_done"} <= set(status)


def test_watch_says_each_thing_once(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
    text = operate._status_text

    def change_once_then_end(status: dict[str, Any]) -> str:
        shown = text(status)
        if status["version"] < 3:
            asyncio.run_coroutine_threadsafe(daemon.unit.change(), daemon._loop).result(10)
        else:
            threading.Thread(target=daemon.end).start()
        return shown

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(operate, "_status_text", change_once_then_end)
        assert daemon.run("status", "--watch") == 1
    out, err = capsys.readouterr()
    assert out.count("State ") == 1, "the version grew, what an operator sees did not"
    assert "5006 NO_DAEMON" in err


def test_accepted_command_says_the_state(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
    assert daemon.run("clear") == 0
    assert capsys.readouterr().out == "Stopped\n"


@pytest.mark.parametrize("json_option", [(), ("--json",)])
def test_a_clear_is_waited_for_and_says_what_is_missing(
    daemon: Daemon,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    json_option: tuple[str, ...],
) -> None:
    async def clearing(_: Command, source: str) -> CommandAnswer:
        daemon.unit.state = State.CLEARING
        asyncio.get_running_loop().call_later(0.05, fail)
        return CommandAnswer(accepted=True, state=daemon.unit.state, reason=source[:0])

    def fail() -> None:
        daemon.unit.state = State.ABORTED
        changes.append(asyncio.ensure_future(daemon.unit.change()))

    changes: list[asyncio.Future[None]] = []
    monkeypatch.setattr(daemon.unit, "command", clearing)
    assert daemon.run("clear", *json_option) == 1
    out, err = capsys.readouterr()
    assert (json.loads(out)["state"] if json_option else out) == ("Aborted" if json_option else "Aborted\n")
    assert "[2101 GRIP_EMPTY] at place 3" in err
    assert "Remedy: Check the part" in err


@pytest.mark.parametrize("json_option", [(), ("--json",)])
def test_refused_command_is_one_and_names_the_way(
    daemon: Daemon, capsys: pytest.CaptureFixture[str], json_option: tuple[str, ...]
) -> None:
    assert daemon.run("start", *json_option) == 1
    out, err = capsys.readouterr()
    assert "5001 COMMAND_REFUSED" in err
    assert "clear, reset, start" in err
    if json_option:
        assert json.loads(out)["leads_there"] == ["clear", "reset", "start"]
    else:
        assert out == ""


def test_mode_and_resolve(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
    assert daemon.run("mode", "dry-run") == 0
    assert daemon.unit.mode is Mode.DRY_RUN
    assert daemon.run("resolve", "gripper", "holding") == 0
    assert daemon.unit.gripper == "holding"
    capsys.readouterr()
    assert daemon.run("resolve", "gripper", "perhaps") == 2
    assert daemon.run("mode", "turbo") == 2
    assert "Production" in capsys.readouterr().err


def test_alarms_and_history(daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
    assert daemon.run("alarms") == 0
    out = capsys.readouterr().out
    assert "2101 GRIP_EMPTY" in out
    assert "Remedy: Check the part" in out
    assert "2999 OF_AN_OLD_RELEASE" in out
    assert daemon.run("history", "--limit", "3", "--json") == 0
    assert len(json.loads(capsys.readouterr().out)["history"]) == 3
    assert daemon.run("history", "--limit", "0") == 2


def test_changes_follow_until_the_daemon_ends(daemon: Daemon) -> None:
    with DaemonClient(daemon.socket) as client:
        changes = client.changes()
        assert next(changes)["state"] == "Aborted"
        assert client.command("command/clear")["accepted"]
        assert next(changes)["state"] == "Stopped"
        daemon.end()
        with pytest.raises(AlarmError) as silence:
            for _ in changes:
                pass
    assert silence.value.alarm is Alarm.NO_DAEMON


def test_nobody_there_is_one_and_says_how_to_start(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in (["status"], ["stop"], ["alarms"], ["status", "--watch"]):
        assert run([*command, "--socket", str(tmp_path / "none.sock")]) == 1
        out, err = capsys.readouterr()
        assert out == ""
        assert "5006 NO_DAEMON" in err
        assert "systemctl start srvs-cell" in err
