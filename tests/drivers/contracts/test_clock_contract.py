"""What every Clock promises."""

import asyncio
from collections.abc import Callable
from itertools import pairwise

import pytest

from drivers.clock.system import SystemClock
from drivers.sim.doubles import StepClock
from srvs_cell.ports import Clock
from tests.drivers.stepped import SteppedClock, SteppedTime

TICK_S = 0.002

CLOCKS: dict[str, Callable[[], Clock]] = {
    "system": SystemClock,
    "step": StepClock,
    "stepped": lambda: SteppedClock(SteppedTime()),
}


@pytest.fixture(params=sorted(CLOCKS))
def clock(request: pytest.FixtureRequest) -> Clock:
    return CLOCKS[request.param]()


def test_it_is_a_clock(clock: Clock) -> None:
    assert isinstance(clock, Clock)


async def test_time_does_not_go_back_and_a_sleep_takes_at_least_its_time(clock: Clock) -> None:
    times = [clock.now_s()]
    for _ in range(3):
        await clock.sleep(TICK_S)
        times.append(clock.now_s())
    assert all(later - earlier >= TICK_S * 0.999 for earlier, later in pairwise(times))


async def test_who_sleeps_less_wakes_first(clock: Clock) -> None:
    woken: list[int] = []

    async def sleeper(number: int) -> None:
        await clock.sleep(number * TICK_S)
        woken.append(number)

    await asyncio.gather(sleeper(3), sleeper(1), sleeper(2))
    assert woken == [1, 2, 3]


async def test_a_sleep_can_be_cancelled_and_does_not_disturb_others(clock: Clock) -> None:
    begun_s = clock.now_s()
    long = asyncio.create_task(clock.sleep(1e6))
    await clock.sleep(TICK_S)
    long.cancel()
    with pytest.raises(asyncio.CancelledError):
        await long
    await clock.sleep(TICK_S)
    assert clock.now_s() - begun_s < 1e5


async def test_work_is_a_block_that_may_be_nested(clock: Clock) -> None:
    with clock.working(), clock.working():
        begun_s = clock.now_s()
    assert clock.now_s() - begun_s < 1.0
    await clock.sleep(TICK_S)
