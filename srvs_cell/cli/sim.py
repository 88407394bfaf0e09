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
        str | None,
        typer.Option("--wire", help="How a daemon talks to the controller: modbus, rmi, karel or karel-serial."),
    ] = None,
    modbus_port: Annotated[
        int | None,
        typer.Option("--modbus-port", min=0, max=_LAST_PORT, help="Serve Modbus TCP there; 0: any free port."),
    ] = None,
    rmi_port: Annotated[
        int | None,
        typer.Option("--rmi-port", min=0, max=_LAST_PORT, help="The same with RMI; its session is on the next port."),
    ] = None,
    karel_port: Annotated[
        int | None, typer.Option("--karel-port", min=0, max=_LAST_PORT, help="The same with the KAREL line protocol.")
    ] = None,
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
    """Run the simulated cell on the loopback until Ctrl-C; prints one JSON line: what listens where.

    Several wires may be served at once; Modbus TCP where none is asked for.
    """
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        clock_page = clock_page or folder.resolve() / "clock"
        calibration_out = folder / CALIBRATION_FILE
    arguments = ["--objects", str(objects), "--seed", str(seed), "--speed", str(speed)]
    arguments += ["--imperfections", imperfections]
    chosen = {
        "--wire": wire,
        "--modbus-port": modbus_port,
        "--rmi-port": rmi_port,
        "--karel-port": karel_port,
        "--clock-page": clock_page,
        "--calibration-out": calibration_out,
        "--robotiq": robotiq,
    }
    for option, value in chosen.items():
        if value is not None:
            arguments += [option, str(value)]
    process, listens = start_simulator(arguments)
    try:
        if folder is not None:
            write_config(folder / "cell.yaml", listens, {})
        typer.echo(json.dumps(listens))
        if process.wait() != 0:
            raise simulator_failure(process)
    finally:
        stop_simulator(process)
