"""``srvs-cell config``: check a configuration, show it with its defaults, print its JSON Schema."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from srvs_cell.config import CellConfig

_ConfigFile = Annotated[Path, typer.Argument(metavar="CELL.yaml", help="The configuration.")]
_AsJson = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]


def register(app: typer.Typer) -> None:
    """Add the command group to an app."""
    group = typer.Typer(no_args_is_help=True, help="Check, show and describe the cell's configuration.")
    group.command("check")(check)
    group.command("show")(show)
    group.command("schema")(schema)
    app.add_typer(group, name="config")


def check(config_file: _ConfigFile, as_json: _AsJson = False) -> None:
    """Check every key, type and bound, the drivers, and the calibration and object files that the config names."""
    import json  # noqa: PLC0415 - the command line starts lazily

    from srvs_cell.config import load_config  # noqa: PLC0415 - as above

    config = load_config(config_file)
    kinds = [kind.name for kind in config.load_library().kinds]
    calibration = _calibration_state(config)
    drivers = {device.role: device.driver for device in config.devices}
    reach = config.planning.arm is not None
    if as_json:
        answer = {
            "valid": True,
            "simulation": config.simulation,
            "drivers": drivers,
            "object_kinds": kinds,
            "calibration": calibration,
        }
        typer.echo(json.dumps(answer))
        return
    typer.echo(f"{config_file}: valid{', SIMULATION' if config.simulation else ''}")
    typer.echo("drivers: " + ", ".join(f"{role} {driver}" for role, driver in drivers.items()))
    typer.echo(f"object kinds: {', '.join(kinds)}")
    typer.echo(f"calibration: {calibration}")
    if not reach:
        typer.echo("reach and joint limits are not checked beforehand: planning.arm does not describe the arm")


def show(
    config_file: Annotated[
        Path | None, typer.Argument(metavar="[CELL.yaml]", help="The configuration; without it, the embedded one.")
    ] = None,
    as_json: _AsJson = False,
) -> None:
    """Show the whole configuration with every default filled in."""
    import json  # noqa: PLC0415 - the command line starts lazily

    import yaml  # noqa: PLC0415 - as above

    from srvs_cell.config import config_to_mapping, load_config, parse_config  # noqa: PLC0415 - as above
    from srvs_cell.config.embedded import DEFAULT_CONFIG, embedded_config  # noqa: PLC0415 - as above

    config = parse_config(embedded_config(), DEFAULT_CONFIG) if config_file is None else load_config(config_file)
    mapping = config_to_mapping(config)
    typer.echo(json.dumps(mapping) if as_json else yaml.safe_dump(mapping, sort_keys=False).rstrip())


def schema() -> None:
    """Print the JSON Schema of the configuration, with the keys of every installed driver, for editors."""
    import json  # noqa: PLC0415 - the command line starts lazily

    from srvs_cell.config import config_schema  # noqa: PLC0415 - as above

    typer.echo(json.dumps(config_schema(), indent=2))


def _calibration_state(config: CellConfig) -> str:
    """Return what is to be said of the calibration file; raises CALIBRATION_INVALID where it is wrong.

    With it, CONFIG_INVALID where the cameras do not show a configured place.

    A simulated cell writes its calibration when it starts, so that there it may be missing.
    """
    if config.simulation and not config.calibration.exists():
        return f"{config.calibration} is not there yet; the simulator writes it"
    from srvs_cell.service.common_view import CommonView, check_places  # noqa: PLC0415 - the command line starts lazily

    calibration = config.load_calibration()
    check_places(config, CommonView.of(config.cell, calibration))
    width, height = calibration.image_size
    return f"{config.calibration}, {width} x {height} px"
