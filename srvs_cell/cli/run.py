"""``srvs-cell run``: the daemon in the foreground."""

import os
from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add ``run``."""
    app.command("run")(run)


def run(
    *,
    config: Annotated[Path, typer.Option("--config", help="The cell's YAML file.")],
    socket: Annotated[Path | None, typer.Option("--socket", help="Instead of the config's service.socket.")] = None,
    state_dir: Annotated[Path | None, typer.Option("--state-dir", help="Instead of service.state_dir.")] = None,
    tcp_port: Annotated[
        int | None,
        typer.Option("--tcp-port", min=0, max=65535, help="Instead of service.tcp_port; 0: any free port."),
    ] = None,
) -> None:
    """Run the daemon in the foreground until SIGTERM or Ctrl-C; the cell starts up in Aborted."""
    # OpenCV reads it when it is imported: a camera that has frozen holds a grab for so many seconds, not for ten.
    os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", "2")
    from srvs_cell.config import load_config  # noqa: PLC0415 - imports the vision; other commands must not wait for it
    from srvs_cell.service.daemon import run_daemon  # noqa: PLC0415 - same

    given = {"socket": socket, "state_dir": state_dir, "tcp_port": tcp_port}
    overrides = {key: value for key, value in given.items() if value is not None}
    loaded = load_config(config)
    run_daemon(loaded, loaded.service.model_copy(update=overrides))
