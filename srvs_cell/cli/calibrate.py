"""`srvs-cell calibrate`: look after calibrations."""

from __future__ import annotations

import json
from pathlib import Path  # noqa: TC003 - typer reads the annotation at run time
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from srvs_cell.calibration import Calibration


def register(app: typer.Typer) -> None:
    """Add the command group `calibrate` to the command line."""
    group = typer.Typer(name="calibrate", help="Look after calibrations.", no_args_is_help=True)
    # a callback keeps "check" a command of its own while it is the group's only one
    group.callback()(_group)
    group.command("check")(check)
    app.add_typer(group)


def check(
    file: Annotated[Path, typer.Argument(metavar="CAL.yaml", help="The calibration file.")],
    json_output: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Check a calibration file and say whether it can be used."""
    from dataclasses import asdict  # noqa: PLC0415 - the command line starts lazily

    from srvs_cell.alarms import Alarm, AlarmError  # noqa: PLC0415 - as above
    from srvs_cell.calibration import CalibrationVerdict, Level, check_calibration, verdict  # noqa: PLC0415 - as above

    findings = check_calibration(_read(file))
    result = verdict(findings)
    if json_output:
        print(json.dumps({"file": str(file), "verdict": result, "findings": [asdict(one) for one in findings]}))
    else:
        for finding in findings:
            print(f"{finding.level:<8} {finding.check}: {finding.value} (expected: {finding.bound})")
            if finding.advice:
                print(f"{'':<8} {finding.advice}")
        print(f"verdict: {result}")
    if result is CalibrationVerdict.UNUSABLE:
        failed = "; ".join(
            f"{one.check} = {one.value}: must be {one.bound}" for one in findings if one.level is Level.ERROR
        )
        raise AlarmError(Alarm.CALIBRATION_INVALID, f"{file}: {failed}.")


def _group() -> None:
    """Look after calibrations."""


def _read(file: Path) -> Calibration:
    import yaml  # noqa: PLC0415 - as above

    from srvs_cell.alarms import Alarm, AlarmError  # noqa: PLC0415 - as above
    from srvs_cell.calibration import Calibration  # noqa: PLC0415 - as above

    try:
        data = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise AlarmError(Alarm.FILE_INVALID, f"{file}: {error}.") from error
    except yaml.YAMLError as error:
        raise AlarmError(Alarm.CALIBRATION_INVALID, f"{file}: not YAML: {error}.") from error
    return Calibration.from_mapping(data, str(file))
