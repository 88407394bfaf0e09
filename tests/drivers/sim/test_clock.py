"""Who decides how fast simulated time runs."""

from __future__ import annotations

import asyncio
import threading
import time
from typing import TYPE_CHECKING

import pytest

from drivers.sim.clock_authority import SimTime
from drivers.sim.clock_client import DRIVER, SimClock, SimClockConfig
from drivers.sim.clock_page import NO_WAKE_S, ClockPage
from drivers.sim.world_model import TIMESTEP_S
from srvs_cell.alarms import Alarm
from srvs_cell.ports import Clock, DriverContext, NotConnectedError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

SPEED = 50.0


class Stepper:
    """A world in which nothing happens but time."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def step(self) -> float:
        self.now_s += TIMESTEP_S
        return self.now_s


@pytest.fixture
def page(tmp_path: Path) -> Iterator[ClockPage]:
    page = ClockPage.create(tmp_path / "clock")
    yield page
    page.close()


@pytest.fixture
def sim_time(page: ClockPage) -> Iterator[SimTime]:
    sim_time = SimTime(Stepper().step, page, SPEED)
    yield sim_time
    sim_time.close()


def test_time_runs_fast_only_while_the_daemon_waits(sim_time: SimTime, page: ClockPage) -> None:
    assert sim_time._rate() == 1.0
    page.wake_s = 10.0
    assert sim_time._rate() == SPEED
    page.working = 1
    assert sim_time._rate() == 1.0


def test_time_stands_still_while_held(sim_time: SimTime, page: ClockPage) -> None:
    page.wake_s = 10.0
    with sim_time.hold(), sim_time.hold():
        assert sim_time._rate() == 0.0
    assert sim_time._rate() == SPEED


def test_time_does_not_run_past_the_instant_at_which_the_daemon_wants_to_wake(
    sim_time: SimTime, page: ClockPage
) -> None:
    page.wake_s = 2.5 * TIMESTEP_S
    with sim_time.lock:
        assert sim_time._advance(1.0) == 3
    assert page.now_s == pytest.approx(3 * TIMESTEP_S)
    assert sim_time._rate() == 1.0


def test_while_time_is_held_no_step_is_made(page: ClockPage) -> None:
    sim_time = SimTime(Stepper().step, page, SPEED)
    page.wake_s = 1e6
    sim_time.start()
    try:
        with sim_time.lock:
            sim_time.lock.wait_for(lambda: sim_time.now_s() > 0.1, 10.0)
        with sim_time.hold():
            before_s, beat_s = sim_time.now_s(), page.beat_s
            while page.beat_s < beat_s + 0.02:
                time.sleep(0)
            assert sim_time.now_s() == before_s
        with sim_time.lock:
            assert sim_time.lock.wait_for(lambda: sim_time.now_s() > before_s, 10.0)
    finally:
        sim_time.close()


def test_a_task_that_was_woken_keeps_time_from_running_until_it_sleeps_again(page: ClockPage) -> None:
    sim_time = SimTime(Stepper().step, page, SPEED)
    page.wake_s = 1e6
    seen: list[float] = []

    def task() -> None:
        for _ in range(20):
            before_s = sim_time.now_s()
            sim_time.sleep(0.02)
            seen.append(sim_time.now_s() - before_s)

    thread = threading.Thread(target=task)
    sim_time.start()
    thread.start()
    thread.join(10.0)
    sim_time.close()
    assert len(seen) == 20
    assert seen[1:] == pytest.approx([0.02] * 19, abs=1.1 * TIMESTEP_S)


def test_at_the_end_of_time_every_sleeper_returns(page: ClockPage) -> None:
    sim_time = SimTime(Stepper().step, page, 1.0)
    thread = threading.Thread(target=lambda: sim_time.sleep(1e6))
    thread.start()
    sim_time.close()
    thread.join(10.0)
    assert not thread.is_alive()


async def test_the_clients_sleep_lasts_as_long_as_it_should(tmp_path: Path, page: ClockPage) -> None:
    sim_time = SimTime(Stepper().step, page, SPEED)
    sim_time.start()
    try:
        clock = DRIVER.factory(SimClockConfig(path=tmp_path / "clock"), DriverContext(SimClock(tmp_path / "clock")))
        assert isinstance(clock, Clock)
        start_s, real_s = clock.now_s(), time.monotonic()
        await asyncio.gather(clock.sleep(1.0), clock.sleep(4.0))
        assert 4.0 <= clock.now_s() - start_s < 4.5
        assert time.monotonic() - real_s < 3.0
        assert page.wake_s == NO_WAKE_S
    finally:
        sim_time.close()


def test_working_is_counted_on_the_page(tmp_path: Path, page: ClockPage) -> None:
    clock = SimClock(tmp_path / "clock")
    with clock.working(), clock.working():
        assert page.working == 2
    assert page.working == 0


async def test_a_simulator_without_a_beat_is_lost(
    tmp_path: Path, page: ClockPage, monkeypatch: pytest.MonkeyPatch
) -> None:
    page.beat_s = 1.0
    real_s = iter(range(1000))
    monkeypatch.setattr("drivers.sim.clock_client.time.monotonic", lambda: float(next(real_s)))
    with pytest.raises(NotConnectedError) as caught:
        await SimClock(tmp_path / "clock").sleep(1.0)
    assert caught.value.alarm is Alarm.CLOCK_LOST


@pytest.mark.parametrize("content", [b"", b"too short", bytes(4096)])
def test_what_is_no_clock_page_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "page"
    path.write_bytes(content)
    with pytest.raises(NotConnectedError, match="clock page") as caught:
        SimClock(path).now_s()
    assert caught.value.alarm is Alarm.CLOCK_LOST
    assert str(path) in str(caught.value)
