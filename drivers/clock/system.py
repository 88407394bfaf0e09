"""The real clock: the kernel's monotonic time."""

from __future__ import annotations

import asyncio
import contextlib
import time
from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict

from srvs_cell.ports import DriverContext, DriverSpec

if TYPE_CHECKING:
    from contextlib import AbstractContextManager


class SystemClockConfig(BaseModel):
    """The system clock has nothing to set."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class SystemClock:
    """Clock on CLOCK_MONOTONIC, which V4L2 stamps frames with too."""

    def now_s(self) -> float:
        """Return monotonic seconds."""
        return time.monotonic()

    async def sleep(self, seconds: float) -> None:
        """Return after ``seconds``."""
        await asyncio.sleep(seconds)

    def working(self) -> AbstractContextManager[None]:
        """Do nothing: real time waits for nobody."""
        return contextlib.nullcontext()


def _make(_config: SystemClockConfig, _context: DriverContext) -> SystemClock:
    return SystemClock()


DRIVER = DriverSpec(SystemClockConfig, _make)
