"""The operator's commands: they say what the daemon answers and know nothing themselves."""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from srvs_cell.cli.client import DEFAULT_SOCKET, DaemonClient
from srvs_cell.cli.quick import QuickCommand

COMMANDS = {
    "reset": "Make the stopped or finished cell ready: Idle.",
    "start": "Start the job.",
    "stop": "Request a stop: the arm halts, the job ends, the cell is Stopped.",
    "hold": "Request a pause; 'unhold' looks again and goes on.",
    "unhold": "Go on after a hold.",
    "suspend": "Pause for a cause outside the cell.",
    "unsuspend": "Go on after a suspension.",
    "complete": "End the job after the part in hand.",
    "abort": "Request a stop at once and forbid all motion until 'clear'.",
    "clear": "After start-up or an abort: reset the robot's fault, connect the devices: Stopped.",
}
"""The PackML commands, as operators type them, and what they are for."""

_VERIFYING = {"clear": "Stopped", "reset": "Idle"}
"""Commands that look whether all is there, and the state that says so."""

_ON_THE_WAY = frozenset({"Clearing", "Resetting", "Stopping", "Aborting"})
_REFUSED, _MISUSED, _FAILED = 1, 2, 1
_WIDTH = 12

Socket = Annotated[Path, typer.Option("--socket", help="The daemon's unix socket; also $SRVS_CELL_SOCKET.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
Limit = Annotated[int, typer.Option("--limit", min=1, max=10_000, help="How many, newest first.")]


def register(app: typer.Typer) -> None:
    """Add status, the PackML commands, mode, resolve, forget, alarms and history."""
    command = partial(app.command, cls=QuickCommand)
    command("status")(show_status)
    for name, purpose in COMMANDS.items():
        command(name, help=purpose)(_sender(name))
    command("mode")(set_mode)
    command("resolve")(resolve)
    command("forget")(forget)
    command("alarms")(show_alarms)
    command("history")(show_history)


def show_status(
    *,
    watch: Annotated[bool, typer.Option("--watch", help="Go on with each change: a block, or a line of JSON.")] = False,
    as_json: Json = False,
    socket: Socket = DEFAULT_SOCKET,
) -> None:
    """Say what the cell is doing."""
    shown = ""
    with DaemonClient(socket) as daemon:
        for status in daemon.changes() if watch else [daemon.read("status")]:
            text = json.dumps(status) if as_json else _status_text(status)
            if text != shown:
                typer.echo(text)
                shown = text


def set_mode(
    mode: Annotated[str, typer.Argument(help="production, maintenance, manual or dry-run")],
    *,
    as_json: Json = False,
    socket: Socket = DEFAULT_SOCKET,
) -> None:
    """Change the unit mode; possible in Stopped, Idle and Aborted."""
    _send(socket, "mode", {"mode": mode}, as_json=as_json)


def resolve(
    what: Annotated[Literal["gripper"], typer.Argument(help="what you looked at")],
    holds: Annotated[Literal["empty", "holding"], typer.Argument(help="what you saw")],
    *,
    as_json: Json = False,
    socket: Socket = DEFAULT_SOCKET,
) -> None:
    """Tell the cell what the gripper holds, after a run that ended with a grip under way."""
    _send(socket, "resolve", {what: holds}, as_json=as_json)


def forget(*, as_json: Json = False, socket: Socket = DEFAULT_SOCKET) -> None:
    """Give up an unfinished job: the next one takes the places where the parts stand by then, not the former ones."""
    _send(socket, "forget", None, as_json=as_json)


def show_alarms(*, limit: Limit = 20, as_json: Json = False, socket: Socket = DEFAULT_SOCKET) -> None:
    """List the newest alarms with cause and remedy."""
    with DaemonClient(socket) as daemon:
        body = daemon.read(f"alarms?limit={limit}")
    typer.echo(json.dumps(body) if as_json else "\n".join(map(_alarm_text, body["alarms"])) or "No alarms.")


def show_history(*, limit: Limit = 50, as_json: Json = False, socket: Socket = DEFAULT_SOCKET) -> None:
    """List the newest entries of the journal."""
    with DaemonClient(socket) as daemon:
        body = daemon.read(f"history?limit={limit}")
    typer.echo(json.dumps(body) if as_json else "\n".join(map(_entry_text, body["history"])) or "Nothing yet.")


def _sender(name: str) -> Callable[..., None]:
    def send(*, as_json: Json = False, socket: Socket = DEFAULT_SOCKET) -> None:
        _send(socket, f"command/{name}", None, wanted=_VERIFYING.get(name), as_json=as_json)

    return send


def _send(socket: Path, name: str, body: dict[str, str] | None, *, as_json: bool, wanted: str | None = None) -> None:
    """Give a command; exit code 1 where it is refused, 2 where it makes no sense, with the reason on stderr.

    Where it ends in a state that is ``wanted`` that is waited for; another one is exit code 1, with the alarms.
    """
    alarms: list[dict[str, Any]] = []
    with DaemonClient(socket) as daemon:
        answer = daemon.command(name, body)
        if answer["accepted"] and wanted is not None:
            reached = next(status for status in daemon.changes() if status["state"] not in _ON_THE_WAY)
            answer["state"] = reached["state"]
            alarms = [] if reached["state"] == wanted else reached["alarms"]
    if as_json:
        typer.echo(json.dumps(answer))
    if not answer["accepted"]:
        typer.echo(_refusal_text(answer), err=True)
        raise typer.Exit(_REFUSED if answer["alarm"] else _MISUSED)
    if not as_json:
        typer.echo(answer["state"])
    if alarms:
        typer.echo("\n".join(f"srvs-cell: {_alarm_text(alarm)}" for alarm in alarms), err=True)
        raise typer.Exit(_FAILED)


def _refusal_text(answer: dict[str, Any]) -> str:
    alarm = answer["alarm"]
    label = f"[{alarm['code']} {alarm['name']}] " if alarm else ""
    lines = [f"srvs-cell: {label}{answer['reason']}"]
    if way := answer.get("leads_there"):
        lines.append(f"  Commands that lead there: {', '.join(way)}")
    elif alarm and alarm["name"] != "COMMAND_REFUSED":  # whose remedy is the way there, and here there is none
        lines.append(f"  Remedy: {alarm['remedy']}")
    return "\n".join(lines)


def _status_text(status: dict[str, Any]) -> str:
    rows = [
        ("State", status["state"]),
        ("Mode", status["mode"] + ("   SIMULATION" if status["simulation"] else "")),
        ("Step", status["step"] or "none"),
        ("Moves", f"{status['moves_done']} of {status['moves_total']}" if status["moves_total"] else "none planned"),
        ("Workpieces", ", ".join(map(_workpiece_text, status["workpieces"])) or "none"),
        ("Gripper", status["gripper"]["knowledge"]),
        ("Page", status["service"]["page"] or "none (service.tcp_port)"),
        ("Commands", ", ".join(status["allowed_commands"])),
    ]
    if (unfinished := status["unfinished_job"]) is not None and not status["step"]:
        rows.insert(4, ("Unfinished", f"job {unfinished}: its places are kept until it is finished, or 'forget'"))
    lines = [f"{name:<{_WIDTH}}{value}" for name, value in rows]
    for alarm in status["alarms"]:
        lines.append(f"{'Alarm':<{_WIDTH}}[{alarm['code']} {alarm['name']}] {alarm['detail']}")
        lines.append(f"{'':<{_WIDTH}}Cause: {alarm['cause']}")
        lines.append(f"{'':<{_WIDTH}}Remedy: {alarm['remedy']}")
    return "\n".join(lines)


def _workpiece_text(workpiece: dict[str, Any]) -> str:
    x_mm, y_mm, _ = workpiece["position_mm"]
    return f"{workpiece['kind']} {workpiece['id']} at ({x_mm:.0f}, {y_mm:.0f}) mm, {workpiece['height_mm']:.0f} mm high"


def _alarm_text(alarm: dict[str, Any]) -> str:
    lines = [f"{alarm.get('at', alarm.get('since'))}  [{alarm['code']} {alarm['name']}] {alarm['detail']}"]
    lines += [f"  {name.capitalize()}: {alarm[name]}" for name in ("cause", "remedy") if name in alarm]
    return "\n".join(lines)


def _entry_text(entry: dict[str, Any]) -> str:
    return f"{entry['at']}  {entry['kind']:<12} {entry['name']:<16} {entry['source']}"
