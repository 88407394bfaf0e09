"""Modbus TCP: Debian's mbpoll on our controller double, our driver on npm's modbus-serial."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import shutil
import subprocess
import threading
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final

from drivers.fanuc.modbus import FanucModbusArm, FanucModbusConfig
from drivers.sim.modbus_controller import ModbusController
from srvs_cell.geometry import Xyzwpr
from srvs_cell.ports import Lifecycle, PortError, RobotMode
from tests.drivers.stepped import PointArm
from tests.peers.bench import Judgement, SkippedError, WallTime, free_ports, running, wall_clock

if TYPE_CHECKING:
    from collections.abc import Callable

HERE: Final = Path(__file__).parent
_LOW_WORD: Final = 0xFFFF
_TARGET_UM: Final = (510_000, 0, 400_000, 180_000, 0, 0)
_SPEED: Final = 50_000


def mbpoll() -> Judgement:
    """Read, write and move our double with a client that was written by others."""
    if shutil.which("mbpoll") is None:
        raise SkippedError("mbpoll is not installed: apt-get install mbpoll")
    controller = ModbusController(PointArm(WallTime()), WallTime())  # type: ignore[arg-type]
    port = controller.start()
    try:
        done = [check(port) for check in (_words, _signals, _exceptions, _move)]
        moved = controller.motions_started == 1
    finally:
        controller.close()
    version = _run(["dpkg-query", "-W", "-f=${Version}", "mbpoll"]) if shutil.which("dpkg-query") else ""
    peer = f"Debian mbpoll {version}, a client".replace("  ", " ")
    return Judgement("Modbus TCP, controller double", peer, "; ".join(done), moved)


def _poll(port: int, *arguments: str | int) -> dict[int, int]:
    """Run mbpoll once; return what it read, by its 1-based reference."""
    options = [str(argument) for argument in arguments]
    said = _run(["mbpoll", "-m", "tcp", "-p", str(port), "-a", "1", "-1", "-q", *options])
    return {int(number): int(value) for number, value in re.findall(r"\[(\d+)\]:\s+(-?\d+)", said)}


def _run(command: list[str]) -> str:
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=30)
    return ended.stdout + ended.stderr


def _write(port: int, kind: str, word: int, *values: int) -> None:
    said = _run(
        ["mbpoll", "-m", "tcp", "-p", str(port), "-a", "1", "-t", kind, "-r", str(word), "127.0.0.1"]
        + [str(value) for value in values]
    )
    assert "Written" in said, said


def _words(port: int) -> str:
    first = _poll(port, "-t", "4", "-r", 12001, "-c", 5, "127.0.0.1")
    assert first[12001] == 4201, first
    pose = _poll(port, "-t", "4:int", "-r", 12010, "-c", 6, "127.0.0.1")
    assert list(pose.values())[:4] == [500_000, 0, 400_000, 180_000], pose
    later = _poll(port, "-t", "4", "-r", 12005, "-c", 1, "127.0.0.1")
    assert later[12005] != first[12005], "the heartbeat does not count"
    return "reads words, 32-bit values low word first, a counting heartbeat"


def _signals(port: int) -> str:
    _write(port, "0", 5, 1)
    assert _poll(port, "-t", "0", "-r", 4, "-c", 2, "127.0.0.1") == {4: 0, 5: 1}
    assert set(_poll(port, "-t", "1", "-r", 1, "-c", 3, "127.0.0.1").values()) == {0}
    return "writes and reads back outputs, reads inputs"


def _exceptions(port: int) -> str:
    address = _run(["mbpoll", "-m", "tcp", "-p", str(port), "-a", "1", "-1", "-t", "1", "-r", "600", "127.0.0.1"])
    assert "Illegal data address" in address, address
    function = _run(["mbpoll", "-m", "tcp", "-p", str(port), "-a", "1", "-1", "-t", "3", "127.0.0.1"])
    assert "Illegal function" in function, function
    return "is told illegal address and illegal function"


def _move(port: int) -> str:
    """Command a move as docs/reference/modbus-map.md has it, word by word."""
    checked = [7, 1, *_TARGET_UM, _SPEED]
    total = 4201 + sum(weight * value for weight, value in enumerate(checked, start=1))
    words = [1]
    for value in (*_TARGET_UM, _SPEED, total):
        words += [value & _LOW_WORD, value >> 16 & _LOW_WORD]
    _write(port, "4", 12032, 1)
    _write(port, "4", 12033, *words)
    _write(port, "4", 12032, 2)
    _write(port, "4", 12031, 7)
    for beat in range(3, 60):
        state = _poll(port, "-t", "4", "-r", 12002, "-c", 3, "127.0.0.1")
        if state[12002] == 7:
            assert (state[12003], state[12004]) == (2, 0), state
            pose = _poll(port, "-t", "4:int", "-r", 12010, "-c", 1, "127.0.0.1")
            assert pose[12010] == 510_000, pose
            return "commands a move that the robot's own programs carry out"
        _write(port, "4", 12032, beat)
    raise AssertionError("the move has not ended")


def modbus_serial(folder: Path) -> Judgement:
    """Let our driver talk to a server that was written by others."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        raise SkippedError("node or npm is not installed")
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("package.json", "modbus_server.js"):
        shutil.copy(HERE / name, folder)
    if not (folder / "node_modules" / "modbus-serial").is_dir():
        installed = subprocess.run(
            ["npm", "install", "--ignore-scripts", "--no-audit", "--no-fund"],
            cwd=folder, capture_output=True, text=True, check=False, timeout=300,
        )  # fmt: skip
        if installed.returncode != 0:
            raise SkippedError(f"npm cannot install modbus-serial: {installed.stderr.strip().splitlines()[-1:]}")
    version = json.loads((folder / "node_modules" / "modbus-serial" / "package.json").read_text())["version"]
    (port,) = free_ports(1)
    with running(["node", str(folder / "modbus_server.js"), str(port)]) as (told, tells):
        result = asyncio.run(_drive(port, told, tells))
    return Judgement("Modbus TCP, driver", f"npm modbus-serial {version}, a server", result, True)


class _Robot:
    """What the robot's programs would do to the words: count, and arrive where a command points."""

    def __init__(self, told: IO[str]) -> None:
        self.words = dict.fromkeys(range(49), 0) | {0: 4201, 5: 1, 6: 7, 21: 100, 23: 1, 25: 1}
        self.coils: dict[int, bool] = {}
        self._told = told
        self.place([500_000, 0, 400_000, 180_000, 0, 0])

    def place(self, micro: list[int]) -> None:
        for i, value in enumerate(micro):
            self.words[9 + 2 * i], self.words[10 + 2 * i] = value & _LOW_WORD, value >> 16 & _LOW_WORD

    def tell(self) -> None:
        self._told.write(json.dumps({"word": 12000, "values": [self.words[i] for i in range(31)]}) + "\n")
        self._told.flush()

    def hear(self, line: str) -> None:
        said = json.loads(line)
        if "coil" in said:
            self.coils[said["coil"] + 1] = said["value"]
        if "register" in said:
            self.words[said["register"] - 12000] = said["value"]
        if said.get("register") == 12030:
            for i in range(9, 21):
                self.words[i] = self.words[i + 24]
            self.words[1], self.words[2] = said["value"], 2
            self.tell()


async def _drive(port: int, told: IO[str], tells: IO[str]) -> str:
    robot = _Robot(told)
    robot.tell()
    threading.Thread(target=_hear_all, args=(tells, robot.hear), daemon=True).start()  # it ends with the server
    counting = asyncio.create_task(_count(robot))
    arm = FanucModbusArm(FanucModbusConfig(port=port), wall_clock())
    try:
        await arm.connect()
        status = await arm.status()
        assert (status.mode, status.pose.x_mm, status.fault) == (RobotMode.AUTO, 500.0, None)
        await arm.activate()
        target = Xyzwpr(510.0, -20.0, 390.0, 180.0, 0.0, 30.0)
        assert await arm.move_linear(target, 100.0) == target
        await arm.write_output(5, on=True)
        assert await arm.read_input(2)
        assert not await arm.read_input(1)
        await arm.request_stop()
        async with asyncio.timeout(10.0):
            while not (robot.coils.get(5) and robot.coils.get(3)):  # noqa: ASYNC110 - the server tells a moment later
                await asyncio.sleep(0.05)
        assert arm.lifecycle is Lifecycle.INACTIVE
        try:
            await FanucModbusArm(FanucModbusConfig(port=port, unit_id=2, timeout_s=0.5), wall_clock()).connect()
        except PortError as error:
            silent = error.alarm.name
        assert silent == "CONNECTION_TIMEOUT"
    finally:
        await arm.disconnect()
        counting.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await counting
    return "connects, reads, moves and confirms, inputs and outputs, hold output; a wrong unit id is CONNECTION_TIMEOUT"


def _hear_all(tells: IO[str], hear: Callable[[str], None]) -> None:
    for line in tells:
        hear(line)


async def _count(robot: _Robot) -> None:
    """The robot's heartbeat."""
    while True:
        robot.words[4] = robot.words[4] % 30_000 + 1
        robot.tell()
        await asyncio.sleep(0.1)
