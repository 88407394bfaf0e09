"""``demo``: the paper's whole job on a simulated cell, through the real service, drivers and wires."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_MIN_OBJECTS, _MAX_OBJECTS = 3, 10


def register(app: typer.Typer) -> None:
    """Add ``demo``."""

    @app.command()
    def demo(
        objects: Annotated[int, typer.Option(min=_MIN_OBJECTS, max=_MAX_OBJECTS, help="parts on the table")] = 5,
        seed: Annotated[int, typer.Option(min=0, help="another table, another lens, another robot")] = 0,
        out: Annotated[Path, typer.Option(help="folder of the report")] = Path("srvs-cell-demo"),
        speed: Annotated[
            float, typer.Option(min=1.0, max=1000.0, help="how much faster than life while waiting")
        ] = 20.0,
        imperfections: Annotated[str, typer.Option(help="of the simulated cell: real or none")] = "real",
        wire: Annotated[
            str, typer.Option(help="to the simulated controller: modbus, rmi, karel or karel-serial")
        ] = "modbus",
        as_json: Annotated[bool, typer.Option("--json", help="one JSON object on stdout")] = False,
    ) -> None:
        """Relocate simulated objects once and judge the result by the simulator's truth; exit 0 only if it agrees."""
        import json  # noqa: PLC0415 - the command line starts lazily

        from srvs_cell.cli.demo_run import DemoOptions, run_demo  # noqa: PLC0415 - same
        from srvs_cell.cli.simulated_cell import SimulationOptions  # noqa: PLC0415 - same

        simulation = SimulationOptions(objects=objects, seed=seed, speed=speed, imperfections=imperfections, wire=wire)
        options = DemoOptions(simulation, out)
        result = run_demo(options, progress=lambda line: typer.echo(line, err=as_json))
        if as_json:
            typer.echo(json.dumps(result))
        if not result["success"]:
            for reason in result["reasons"]:
                typer.echo(f"srvs-cell demo: {reason}", err=True)
            raise typer.Exit(1)
