"""Doubles in the wall's time, free ports, and what a judgement is."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import time
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING

from drivers.clock.system import SystemClock

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from srvs_cell.ports import Clock


class SkippedError(Exception):
    """A peer that cannot be had here; the text says why."""


@dataclass(frozen=True)
class Judgement:
    """One row of the table.

    Attributes:
        wire: what was judged.
        peer: what judged it.
        result: what came of it.
        passed: whether it is what the protocol demands; None where the peer could not be had.
    """

    wire: str
    peer: str
    result: str
    passed: bool | None


class WallTime:
    """Time for the doubles' threads that cannot be stopped."""

    def now_s(self) -> float:
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)

    @contextlib.contextmanager
    def hold(self) -> Iterator[None]:
        yield

    def hold_while(self, _unread: Callable[[], bool]) -> None:
        pass


def wall_clock() -> Clock:
    return SystemClock()


def free_ports(count: int) -> list[int]:
    """Return ports that nobody listens on now."""
    with contextlib.ExitStack() as stack:
        listeners = [stack.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(count)]
        return [int(listener.getsockname()[1]) for listener in listeners]


@contextlib.contextmanager
def running(command: Sequence[str]) -> Iterator[tuple[IO[str], IO[str]]]:
    """Run a peer that says a line when it listens; yields its stdin and stdout, and ends it."""
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        if not process.stdout.readline():
            raise SkippedError(f"{command[0]} did not start")
        yield process.stdin, process.stdout
    finally:
        process.kill()
        process.communicate()
