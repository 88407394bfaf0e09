"""The entry point ``srvs-cell``: finds the module of the command that was typed and imports nothing else.

Exit codes: 0 done, 1 the work failed or no daemon answers, 2 usage or config error, 130 interrupted.
"""

import sys
from importlib import import_module
from typing import Annotated, NoReturn

import typer

from srvs_cell import __version__
from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cli.quick import QuickGroup

_OPERATE = "srvs_cell.cli.operate"
MODULES = {
    "run": "srvs_cell.cli.run",
    "demo": "srvs_cell.cli.demo",
    "sim": "srvs_cell.cli.sim",
    "status": _OPERATE,
    "reset": _OPERATE,
    "start": _OPERATE,
    "stop": _OPERATE,
    "hold": _OPERATE,
    "unhold": _OPERATE,
    "suspend": _OPERATE,
    "unsuspend": _OPERATE,
    "complete": _OPERATE,
    "abort": _OPERATE,
    "clear": _OPERATE,
    "mode": _OPERATE,
    "resolve": _OPERATE,
    "forget": _OPERATE,
    "alarms": _OPERATE,
    "history": _OPERATE,
    "perceive": "srvs_cell.cli.see",
    "plan": "srvs_cell.cli.plan",
    "calibrate": "srvs_cell.cli.calibrate",
    "config": "srvs_cell.cli.config",
    "doctor": "srvs_cell.cli.doctor",
}
"""Command -> the module whose ``register(app)`` adds it."""

FAILED, MISUSED, INTERRUPTED = 1, 2, 130
_MISUSES = frozenset({Alarm.CONFIG_INVALID, Alarm.DRIVER_UNKNOWN, Alarm.PROBLEM_INVALID})
_CONFIGURED = frozenset({"run", "config"})
"""Commands to which a calibration is a part of the config: starting them again does not mend it."""


def main() -> NoReturn:
    """Run the command line and exit with its code."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run the command line.

    Args:
        arguments: what was typed after the program's name.

    Returns:
        The exit code. Reasons go to stderr.
    """
    try:
        application(arguments)(arguments, prog_name="srvs-cell")
    except SystemExit as done:
        return done.code if isinstance(done.code, int) else int(done.code is not None)
    except KeyboardInterrupt:
        return INTERRUPTED
    except AlarmError as error:
        typer.echo(f"srvs-cell: {error}", err=True)
        return MISUSED if error.alarm in _misuses(arguments[0]) else FAILED
    return 0


def _misuses(command: str) -> frozenset[Alarm]:
    """Return the alarms that say of a command that what it was given is wrong."""
    return _MISUSES | {Alarm.CALIBRATION_INVALID} if command in _CONFIGURED else _MISUSES


def application(arguments: list[str]) -> typer.Typer:
    """Return the app with the command that ``arguments`` begin with, or with all where they begin with none."""
    app = typer.Typer(cls=QuickGroup, add_completion=False, pretty_exceptions_enable=False, no_args_is_help=True)

    @app.callback()
    def _root(
        *,
        version: Annotated[
            bool, typer.Option("--version", is_eager=True, callback=_show_version, help="Show the version.")
        ] = False,
    ) -> None:
        """Cell controller for a stereo robot vision cell."""

    typed = next(iter(arguments), "")
    wanted = [MODULES[typed]] if typed in MODULES else dict.fromkeys(MODULES.values())
    for module in wanted:
        import_module(module).register(app)
    return app


def _show_version(shown: bool) -> None:
    if shown:
        typer.echo(__version__)
        raise typer.Exit


if __name__ == "__main__":
    main()
