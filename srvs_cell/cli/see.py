"""``srvs-cell perceive LEFT RIGHT``: see two images (design.md section 9)."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path  # noqa: TC003 - typer reads the annotation at run time
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from srvs_cell.geometry import Transform
    from srvs_cell.scene import Perception, TableCheck, Workpiece
    from srvs_cell.vision import StereoView, VisionParameters
    from srvs_cell.vision.lines import LinePerception
    from srvs_cell.vision.recognition import ObjectKind

_POSE_NUMBERS = 6


class Method(StrEnum):
    """What is matched: the paper's planes, or the straight lines that it compares them with."""

    PLANES = "planes"
    LINES = "lines"


def register(app: typer.Typer) -> None:
    """Add the command to an app."""
    app.command("perceive")(perceive_command)


def perceive_command(
    left_file: Annotated[Path, typer.Argument(metavar="LEFT", help="Image at the left end of the lateral path.")],
    right_file: Annotated[Path, typer.Argument(metavar="RIGHT", help="Image at the right end.")],
    config: Annotated[Path | None, typer.Option(metavar="CELL.yaml", help="Take the vision's parameters here.")] = None,
    library: Annotated[
        Path | None, typer.Option(metavar="OBJECTS.yaml", help="Kinds of objects, instead of the config's.")
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(metavar="CAL.yaml", help="Calibration file; needs both poses.")
    ] = None,
    left_pose: Annotated[
        str | None, typer.Option(metavar="X,Y,Z,W,P,R", help="base_T_tcp at the left end, mm and degrees.")
    ] = None,
    right_pose: Annotated[
        str | None, typer.Option(metavar="X,Y,Z,W,P,R", help="base_T_tcp at the right end, mm and degrees.")
    ] = None,
    table_z: Annotated[
        float | None, typer.Option(metavar="MM", help="Height of the table in the base frame.", show_default="0")
    ] = None,
    min_disparity: Annotated[
        float | None, typer.Option(metavar="PX", min=0.0, help="Least disparity, without calibration.")
    ] = None,
    max_disparity: Annotated[
        float | None, typer.Option(metavar="PX", min=0.0, help="Greatest disparity, without calibration.")
    ] = None,
    disparity: Annotated[
        Path | None, typer.Option(metavar="OUT.pfm", help="Write the disparity map of the left image.")
    ] = None,
    overlay: Annotated[
        Path | None, typer.Option(metavar="OUT.png", help="Write both images with numbered matched planes (lines).")
    ] = None,
    method: Annotated[
        Method, typer.Option(help="What is matched; lines are the paper's baseline and make no workpieces.")
    ] = Method.PLANES,
    faithful: Annotated[
        bool, typer.Option("--faithful", help="The paper's steps alone: every gain beyond them is switched off.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Extract and match planes; with calibration and poses also recognise workpieces and place them."""
    import json  # noqa: PLC0415 - the command line starts lazily
    import time  # noqa: PLC0415 - as above

    parameters, table_z_mm, kinds = _parameters(config, library, min_disparity, max_disparity)
    if faithful:
        parameters = parameters.as_the_paper()
    poses = [_pose(text, option) for text, option in ((left_pose, "--left-pose"), (right_pose, "--right-pose"))]
    view = _view(calibration, poses, table_z if table_z is not None else table_z_mm, parameters)
    images = _read_image(left_file), _read_image(right_file)
    if method is Method.LINES:
        from srvs_cell.vision.lines import lines_to_json, perceive_lines  # noqa: PLC0415 - as above

        lines = perceive_lines(*images, parameters, view=view, stopwatch=time.perf_counter)
        _write_lines(lines, disparity, overlay)
        if as_json:
            typer.echo(json.dumps(lines_to_json(lines)))
        else:
            _show_lines(lines)
        return
    from srvs_cell.vision import perceive, perception_to_json  # noqa: PLC0415 - as above

    perception = perceive(*images, parameters, view=view, kinds=kinds, stopwatch=time.perf_counter)
    if disparity is not None:
        from srvs_cell.vision import encode_pfm  # noqa: PLC0415 - as above

        _write(disparity, encode_pfm(perception.disparity_px))
    if overlay is not None:
        _write_overlay(overlay, perception)
    if as_json:
        typer.echo(json.dumps(perception_to_json(perception, calibrated=view is not None)))
    else:
        _show(perception)


def _parameters(
    config: Path | None, library: Path | None, min_disparity: float | None, max_disparity: float | None
) -> tuple[VisionParameters, float, tuple[ObjectKind, ...]]:
    """Return the vision's parameters, the table's height and the kinds of objects.

    They are the config's or the defaults, with what was typed.
    """
    from dataclasses import replace  # noqa: PLC0415 - the command line starts lazily

    from pydantic import ValidationError  # noqa: PLC0415 - as above

    from srvs_cell.config import built_in_library, load_config, load_library  # noqa: PLC0415 - as above
    from srvs_cell.vision import VisionParameters  # noqa: PLC0415 - as above

    cell = None if config is None else load_config(config)
    parameters, table_z_mm = (VisionParameters(), 0.0) if cell is None else (cell.vision, cell.cell.table_z_mm)
    if library is not None:
        objects = load_library(library)
        objects.check(parameters.recognition)
    else:
        objects = built_in_library() if cell is None else cell.load_library()
    low = parameters.min_disparity_px if min_disparity is None else min_disparity
    high = parameters.max_disparity_px if max_disparity is None else max_disparity
    if low >= high:
        raise typer.BadParameter(f"--min-disparity {low:g} must be less than --max-disparity {high:g}.")
    try:
        return replace(parameters, min_disparity_px=low, max_disparity_px=high), table_z_mm, objects.kinds
    except ValidationError as error:
        reasons = "; ".join(f"{item['loc'][-1]} {item['input']}: {item['msg']}" for item in error.errors())
        raise typer.BadParameter(f"disparity range: {reasons}.") from error


def _pose(text: str | None, option: str) -> Transform | None:
    """Return base_T_tcp of six numbers X,Y,Z,W,P,R."""
    from math import isfinite  # noqa: PLC0415 - the command line starts lazily

    from srvs_cell.geometry import Transform, Xyzwpr  # noqa: PLC0415 - as above

    if text is None:
        return None
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != _POSE_NUMBERS or not all(isfinite(number) for number in numbers):
        raise typer.BadParameter(f"{option} {text!r}: six numbers X,Y,Z,W,P,R in mm and degrees are expected.")
    return Transform.from_xyzwpr("base", "tcp", Xyzwpr(*numbers))


def _view(
    calibration: Path | None, poses: list[Transform | None], table_z_mm: float, parameters: VisionParameters
) -> StereoView | None:
    """Return where the images were taken from; None where nothing was said about it."""
    left, right = poses
    if calibration is None and left is None and right is None:
        return None
    if calibration is None or left is None or right is None:
        raise typer.BadParameter("--calibration, --left-pose and --right-pose go together.")
    import yaml  # noqa: PLC0415 - the command line starts lazily

    from srvs_cell.alarms import Alarm, AlarmError  # noqa: PLC0415 - as above
    from srvs_cell.calibration import Calibration  # noqa: PLC0415 - as above
    from srvs_cell.vision import StereoView  # noqa: PLC0415 - as above

    try:
        data = yaml.safe_load(calibration.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise AlarmError(Alarm.CALIBRATION_INVALID, f"{calibration}: {' '.join(str(error).split())}.") from error
    if not isinstance(data, dict):
        raise AlarmError(Alarm.CALIBRATION_INVALID, f"{calibration}: a mapping of keys is expected.")
    return StereoView(
        calibration=Calibration.from_mapping(data, str(calibration)),
        base_T_tcp_left=left,
        base_T_tcp_right=right,
        table_z_mm=table_z_mm,
        max_height_mm=parameters.recognition.max_height_mm,
    )


def _read_image(path: Path) -> NDArray[np.uint8]:
    """Return a picture file as BGR or grey; raises `AlarmError` IMAGE_INVALID where it is missing or broken."""
    import cv2  # noqa: PLC0415 - the command line starts lazily
    import numpy as np  # noqa: PLC0415 - as above

    from srvs_cell.alarms import Alarm, AlarmError  # noqa: PLC0415 - as above

    try:
        data = path.read_bytes()
    except OSError as error:
        raise AlarmError(Alarm.IMAGE_INVALID, f"{path}: {error.strerror}.") from error
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR) if data else None
    if image is None:
        raise AlarmError(Alarm.IMAGE_INVALID, f"{path}: {len(data)} bytes that are no complete picture.")
    return np.asarray(image, dtype=np.uint8)


def _write(path: Path, data: bytes) -> None:
    from srvs_cell.alarms import Alarm, AlarmError  # noqa: PLC0415 - the command line starts lazily

    try:
        path.write_bytes(data)
    except OSError as error:
        raise AlarmError(Alarm.FILE_INVALID, f"{path}: {error.strerror}.") from error


def _write_overlay(path: Path, perception: Perception) -> None:
    import cv2  # noqa: PLC0415 - the command line starts lazily

    from srvs_cell.vision.overlay import draw_matches  # noqa: PLC0415 - as above

    _, data = cv2.imencode(".png", draw_matches(perception))
    _write(path, data.tobytes())


def _write_lines(perception: LinePerception, disparity: Path | None, overlay: Path | None) -> None:
    """Write the files of the line matching that were asked for."""
    if disparity is not None:
        from srvs_cell.vision import encode_pfm  # noqa: PLC0415 - the command line starts lazily
        from srvs_cell.vision.lines import line_disparity_map  # noqa: PLC0415 - as above

        _write(disparity, encode_pfm(line_disparity_map(perception)))
    if overlay is not None:
        import cv2  # noqa: PLC0415 - as above

        from srvs_cell.vision.line_overlay import draw_line_matches  # noqa: PLC0415 - as above

        _, data = cv2.imencode(".png", draw_line_matches(perception))
        _write(overlay, data.tobytes())


def _show_lines(perception: LinePerception) -> None:
    """Print a table of matched lines for people."""
    matches = perception.matches
    typer.echo(f"{len(perception.left)} lines left, {len(perception.right)} right, {len(matches)} matched")
    typer.echo(f"{'left':>5} {'right':>5} {'score':>6} {'x px':>7} {'y px':>7} {'length px':>10} {'disparity px':>13}")
    for left, right, score, ends_px in zip(
        matches.left, matches.right, matches.score, matches.disparity_ends_px, strict=True
    ):
        x, y = perception.left.centre_px[left]
        typer.echo(
            f"{left + 1:5d} {right + 1:5d} {score:6.3f} {x:7.1f} {y:7.1f} {perception.left.length_px[left]:10.1f} "
            f"{ends_px.mean():13.2f}"
        )
    typer.echo(f"{sum(perception.timings_ms.values()):.0f} ms")


def _show(perception: Perception) -> None:
    """Print a table for people."""
    typer.echo(
        f"{len(perception.left.planes)} planes left, {len(perception.right.planes)} right, "
        f"{len(perception.matches)} matched"
    )
    planes = {plane.id: plane for plane in perception.left.planes}
    typer.echo(f"{'left':>5} {'right':>5} {'score':>6} {'x px':>7} {'y px':>7} {'area px':>8} {'disparity px':>13}")
    for match in perception.matches:
        plane = planes[match.left]
        x, y = plane.centre_px
        typer.echo(
            f"{match.left:5d} {match.right:5d} {match.score:6.3f} {x:7.1f} {y:7.1f} {plane.area_px:8.0f} "
            f"{match.disparity_px:13.2f}"
        )
    if perception.ambiguous_planes:
        places = ", ".join("({:.0f}, {:.0f})".format(*plane.centre_px) for plane in perception.ambiguous_planes)
        typer.echo(
            f"{len(perception.ambiguous_planes)} left unmatched because they are ambiguous, at x, y px: {places}"
        )
    if perception.table is not None:
        typer.echo(f"table: {_correction(perception.table)}")
    for workpiece in perception.workpieces:
        typer.echo(f"{workpiece.id}: {_described(workpiece)}")
    typer.echo(f"{sum(perception.timings_ms.values()):.0f} ms")


def _correction(table: TableCheck) -> str:
    """Return what the table corrected, or why it did not."""
    if table.refusal:
        return f"corrects nothing, {table.refusal}"
    moved = ", ".join(f"{value:.2f}" for value in table.correction_mm)
    return f"corrects places in the middle of its picture by ({moved}) mm"


def _described(workpiece: Workpiece) -> str:
    """Return where a workpiece is, how surely, and how it is taken, or why not."""
    position = ", ".join(f"{value:.1f}" for value in workpiece.position_mm)
    yaw = "" if workpiece.yaw_deg is None else f", yaw {workpiece.yaw_deg:.1f} deg"
    grey = "" if workpiece.brightness is None else f", brightness {workpiece.brightness:.0f}"
    grasp = workpiece.grasp
    taken = (
        f"no grasp: {workpiece.grasp_refusal}"
        if grasp is None
        else f"grasp closes to {grasp.opening_mm:.1f} mm at {grasp.yaw_deg:.1f} deg"
    )
    place = f"{workpiece.kind} at ({position}) mm, sigma {_sigmas(workpiece)}, height {workpiece.height_mm:.1f} mm"
    return f"{place}{yaw}{grey}; {taken}"


def _sigmas(workpiece: Workpiece) -> str:
    """Return the standard deviations of a workpiece's place, and of them the random part."""
    whole, systematic = workpiece.covariance_mm2, workpiece.systematic_mm2
    told = f"({_roots(whole)}) mm"
    return told if systematic is None else f"{told}, random ({_roots(whole - systematic)}) mm"


def _roots(covariance_mm2: NDArray[np.float64]) -> str:
    return ", ".join(f"{value**0.5:.2f}" for value in covariance_mm2.diagonal())
