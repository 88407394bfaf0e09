"""The sign of life that the service manager waits for, and for how long it has to.

The daemon looks three times a period whether the unit's loops have turned, and says so. A round of the unit lasts the
status interval and the reading of the arm, so that signs come at the latest after a round and a third of the period:
a period shorter than one and a half rounds would kill a daemon that is well.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

import structlog

from srvs_cell.ports import KnowsItsPatience
from srvs_cell.service.systemd import ask_for_watchdog_period, notify, watchdog_period_s

if TYPE_CHECKING:
    from srvs_cell.cell import Unit
    from srvs_cell.config import CellConfig

_SIGNS_PER_PERIOD: Final = 3
_ROUNDS_PER_PERIOD: Final = _SIGNS_PER_PERIOD / (_SIGNS_PER_PERIOD - 1)

_END_S: Final = 120.0
"""More than the unit file's TimeoutStopSec."""

_log = structlog.stdlib.get_logger("srvs_cell.watchdog")


def least_period_s(config: CellConfig) -> float | None:
    """Return the shortest WatchdogSec that leaves a healthy daemon alone; None where the arm's driver does not say."""
    settings = config.devices.arm.settings
    if not isinstance(settings, KnowsItsPatience):
        return None
    return _ROUNDS_PER_PERIOD * (config.cell.status_interval_s + settings.longest_reading_s)


def settle_period_s(config: CellConfig) -> float | None:
    """Return the period in force, lengthened where the config needs a longer one; None without a watchdog."""
    given_s, least_s = watchdog_period_s(), least_period_s(config)
    if given_s is None or least_s is None or given_s > least_s:
        return given_s
    _log.warning(
        "WatchdogSec is too short for this config and is lengthened; set it so in the unit file",
        watchdog_sec=given_s,
        lengthened_to_s=least_s,
        status_interval_s=config.cell.status_interval_s,
        arm=config.devices.arm.driver,
        longest_reading_s=least_s / _ROUNDS_PER_PERIOD - config.cell.status_interval_s,
    )
    ask_for_watchdog_period(least_s)
    return least_s


def end_watch(period_s: float | None) -> None:
    """Leave the end to TimeoutStopSec: a computation that is under way is waited for without signs of life."""
    if period_s is not None:
        ask_for_watchdog_period(max(period_s, _END_S))


async def feed_watchdog(unit: Unit, life: asyncio.Task[None], period_s: float | None) -> None:
    """Give the sign of life while the unit's task lives and its loops have turned since the last sign.

    A blocked event loop is silent, and so is a unit that waits for something that never comes.
    """
    told = None
    while period_s is not None and not life.done():
        if (turns := unit.turns) != told:
            notify("WATCHDOG=1")
            told = turns
        await asyncio.sleep(period_s / _SIGNS_PER_PERIOD)
    await asyncio.wait({life})
