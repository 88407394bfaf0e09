"""The daemon as the systemd service: its start, its sandbox, its cameras' faults, its watchdog, its end."""

from __future__ import annotations

import json
import os
import pwd
import re
import signal
import sqlite3
import stat
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from tests.vm.checks.cell import CONFIG, SOCKET, STATE_DIR, UNIT, write_cell
from tests.vm.checks.commands import run, wait_until

if TYPE_CHECKING:
    from tests.vm.checks.report import Report
    from tests.vm.checks.usb import UsbCameraProcess

_MOST_EXPOSURE = 2.0
_UNIT_FILE = f"/etc/systemd/system/{UNIT}"
_STOP_LIMIT_S = 30.0
_LOOKS = 3
_STARVED = {"HEARTBEAT_LOST", "MOTION_STOPPED", "ROBOT_FAULT"}
"""What the robot's watchdog leads to, in mid-move or before the move."""
_PATIENCE_S = 300.0
_DROP_IN = Path(f"{_UNIT_FILE}.d/bench.conf")
_ALARM_S = 20.0
"""Two seconds are the config's; a machine that does much else takes its time to answer."""


class Service:
    """The checks; each leaves the service so that the next one can begin.

    Args:
        camera: the cell's camera.
        folder: what the simulated robot's cell is like.
    """

    def __init__(self, camera: UsbCameraProcess, folder: Path) -> None:
        self._cell, self._camera = write_cell(folder), camera

    def check_start(self, report: Report) -> bool:
        """Wait until it serves, and look at its sandbox; tell whether it serves."""
        if not report.check("service: started", self._started):
            return False
        report.check("service: systemd-analyze security", self._security)
        report.check("service: sandbox in force", self._sandbox)
        report.check("service: device policy", self._device_policy)
        report.check("service: who may command", self._who_may_command)
        return True

    def check_work(self, report: Report) -> None:
        """Let it work with the camera, which is plugged in now, hang and end."""
        report.check("service: ready", self._make_ready)
        report.check("service: looks along the lateral path", self._look)
        report.check("service: camera frozen", self._frozen)
        report.check("service: camera unplugged and back", self._unplugged)
        report.check("service: hangs: watchdog", self._hangs)
        report.check("service: stopped in mid-move", self._stopped)

    # -- start and sandbox --------------------------------------------------------------------------------------------

    @staticmethod
    def verify() -> str:
        """Judge the unit file."""
        complaints = run("systemd-analyze", "verify", _UNIT_FILE)
        assert not complaints, complaints
        return "no complaint"

    @staticmethod
    def begin_start() -> str:
        """Start it on a machine that has never seen a camera; do not wait."""
        known = Path("/proc/devices").read_text(encoding="ascii")
        assert "video4linux" not in known, "the kernel has met a camera before"
        # The one thing that differs from a real machine: an emulated processor takes ten times as long to start Python.
        _DROP_IN.parent.mkdir()
        _DROP_IN.write_text("[Service]\nTimeoutStartSec=300\n", encoding="utf-8")
        run("systemctl", "daemon-reload")
        run("systemctl", "enable", UNIT)
        run("systemctl", "start", "--no-block", UNIT)
        wait_until("its process", lambda: _shown("MainPID") != "0", _PATIENCE_S)
        return "its process runs"

    def _started(self) -> str:
        _settled()
        begun_us, served_us = (int(_shown(f"{name}TimestampMonotonic")) for name in ("ExecMainStart", "ActiveEnter"))
        state = self._cell.status()["state"]
        assert state == "Aborted", state
        memory_mib = int(_shown("MemoryCurrent")) / 2**20
        took_s = (served_us - begun_us) / 1e6
        return f"without a camera: serves after {took_s:.1f} s, {_shown('StatusText')}, {memory_mib:.0f} MiB"

    def _security(self) -> str:
        verdict = run("systemd-analyze", "security", "--no-pager", UNIT).splitlines()[-1]
        found = re.search(r"(\d+\.\d+)", verdict)
        assert found, verdict
        assert float(found[1]) <= _MOST_EXPOSURE, verdict
        return verdict

    def _sandbox(self) -> str:
        lines = Path(f"/proc/{_shown('MainPID')}/status").read_text(encoding="utf-8").splitlines()
        status = {key: value.strip() for key, _, value in (line.partition(":") for line in lines)}
        wanted = {"CapEff": "0000000000000000", "CapBnd": "0000000000000000", "NoNewPrivs": "1", "Seccomp": "2"}
        found = {key: status[key] for key in wanted}
        assert found == wanted, found
        return f"no capability, no new privileges, seccomp filter, user {status['Uid'].split()[0]}"

    def _device_policy(self) -> str:
        """As root, so that nothing but the policy can refuse."""
        opens = {device: self._opens(device) for device in ("/dev/ttyS0", "/dev/vda", "/dev/mem")}
        assert opens == {"/dev/ttyS0": True, "/dev/vda": False, "/dev/mem": False}, opens
        return "a serial port opens; the disk and the memory do not"

    @staticmethod
    def _opens(device: str) -> bool:
        enter = f"echo $$ >{_cgroup()}/cgroup.procs && exec 3<{device}"
        run("sh", "-c", f"exec 3<{device}")
        return not run("sh", "-c", enter, check=False)

    def _who_may_command(self) -> str:
        mode = stat.filemode(SOCKET.stat().st_mode)
        assert mode == "srw-rw----", mode
        run("useradd", "--groups", "srvs-cell", "alice")
        with ThreadPoolExecutor() as both:
            told = both.submit(run, "runuser", "-u", "alice", "--", "srvs-cell", "status", "--json")
            untold = both.submit(run, "runuser", "-u", "nobody", "--", "srvs-cell", "status", check=False)
            answer, refused = told.result(), untold.result()
        assert json.loads(answer)["state"] == "Aborted", answer
        assert "NO_DAEMON" in refused, refused
        return f"{mode} in a closed directory; a member of the group is answered, nobody else"

    # -- a cell at work -----------------------------------------------------------------------------------------------

    def _make_ready(self) -> str:
        alarms = self._cell.alarms()
        assert alarms == {"CAMERA_UNAVAILABLE"}, alarms
        self._cell.make_idle()
        devices = self._cell.status()["devices"]
        lifecycles = {name: device["lifecycle"] for name, device in devices.items()}
        assert set(lifecycles.values()) == {"active"}, lifecycles
        return f"{', '.join(sorted(alarms))} before; Idle, {', '.join(lifecycles)} active"

    def _look(self) -> str:
        """Both pictures are on the disk; what is in them is for other tests.

        A machine that is starved for two seconds is stopped by the robot's watchdog, as it must be: once more, then.
        """
        process = _shown("MainPID")
        for stopped in range(_LOOKS):
            started_s = time.monotonic()
            self._cell.command("start")
            wait_until("two pictures", self._looked_or_ended, _PATIENCE_S)
            took_s = time.monotonic() - started_s
            if self._pictures():
                self._end_look()
                return f"left and right picture after {took_s:.1f} s; stopped before by the robot's watchdog: {stopped}"
            assert self._cell.alarms() <= _STARVED, self._cell.alarms()
            self._recover(process)
        raise AssertionError(f"stopped by the robot's watchdog {_LOOKS} times")

    def _end_look(self) -> None:
        """Stop, unless the vision was faster: the bench's camera may show both times the same, which it refuses."""
        try:
            self._cell.command("stop")
        except AssertionError:
            assert self._cell.status()["state"] == "Aborted", self._cell.status()["state"]
        self._cell.reaches({"Stopped", "Aborted"})
        if self._cell.status()["state"] == "Aborted":
            assert self._cell.alarms() == {"PAIR_INCONSISTENT"}, self._cell.alarms()

    def _looked_or_ended(self) -> bool:
        return self._pictures() or self._cell.status()["state"] in {"Aborted", "Held"}

    @staticmethod
    def _pictures() -> bool:
        return {"left_0.png", "right_0.png"} <= {path.name for path in STATE_DIR.glob("runs/*/*")}

    def _frozen(self) -> str:
        process = _shown("MainPID")
        self._cell.make_idle()
        self._camera.tell("freeze")
        alarm, took_s = self._start_in_vain({"CAMERA_TIMEOUT"})
        self._camera.tell("thaw")
        self._recover(process)
        return f"{alarm} {took_s:.1f} s after start; Idle again with the same process"

    def _unplugged(self) -> str:
        process = _shown("MainPID")
        self._camera.unplug()
        alarm, took_s = self._start_in_vain({"CAMERA_UNAVAILABLE"})
        self._camera.plug()
        self._recover(process)
        return f"{alarm} {took_s:.1f} s after start; Idle again with the same process"

    def _start_in_vain(self, expected: set[str]) -> tuple[str, float]:
        started_s = time.monotonic()
        self._cell.command("start")
        self._cell.reaches({"Aborted", "Held", "Stopped"})
        took_s = time.monotonic() - started_s
        alarms = self._cell.alarms()
        assert alarms & expected, alarms
        assert took_s < _ALARM_S, f"only after {took_s:.1f} s"
        return ", ".join(sorted(alarms)), took_s

    def _recover(self, process: str) -> None:
        if self._cell.status()["state"] == "Held":
            self._cell.command("stop")
            self._cell.reaches({"Stopped"})
        self._cell.make_idle()
        assert _shown("MainPID") == process, "the daemon was restarted"

    # -- restart ------------------------------------------------------------------------------------------------------

    def _hangs(self) -> str:
        """A process that is stopped gives no sign of life."""
        before, process = int(_shown("NRestarts")), int(_shown("MainPID"))
        assert process > 0, "the daemon does not run"
        os.kill(process, signal.SIGSTOP)

        def serves() -> bool:
            assert not self._cell.arm_moves(), "the arm moves"
            return int(_shown("NRestarts")) > before and _shown("ActiveState") == "active"

        took_s = wait_until("the next daemon serves", serves, _PATIENCE_S)
        state = self._cell.status()["state"]
        assert state == "Aborted", state
        journal = run("journalctl", "--unit", UNIT, "--no-pager", "--output", "cat")
        assert "Watchdog timeout" in journal, journal[-500:]
        return f"killed and serves again {took_s:.1f} s after the last sign of life, {state}; nothing moved"

    # -- the end ------------------------------------------------------------------------------------------------------

    def _stopped(self) -> str:
        self._cell.make_idle()
        self._cell.command("start")
        wait_until("the arm moves", self._cell.arm_moves, _PATIENCE_S)
        group = _cgroup()
        started_s = time.monotonic()
        run("systemctl", "stop", UNIT)
        took_s = time.monotonic() - started_s
        assert took_s < _STOP_LIMIT_S, f"took {took_s:.1f} s"
        assert not self._cell.arm_moves(), "the arm still moves"
        assert _shown("Result") == "success", _shown("Result")
        assert not group.exists(), f"{group} has {(group / 'cgroup.procs').read_text(encoding='ascii')}"
        user = pwd.getpwnam("srvs-cell").pw_uid
        left = [path.name for path in Path("/proc").glob("[0-9]*") if path.stat().st_uid == user]
        assert not left, f"processes left: {left}"
        assert not SOCKET.exists(), "the socket is still there"
        with closing(sqlite3.connect(STATE_DIR / "journal.sqlite")) as journal:
            sound = journal.execute("PRAGMA integrity_check").fetchone()[0]
        assert sound == "ok", sound
        return f"after {took_s:.1f} s of {_STOP_LIMIT_S:.0f} s; the arm stands still, no process is left, journal sound"

    @staticmethod
    def begin_wrong_start() -> str:
        """Start it with an unknown key in its config; do not wait."""
        run("systemctl", "reset-failed", UNIT, check=False)
        sound = CONFIG.read_text(encoding="utf-8")
        CONFIG.write_text(sound.replace("baseline_mm:", "baseline_cm:"), encoding="utf-8")
        run("systemctl", "start", "--no-block", UNIT)
        return "its process runs"

    @staticmethod
    def wrong_start() -> str:
        """Wait until that start has ended, and longer than it would take to be tried again."""
        _settled()
        time.sleep(3.0)  # longer than RestartSec
        found = _shown("ActiveState"), _shown("ExecMainStatus"), _shown("NRestarts")
        assert found == ("failed", "2", "0"), found
        journal = run("journalctl", "--unit", UNIT, "--no-pager", "--output", "cat", "--lines", "20")
        assert "baseline_cm" in journal, journal
        return "failed with exit code 2, not restarted; the journal names the key"


def _settled() -> None:
    """Wait until the service serves or has failed."""
    wait_until("the end of its start", lambda: _shown("ActiveState") in {"active", "failed"}, _PATIENCE_S)


def _cgroup() -> Path:
    """Return the folder of the unit's control group."""
    return Path("/sys/fs/cgroup") / _shown("ControlGroup").lstrip("/")


def _shown(name: str) -> str:
    """Return one property of the unit."""
    return run("systemctl", "show", "--property", name, "--value", UNIT)
