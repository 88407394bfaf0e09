"""``srvs-cell sim``: the simulated cell alone, for other people's clients."""

import json
from pathlib import Path
from typing import Annotated

import typer

from srvs_cell.cli.simulated_cell import CALIBRATION_FILE, write_config
from srvs_cell.cli.simulator import simulator_failure, start_simulator, stop_simulator

_LAST_PORT = 65535


def register(app: typer.Typer) -> None:
    """Add ``sim``."""
    app.command("sim")(sim)


def sim(
    *,
    objects: Annotated[int, typer.Option("--objects", min=1, max=10, help="Parts on the table.")] = 5,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Another table, another lens, another robot.")] = 0,
    speed: Annotated[float, typer.Option("--speed", min=0.1, max=1000.0, help="Times faster than life.")] = 1.0,
    imperfections: Annotated[
        str, typer.Option("--imperfections", help="Of the simulated cell: real or none.")
    ] = "real",
    wire: Annotated[
        str, typer.Option("--wire", help="How the controller is talked to: modbus, rmi, karel or karel-serial.")
    ] = "modbus",
    modbus_port: Annotated[
        int, typer.Option("--modbus-port", min=0, max=_LAST_PORT, help="Port of the controller; 0: any free one.")
    ] = 0,
    rmi_port: Annotated[
        int, typer.Option("--rmi-port", min=0, max=_LAST_PORT, help="The same, where the wire is rmi.")
    ] = 0,
    karel_port: Annotated[
        int, typer.Option("--karel-port", min=0, max=_LAST_PORT, help="The same, where the wire is karel.")
    ] = 0,
    robotiq: Annotated[
        Path | None,
        typer.Option("--robotiq", metavar="PTY", help="Let the gripper be a Robotiq; its serial port is linked there."),
    ] = None,
    clock_page: Annotated[
        Path | None, typer.Option("--clock-page", help="Make the clock page there, for a daemon's devices.clock.path.")
    ] = None,
    calibration_out: Annotated[
        Path | None, typer.Option("--calibration-out", help="Write the calibration file of this cell there.")
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option("--folder", help="Make cell.yaml, calibration.yaml and clock there: all that 'run' needs."),
    ] = None,
) -> None:
    """Run the simulated cell on the loopback until Ctrl-C; prints one JSON line: what listens where."""
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        clock_page = clock_page or folder.resolve() / "clock"
        calibration_out = folder / CALIBRATION_FILE
    arguments = ["--objects", str(objects), "--seed", str(seed), "--speed", str(speed)]
    arguments += ["--imperfections", imperfections, "--wire", wire, "--modbus-port", str(modbus_port)]
    arguments += ["--rmi-port", str(rmi_port), "--karel-port", str(karel_port)]
    for option, path in (("--clock-page", clock_page), ("--calibration-out", calibration_out), ("--robotiq", robotiq)):
        if path is not None:
            arguments += [option, str(path)]
    process, listens = start_simulator(arguments)
    try:
        if folder is not None:
            write_config(folder / "cell.yaml", listens, {})
        typer.echo(json.dumps(listens))
        if process.wait() != 0:
            raise simulator_failure(process)
    finally:
        stop_simulator(process)
