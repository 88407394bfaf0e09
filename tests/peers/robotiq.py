"""Modbus RTU: PyPI's robotiq2f and Debian's mbpoll on our gripper double."""

from __future__ import annotations

import contextlib
import json
import shutil
import subprocess
import time
from typing import TYPE_CHECKING

from drivers.sim.robotiq_double import RobotiqDouble
from drivers.sim.robotiq_fingers import ScriptedFingers
from tests.peers.bench import Judgement, SkippedError
from tests.peers.rmi import HERE, environment

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

WIRE = "Modbus RTU, gripper double"
PART_AT = 120
STATUS, COMMAND = 0x07D0 + 1, 0x03E8 + 1  # mbpoll counts from 1


@contextlib.contextmanager
def _gripper() -> Iterator[tuple[RobotiqDouble, str]]:
    fingers = ScriptedFingers(time.monotonic)
    fingers.part_at = PART_AT
    double = RobotiqDouble(fingers, time.monotonic)
    try:
        yield double, double.start()
    finally:
        double.close()


def robotiq2f(folder: Path) -> Judgement:
    """Drive our double with a gripper client that was written by others, on a Modbus library of others."""
    python = environment(folder)
    with _gripper() as (double, port):
        ended = subprocess.run(
            [str(python), str(HERE / "robotiq_client.py"), port],
            capture_output=True, text=True, check=False, timeout=60,
        )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout.splitlines()[-1])
    assert (found["reset"], found["activated"], found["fault"]) == (True, True, False), found
    assert found["closed"] == {"detected": True, "opening_mm": (230 - PART_AT) * 0.39, "moving": False}, found
    assert found["open"] == {"detected": False, "opening_mm": 85.0, "moving": False}, found
    assert [command[0] for command in double.commands] == [0x00, 0x01, 0x09, 0x09]
    result = "resets, activates, closes on a part (object detected), opens, reads status and faults: all as it expects"
    return Judgement(WIRE, "PyPI robotiq2f 0.2.0 on minimalmodbus, a client", result, True)


def mbpoll() -> Judgement:
    """Read and write the double's registers with a client that knows nothing of grippers."""
    if shutil.which("mbpoll") is None:
        raise SkippedError("mbpoll is not installed: apt-get install mbpoll")
    with _gripper() as (double, port):
        double.make_ready()
        serial = ["mbpoll", "-m", "rtu", "-b", "115200", "-P", "none", "-a", "9", "-o", "5"]
        read = [*serial, "-t", "3:hex", "-r", str(STATUS), "-c", "3", "-1", "-q", port]
        first = _run(read)
        _run([*serial, "-t", "4:hex", "-r", str(COMMAND), port, "0x0900", "0x00FF", "0xFF20"])
        time.sleep(1.0)
        held = _run(read)
    assert "0xF900" in first, first
    assert "0x0300" in first, first
    assert "0xB900" in held, held
    assert f"0x{PART_AT:02X}01" in held, held
    assert double.commands == [(0x09, 0xFF, 0xFF, 0x20)]
    result = "reads the status (FC04), writes a grip (FC16), reads the contact: 0xF900, then 0xB900 at the part"
    version = _run(["dpkg-query", "-W", "-f=${Version}", "mbpoll"]) if shutil.which("dpkg-query") else ""
    return Judgement(WIRE, f"Debian mbpoll {version}, a client".replace("  ", " "), result, True)


def _run(command: list[str]) -> str:
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=30)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout
