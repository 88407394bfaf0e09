"""RMI: PyPI's fanuc-rmi on our controller double, our driver on PyPI airo-fanuc's fake controller."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from pathlib import Path
from typing import Final

from drivers.fanuc.rmi import FanucRmiArm, FanucRmiConfig
from drivers.sim.rmi_controller import RmiController
from srvs_cell.alarms import Alarm
from srvs_cell.ports import PortError
from tests.drivers.sim.test_rmi_double import JointArm
from tests.peers.bench import Judgement, SkippedError, WallTime, free_ports, running, wall_clock

HERE: Final = Path(__file__).parent


def environment(folder: Path) -> Path:
    """Return the Python of the peers' environment, made where there is none."""
    python = folder / "venv" / "bin" / "python"
    done = folder / "venv" / ".installed"
    wanted = (HERE / "requirements.txt").read_text(encoding="utf-8")
    if not done.exists() or done.read_text(encoding="utf-8") != wanted:
        made = subprocess.run([sys.executable, "-m", "venv", str(folder / "venv")], check=False, capture_output=True)
        install = [str(python), "-m", "pip", "install", "--quiet", "-r", str(HERE / "requirements.txt")]
        if made.returncode != 0 or subprocess.run(install, check=False, capture_output=True).returncode != 0:
            raise SkippedError("pip cannot install the peers of tests/peers/requirements.txt")
        done.write_text(wanted, encoding="utf-8")
    return python


def fanuc_rmi(folder: Path) -> Judgement:
    """Drive our double with a client that was written by others."""
    python = environment(folder)
    startup, session = free_ports(2)
    point = JointArm(WallTime())  # type: ignore[arg-type]
    point.inputs[1] = True
    controller = RmiController(point, WallTime(), startup, session)
    controller.start()
    try:
        ended = subprocess.run(
            [str(python), str(HERE / "rmi_client.py"), str(startup), str(session)],
            capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip
    finally:
        controller.close()
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout.splitlines()[-1])
    assert (found["frames"]["UFrameNumber"], found["frames"]["UToolNumber"]) == (1, 1), found
    assert (found["written"]["ErrorID"], found["read"]["PortValue"], found["aborted"]["ErrorID"]) == (0, 1, 0), found
    assert point.outputs[5]
    assert (point.override_percent, controller.motions_started) == (50, 4)
    assert (point.pose.x_mm, point.pose.z_mm) == (520.0, 390.0)
    result = (
        "connects, resets, initialises, selects frames, sets the override, moves absolutely and relatively to "
        "poses and to joint angles, waits, writes an output, reads an input, pose and joints, aborts, disconnects: all "
        "replies as it expects"
    )
    return Judgement("RMI, controller double", "PyPI fanuc-rmi 0.3.1, a client", result, True)


def airo_fanuc(folder: Path) -> Judgement:
    """Connect our driver to a server that is no RMI of the manual."""
    python = environment(folder)
    startup, session = free_ports(2)
    command = [str(python), str(HERE / "rmi_server.py"), str(startup), str(session)]
    with running(command):
        arm = FanucRmiArm(FanucRmiConfig(port=startup), wall_clock())
        try:
            asyncio.run(arm.connect())
        except PortError as error:
            refused = error
    assert refused.alarm is Alarm.PROTOCOL_ERROR
    assert "names no PortNumber" in refused.detail, refused.detail
    peer = "PyPI airo-fanuc 0.1.0, its fake controller (a hostile server)"
    result = f"refused with the reason: {refused.alarm.name}, the reply to FRC_Connect names no PortNumber"
    return Judgement("RMI, driver", peer, result, True)
