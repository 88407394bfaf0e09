"""Small programs, and a controller for them that is nothing but data."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.sim.tp import TpAlarm, TpMachine, load

if TYPE_CHECKING:
    from collections.abc import Sequence


def program(name: str, *lines: str, group: str = "1", ignore: int = 0, position: str = "") -> str:
    """An .LS file of these lines."""
    numbered = [f"{n:4}:{'' if line[:2] in ('L ', 'J ') else '  '}{line} ;" for n, line in enumerate(lines, start=1)]
    return "\n".join(
        [
            f"/PROG  {name}",
            "/ATTR",
            'COMMENT\t\t= "test";',
            f"LINE_COUNT\t= {len(lines)};",
            "TCD:  STACK_SIZE\t= 0,",
            f"      ABORT_REQUEST\t= {ignore},",
            f"      PAUSE_REQUEST\t= {ignore};",
            f"DEFAULT_GROUP\t= {group},*,*,*,*;",
            "/MN",
            *numbered,
            "/POS",
            *([position] if position else []),
            "/END",
            "",
        ]
    )


class Devices:
    """Signals in a dict, an arm that moves for a second."""

    def __init__(self) -> None:
        self.signals: dict[tuple[str, int], bool] = {}
        self.frames: list[tuple[str, int]] = []
        self.moves: list[tuple[tuple[float, ...], float, bool]] = []
        self.moving = self.stopped_short = False
        self.refusal: str | None = None

    def signal(self, kind: str, number: int) -> bool:
        return self.signals.get((kind, number), False)

    def set_signal(self, kind: str, number: int, on: bool) -> None:
        self.signals[kind, number] = on

    def variable(self, name: str) -> int:
        return {"$MNUFRAMENUM[1]": 4}[name]

    def select_frame(self, name: str, number: int) -> None:
        self.frames.append((name, number))

    def position(self) -> tuple[float, ...]:
        return (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)

    def start(self, position: Sequence[float], speed: float, *, joint: bool) -> None:
        if self.refusal is not None:
            raise TpAlarm(self.refusal)
        self.moves.append((tuple(position), speed, joint))
        self.moving = True

    def stop(self) -> None:
        self.moving = False


class Bench:
    """A machine with the program MAIN, and others."""

    def __init__(self, *lines: str, others: dict[str, str] | None = None) -> None:
        self.devices = Devices()
        sources = {"MAIN.LS": program("MAIN", *lines), **(others or {})}
        self.machine = TpMachine(load(sources), self.devices)
        self.now_s = 0.0
        self.machine.run("MAIN", 0.0)

    def go(self, seconds: float = 0.1) -> str | None:
        self.now_s += seconds
        return self.machine.catch_up(self.now_s)

    def r(self, index: int) -> float:
        return self.machine.memory.registers.get(index, 0)

    @property
    def runs(self) -> bool:
        return self.machine.running("MAIN")
