"""``srvs-cell doctor``: what keeps the cell from working, and what to do. Moves nothing."""

from pathlib import Path
from typing import Annotated, Any

import typer

_SERVICE_CONFIG = Path("/etc/srvs-cell/cell.yaml")
"""What the unit file runs."""


def register(app: typer.Typer) -> None:
    """Add ``doctor``."""
    app.command("doctor")(doctor)


def doctor(
    *,
    config: Annotated[Path, typer.Option("--config", help="The cell's YAML file.")] = _SERVICE_CONFIG,
    socket: Annotated[Path | None, typer.Option("--socket", help="Instead of the config's service.socket.")] = None,
    state_dir: Annotated[Path | None, typer.Option("--state-dir", help="Instead of service.state_dir.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Say what keeps the cell from working, and what to do; moves nothing and changes no output."""
    import asyncio  # noqa: PLC0415 - the command line starts lazily
    import json  # noqa: PLC0415 - as above
    import logging  # noqa: PLC0415 - as above

    from srvs_cell.config import load_config  # noqa: PLC0415 - as above
    from srvs_cell.ports import FindingLevel  # noqa: PLC0415 - as above
    from srvs_cell.service.doctor import examine, verdict  # noqa: PLC0415 - as above

    loaded = load_config(config)
    loaded.load_library()
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # what it logs is a finding
    status = _ask(socket or loaded.service.socket)
    examined = asyncio.run(examine(loaded, state_dir or loaded.service.state_dir, status))
    level = verdict(examined)
    if as_json:
        findings = [one.as_json() for one in examined]
        answer = {"config": str(config), "verdict": level.value, "daemon": status is not None, "findings": findings}
        typer.echo(json.dumps(answer))
    else:
        for one in examined:
            typer.echo(one.line)
        typer.echo(f"verdict: {level.value}")
    failed = [one for one in examined if one.finding.level is FindingLevel.FAILED]
    if failed:
        typer.echo(f"srvs-cell: {len(failed)} of {len(examined)} checks failed; {failed[0].line}", err=True)
        raise typer.Exit(1)


def _ask(socket: Path) -> dict[str, Any] | None:
    """Return the status of the daemon behind a socket, None where none answers."""
    from srvs_cell.alarms import AlarmError  # noqa: PLC0415 - the command line starts lazily
    from srvs_cell.cli.client import DaemonClient  # noqa: PLC0415 - as above

    try:
        with DaemonClient(socket) as client:
            return client.read("status")
    except AlarmError:  # silence is an answer here
        return None
