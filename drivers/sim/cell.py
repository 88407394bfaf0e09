"""The simulated cell as a program: the entry point ``mujoco`` of the group ``srvs_cell.simulators``.

Prints one JSON line on stdout that says what listens where, then serves until SIGTERM, SIGINT, the end of stdin, or
``{"op": "shutdown"}`` on the control socket. Everything listens on loopback only.
"""

from __future__ import annotations

import argparse
import json
import logging
import signal
import sys
import tempfile
import threading
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from drivers.sim.simulation import Simulation, SimulationParameters

_LOG: Final = logging.getLogger("srvs_cell.sim")
_LEVELS: Final = ("none", "real")
_PORTED: Final = ("modbus", "rmi", "karel")
_WIRES: Final = (*_PORTED, "karel-serial")
_EXIT_FAILED: Final = 1
_POLL_S: Final = 0.2


def main(argv: Sequence[str] | None = None) -> int:
    """Run the simulated cell; return the exit code."""
    arguments = _parser().parse_args(argv)
    logging.basicConfig(stream=sys.stderr, level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
    if find_spec("mujoco") is None:
        _LOG.error("The simulated cell needs MuJoCo: pip install 'srvs-cell[sim]'.")
        return _EXIT_FAILED
    return _serve(arguments)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="srvs-cell sim", description="A simulated stereo robot vision cell.")
    parser.add_argument("--objects", type=int, default=5, help="number of parts, 1 to 10")
    parser.add_argument("--seed", type=int, default=0, help="the same seed gives the same cell")
    parser.add_argument("--speed", type=float, default=20.0, help="how much faster than life while the daemon waits")
    parser.add_argument("--imperfections", choices=_LEVELS, default="real", help="a perfect cell or a real one")
    parser.add_argument("--wire", choices=_WIRES, default=None, help="how a daemon talks to the controller")
    for wire in _PORTED:
        parser.add_argument(f"--{wire}-port", type=int, default=None, help=f"serves {wire} there; 0 takes a free one")
    parser.add_argument("--robotiq", type=Path, default=None, help="where to link the serial port of a Robotiq gripper")
    parser.add_argument("--calibration-out", type=Path, default=None, help="where to write the calibration file")
    parser.add_argument("--clock-page", type=Path, default=None, help="where to make the clock page")
    parser.add_argument("--ties", action="store_true", help="two parts have the same height")
    return parser


def _serve(arguments: argparse.Namespace) -> int:
    # needs MuJoCo, an extra: imported when it is known to be there
    from drivers.sim.scenario import ScenarioError  # noqa: PLC0415
    from drivers.sim.simulation import SimulationParameters  # noqa: PLC0415

    parameters = SimulationParameters(
        objects=arguments.objects,
        seed=arguments.seed,
        speed=arguments.speed,
        level=arguments.imperfections,
        ties=arguments.ties,
    )
    try:
        return _run(parameters, arguments)
    except (OSError, ScenarioError) as error:
        _LOG.error("The simulated cell cannot start: %s", error)
        return _EXIT_FAILED


def _run(parameters: SimulationParameters, arguments: argparse.Namespace) -> int:
    from drivers.sim.camera_server import CameraServer  # noqa: PLC0415 - see `_serve`
    from drivers.sim.clock_page import ClockPage  # noqa: PLC0415
    from drivers.sim.control_server import Control, ControlServer  # noqa: PLC0415
    from drivers.sim.controllers import WIRES  # noqa: PLC0415
    from drivers.sim.imperfections import write_calibration  # noqa: PLC0415
    from drivers.sim.simulation import Simulation  # noqa: PLC0415

    ended = threading.Event()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="srvs-sim-")))
        page_path = arguments.clock_page or folder / "clock"
        calibration_path = arguments.calibration_out or folder / "calibration.yaml"
        page = ClockPage.create(page_path)
        stack.callback(page.close)
        simulation = Simulation(parameters, page)
        write_calibration(simulation.camera, calibration_path)
        wired = [WIRES[wire](simulation.arm, simulation.time, port) for wire, port in _wires(arguments).items()]
        camera_server = CameraServer(simulation.stream, simulation.pictures, simulation.time)
        control_server = ControlServer(Control(simulation, wired, camera_server, ended.set))
        stack.callback(simulation.time.close)
        simulation.time.start()
        stack.callback(camera_server.close)
        stack.callback(control_server.close)
        line: dict[str, Any] = {}
        for wire in reversed(wired):  # the first one's ``arm`` is the one that is listed
            stack.callback(wire.controller.close)
            line |= wire.start()
        line |= {
            "camera_port": camera_server.start(),
            "control_port": control_server.start(),
            "clock_page": str(page_path),
            "calibration": str(calibration_path),
            **simulation.layout(),
        }
        if arguments.robotiq is not None:
            line["robotiq"] = str(stack.enter_context(_robotiq(simulation, arguments.robotiq)))
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: ended.set())
        _end_with_stdin(ended)
        sys.stdout.write(json.dumps(line) + "\n")
        sys.stdout.flush()
        _LOG.info("%d parts, seed %d, imperfections %s", parameters.objects, parameters.seed, parameters.level)
        while not ended.wait(_POLL_S):
            if simulation.time.failure is not None:
                _LOG.error("The physics has failed: %r", simulation.time.failure)
                return _EXIT_FAILED
    return 0


def _wires(arguments: argparse.Namespace) -> dict[str, int]:
    """Return the wires that are asked for and their ports, the one for a daemon first; Modbus where none is."""
    given = {wire: port for wire in _PORTED if (port := getattr(arguments, f"{wire}_port")) is not None}
    first = arguments.wire or next(iter(given), "modbus")
    return {first: given.get(first, 0)} | given


@contextmanager
def _robotiq(simulation: Simulation, link: Path) -> Iterator[Path]:
    """Let the world's jaws be a Robotiq gripper on a pseudo-terminal, to which ``link`` leads meanwhile."""
    from drivers.sim.robotiq_double import RobotiqDouble  # noqa: PLC0415 - see `_serve`
    from drivers.sim.robotiq_fingers import WorldFingers  # noqa: PLC0415

    world, time = simulation.world, simulation.time
    fingers = WorldFingers(world, time.lock, world.gripper.max_opening_mm)
    gripper = RobotiqDouble(fingers, time.now_s, hold=time.hold)
    if link.is_symlink():  # an earlier cell that was killed has left it
        link.unlink()
    link.symlink_to(gripper.start())
    try:
        yield link.absolute()
    finally:
        link.unlink(missing_ok=True)
        gripper.close()


def _end_with_stdin(ended: threading.Event) -> None:
    """End when stdin ends, so that no simulator outlives who started it; a terminal or no stdin does not count."""
    if sys.stdin is None or sys.stdin.isatty():
        return

    def watch() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=watch, name="stdin", daemon=True).start()


if __name__ == "__main__":
    sys.exit(main())
