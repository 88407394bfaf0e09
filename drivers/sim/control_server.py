"""The control socket of the simulated cell: one JSON object per line asks, one answers. For demos and tests only."""

from __future__ import annotations

import base64
import json
import socketserver
import threading
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np

from drivers.sim.truth import truth
from srvs_cell.ports import RobotMode

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from drivers.sim.camera_server import CameraServer
    from drivers.sim.controllers import WiredController
    from drivers.sim.simulation import Simulation

_ESTOP: Final = "SRVO-001 Operator panel E-stop"
_FAULT: Final = "SRVO-023 Stop error excess"
_DROP_HEIGHT_MM: Final = 40.0
_FULL_PERCENT: Final = 100


class RequestError(ValueError):
    """A request that the control socket does not know or cannot carry out."""


class Control:
    """Carries out requests.

    Args:
        simulation: the cell.
        wires: its robot controller on each wire; faults of a wire strike the first.
        camera_server: its camera.
        shutdown: ends the simulator.
    """

    def __init__(
        self,
        simulation: Simulation,
        wires: Sequence[WiredController],
        camera_server: CameraServer,
        shutdown: Callable[[], None],
    ) -> None:
        wired = wires[0]
        self._simulation, self._wires, self._wired, self._shutdown = simulation, wires, wired, shutdown
        self._faults: dict[str, Callable[[dict[str, Any]], None]] = {
            "e_stop": lambda _: simulation.arm.raise_fault(_ESTOP, servo_off=True),
            "arm_fault": lambda request: simulation.arm.raise_fault(str(request.get("text", _FAULT))),
            "camera_stop": lambda request: self._set_stream("running", not request.get("on", True)),
            "camera_freeze": lambda request: self._set_stream("frozen", bool(request.get("on", True))),
            "camera_disconnect": lambda _: camera_server.disconnect(),
            "drop_part": self._drop_part,
            "move_part": self._move_part,
            "override": self._set_override,
            "mode": lambda request: setattr(simulation.arm, "mode", RobotMode(request["mode"])),
            "pendant": lambda request: setattr(simulation.arm, "pendant_enabled", bool(request["on"])),
        }
        self._wire_faults: dict[str, Callable[[dict[str, Any]], None]] = {
            "wire": lambda request: wired.set_fault(wired.faults[str(request["kind"]).upper()]),
            "wire_cut": lambda _: wired.cut(),
            "heartbeat": self._set_heartbeat,
            "reboot": lambda _: wired.controller.reboot(),
        }

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """Return the answer to a request.

        Raises:
            RequestError: the request is unknown, or its values are wrong.
        """
        operation = request.get("op")
        if operation == "truth":
            started = sum(wired.controller.motions_started for wired in self._wires)
            return {**truth(self._simulation), "motions_started": started}
        if operation == "inject":
            self._inject(str(request.get("fault")), request)
            return {"ok": True, "time_s": self._simulation.time.now_s()}
        if operation == "render":
            return {"png": self._render()}
        if operation == "shutdown":
            self._shutdown()
            return {"ok": True}
        raise RequestError("op must be truth, inject, render or shutdown")

    def _inject(self, name: str, request: dict[str, Any]) -> None:
        if name in self._wire_faults:  # the controller has a lock of its own, which it takes before the world's
            self._wire_faults[name](request)
        elif name in self._faults:
            with self._simulation.time.lock:
                self._faults[name](request)
        else:
            raise RequestError(f"fault must be one of {', '.join([*self._faults, *self._wire_faults])}")

    def _render(self) -> str:
        exposure = self._simulation.view_now()
        with self._simulation.time.hold():
            picture = self._simulation.pictures.picture(exposure)
        encoded = np.asarray(cv2.imencode(".png", picture)[1])
        return base64.b64encode(encoded.tobytes()).decode("ascii")

    def _set_heartbeat(self, request: dict[str, Any]) -> None:
        if self._wired.set_heartbeat is None:
            raise RequestError("this wire has no heartbeat")
        self._wired.set_heartbeat(bool(request["on"]))

    def _set_stream(self, name: str, value: bool) -> None:
        setattr(self._simulation.stream, name, value)

    def _set_override(self, request: dict[str, Any]) -> None:
        percent = int(request["percent"])
        if not 1 <= percent <= _FULL_PERCENT:
            raise RequestError(f"percent must be 1 to {_FULL_PERCENT}")
        self._simulation.arm.override_percent = percent

    def _drop_part(self, _request: dict[str, Any]) -> None:
        """Let the held part slip: it is moved out of the jaws, down and aside."""
        world = self._simulation.world
        held = world.held_part()
        if held is None:
            raise RequestError("no part is held")
        pose = world.part_poses()[held].base_T_part.copy()
        pose[2, 3] -= _DROP_HEIGHT_MM
        pose[:3, 3] += world.base_T_tcp[:3, 0] * (world.gripper.finger_width_mm + world.parts[held].length_mm)
        world.put_part(held, pose)

    def _move_part(self, request: dict[str, Any]) -> None:
        """Push a part aside by ``dx_mm`` and ``dy_mm``, as a person would."""
        world = self._simulation.world
        index = int(request["part"])
        if not 0 <= index < len(world.parts):
            raise RequestError(f"part must be 0 to {len(world.parts) - 1}")
        pose = world.part_poses()[index].base_T_part.copy()
        pose[:2, 3] += (float(request.get("dx_mm", 0.0)), float(request.get("dy_mm", 0.0)))
        world.put_part(index, pose)


class ControlServer:
    """Serves `Control` on loopback."""

    def __init__(self, control: Control) -> None:
        class Handler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                for line in self.rfile:
                    self.wfile.write((json.dumps(_reply(control, line)) + "\n").encode())

        self._server = socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, name="control server", daemon=True)

    def start(self) -> int:
        """Serve; return the port."""
        self._thread.start()
        return int(self._server.server_address[1])

    def close(self) -> None:
        """End the server."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def _reply(control: Control, line: bytes) -> dict[str, Any]:
    try:
        request = json.loads(line)
        if not isinstance(request, dict):
            raise RequestError("a request is a JSON object")
        return control.answer(request)
    except (ValueError, KeyError, TypeError) as error:
        return {"error": f"{type(error).__name__}: {error}"}
