"""The sign of life: given while the unit turns, and waited for as long as a round of the unit may take."""

from __future__ import annotations

import asyncio
import itertools
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import pytest

from srvs_cell.config import CellConfig, load_config
from srvs_cell.service import watchdog

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).parents[2]


def config(name: str, status_interval_s: float = 0.5, **arm: float) -> CellConfig:
    """A shipped config with some settings changed."""
    shipped = load_config(ROOT / "configs" / f"cell.{name}.yaml")
    device = shipped.devices.arm
    settings = device.settings.model_copy(update=arm)
    devices = replace(shipped.devices, arm=replace(device, settings=settings))
    return replace(shipped, cell=replace(shipped.cell, status_interval_s=status_interval_s), devices=devices)


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What the service manager hears; it waits 15 s for a sign of life."""
    heard: list[str] = []
    note: Callable[[str], None] = heard.append
    monkeypatch.setattr("srvs_cell.service.watchdog.notify", note)
    monkeypatch.setattr("srvs_cell.service.systemd.notify", note)
    monkeypatch.setenv("WATCHDOG_USEC", "15000000")
    monkeypatch.delenv("WATCHDOG_PID", raising=False)
    return heard


def test_the_shipped_unit_is_patient_enough_for_modbus(sent: list[str]) -> None:
    unit = (ROOT / "systemd" / "srvs-cell.service").read_text(encoding="utf-8")
    assert "\nWatchdogSec=15\n" in unit
    assert watchdog.settle_period_s(config("fanuc-modbus")) == 15.0
    assert sent == []


@pytest.mark.parametrize(
    ("cell", "least_s"),
    [
        (config("fanuc-modbus", status_interval_s=8.0, timeout_s=1.0), 1.5 * (8.0 + 2.0)),
        (config("fanuc-modbus", status_interval_s=0.5, timeout_s=9.0), 1.5 * (0.5 + 18.0)),
        (config("fanuc-rmi", abort_timeout_s=60.0, timeout_s=2.0), 1.5 * (0.5 + 60.0 + 6.0)),
    ],
)
def test_a_period_that_would_kill_a_healthy_daemon_is_lengthened_and_said(
    cell: CellConfig, least_s: float, sent: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert watchdog.settle_period_s(cell) == least_s
    assert sent == [f"WATCHDOG_USEC={round(least_s * 1e6)}"]
    said = capsys.readouterr()
    assert "WatchdogSec is too short" in said.out + said.err


def test_the_end_is_bounded_by_the_time_to_stop_and_not_by_signs_of_life(sent: list[str]) -> None:
    unit = (ROOT / "systemd" / "srvs-cell.service").read_text(encoding="utf-8")
    to_stop_s = float(unit.split("\nTimeoutStopSec=")[1].split("\n")[0])
    watchdog.end_watch(None)
    assert sent == []
    watchdog.end_watch(15.0)
    watchdog.end_watch(600.0)
    lengthened_s = [float(line.removeprefix("WATCHDOG_USEC=")) / 1e6 for line in sent]
    assert lengthened_s[0] > to_stop_s
    assert lengthened_s[1] == 600.0


def test_a_driver_that_does_not_say_how_patient_it_is_changes_nothing(sent: list[str]) -> None:
    cell = config("fanuc-modbus", status_interval_s=9.0)
    arm = replace(cell.devices.arm, settings=cell.devices.gripper.settings)
    assert watchdog.settle_period_s(replace(cell, devices=replace(cell.devices, arm=arm))) == 15.0
    assert sent == []


def test_without_a_service_manager_there_is_no_period(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WATCHDOG_USEC", raising=False)
    assert watchdog.settle_period_s(config("fanuc-rmi")) is None


@pytest.mark.parametrize("turn_s", [0.5, 3.0, 9.9])
async def test_signs_come_in_time_as_long_as_the_period_is_not_too_short(
    turn_s: float, sent: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A unit that turns every ``turn_s``: no silence is longer than the 15 s that one and a half rounds stay under."""
    unit, life, now_s = SimpleNamespace(turns=0), asyncio.create_task(asyncio.Event().wait()), 0.0
    signs: list[float] = []
    monkeypatch.setattr("srvs_cell.service.watchdog.notify", lambda _: signs.append(now_s))

    async def sleep(seconds: float) -> None:
        nonlocal now_s
        now_s += seconds
        unit.turns = int(now_s / turn_s)
        if now_s > 300.0:
            life.cancel()
        await asyncio.get_running_loop().run_in_executor(None, int)

    monkeypatch.setattr("asyncio.sleep", sleep)
    await watchdog.feed_watchdog(unit, life, 15.0)  # type: ignore[arg-type]
    assert max(b - a for a, b in itertools.pairwise(signs)) < 15.0
    assert sent == []


async def test_a_unit_that_does_not_turn_gets_no_sign_of_life(sent: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    unit = SimpleNamespace(turns=1)
    slept = 0

    async def sleep(_: float) -> None:
        nonlocal slept
        slept += 1
        unit.turns += slept < 3  # it turns twice, then it is stuck
        if slept == 6:
            life.cancel()
        await asyncio.get_running_loop().run_in_executor(None, int)

    life = asyncio.create_task(asyncio.Event().wait())
    monkeypatch.setattr("asyncio.sleep", sleep)
    await watchdog.feed_watchdog(unit, life, 15.0)  # type: ignore[arg-type]
    assert sent == ["WATCHDOG=1"] * 3
