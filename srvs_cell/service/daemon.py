"""The composition root: config in, devices, journal, unit and API out; signals, systemd and a tidy end."""

from __future__ import annotations

import asyncio
import platform
import signal
from contextlib import ExitStack
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import structlog
from pydantic_core import to_jsonable_python

from srvs_cell import __version__
from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell import WAIT_STATES, Command
from srvs_cell.service.api import create_app
from srvs_cell.service.equipment import make_unit
from srvs_cell.service.listeners import lock, make_directory, serving, tcp_listener, unix_listener
from srvs_cell.service.logs import configure_logs
from srvs_cell.service.systemd import notify
from srvs_cell.service.watchdog import end_watch, feed_watchdog, settle_period_s

if TYPE_CHECKING:
    import socket

    from srvs_cell.cell import Unit
    from srvs_cell.config import CellConfig, ServiceConfig

_LOOPBACK = "127.0.0.1"
_RUNS = "runs"
_STOP_S, _ABORT_S, _LEAVE_S = 10.0, 5.0, 5.0  # together less than the unit file's TimeoutStopSec
_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)  # the last one comes when a terminal is closed
_LOGGED_PACKAGES = ("numpy", "opencv-python-headless", "scipy", "pymodbus", "pydantic", "fastapi", "uvicorn")
_WAIT_TITLES = frozenset(state.title for state in WAIT_STATES)

_log = structlog.stdlib.get_logger("srvs_cell.daemon")


def run_daemon(config: CellConfig, service: ServiceConfig) -> None:
    """Serve the cell until SIGTERM, SIGINT or SIGHUP.

    Args:
        config: the cell.
        service: where to listen and to keep the journal; the config's own, or with the command line's changes.

    Raises:
        AlarmError: CONFIG_INVALID, ALREADY_RUNNING, CALIBRATION_INVALID before anything is served; INTERNAL_ERROR
            where the unit or a listener ends by itself.
    """
    configure_logs()
    _log.info(
        "starting",
        version=__version__,
        python=platform.python_version(),
        kernel=platform.release(),
        packages={package: version(package) for package in _LOGGED_PACKAGES},
        config=config.source,
        effective=_effective(config, service),
    )
    asyncio.run(_serve(config, service))


def _effective(config: CellConfig, service: ServiceConfig) -> Any:
    """Return the configuration in force, so that any log file can be understood by itself."""
    devices = {device.role: {"driver": device.driver, "settings": device.settings} for device in config.devices}
    rooms = {"cell": config.cell, "vision": config.vision, "planning": config.planning}
    return to_jsonable_python({**rooms, "devices": devices, "calibration": config.calibration, "service": service})


async def _serve(config: CellConfig, service: ServiceConfig) -> None:
    stopping = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in _SIGNALS:
        loop.add_signal_handler(number, stopping.set)
    with ExitStack() as stack:
        make_directory(service.state_dir)
        stack.enter_context(lock(service.state_dir / "daemon.lock", f"The state folder {service.state_dir}"))
        unix = stack.enter_context(unix_listener(service.socket))
        tcp = None if service.tcp_port is None else stack.enter_context(tcp_listener(_LOOPBACK, service.tcp_port))
        unit = make_unit(config, service.state_dir)
        try:
            await _operate(unit, service, unix, tcp, stopping, settle_period_s(config))
        finally:
            await unit.close()
            _log.info("stopped")


async def _operate(
    unit: Unit,
    service: ServiceConfig,
    unix: socket.socket,
    tcp: socket.socket | None,
    stopping: asyncio.Event,
    watchdog_s: float | None,
) -> None:
    """Run the unit and serve the API until ``stopping`` is set or something ends that should not."""
    closing = asyncio.Event()
    page_url = None if tcp is None else f"http://{_LOOPBACK}:{tcp.getsockname()[1]}/"
    app = create_app(unit, unit.journal, service.state_dir / _RUNS, closing=closing, page_url=page_url)
    # a command that comes at once must meet a unit that knows what the gripper holds
    await unit.open()
    async with serving(app, unix, tcp) as servers:
        life = asyncio.create_task(unit.run())
        stop = asyncio.create_task(stopping.wait())
        helpers = (asyncio.create_task(_tell_status(unit)), asyncio.create_task(feed_watchdog(unit, life, watchdog_s)))
        _log.info("serving", socket=str(service.socket), page=page_url)
        notify("READY=1")
        try:
            ended, _ = await asyncio.wait({life, stop, *servers, *helpers}, return_when=asyncio.FIRST_COMPLETED)
            _log_failures(ended)
        finally:
            notify("STOPPING=1")
            end_watch(watchdog_s)
            _log.info("stopping", asked=stopping.is_set(), state=unit.snapshot()["state"])
            await _end(unit, life)
            closing.set()
            for task in (stop, *helpers):
                task.cancel()
    if not stopping.is_set():
        raise AlarmError(Alarm.INTERNAL_ERROR, "A part of the daemon has ended by itself; the log says which.")


async def _end(unit: Unit, life: asyncio.Task[None]) -> None:
    """Ask what moves to stop, wait for it within bounds, let go of the devices."""
    for command, timeout_s in ((Command.STOP, _STOP_S), (Command.ABORT, _ABORT_S)):
        if life.done() or unit.snapshot()["state"] in _WAIT_TITLES:
            break
        await unit.command(command, "daemon: asked to end")
        try:
            async with asyncio.timeout(timeout_s):
                await _wait_state(unit)
        except TimeoutError:
            _log.warning("did not end in time", command=command.title, timeout_s=timeout_s)
    life.cancel()
    done, _ = await asyncio.wait({life}, timeout=_LEAVE_S)
    _log_failures(done)
    if not done:
        _log.error("the devices were not let go in time", timeout_s=_LEAVE_S)


def _log_failures(tasks: set[asyncio.Task[Any]]) -> None:
    for task in tasks:
        if not task.cancelled() and (error := task.exception()) is not None:
            _log.error("a part of the daemon failed", exc_info=error)


async def _wait_state(unit: Unit) -> None:
    while (snapshot := unit.snapshot())["state"] not in _WAIT_TITLES:
        await unit.wait_change(snapshot["version"])


async def _tell_status(unit: Unit) -> None:
    """Tell the service manager and the log each change of state."""
    told = ""
    while True:
        snapshot = unit.snapshot()
        status = f"{snapshot['state']}, {snapshot['mode']}" + (", SIMULATION" if snapshot["simulation"] else "")
        if status != told:
            notify(f"STATUS={status}")
            _log.info("state", state=snapshot["state"], mode=snapshot["mode"], alarms=snapshot["alarms"])
            told = status
        await unit.wait_change(snapshot["version"])
